// What the tests call in the browser: Filament plays a clip as a page does, with none of our code.

import { base64 } from '/support/base64.mjs';

CAPTURE.names = ['vertex_worldNormal'];

const SIZE = 64;
const canvas = document.createElement('canvas');
canvas.width = canvas.height = SIZE;
document.body.append(canvas);
await new Promise((done) => Filament.init([], done));
const engine = Filament.Engine.create(canvas);
const swapChain = engine.createSwapChain();
const renderer = engine.createRenderer();
const view = engine.createView();
const camera = engine.createCamera(Filament.EntityManager.get().create());
view.setCamera(camera);
view.setViewport([0, 0, SIZE, SIZE]);
camera.setProjectionFov(45, 1, 0.1, 100, Filament.Camera$Fov.VERTICAL);
camera.lookAt([0, 0, 10], [0, 0, 0], [0, 1, 0]);

// The normals that each draw hands on, in the scene.
window.played = async ({ url, clip, time }) => {
    const scene = engine.createScene();
    view.setScene(scene);
    const asset = engine.createAssetLoader().createAsset(new Uint8Array(await (await fetch(url)).arrayBuffer()));
    await new Promise((done) => asset.loadResources(done));
    const sun = Filament.EntityManager.get().create();
    Filament.LightManager.Builder(Filament.LightManager$Type.SUN).direction([0, -1, -1]).build(engine, sun);
    scene.addEntity(sun);
    scene.addEntities(asset.getEntities());
    const animator = asset.getInstance().getAnimator();
    animator.applyAnimation(clip, time);
    animator.updateBoneMatrices();
    const frame = async () => {
        renderer.render(swapChain, view);
        engine.execute();
        await new Promise(requestAnimationFrame);
    };
    CAPTURE.draws = [];
    for (let i = 0; i < 10; i++) await frame(); // Programs are compiled beside the page.
    CAPTURE.on = true;
    for (let i = 0; i < 100 && !CAPTURE.draws.length; i++) await frame();
    CAPTURE.on = false;
    return CAPTURE.draws.map(({ values }) => base64(values));
};
