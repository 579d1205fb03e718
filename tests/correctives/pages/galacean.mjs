// What the tests call in the browser: Galacean plays a clip as a page does, with none of our code.

import { Animator, AssetType, Camera, DirectLight, WebGLEngine } from '@galacean/engine';
import { base64 } from '/support/base64.mjs';

CAPTURE.names = ['v_normal'];

const canvas = document.createElement('canvas');
canvas.width = canvas.height = 64;
document.body.append(canvas);
const started = WebGLEngine.create({ canvas }).then((engine) => {
    const root = engine.sceneManager.scenes[0].createRootEntity();
    root.createChild().addComponent(Camera).enableFrustumCulling = false;
    root.createChild().addComponent(DirectLight);
    return { engine, root };
});

// The normals that each draw hands on, in the scene.
window.played = async ({ url, clip, time }) => {
    const { engine, root } = await started;
    const resource = await engine.resourceManager.load({ url, type: AssetType.GLTF });
    const entity = resource.instantiateSceneRoot();
    root.addChild(entity);
    const animator = entity.getComponent(Animator);
    const { name, length } = resource.animations[clip];
    animator.play(name, 0, time / length);
    animator.speed = 0;
    engine.update();
    CAPTURE.draws = [];
    CAPTURE.on = true;
    engine.update();
    CAPTURE.on = false;
    const draws = CAPTURE.draws.map(({ values }) => base64(values));
    entity.destroy();
    return draws;
};
