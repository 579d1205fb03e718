// A page of three.js with WebGPURenderer: window.show() draws a model and returns the normals of its vertices.

import * as THREE from 'three/webgpu';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { SkinbakePlugin } from 'skinbake-three/webgpu';

window.show = async ({ url, pose, backend }) => {
    const loader = new GLTFLoader();
    loader.register((parser) => new SkinbakePlugin(parser));
    const { scene, animations, userData } = await loader.loadAsync(url);
    const mixer = new THREE.AnimationMixer(scene);
    mixer.clipAction(animations[pose.clip]).play();
    mixer.setTime(pose.time);
    scene.traverse((object) => (object.frustumCulled = false));
    const renderer = new THREE.WebGPURenderer({ forceWebGL: backend === 'webgl' });
    await renderer.init();
    const isWebGPU = renderer.backend.isWebGPUBackend === true;
    // SwiftShader's WebGPU cannot present to a canvas.
    if (isWebGPU) renderer.setRenderTarget(new THREE.RenderTarget(64, 64));
    const camera = new THREE.PerspectiveCamera();
    CAPTURE.names = ['v_normalViewGeometry'];
    const capture = isWebGPU ? WEBGPU_CAPTURE : CAPTURE;
    for (let frame = 0; frame < 3; frame++) {
        capture.draws = [];
        capture.on = true;
        renderer.render(scene, camera);
        capture.on = false;
        await null;
    }
    const [draw] = capture.draws;
    const values = isWebGPU
        ? (await WEBGPU_CAPTURE.read(draw)).varying.filter((_, index) => index % 4 < 3)
        : draw.values;
    const [{ mesh, lighting, reason }] = userData.skinbake;
    const used = isWebGPU ? 'webgpu' : 'webgl';
    return { values: [...values], report: [lighting, reason], world: mesh.matrixWorld.toArray(), backend: used };
};
