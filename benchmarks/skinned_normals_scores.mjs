// What benchmarks/skinned_normals_scores.py calls in the browser: SkinnedNormalsTest as three.js draws it.

import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import * as skinbake from 'skinbake-three';
import { base64 } from '/support/base64.mjs';

// sRGB, four bytes a pixel, rows from the bottom. Options: url; time in the first clip; size; lighting.
window.pictured = async ({ url, time, size: [width, height], lighting }) => {
    const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
    renderer.setSize(width, height);
    const loader = new GLTFLoader();
    loader.register((parser) => new skinbake.SkinbakePlugin(parser));
    const { scene: model, animations } = await loader.loadAsync(url);
    const mixer = new THREE.AnimationMixer(model);
    mixer.clipAction(animations[0]).play();
    mixer.setTime(time);
    model.traverse((object) => (object.frustumCulled = false));
    // Without perspective, both rows are seen alike.
    const [across, up] = [5.6, (5.6 * height) / width];
    const camera = new THREE.OrthographicCamera(-across, across, up, -up, 1, 100);
    camera.position.set(4.4, 4.8, 23);
    camera.lookAt(4.4, 2.8, 0);
    const light = new THREE.DirectionalLight(0xffffff, 3);
    light.position.set(-3, 9, 3);
    light.target.position.set(4.4, 2.8, 0);
    const scene = new THREE.Scene();
    scene.background = new THREE.Color(0xe6e8eb);
    scene.add(model, light, light.target, new THREE.HemisphereLight(0xffffff, 0x443a55, 0.6));
    skinbake.lighting(model, lighting);
    for (let frame = 0; frame < 3; frame++) {
        renderer.render(scene, camera);
        await null;
    }
    const gl = renderer.getContext();
    const pixels = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    return base64(pixels);
};
