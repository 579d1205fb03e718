// What the tests call in the browser: a picture of a model by three.js as its loader makes it, lit by what glows.

import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { base64 } from '/support/base64.mjs';

const renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true, preserveDrawingBuffer: true });

// Draw a model at a time of its first clip. projected is the matrix to the screen, column by column. Returns the
// pixels, as base64, from the lowest row on.
window.drawn = async ({ url, time, projected, width, height }) => {
    renderer.setSize(width, height);
    const { scene, animations } = await new GLTFLoader().loadAsync(url);
    const mixer = new THREE.AnimationMixer(scene);
    Object.assign(mixer.clipAction(animations[0]).play(), { loop: THREE.LoopOnce, clampWhenFinished: true });
    mixer.setTime(time);
    const camera = new THREE.Camera();
    camera.projectionMatrix.fromArray(projected);
    camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
    renderer.render(scene, camera);
    const gl = renderer.getContext();
    const pixels = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    return base64(pixels);
};
