// What benchmarks/three_frame.py calls in the browser: times of frames, of all kinds of lighting in turn.

import * as THREE from 'three';
import * as GPU from 'three/webgpu';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import * as SkeletonUtils from 'three/addons/utils/SkeletonUtils.js';
import * as webgl from 'skinbake-three';
import * as webgpu from 'skinbake-three/webgpu';

const HOOKS = ['onBeforeRender', 'onAfterRender', 'onBeforeShadow', 'onAfterShadow'];

// Renderers, each with its module, and what waits until it has drawn.
const RENDERERS = {
    async WebGLRenderer(size) {
        const renderer = new THREE.WebGLRenderer({ antialias: false });
        renderer.setSize(size, size);
        return { renderer, module: webgl, finish: () => read(renderer.getContext()) };
    },
    async 'WebGPURenderer, WebGL 2'(size) {
        const renderer = new GPU.WebGPURenderer({ antialias: false, forceWebGL: true });
        renderer.setSize(size, size);
        await renderer.init();
        return { renderer, module: webgpu, finish: () => read(renderer.getContext()) };
    },
    async 'WebGPURenderer, WebGPU'(size) {
        const renderer = new GPU.WebGPURenderer({ antialias: false });
        renderer.setSize(size, size);
        await renderer.init();
        if (!renderer.backend.isWebGPUBackend) return null;
        renderer.setRenderTarget(new THREE.RenderTarget(size, size));
        return { renderer, module: webgpu, finish: () => renderer.backend.device.queue.onSubmittedWorkDone() };
    },
};

const read = (gl) => gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));

function skinnedMeshes(root) {
    const found = [];
    root.traverse((object) => object.isSkinnedMesh && found.push(object));
    return found;
}

// TANGENT at right angles to each normal, and a normal map of one texel.
function mapNormals({ geometry, material }) {
    const { normal } = geometry.attributes;
    const tangents = new Float32Array(4 * normal.count).fill(1);
    const [n, t] = [new THREE.Vector3(), new THREE.Vector3()];
    for (let vertex = 0; vertex < normal.count; vertex++) {
        t.set(0.3, 0.2, 0.9).cross(n.fromBufferAttribute(normal, vertex)).normalize().toArray(tangents, 4 * vertex);
    }
    geometry.setAttribute('tangent', new THREE.BufferAttribute(tangents, 4));
    material.normalMap = new THREE.DataTexture(new Uint8Array([160, 110, 240, 255]), 1, 1);
    material.normalMap.needsUpdate = true;
}

async function sceneOf(url, count, isMapped) {
    const { scene: model } = await new GLTFLoader().loadAsync(url);
    if (isMapped) skinnedMeshes(model).forEach(mapNormals);
    const scene = new THREE.Scene();
    const light = new THREE.DirectionalLight(0xffffff, 3);
    light.position.set(1, 2, 3);
    scene.add(light);
    const side = Math.ceil(Math.sqrt(count));
    for (let number = 0; number < count; number++) {
        const one = SkeletonUtils.clone(model);
        const [mesh] = skinnedMeshes(one);
        mesh.frustumCulled = false;
        const holder = new THREE.Group().add(one);
        holder.position.set(2.4 * ((number % side) - (side - 1) / 2), 2.4 * (Math.floor(number / side) - (side - 1) / 2), 0);
        scene.add(holder);
    }
    const camera = new THREE.PerspectiveCamera(45, 1, 0.1, 1000);
    camera.position.set(0, 0, 4 * side);
    return { scene, camera, bones: skinnedMeshes(scene).map(({ skeleton }) => skeleton.bones.at(-1)) };
}

// Draw every kind until it is compiled. three is untouched: its programs and hooks are its own.
window.prepare = async ({ name, url, count, size, isMapped = false }) => {
    const made = await RENDERERS[name](size);
    if (!made) return false;
    const { renderer, module, finish } = made;
    const kinds = {};
    for (const kind of ['three', 'standard', 'lbs', 'dqs']) {
        kinds[kind] = await sceneOf(url, count, isMapped);
        const { scene, camera } = kinds[kind];
        if (kind === 'three') {
            for (const mesh of skinnedMeshes(scene)) {
                for (const hook of HOOKS) Object.defineProperty(mesh, hook, { value: () => {} });
            }
        } else {
            kinds[kind].report = module.applySkinbake(scene, { method: kind === 'dqs' ? 'dqs' : 'lbs' });
        }
        const draw = async () => {
            for (let frame = 0; frame < 4; frame++) {
                renderer.render(scene, camera);
                await finish();
            }
        };
        await draw();
        if (kind !== 'standard') continue;
        module.lighting(scene, 'standard');
        await new Promise((resolve) => setTimeout(resolve, 1100)); // Then three.js's own program draws.
        await draw();
    }
    window.prepared = { kinds, renderer, finish };
    return true;
};

// The milliseconds of one frame of each kind. The first kind is another in each round.
window.round = async (number) => {
    const { kinds, renderer, finish } = window.prepared;
    const names = Object.keys(kinds);
    const times = {};
    for (let turn = 0; turn < names.length; turn++) {
        const kind = names[(turn + number) % names.length];
        const { scene, camera, bones } = kinds[kind];
        for (const bone of bones) bone.rotation.z = 0.3 * Math.sin(number);
        const start = performance.now();
        renderer.render(scene, camera);
        await finish();
        times[kind] = performance.now() - start;
    }
    return times;
};

window.lightings = () => {
    const found = {};
    for (const [kind, { report }] of Object.entries(window.prepared.kinds)) {
        if (report) found[kind] = [...new Set(report.map(({ lighting }) => lighting))];
    }
    return found;
};
