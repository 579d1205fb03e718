// What the tests call in the browser: models drawn by three.js as any page would, and vertices read back.
//
// Matrices are three.js's, 16 numbers column by column; arrays come back as base64 of little-endian floats.

import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { base64 } from '/support/base64.mjs';
import { posed, skinnedMeshes } from './posed.mjs';

const renderer = new THREE.WebGLRenderer({ antialias: false });
renderer.setSize(64, 64);
document.body.append(renderer.domElement);

// Load a model and put it into a pose. Options: url; pose and morphs, as for posed; root, a matrix for the whole
// scene; bind, a bind matrix; Plugin, that of a module, and its method.
async function load({ url, pose = {}, root, bind, morphs, Plugin, method }) {
    const loader = new GLTFLoader();
    if (Plugin) loader.register((parser) => new Plugin(parser, { method }));
    const model = await loader.loadAsync(url);
    const { scene } = model;
    if (root) {
        scene.matrixAutoUpdate = false;
        scene.matrix.fromArray(root);
    }
    const meshes = posed(model, pose, morphs);
    scene.updateMatrixWorld(true);
    for (const mesh of meshes) {
        if (bind) mesh.bind(mesh.skeleton, new THREE.Matrix4().fromArray(bind));
        mesh.updateMatrixWorld(true);
    }
    return scene;
}

async function imported(address) {
    return { address, ...(await import(address)) };
}

// A material like another one whose vertex shader writes an expression of its last scope, a vec3, for each
// vertex into a pixel of its own.
function probeOf(material, expression, module, width, height) {
    const probe = material.clone();
    probe.depthTest = false;
    probe.onBeforeCompile = function (shader, used) {
        material.onBeforeCompile.call(this, shader, used);
        shader.uniforms.size = { value: new THREE.Vector2(width, height) };
        const declaration = 'flat varying vec3 probed;\n';
        shader.vertexShader = `uniform vec2 size;\n${declaration}` + beforeLastBrace(shader.vertexShader, `
            probed = ${expression};
            vec2 pixel = vec2(gl_VertexID % int(size.x), gl_VertexID / int(size.x)) + 0.5;
            gl_Position = vec4(2.0 * pixel / size - 1.0, 0.0, 1.0);
            gl_PointSize = 1.0;`);
        shader.fragmentShader = declaration + beforeLastBrace(shader.fragmentShader, `
            gl_FragColor = vec4(probed, 1.0);`);
    };
    probe.customProgramCacheKey = () => `${material.customProgramCacheKey()} ${expression} ${module}`;
    return probe;
}

function beforeLastBrace(text, added) {
    const at = text.lastIndexOf('}');
    return `${text.slice(0, at)}${added}\n${text.slice(at)}`;
}

// Draw a skinned mesh as points, one a vertex, and return the expression at each: three numbers a vertex.
function probed(mesh, expression, module, instance, method) {
    const count = mesh.geometry.attributes.position.count;
    const width = Math.ceil(Math.sqrt(count));
    const height = Math.ceil(count / width);
    const geometry = mesh.geometry.clone().setIndex(null);
    const points = new THREE.Points(geometry, probeOf(mesh.material, expression, module?.address, width, height));
    for (const name of ['skeleton', 'bindMatrix', 'bindMatrixInverse', 'morphTargetInfluences']) {
        points[name] = mesh[name];
    }
    points.isSkinnedMesh = true;
    points.frustumCulled = points.matrixAutoUpdate = points.matrixWorldAutoUpdate = false;
    points.matrixWorld.copy(mesh.matrixWorld);
    if (instance) {
        points.isInstancedMesh = true;
        points.count = 1;
        points.instanceMatrix = new THREE.InstancedBufferAttribute(new Float32Array(instance), 16);
        points.instanceColor = points.morphTexture = null;
    }
    module?.applySkinbake(points, { method });
    const pixels = drawn(points, new THREE.PerspectiveCamera(), width, height);
    module?.dispose(points);
    points.material.dispose();
    geometry.dispose();
    const values = new Float32Array(3 * count);
    for (let vertex = 0; vertex < count; vertex++) {
        values.set(pixels.subarray(4 * vertex, 4 * vertex + 3), 3 * vertex);
        if (pixels[4 * vertex + 3] !== 1) throw new Error(`vertex ${vertex} was not drawn`);
    }
    return values;
}

// Draw one object, unlit, and return its pixels: RGBA as float, rows from below.
function drawn(object, camera, width, height) {
    const target = new THREE.WebGLRenderTarget(width, height, {
        type: THREE.FloatType,
        minFilter: THREE.NearestFilter,
        magFilter: THREE.NearestFilter,
    });
    const scene = new THREE.Scene();
    scene.matrixWorldAutoUpdate = false;
    const parent = object.parent;
    scene.add(object);
    renderer.setRenderTarget(target);
    renderer.setClearColor(0x000000, 0);
    renderer.clear();
    renderer.render(scene, camera);
    const pixels = new Float32Array(4 * width * height);
    renderer.readRenderTargetPixels(target, 0, 0, width, height, pixels);
    renderer.setRenderTarget(null);
    target.dispose();
    if (parent) parent.add(object);
    return pixels;
}

