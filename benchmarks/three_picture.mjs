// What benchmarks/three_picture.py calls in the browser: a baked character as three.js draws it.

import * as THREE from 'three';
import * as GPU from 'three/webgpu';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import * as webgl from 'skinbake-three';
import * as webgpu from 'skinbake-three/webgpu';

// Pixels of one lighting after the other, in linear light, rows from the bottom (WebGL) or the top (WebGPU).
window.pictures = async ({ url, clip, time, backend, size: [width, height], from, at, across, colour }) => {
    const isGPU = backend === 'webgpu';
    const module = isGPU ? webgpu : webgl;
    const renderer = isGPU ? new GPU.WebGPURenderer() : new THREE.WebGLRenderer();
    await renderer.init?.();
    if (isGPU && !renderer.backend.isWebGPUBackend) return null;
    const loader = new GLTFLoader();
    loader.register((parser) => new module.SkinbakePlugin(parser));
    const { scene: model, animations } = await loader.loadAsync(url);
    const mixer = new THREE.AnimationMixer(model);
    mixer.clipAction(animations[clip]).play();
    mixer.setTime(time);
    const scene = new THREE.Scene();
    scene.background = new THREE.Color(0xe6e8eb);
    const light = new THREE.DirectionalLight(0xffffff, 2.6);
    scene.add(model, light, new THREE.HemisphereLight(0xffffff, 0x443a55, 0.9));
    model.traverse((object) => {
        if (!object.isSkinnedMesh) return;
        object.frustumCulled = false;
        if (colour) object.material = new THREE.MeshStandardMaterial({ color: colour, roughness: 0.38 });
    });
    const half = across / 2;
    const [x, y] = [half, (half * height) / width];
    const camera = new THREE.OrthographicCamera(-x, x, y, -y, 0.01, 100);
    const back = new THREE.Vector3(...from).normalize();
    camera.position.set(...at).addScaledVector(back, 10);
    camera.lookAt(...at);
    light.position.copy(camera.position).add(new THREE.Vector3(-5, 6, 0).applyQuaternion(camera.quaternion));
    light.target.position.set(...at);
    scene.add(light.target);
    const Target = isGPU ? GPU.RenderTarget : THREE.WebGLRenderTarget;
    const target = new Target(width, height, { type: THREE.FloatType });
    renderer.setRenderTarget(target);
    const found = {};
    for (const lighting of ['standard', 'accurate']) {
        module.lighting(model, lighting);
        for (let frame = 0; frame < 3; frame++) {
            renderer.render(scene, camera);
            await null;
        }
        const pixels = new Float32Array(4 * width * height);
        if (isGPU) pixels.set(await renderer.readRenderTargetPixelsAsync(target, 0, 0, width, height));
        else renderer.readRenderTargetPixels(target, 0, 0, width, height, pixels);
        const bytes = new Uint8Array(pixels.buffer);
        let text = '';
        for (let start = 0; start < bytes.length; start += 8192) {
            text += String.fromCharCode(...bytes.subarray(start, start + 8192));
        }
        found[lighting] = btoa(text);
    }
    return { ...found, lightings: module.applySkinbake(model).map(({ lighting }) => lighting) };
};
