// What benchmarks/normal_map_picture.py calls in the browser: a baked character with a normal map, drawn three ways.

import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import * as skinbake from 'skinbake-three';

// Round bumps, whose sides tilt the normal by up to 25 degrees.
function bumps(repeat) {
    const size = 64;
    const data = new Uint8Array(4 * size * size);
    for (let i = 0; i < size * size; i++) {
        const x = ((i % size) + 0.5) / size * 2 - 1;
        const y = (Math.floor(i / size) + 0.5) / size * 2 - 1;
        const far = Math.hypot(x, y);
        const slope = far < 1 ? Math.sin(Math.PI * far) * Math.sin(THREE.MathUtils.degToRad(25)) / Math.max(far, 1e-6) : 0;
        const [nx, ny] = [x * slope, y * slope];
        data.set([nx, ny, Math.sqrt(1 - nx * nx - ny * ny)].map((one) => Math.round(127.5 + 127.5 * one)), 4 * i);
        data[4 * i + 3] = 255;
    }
    const texture = new THREE.DataTexture(data, size, size);
    texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
    texture.repeat.set(repeat, repeat);
    texture.generateMipmaps = true;
    texture.minFilter = THREE.LinearMipmapLinearFilter;
    texture.magFilter = THREE.LinearFilter;
    texture.needsUpdate = true;
    return texture;
}

// Pixels of each way: sRGB, four bytes, rows from the bottom. Options: url; time in the first clip; from; zoom; aim: a
// shift of the middle, in radii; repeat: of bumps, in place of the model's own normal map.
window.pictures = async ({ url, time, size: [width, height], from, zoom = 1, aim = [0, 0, 0], repeat = 0, clip = 0 }) => {
    const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
    renderer.setSize(width, height);
    const loader = new GLTFLoader();
    loader.register((parser) => new skinbake.SkinbakePlugin(parser));
    const { scene: model, animations } = await loader.loadAsync(url);
    const mixer = new THREE.AnimationMixer(model);
    mixer.clipAction(animations[clip]).play();
    mixer.setTime(time);
    const scene = new THREE.Scene();
    scene.background = new THREE.Color(0xe6e8eb);
    scene.add(model, new THREE.HemisphereLight(0xffffff, 0x443a55, 0.7));
    scene.updateMatrixWorld(true);
    const box = new THREE.Box3();
    const meshes = [];
    model.traverse((mesh) => {
        if (!mesh.isSkinnedMesh) return;
        meshes.push(mesh);
        mesh.frustumCulled = false;
        mesh.computeBoundingBox();
        box.union(mesh.boundingBox.clone().applyMatrix4(mesh.matrixWorld));
        const normalMap = repeat ? bumps(repeat) : mesh.material.normalMap;
        mesh.material = new THREE.MeshStandardMaterial({ color: 0xb8b2a8, roughness: 0.42, normalMap, side: mesh.material.side });
    });
    const { center, radius } = box.getBoundingSphere(new THREE.Sphere());
    const camera = new THREE.PerspectiveCamera(30, width / height, radius / 50, 50 * radius);
    const back = new THREE.Vector3(...from).normalize();
    const target = center.clone().addScaledVector(new THREE.Vector3(...aim), radius);
    camera.position.copy(target).addScaledVector(back, 4 * radius / zoom);
    camera.lookAt(target);
    const light = new THREE.DirectionalLight(0xffffff, 2.8);
    light.position.copy(camera.position).add(new THREE.Vector3(-3, 2, 0).multiplyScalar(radius).applyQuaternion(camera.quaternion));
    light.target.position.copy(target);
    scene.add(light, light.target);
    const found = {};
    for (const way of ['standard', 'frame', 'relief']) {
        skinbake.lighting(model, way === 'standard' ? 'standard' : 'accurate');
        for (const { material } of meshes) {
            // Without the module's define, a normal map has three.js's own frame.
            material.onBeforeCompile = (shader) => {
                if (way !== 'frame') return;
                for (const name of ['vertexShader', 'fragmentShader']) shader[name] = `#undef SKINBAKE_NORMAL_MAP\n${shader[name]}`;
            };
            material.customProgramCacheKey = () => way;
            material.needsUpdate = true;
        }
        for (let frame = 0; frame < 3; frame++) {
            renderer.render(scene, camera);
            await null;
        }
        const gl = renderer.getContext();
        const pixels = new Uint8Array(4 * width * height);
        gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
        let text = '';
        for (let start = 0; start < pixels.length; start += 8192) text += String.fromCharCode(...pixels.subarray(start, start + 8192));
        found[way] = btoa(text);
    }
    return found;
};
