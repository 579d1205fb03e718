// A page of Galacean: window.show() draws a model and returns the normals of its vertices.

import { AssetType, Camera, DirectLight, Quaternion, SkinnedMeshRenderer, WebGLEngine } from '@galacean/engine';
import { registerSkinbake, report } from 'skinbake-galacean';

CAPTURE.names = ['v_normal'];

window.show = async ({ url, pose }) => {
    registerSkinbake();
    const canvas = document.createElement('canvas');
    document.body.append(canvas);
    const engine = await WebGLEngine.create({ canvas });
    const root = engine.sceneManager.scenes[0].createRootEntity();
    root.createChild().addComponent(Camera).enableFrustumCulling = false;
    root.createChild().addComponent(DirectLight);
    const resource = await engine.resourceManager.load({ url, type: AssetType.GLTF });
    const entity = resource.instantiateSceneRoot();
    root.addChild(entity);
    const [renderer] = entity.getComponentsIncludeChildren(SkinnedMeshRenderer, []);
    for (const [joint, [w, x, y, z]] of pose.turned.entries()) {
        const { transform } = renderer.skin.bones[joint];
        const turned = new Quaternion();
        Quaternion.multiply(transform.rotationQuaternion, new Quaternion(x, y, z, w), turned);
        transform.rotationQuaternion = turned;
    }
    for (let frame = 0; frame < 3; frame++) {
        CAPTURE.draws = [];
        CAPTURE.on = true;
        engine.update();
        CAPTURE.on = false;
    }
    const [{ lighting, reason }] = report(entity);
    return { values: [...CAPTURE.draws[0].values], report: [lighting, reason] };
};