const floatsOf = (text) => new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);

// One texel that tilts the normal, so that a normal map is not optimised away.
function normalTexture() {
    const texture = new THREE.DataTexture(new Uint8Array([150, 110, 240, 255]), 1, 1);
    texture.needsUpdate = true;
    return texture;
}

function environment() {
    const side = document.createElement('canvas');
    side.width = side.height = 4;
    const texture = new THREE.CubeTexture(Array(6).fill(side));
    texture.needsUpdate = true;
    return texture;
}

const grey = () => {
    const texture = new THREE.DataTexture(new Uint8Array([128, 128, 128, 255]), 1, 1);
    texture.needsUpdate = true;
    return texture;
};

const MATERIALS = {
    basic: () => new THREE.MeshBasicMaterial({ envMap: environment() }),
    normal: () => new THREE.MeshNormalMaterial(),
    lambert: () => new THREE.MeshLambertMaterial(),
    phong: () => new THREE.MeshPhongMaterial(),
    toon: () => new THREE.MeshToonMaterial(),
    matcap: () => new THREE.MeshMatcapMaterial({ matcap: grey() }),
    standard: () => new THREE.MeshStandardMaterial(),
    mapped: () => new THREE.MeshStandardMaterial({ normalMap: normalTexture() }),
    'second coordinates': () => {
        const normalMap = normalTexture();
        normalMap.channel = 1;
        return new THREE.MeshStandardMaterial({ normalMap });
    },
    'object-space map': () =>
        new THREE.MeshStandardMaterial({ normalMap: normalTexture(), normalMapType: THREE.ObjectSpaceNormalMap }),
    physical: () =>
        new THREE.MeshPhysicalMaterial({
            clearcoat: 1,
            clearcoatNormalMap: normalTexture(),
            sheen: 1,
            iridescence: 1,
            anisotropy: 0.5,
            transmission: 0.5,
            normalMap: normalTexture(),
        }),
    flat: () => new THREE.MeshStandardMaterial({ flatShading: true, normalMap: normalTexture() }),
    'double-sided': () => new THREE.MeshStandardMaterial({ side: THREE.DoubleSide, bumpMap: grey() }),
    back: () => new THREE.MeshStandardMaterial({ side: THREE.BackSide, normalMap: normalTexture() }),
    displaced: () => new THREE.MeshStandardMaterial({ displacementMap: grey(), displacementScale: 0.01 }),
    hashed: () => new THREE.MeshStandardMaterial({ alphaHash: true }),
    wireframe: () => new THREE.MeshStandardMaterial({ wireframe: true }),
    depth: () => new THREE.MeshDepthMaterial(),
};

