// What the tests call in the browser: three.js plays a clip as a page does, with none of our code but what a page sets as
// window.plugin. "three" is the module of WebGLRenderer or that of WebGPURenderer, by the page's import map.

import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { base64 } from '/support/base64.mjs';

const SIZE = 64;
const renderers = {};

async function rendererOf(backend) {
    if (renderers[backend]) return renderers[backend];
    const { WebGLRenderer, WebGPURenderer } = THREE;
    const options = { antialias: false, forceWebGL: backend !== 'webgpu' };
    const renderer = WebGPURenderer ? new WebGPURenderer(options) : new WebGLRenderer(options);
    renderer.setSize(SIZE, SIZE);
    await renderer.init?.();
    if (WebGPURenderer) CAPTURE.names = ['v_normalViewGeometry'];
    return (renderers[backend] = renderer);
}

window.backend = async (name) => ((await rendererOf(name)).backend?.isWebGPUBackend ? 'webgpu' : 'webgl');

// The normals that each draw hands on, in the scene: the camera stands at the origin. The page sets weights of the morph
// targets of a node first, and stops the clip if it is asked to. The clip may be from another file, clipsOf.
window.played = async ({ url, clip, time, clipsOf, backend = 'webgl', node, weights = [], isStopped = false }) => {
    const renderer = await rendererOf(backend);
    const loader = new GLTFLoader();
    if (window.plugin) loader.register(window.plugin);
    const { scene: model, animations: own } = await loader.loadAsync(url);
    const animations = clipsOf ? (await loader.loadAsync(clipsOf)).animations : own;
    model.traverse((object) => (object.frustumCulled = false));
    const morphed = model.getObjectByName(node);
    weights.forEach((weight, target) => (morphed.morphTargetInfluences[target] = weight));
    const mixer = new THREE.AnimationMixer(model);
    mixer.clipAction(animations[clip]).play();
    mixer.setTime(time);
    if (isStopped) mixer.stopAllAction();
    const scene = new THREE.Scene();
    scene.add(model, new THREE.DirectionalLight());
    const camera = new THREE.PerspectiveCamera();
    const isWebGPU = renderer.backend?.isWebGPUBackend;
    // SwiftShader's WebGPU cannot present to a canvas.
    if (isWebGPU) renderer.setRenderTarget(new THREE.RenderTarget(SIZE, SIZE));
    for (let frame = 0; frame < 2; frame++) {
        renderer.render(scene, camera);
        await null;
    }
    const capture = isWebGPU ? WEBGPU_CAPTURE : CAPTURE;
    capture.draws = [];
    capture.on = true;
    renderer.render(scene, camera);
    capture.on = false;
    if (!isWebGPU) return CAPTURE.draws.map(({ values }) => base64(values));
    const read = [];
    for (const one of capture.draws) {
        const { name, varying } = await WEBGPU_CAPTURE.read(one);
        if (name) read.push(base64(varying.filter((_, index) => index % 4 < 3)));
    }
    return read;
};
