// What the tests of WebGPURenderer call in the browser: characters drawn as a page draws them, by either backend.

import * as THREE from 'three/webgpu';
import { mrt, normalView, output, positionLocal, vec3, vec4, velocity } from 'three/tsl';
import { WebGLRenderer } from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { CSMShadowNode } from 'three/addons/csm/CSMShadowNode.js';
import * as SkeletonUtils from 'three/addons/utils/SkeletonUtils.js';
import { MToonNodeMaterial } from '@pixiv/three-vrm/nodes';
import { WebGLNodesHandler } from 'three/addons/tsl/WebGLNodesHandler.js';
import * as chunks from 'skinbake-three';
import * as skinbake from 'skinbake-three/webgpu';
import { base64 } from '/support/base64.mjs';
import { parented, pass, posed, skinnedMeshes, stretch } from './posed.mjs';

// A page that has used the package is not told of what it draws before it asks for more.
skinbake.applySkinbake(new THREE.Group());
skinbake.dispose(new THREE.Group());

CAPTURE.names = ['v_normalViewGeometry'];

const SIZE = 96;
const renderers = {};

async function rendererOf(backend) {
    if (!renderers[backend]) {
        const renderer = new THREE.WebGPURenderer({ antialias: false, forceWebGL: backend === 'webgl' });
        renderer.setSize(SIZE, SIZE);
        await renderer.init();
        renderers[backend] = renderer;
    }
    return renderers[backend];
}

async function load({ url, pose = {}, plugin = true, method, cap, morphs }) {
    const loader = new GLTFLoader();
    if (plugin) loader.register((parser) => new skinbake.SkinbakePlugin(parser, { method, cap }));
    const gltf = await loader.loadAsync(url);
    for (const mesh of posed(gltf, pose, morphs)) mesh.frustumCulled = false;
    return gltf;
}

// Draw until all is compiled, then once more, recorded: values of three floats for each vertex, and clip positions.
async function draw(renderer, scene, camera) {
    // SwiftShader's WebGPU cannot present to a canvas.
    if (renderer.backend?.isWebGPUBackend) renderer.setRenderTarget(new THREE.RenderTarget(SIZE, SIZE));
    for (let frame = 0; frame < 2; frame++) {
        renderer.render(scene, camera);
        await null;
    }
    const capture = renderer.backend?.isWebGPUBackend ? WEBGPU_CAPTURE : CAPTURE;
    capture.draws = [];
    capture.on = true;
    renderer.render(scene, camera);
    capture.on = false;
    if (capture === CAPTURE) return capture.draws;
    const read = [];
    for (const one of capture.draws) read.push({ ...(await WEBGPU_CAPTURE.read(one)), text: one.pipeline.code });
    return read
        .filter(({ name }) => name)
        .map(({ varying, position, text }) => ({ values: varying.filter((_, index) => index % 4 < 3), position, text }));
}

// What applications do after the first frames.
const CHANGES = {
    'geometry.clone()': ({ mesh }) => (mesh.geometry = mesh.geometry.clone()),
    'geometry.copy()': ({ mesh }) => mesh.geometry.copy(mesh.geometry.clone()),
    'targets in another order': ({ mesh }) => {
        mesh.geometry = mesh.geometry.clone();
        for (const targets of Object.values(mesh.geometry.morphAttributes)) targets.reverse();
        mesh.morphTargetInfluences?.reverse();
    },
    'mesh.clone()': ({ mesh }) => replace(mesh, mesh.clone()),
    'SkeletonUtils.clone()': ({ scene, model }) => {
        const other = SkeletonUtils.clone(model);
        skinnedMeshes(other).forEach((one) => (one.frustumCulled = false));
        model.removeFromParent();
        scene.add(other);
    },
    'another material': ({ mesh }) => (mesh.material = new THREE.MeshPhongMaterial()),
    'material.clone()': ({ mesh }) => (mesh.material = mesh.material.clone()),
    'applied twice': ({ scene }) => void skinbake.applySkinbake(scene),
    'attribute taken away': ({ mesh }) => mesh.geometry.deleteAttribute('morphSkinbakeStorage'),
    CSM: ({ scene, renderer }) => {
        const light = scene.children.find(({ isLight }) => isLight);
        light.castShadow = renderer.shadowMap.enabled = true;
        light.shadow.shadowNode = new CSMShadowNode(light, { cascades: 2, maxFar: 10 });
        skinnedMeshes(scene).forEach((mesh) => (mesh.receiveShadow = mesh.castShadow = true));
    },
    'override material': ({ scene }) => (scene.overrideMaterial = new THREE.MeshNormalMaterial()),
};

