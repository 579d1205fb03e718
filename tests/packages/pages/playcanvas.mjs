// A page of PlayCanvas: window.show() draws a model and returns the normals of its vertices.

import * as pc from 'playcanvas';
import { skinbakeOptions, report } from 'skinbake-playcanvas';

CAPTURE.names = ['vNormalW'];

window.show = async ({ url, pose }) => {
    const canvas = document.createElement('canvas');
    document.body.append(canvas);
    const app = new pc.Application(canvas);
    app.start();
    app.autoRender = false;
    for (const kind of ['camera', 'light']) {
        const entity = new pc.Entity();
        entity.addComponent(kind, kind === 'light' ? { type: 'directional' } : {});
        app.root.addChild(entity);
    }
    const asset = new pc.Asset('hero', 'container', { url }, null, skinbakeOptions(app));
    app.assets.add(asset);
    await new Promise((resolve) => {
        asset.ready(resolve);
        app.assets.load(asset);
    });
    const entity = asset.resource.instantiateRenderEntity();
    app.root.addChild(entity);
    const [instance] = entity.findComponents('render').flatMap(({ meshInstances }) => meshInstances);
    instance.cull = false;
    for (const [joint, [w, x, y, z]] of pose.turned.entries()) {
        const bone = instance.skinInstance.bones[joint];
        bone.setLocalRotation(bone.getLocalRotation().clone().mul(new pc.Quat(x, y, z, w)));
    }
    app.update(0);
    for (let frame = 0; frame < 3; frame++) {
        CAPTURE.draws = [];
        CAPTURE.on = true;
        app.render();
        CAPTURE.on = false;
    }
    const [{ lighting, reason }] = report(entity);
    const world = [...instance.node.getWorldTransform().data];
    return { values: [...CAPTURE.draws[0].values], report: [lighting, reason], world };
};