const api = {
    materials: () => Object.keys(MATERIALS),
    revision: () => THREE.REVISION,

    // The values of GLSL expressions at every vertex of each skinned mesh. Options: those of load; module, the
    // address of a generated module, or none; material, one of MATERIALS instead of the model's; instance, a
    // matrix to draw one instance by; expressions.
    async vertices({ module, material, instance, method, expressions, ...options }) {
        const scene = await load(options);
        const meshes = skinnedMeshes(scene);
        if (material) meshes.forEach((mesh) => (mesh.material = MATERIALS[material]()));
        const skinbake = module && (await imported(module));
        const reports = skinbake ? skinbake.applySkinbake(scene, { method }) : [];
        const result = meshes.map((mesh) => ({
            patched: reports.filter((report) => report.lighting !== 'standard').length,
            world: mesh.matrixWorld.toArray(),
            values: expressions.map((expression) => base64(probed(mesh, expression, skinbake, instance, method))),
        }));
        skinbake?.dispose(scene);
        return result;
    },

    // The model's first mesh from a camera, by MeshNormalMaterial as it is, patched, and in the colours given.
    // Options: those of load; module; camera: { projection, view }, matrices; size; colours, three a vertex.
    async pictures({ module, camera, size, colours, ...options }) {
        const scene = await load(options);
        const { applySkinbake, dispose } = await import(module);
        const [mesh] = skinnedMeshes(scene);
        mesh.geometry.setAttribute('color', new THREE.BufferAttribute(floatsOf(colours), 3));
        mesh.frustumCulled = mesh.matrixWorldAutoUpdate = false;
        const seen = new THREE.Camera();
        seen.matrixWorldAutoUpdate = false;
        seen.projectionMatrix.fromArray(camera.projection);
        seen.matrixWorldInverse.fromArray(camera.view);
        seen.matrixWorld.copy(seen.matrixWorldInverse).invert();
        const materials = [
            new THREE.MeshNormalMaterial(),
            new THREE.MeshNormalMaterial(),
            new THREE.MeshBasicMaterial({ vertexColors: true }),
        ];
        const images = materials.map((material, index) => {
            mesh.material = material;
            if (index === 1) applySkinbake(mesh);
            const image = base64(drawn(mesh, seen, size, size));
            material.dispose();
            return image;
        });
        dispose(mesh);
        return images;
    },

    // A vector of the fragment shader at every pixel, from a camera, with one texel as normal map for the base and the
    // clear coat. Options: those of load; module, or none; method; texel; expression; camera; size; side; beside: the
    // roots of others of the same geometry and material, at rest, that are drawn before it and after it.
    async mapped({ module, method, texel, expression, camera, size, anisotropy = 0, beside = [], ...options }) {
        const skinbake = module && (await imported(module));
        const scene = await load({ ...options, method, Plugin: skinbake?.SkinbakePlugin });
        const [mesh] = skinnedMeshes(scene);
        mesh.frustumCulled = mesh.matrixWorldAutoUpdate = false;
        const map = new THREE.DataTexture(new Uint8Array([...texel, 255]), 1, 1);
        map.needsUpdate = true;
        mesh.material = new THREE.MeshPhysicalMaterial({
            normalMap: map,
            clearcoat: 1,
            clearcoatNormalMap: map,
            anisotropy,
            side: THREE.FrontSide,
        });
        mesh.material.onBeforeCompile = (shader) => {
            shader.fragmentShader = beforeLastBrace(shader.fragmentShader, `
                gl_FragColor = vec4(${expression}, 1.0);`);
        };
        const all = new THREE.Group().add(mesh);
        for (const [number, root] of beside.entries()) {
            const [other] = skinnedMeshes(await load({ url: options.url, root }));
            Object.assign(other, { geometry: mesh.geometry, material: mesh.material, renderOrder: 2 * number - 1 });
            other.frustumCulled = other.matrixWorldAutoUpdate = false;
            all.add(other);
        }
        const seen = new THREE.Camera();
        seen.matrixWorldAutoUpdate = false;
        seen.projectionMatrix.fromArray(camera.projection);
        seen.matrixWorldInverse.fromArray(camera.view);
        seen.matrixWorld.copy(seen.matrixWorldInverse).invert();
        const report = skinbake?.applySkinbake(all, { method });
        drawn(all, seen, size, size);
        const image = base64(drawn(all, seen, size, size));
        const told = report?.map(({ lighting, normalMap }) => `${lighting} ${normalMap}`);
        skinbake?.dispose(all);
        mesh.material.dispose();
        return { image, told, world: mesh.matrixWorld.toArray() };
    },

    // Draw the model once in each material, lit, fogged and with shadows; the console has what goes wrong.
    async compile({ module, materials, ...options }) {
        const { applySkinbake, dispose } = await import(module);
        const scene = new THREE.Scene();
        const model = await load(options);
        scene.fog = new THREE.Fog(0xffffff, 1, 100);
        const light = new THREE.DirectionalLight();
        light.castShadow = true;
        scene.add(model, light, new THREE.HemisphereLight());
        renderer.shadowMap.enabled = true;
        const found = materials.map((name) => {
            for (const mesh of skinnedMeshes(model)) {
                mesh.material = MATERIALS[name]();
                mesh.castShadow = mesh.receiveShadow = true;
                mesh.frustumCulled = false;
            }
            const report = applySkinbake(model);
            renderer.render(scene, new THREE.PerspectiveCamera());
            return report.map(({ lighting }) => lighting).join();
        });
        renderer.shadowMap.enabled = false;
        dispose(model);
        return { found, error: renderer.getContext().getError() };
    },

    // What is reported of meshes of which something is not as baked, by the names of the changes; the console
    // has the reasons.
    async misfits({ module, url, names }) {
        const { applySkinbake, dispose } = await import(module);
        const changes = {
            size: ({ attributes: a }) => {
                const size = 7 - a._skinbake_alpha_0.itemSize;
                a._skinbake_alpha_0 = new THREE.BufferAttribute(new Float32Array(4 * size), size, true);
            },
            integers: ({ attributes: a }) => (a._skinbake_alpha_0.normalized = false),
            floats: ({ attributes: a }) => (a._skinbake_alpha_0 = new THREE.BufferAttribute(new Float32Array(9), 3)),
            lacking: (geometry) => geometry.deleteAttribute('_skinbake_beta_0'),
            scale: ({ userData }) => delete userData.skinbake.scale,
            frame: ({ userData }) => (userData.skinbake.frame = 'other'),
            encoding: ({ userData }) => (userData.skinbake.encoding = 'other'),
            version: ({ userData }) => (userData.skinbake.version = 2),
            damaged: ({ userData }) => delete userData.skinbake.alpha,
            metadata: ({ userData }) => delete userData.skinbake,
            normal: (geometry) => geometry.deleteAttribute('normal'),
            influences: ({ attributes: a }) => (a.joints_1 = a.skinIndex),
            pair: (geometry) => geometry.deleteAttribute('uv2'),
            bare: ({ userData }) => delete userData.skinbake,
        };
        const found = [];
        for (const name of names) {
            const scene = await load({ url });
            const [mesh] = skinnedMeshes(scene);
            mesh.name = name;
            changes[name](mesh.geometry);
            found.push(applySkinbake(scene)[0].lighting);
            dispose(scene);
        }
        return found;
    },
};

Object.assign(window, api);