function replace(mesh, other) {
    other.frustumCulled = false;
    mesh.parent.add(other);
    mesh.removeFromParent();
}

class Still extends THREE.MeshBasicNodeMaterial {
    setupPosition() {
        return positionLocal;
    }
}

const MATERIALS = {
    own: null,
    fuzzy: () => new THREE.MeshPhysicalMaterial({ sheen: 1 }),
    normal: () => new THREE.MeshNormalMaterial(),
    standard: () => new THREE.MeshStandardMaterial(),
    node: () => new THREE.MeshPhysicalNodeMaterial(),
    clone: (material) => material.clone(),
    copy: (material) => new material.constructor().copy(material),
    hook: (material) => Object.assign(material, { onBeforeCompile: () => {} }),
    mtoon: () => new MToonNodeMaterial(),
    lambert: () => new THREE.MeshLambertMaterial(),
    phong: () => new THREE.MeshPhongMaterial(),
    toon: () => new THREE.MeshToonMaterial(),
    matcap: () => new THREE.MeshMatcapMaterial(),
    positioned: () => new THREE.MeshStandardNodeMaterial({ positionNode: positionLocal.add(vec3(1, 0, 0)) }),
};

function cameraOf(half, view) {
    const camera = new THREE.OrthographicCamera(-half, half, half, -half, -half, half);
    camera.matrixAutoUpdate = camera.matrixWorldAutoUpdate = false;
    camera.matrixWorldInverse.fromArray(view);
    camera.matrixWorld.copy(camera.matrixWorldInverse).invert();
    camera.matrix.copy(camera.matrixWorld);
    return camera;
}

// Let a renderer take uniform buffers for small, if bytes are given. Return what undoes it.
function limitUniforms({ backend }, bytes) {
    const { createNodeBuilder } = backend;
    if (bytes) {
        backend.createNodeBuilder = function (...parameters) {
            const getUniformBufferLimit = () => bytes;
            return Object.assign(createNodeBuilder.apply(this, parameters), { getUniformBufferLimit });
        };
    }
    return () => (backend.createNodeBuilder = createNodeBuilder);
}

