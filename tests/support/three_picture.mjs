// What the tests call in the browser: a picture of a model by three.js as its loader makes it, lit by what glows.

import * as THREE from 'three';
import { DRACOLoader } from 'three/addons/loaders/DRACOLoader.js';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { base64 } from '/support/base64.mjs';

const renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true, preserveDrawingBuffer: true });
const loader = new GLTFLoader().setDRACOLoader(new DRACOLoader().setDecoderPath('/three/examples/jsm/libs/draco/gltf/'));

// Draw a model at a time of its first clip, at rest without one. projected is the matrix to the screen, column by
// column. Returns the pixels, as base64, from the lowest row on.
window.drawn = async ({ url, time, projected, width, height }) => {
    renderer.setSize(width, height);
    const { scene, animations } = await loader.loadAsync(url);
    scene.traverse((node) => (node.frustumCulled = false)); // its boxes are of the pose at rest
    for (const clip of animations.slice(0, 1)) {
        const mixer = new THREE.AnimationMixer(scene);
        Object.assign(mixer.clipAction(clip).play(), { loop: THREE.LoopOnce, clampWhenFinished: true });
        mixer.setTime(time);
    }
    const camera = new THREE.Camera();
    camera.projectionMatrix.fromArray(projected);
    camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
    renderer.render(scene, camera);
    const gl = renderer.getContext();
    const pixels = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    return base64(pixels);
};
