// What the tests call in the browser: PlayCanvas plays a clip as a page does, with none of our code but what a page
// sets as window.optionsFor.

import * as pc from 'playcanvas';
import { base64 } from '/support/base64.mjs';

CAPTURE.names = ['vNormalW'];

const canvas = document.createElement('canvas');
canvas.width = canvas.height = 64;
document.body.append(canvas);
const device = await pc.createGraphicsDevice(canvas, { deviceTypes: ['webgl2'], antialias: false });
const options = new pc.AppOptions();
options.graphicsDevice = device;
const { AnimComponentSystem, RenderComponentSystem, CameraComponentSystem, LightComponentSystem } = pc;
options.componentSystems = [AnimComponentSystem, RenderComponentSystem, CameraComponentSystem, LightComponentSystem];
const { AnimClipHandler, ContainerHandler, RenderHandler, TextureHandler } = pc;
options.resourceHandlers = [TextureHandler, ContainerHandler, AnimClipHandler, RenderHandler];
const app = new pc.AppBase(canvas);
app.init(options);
app.start();
app.autoRender = false;
const sun = new pc.Entity();
sun.addComponent('light', { type: 'directional' });
const camera = new pc.Entity();
camera.addComponent('camera', {});
camera.setPosition(0, 0, 10);
app.root.addChild(sun);
app.root.addChild(camera);

async function loaded(url, options) {
    const asset = new pc.Asset(url, 'container', { url, filename: url.split('/').pop() }, null, options);
    app.assets.add(asset);
    await new Promise((resolve, reject) => {
        asset.ready(resolve);
        asset.once('error', (error) => reject(new Error(error)));
        app.assets.load(asset);
    });
    return asset;
}

// The normals that each draw hands on, in the scene. isPrecise: morph targets in floats, not in half floats. The page sets
// weights of the morph targets of a node first, and runs code of documentation last. The clip may be from another file,
// clipsOf.
window.played = async ({ url, clip, time, clipsOf, isPrecise = false, node, weights = [], code = '' }) => {
    const others = { morphPreferHighPrecision: isPrecise };
    const options = window.optionsFor?.(app, {}, others) ?? others;
    const asset = await loaded(url, options);
    const other = clipsOf ? await loaded(clipsOf, options) : asset;
    const entity = asset.resource.instantiateRenderEntity();
    app.root.addChild(entity);
    const morphed = entity.findByName(node)?.render.meshInstances[0].morphInstance;
    weights.forEach((weight, target) => morphed.setWeight(target, weight));
    entity.addComponent('anim', { activate: true });
    entity.anim.assignAnimation('clip', other.resource.animations[clip].resource, undefined, 1, false);
    entity.anim.baseLayer.play('clip');
    entity.anim.baseLayer.activeStateCurrentTime = time;
    for (const { meshInstances } of entity.findComponents('render')) {
        for (const instance of meshInstances) instance.cull = false;
    }
    app.update(0);
    new Function('entity', code)(entity);
    app.render();
    CAPTURE.draws = [];
    CAPTURE.on = true;
    app.render();
    CAPTURE.on = false;
    const draws = CAPTURE.draws.map(({ values }) => base64(values));
    entity.destroy();
    for (const one of new Set([asset, other])) {
        app.assets.remove(one);
        one.unload();
    }
    return draws;
};