const api = {
    // The normal of the fragment shader at every pixel, with one texel as normal map. camera: { half, view }; roots: where
    // the model is, and where others of the same geometry and material are, at rest, before it and after it.
    async mapped({ backend, texel, camera: { half, view }, size, plugin = true, roots = [], ...options }) {
        const renderer = await rendererOf(backend);
        const { scene: model } = await load({ plugin, ...options });
        const scene = new THREE.Scene();
        scene.add(model);
        const [mesh] = skinnedMeshes(model);
        if (roots.length) parented(scene, model, { root: roots[0] });
        const normalMap = new THREE.DataTexture(new Uint8Array([...texel, 255]), 1, 1);
        normalMap.needsUpdate = true;
        mesh.material = new THREE.MeshStandardNodeMaterial({ normalMap });
        mesh.material.outputNode = vec4(normalView, 1);
        for (const [number, root] of roots.slice(1).entries()) {
            const { scene: another } = await load({ plugin: false, url: options.url });
            const other = parented(scene, another, { root });
            Object.assign(other, { geometry: mesh.geometry, material: mesh.material, renderOrder: 2 * number - 1 });
        }
        const camera = cameraOf(half, view);
        const target = new THREE.RenderTarget(size, size, { type: THREE.FloatType });
        renderer.setRenderTarget(target);
        renderer.setClearColor(0x000000, 0);
        const report = plugin ? skinbake.applySkinbake(scene, options) : [];
        for (let frame = 0; frame < 3; frame++) {
            renderer.render(scene, camera);
            await null;
        }
        const image = base64(await renderer.readRenderTargetPixelsAsync(target, 0, 0, size, size));
        const told = report.map(({ lighting, normalMap, reason }) => `${lighting} ${normalMap}${reason}`);
        renderer.setRenderTarget(null);
        skinbake.dispose(scene);
        return {
            image,
            told,
            isFromTop: renderer.backend.isWebGPUBackend === true,
        };
    },

    // The velocity at every pixel, which temporal passes read, in the last of two frames with a pose each. Another
    // character of the file has other joints beside it. camera: { half, view }.
    async velocities({ backend, poses, camera: { half, view }, size, uniformBytes, lighting, ...options }) {
        const renderer = await rendererOf(backend);
        const restore = limitUniforms(renderer, uniformBytes);
        const gltf = await load(options);
        const scene = new THREE.Scene();
        const other = SkeletonUtils.clone(gltf.scene);
        other.position.x = 1000;
        skinnedMeshes(other).forEach((mesh) => (mesh.frustumCulled = false));
        scene.add(other, gltf.scene);
        if (lighting) skinbake.lighting(scene, lighting);
        const target = new THREE.RenderTarget(size, size, { count: 2, type: THREE.FloatType });
        ['output', 'velocity'].forEach((name, index) => (target.textures[index].name = name));
        renderer.setRenderTarget(target);
        renderer.setMRT(mrt({ output, velocity }));
        renderer.setClearColor(0x000000, 0);
        const camera = cameraOf(half, view);
        for (const pose of [poses[0], poses[0], ...poses]) {
            posed(gltf, pose);
            renderer.render(scene, camera);
            await new Promise(requestAnimationFrame); // Joints are moved once for each of them.
        }
        const [colour, image] = await Promise.all(
            [0, 1].map((texture) => renderer.readRenderTargetPixelsAsync(target, 0, 0, size, size, texture)),
        );
        renderer.setMRT(null);
        renderer.setRenderTarget(null);
        restore();
        skinbake.dispose(scene);
        return { colour: base64(colour), image: base64(image), isFromTop: renderer.backend.isWebGPUBackend === true };
    },

    changes: () => Object.keys(CHANGES),

    // The backend that a renderer really has.
    async backend(name) {
        const renderer = await rendererOf(name);
        return renderer.backend.isWebGPUBackend ? 'webgpu' : 'webgl';
    },

    // The normals of a character as its vertex stage hands them on.
    async normals({ material = 'own', lighting, backend = 'webgl', change, uniformBytes, ...options }) {
        const renderer = await rendererOf(backend);
        const restore = limitUniforms(renderer, uniformBytes);
        const { scene: model } = await load(options);
        const scene = new THREE.Scene();
        scene.add(model, new THREE.DirectionalLight());
        const [mesh] = skinnedMeshes(model);
        const original = mesh.clone();
        if (MATERIALS[material]) mesh.material = MATERIALS[material](mesh.material);
        if (lighting) skinbake.lighting(model, lighting);
        const camera = new THREE.PerspectiveCamera();
        if (change) {
            await draw(renderer, scene, camera);
            CHANGES[change]({ scene, model, mesh, renderer });
        }
        const draws = (await draw(renderer, scene, camera)).map(({ values }) => base64(values));
        restore();
        renderer.shadowMap.enabled = false;
        const world = mesh.matrixWorld.toArray();
        const report = skinbake.applySkinbake(scene).map((one) => [one.lighting, one.reason]);
        skinbake.dispose(scene);
        skinbake.dispose(original);
        return { draws, world, report };
    },

    // The draws of characters that share a material.
    async together({ backend, characters }) {
        const renderer = await rendererOf(backend);
        const scene = new THREE.Scene();
        const material = new THREE.MeshStandardMaterial();
        for (const options of characters) {
            const { scene: model } = await load(options);
            skinnedMeshes(model).forEach((mesh) => (mesh.material = material));
            scene.add(model);
        }
        const draws = await draw(renderer, scene, new THREE.PerspectiveCamera());
        skinbake.dispose(scene);
        return draws.map(({ values }) => base64(values));
    },

    // The normals and the report of a mesh whose normals a page computes anew, or writes as they were. Then the same
    // normals by three.js alone.
    async altered({ backend, ...options }) {
        const renderer = await rendererOf(backend);
        const camera = new THREE.PerspectiveCamera();
        const changes = {
            anew: ({ geometry }) => geometry.computeVertexNormals(),
            'as they were': ({ geometry }) => (geometry.attributes.normal.needsUpdate = true),
        };
        const found = {};
        for (const [name, change] of Object.entries({ ...changes, alone: changes.anew })) {
            const { scene: model } = await load({ ...options, plugin: name !== 'alone' });
            const scene = new THREE.Scene();
            scene.add(model, new THREE.DirectionalLight());
            const [mesh] = skinnedMeshes(model);
            await draw(renderer, scene, camera);
            change(mesh);
            mesh.name = name;
            const draws = (await draw(renderer, scene, camera)).map(({ values }) => base64(values));
            const report = name === 'alone' ? [] : skinbake.applySkinbake(scene).map((one) => [one.lighting, one.reason]);
            found[name] = { draws, report, world: mesh.matrixWorld.toArray() };
            if (name !== 'alone') skinbake.dispose(scene);
        }
        return found;
    },

    // A mesh that was drawn before it is asked for, then switched, then disposed of.
    async late({ backend, ...options }) {
        const renderer = await rendererOf(backend);
        const { scene: model } = await load({ ...options, plugin: false });
        const scene = new THREE.Scene();
        scene.add(model);
        const [mesh] = skinnedMeshes(model);
        const original = mesh.clone();
        const camera = new THREE.PerspectiveCamera();
        const found = [];
        const look = async (report) => {
            const draws = (await draw(renderer, scene, camera)).map(({ values }) => base64(values));
            found.push({ draws, report: (report ?? []).map((one) => [one.lighting, one.reason]) });
        };
        await look();
        const report = skinbake.applySkinbake(scene);
        await look(report);
        skinbake.lighting(scene, 'standard');
        await look(report);
        skinbake.lighting(scene, 'accurate');
        await look(report);
        await look(skinbake.applySkinbake(scene, { method: 'dqs' }));
        mesh.geometry = mesh.geometry.clone();
        await look(report);
        await look(skinbake.applySkinbake(scene, { method: 'lbs' }));
        skinbake.dispose(scene);
        skinbake.dispose(original);
        await look();
        return { found, world: mesh.matrixWorld.toArray() };
    },

    // Normals and vertex shader of each draw of two characters, while one is switched, a second after that, and when
    // it is switched back. Then how many programs there are after each of more such rounds, and how many were made
    // while it was switched in each frame.
    async switched({ backend, plain, ...options }) {
        const renderer = await rendererOf(backend);
        const camera = new THREE.PerspectiveCamera();
        const { scene: model } = await load({ ...options, plugin: !plain });
        const other = SkeletonUtils.clone(model);
        skinnedMeshes(other).forEach((mesh) => (mesh.frustumCulled = false));
        const scene = new THREE.Scene();
        scene.add(model, new THREE.DirectionalLight());
        if (!plain) scene.add(other);
        const found = [];
        const look = async () => {
            const draws = await draw(renderer, scene, camera);
            found.push(draws.map(({ values, text }) => ({ values: base64(values), text })));
        };
        const change = async (lighting, milliseconds = 0) => {
            skinbake.lighting(other, lighting);
            pass(milliseconds);
            await look();
        };
        await look();
        const programs = [];
        let made = 0;
        for (let round = 0; round < 3 && !plain; round++) {
            await change('standard');
            await change('standard', 1001);
            await change('accurate');
            programs.push(renderer.info.memory.programs);
        }
        const { createProgram } = renderer.info;
        renderer.info.createProgram = function (...parameters) {
            made++;
            createProgram.apply(this, parameters);
        };
        for (let frame = 0; frame < 6 && !plain; frame++) {
            skinbake.lighting(other, frame % 2 ? 'accurate' : 'standard');
            pass(400);
            renderer.render(scene, camera);
        }
        renderer.info.createProgram = createProgram;
        const world = skinnedMeshes(model)[0].matrixWorld.toArray();
        skinbake.dispose(scene);
        return { found, programs, made, world };
    },

    // A character of a group that is drawn from a bundle, switched.
    async bundled({ backend, ...options }) {
        const renderer = await rendererOf(backend);
        const { scene: model } = await load(options);
        const scene = new THREE.Scene();
        const group = new THREE.BundleGroup();
        scene.add(group.add(model));
        skinbake.lighting(scene, 'standard');
        const camera = new THREE.PerspectiveCamera();
        await draw(renderer, scene, camera);
        pass(1001);
        await draw(renderer, scene, camera);
        skinbake.lighting(scene, 'accurate');
        if (renderer.backend.isWebGPUBackend) renderer.setRenderTarget(new THREE.RenderTarget(SIZE, SIZE));
        const version = group.version;
        const report = skinbake.applySkinbake(scene);
        renderer.render(scene, camera);
        const found = { version, report: report.map((one) => [one.lighting, one.reason]) };
        skinbake.dispose(scene);
        return found;
    },

    // The draws of one frame with an ArrayCamera, or of two renders. Each camera is turned by its number.
    async views({ kind, ...options }) {
        const renderer = await rendererOf('webgl');
        const { scene: model } = await load(options);
        const scene = new THREE.Scene();
        scene.add(model);
        const cameras = [0, 1].map((number) => {
            const one = new THREE.PerspectiveCamera();
            one.rotation.set(0, number, 0);
            one.updateMatrixWorld();
            one.viewport = new THREE.Vector4(32 * number, 0, 32, 64);
            return one;
        });
        const all = kind === 'ArrayCamera' ? [new THREE.ArrayCamera(cameras)] : cameras;
        for (const one of all) renderer.render(scene, one);
        CAPTURE.draws = [];
        CAPTURE.on = true;
        for (const one of all) renderer.render(scene, one);
        CAPTURE.on = false;
        const draws = CAPTURE.draws.map(({ values }) => base64(values));
        skinbake.dispose(scene);
        return { draws, world: skinnedMeshes(model)[0].matrixWorld.toArray() };
    },

    // A node material that WebGLRenderer draws: with the module of chunks alone, then with both.
    async handled(options) {
        const found = [];
        for (const modules of [[chunks], [chunks, skinbake]]) {
            const renderer = new WebGLRenderer();
            renderer.setNodesHandler(new WebGLNodesHandler());
            const { scene: model } = await load({ ...options, plugin: false });
            const scene = new THREE.Scene();
            scene.add(model, new THREE.DirectionalLight());
            const [mesh] = skinnedMeshes(model);
            Object.assign(mesh, { name: 'hero', material: new THREE.MeshStandardNodeMaterial({ name: 'nodes' }) });
            const [meshes] = modules.map((module) => module.applySkinbake(scene));
            const draws = (await draw(renderer, scene, new THREE.PerspectiveCamera())).map(({ values }) => base64(values));
            const report = meshes.map((one) => [one.lighting, one.reason]);
            found.push({ draws, report, world: mesh.matrixWorld.toArray() });
            skinbake.dispose(scene);
            renderer.dispose();
        }
        return found;
    },

    // How many programs one character of a file needs, and how many more a hundred of it need.
    async programs({ backend, ...options }) {
        const renderer = await rendererOf(backend);
        const { scene: model } = await load(options);
        const scene = new THREE.Scene();
        scene.add(new THREE.DirectionalLight());
        const count = async (characters) => {
            const before = renderer.info.memory.programs;
            scene.add(...Array.from({ length: characters }, () => SkeletonUtils.clone(model)));
            for (const mesh of skinnedMeshes(scene)) {
                Object.assign(mesh, { frustumCulled: false, material: new THREE.MeshPhysicalMaterial({ clearcoat: 1 }) });
            }
            const draws = await draw(renderer, scene, new THREE.PerspectiveCamera());
            return { draws: draws.length, more: renderer.info.memory.programs - before };
        };
        const found = [await count(1), await count(99)];
        const lightings = skinbake.applySkinbake(scene).map((report) => report.lighting);
        skinbake.dispose(scene);
        return { found, lightings: [...new Set(lightings)] };
    },

    // The normals of characters in one scene whose materials read as many attributes as the device has vertex buffers,
    // alpha and beta aside. Then how many textures their geometries free.
    async crowded({ backend, characters }) {
        const renderer = await rendererOf(backend);
        const scene = new THREE.Scene();
        scene.add(new THREE.DirectionalLight());
        const grey = [0, 1].map((channel) => {
            const one = new THREE.DataTexture(new Uint8Array([128, 128, 255, 255]), 1, 1);
            return Object.assign(one, { channel, needsUpdate: true });
        });
        const reports = [];
        for (const options of characters) {
            const { scene: model, userData } = await load(options);
            scene.add(model);
            reports.push(...userData.skinbake);
            const [{ geometry }] = skinnedMeshes(model);
            const { count } = geometry.attributes.position;
            geometry.setAttribute('color', new THREE.BufferAttribute(new Float32Array(3 * count).fill(1), 3));
            const [map, aoMap] = grey;
            const maps = { map, normalMap: map };
            if (!geometry.attributes.uv1) {
                geometry.setAttribute('uv1', new THREE.BufferAttribute(new Float32Array(2 * count), 2));
                Object.assign(maps, { aoMap });
            }
            skinnedMeshes(model)[0].material = new THREE.MeshStandardMaterial({ vertexColors: true, ...maps });
        }
        const draws = (await draw(renderer, scene, new THREE.PerspectiveCamera())).map(({ values }) => base64(values));
        const report = reports.map((one) => [one.lighting, one.reason]);
        const meshes = skinnedMeshes(scene);
        const before = renderer.info.memory.textures;
        for (const { geometry } of meshes) geometry.dispose();
        const freed = before - renderer.info.memory.textures;
        skinbake.dispose(scene);
        const names = Object.keys(meshes[0].geometry.attributes);
        return { draws, freed, names, report, world: meshes[0].matrixWorld.toArray() };
    },

    // The tangents of a character, which anisotropy needs.
    async tangents(options) {
        CAPTURE.names = ['v_tangentView'];
        const renderer = new THREE.WebGPURenderer({ forceWebGL: true });
        await renderer.init();
        const { scene: model } = await load(options);
        const scene = new THREE.Scene();
        scene.add(model, new THREE.DirectionalLight());
        const [mesh] = skinnedMeshes(model);
        mesh.material = new THREE.MeshPhysicalMaterial({ anisotropy: 0.5 });
        const draws = (await draw(renderer, scene, new THREE.PerspectiveCamera())).map(({ values }) => base64(values));
        CAPTURE.names = ['v_normalViewGeometry'];
        skinbake.dispose(scene);
        renderer.dispose();
        return { draws, world: mesh.matrixWorld.toArray() };
    },

    // A character below a parent with any matrix; if asked for, its mesh elsewhere, with the matrix other.
    async parented({ backend, ...options }) {
        const { scene: model } = await load(options);
        const scene = new THREE.Scene();
        const mesh = parented(scene, model, options);
        mesh.material = new THREE.MeshNormalMaterial({ side: THREE.DoubleSide });
        const camera = new THREE.PerspectiveCamera();
        const found = {};
        for (const [name, output] of Object.entries({ position: 'gl_Position', normal: 'v_normalViewGeometry' })) {
            CAPTURE.names = [output];
            const renderer = new THREE.WebGPURenderer({ forceWebGL: backend === 'webgl' });
            renderer.setSize(SIZE, SIZE);
            await renderer.init();
            const [drawn] = await draw(renderer, scene, camera);
            found[name] = base64((output === 'gl_Position' && drawn.position) || drawn.values);
            renderer.dispose();
        }
        CAPTURE.names = ['v_normalViewGeometry'];
        const report = skinbake.applySkinbake(scene, options).map((one) => [one.lighting, one.reason]);
        const { matrixWorldInverse, projectionMatrix } = camera;
        const world = mesh.matrixWorld.toArray();
        skinbake.dispose(scene);
        return { ...found, report, world, view: matrixWorldInverse.toArray(), projection: projectionMatrix.toArray() };
    },

    // Normals with a joint of its own scale, of three.js alone too; then with the scale undone, before and after
    // applySkinbake.
    async stretched({ backend, ...options }) {
        const renderer = await rendererOf(backend);
        const camera = new THREE.PerspectiveCamera();
        const found = [];
        const scene = new THREE.Scene();
        let report;
        const look = async () => {
            await new Promise(requestAnimationFrame); // Joints are moved once for each of them.
            const draws = (await draw(renderer, scene, camera)).map(({ values }) => base64(values));
            found.push({ draws, report: (report ?? []).map((one) => [one.lighting, one.reason]) });
        };
        const { scene: plain } = await load({ ...options, plugin: false });
        stretch(scene.add(plain), true);
        await look();
        plain.removeFromParent();
        const { scene: model, userData } = await load(options);
        report = userData.skinbake;
        stretch(scene.add(model), true);
        await look();
        stretch(scene, false);
        await look();
        skinbake.applySkinbake(scene, options);
        await look();
        const world = skinnedMeshes(model)[0].matrixWorld.toArray();
        skinbake.dispose(scene);
        return { found, world };
    },

    // The version of a material after each frame, where a later hook calls the one that was there before, or that of
    // a class calls the one that it inherits.
    async chained({ classed, ...options }) {
        const renderer = await rendererOf('webgl');
        const { scene: model } = await load(options);
        const scene = new THREE.Scene();
        scene.add(model);
        let [mesh] = skinnedMeshes(model);
        let calls = 0;
        if (classed) {
            class Own extends THREE.SkinnedMesh {
                onAfterRender(...parameters) {
                    super.onAfterRender(...parameters);
                    calls++;
                }
            }
            const own = new Own(mesh.geometry, mesh.material);
            own.bind(mesh.skeleton, mesh.bindMatrix);
            replace(mesh, own);
            mesh = own;
        } else {
            const before = mesh.onAfterRender;
            mesh.onAfterRender = function (...parameters) {
                before.apply(this, parameters);
                calls++;
            };
        }
        const report = skinbake.applySkinbake(scene);
        const versions = [];
        for (let frame = 0; frame < 5; frame++) {
            renderer.render(scene, new THREE.PerspectiveCamera());
            versions.push(mesh.material.version);
        }
        const reported = report.map((one) => [one.lighting, one.reason]);
        skinbake.dispose(scene);
        return { versions, calls, report: reported };
    },

    // Where a shadow's draw puts vertices, in clip space, and the cameras of the frame.
    async shadows({ lighting, ...options }) {
        const renderer = await rendererOf('webgpu');
        const { scene: model } = await load(options);
        if (lighting) skinbake.lighting(model, lighting);
        const light = new THREE.DirectionalLight();
        light.position.set(1, 2, 3);
        light.castShadow = true;
        const scene = new THREE.Scene();
        scene.add(model, light);
        skinnedMeshes(model).forEach((mesh) => Object.assign(mesh, { castShadow: true, receiveShadow: true }));
        renderer.shadowMap.enabled = true;
        renderer.setRenderTarget(new THREE.RenderTarget(SIZE, SIZE));
        const camera = new THREE.PerspectiveCamera();
        for (let frame = 0; frame < 2; frame++) {
            renderer.render(scene, camera);
            await new Promise(requestAnimationFrame); // Shadows are drawn once for each of them.
        }
        WEBGPU_CAPTURE.draws = [];
        WEBGPU_CAPTURE.on = true;
        renderer.render(scene, camera);
        WEBGPU_CAPTURE.on = false;
        const draws = [];
        for (const one of WEBGPU_CAPTURE.draws) {
            const { name, position } = await WEBGPU_CAPTURE.read(one);
            if (!name) draws.push(base64(position));
        }
        renderer.shadowMap.enabled = false;
        const world = skinnedMeshes(model)[0].matrixWorld.toArray();
        const seen = light.shadow.camera;
        skinbake.dispose(scene);
        return { draws, world, view: seen.matrixWorldInverse.toArray(), projection: seen.projectionMatrix.toArray() };
    },

    // What is reported of a material that does not skin as NodeMaterial does.
    async foreign(options) {
        const renderer = await rendererOf('webgl');
        const { scene } = await load(options);
        const [mesh] = skinnedMeshes(scene);
        mesh.name = 'hero';
        mesh.material = new Still({ name: 'own' });
        for (let frame = 0; frame < 3; frame++) renderer.render(scene, new THREE.PerspectiveCamera());
        const report = skinbake.applySkinbake(mesh).map((one) => [one.lighting, one.reason]);
        skinbake.dispose(scene);
        return report;
    },

    // The same view of a character by either backend: normals as colours, in floats.
    async picture({ backend, ...options }) {
        const renderer = await rendererOf(backend);
        const { scene: model } = await load(options);
        const scene = new THREE.Scene();
        scene.add(model);
        skinnedMeshes(model).forEach((mesh) => (mesh.material = new THREE.MeshNormalMaterial()));
        model.updateMatrixWorld(true);
        const box = new THREE.Box3();
        skinnedMeshes(model).forEach((mesh) => {
            mesh.skeleton.update();
            mesh.computeBoundingBox();
            box.union(mesh.boundingBox.clone().applyMatrix4(mesh.matrixWorld));
        });
        const { center, radius } = box.getBoundingSphere(new THREE.Sphere());
        const camera = new THREE.OrthographicCamera(-radius, radius, radius, -radius, 0, 4 * radius);
        camera.position.copy(center).add(new THREE.Vector3(0, 0, 2 * radius));
        const target = new THREE.RenderTarget(SIZE, SIZE, { type: THREE.FloatType });
        renderer.setClearColor(0x000000, 0);
        renderer.setRenderTarget(target);
        for (let frame = 0; frame < 2; frame++) renderer.render(scene, camera);
        const pixels = await renderer.readRenderTargetPixelsAsync(target, 0, 0, SIZE, SIZE);
        renderer.setRenderTarget(null);
        target.dispose();
        skinbake.dispose(scene);
        return base64(pixels);
    },
};

Object.assign(window, api);
