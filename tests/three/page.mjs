// What the tests call in the browser: models drawn by three.js as any page would, and vertices read back.
//
// Matrices are three.js's, 16 numbers column by column; arrays come back as base64 of little-endian floats.

import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';

const renderer = new THREE.WebGLRenderer({ antialias: false });
renderer.setSize(64, 64);
document.body.append(renderer.domElement);

// Load a model and put it into a pose. Options: url; pose: { clip, time } or { turned }, a quaternion
// (w, x, y, z) for each joint, after its own rotation; root, a matrix for the whole scene; bind, a bind matrix;
// morphs, the influences of morph targets.
async function load({ url, pose = {}, root, bind, morphs }) {
    const { scene, animations } = await new GLTFLoader().loadAsync(url);
    if (root) {
        scene.matrixAutoUpdate = false;
        scene.matrix.fromArray(root);
    }
    if (pose.clip !== undefined) {
        const mixer = new THREE.AnimationMixer(scene);
        mixer.clipAction(animations[pose.clip]).play();
        mixer.setTime(pose.time);
    }
    const meshes = skinnedMeshes(scene);
    for (const [joint, [w, x, y, z]] of (pose.turned ?? []).entries()) {
        meshes[0].skeleton.bones[joint].quaternion.multiply(new THREE.Quaternion(x, y, z, w));
    }
    scene.updateMatrixWorld(true);
    for (const mesh of meshes) {
        if (bind) mesh.bind(mesh.skeleton, new THREE.Matrix4().fromArray(bind));
        if (morphs) mesh.morphTargetInfluences = morphs;
        mesh.updateMatrixWorld(true);
    }
    return scene;
}

function skinnedMeshes(root) {
    const found = [];
    root.traverse((object) => {
        if (object.isSkinnedMesh) found.push(object);
    });
    return found;
}

// A material like another one whose vertex shader writes an expression of its last scope, a vec3, for each
// vertex into a pixel of its own.
function probeOf(material, expression, width, height) {
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
    probe.customProgramCacheKey = () => `${material.customProgramCacheKey()} ${expression}`;
    return probe;
}

function beforeLastBrace(text, added) {
    const at = text.lastIndexOf('}');
    return `${text.slice(0, at)}${added}\n${text.slice(at)}`;
}

// Draw a skinned mesh as points, one a vertex, and return the expression at each: three numbers a vertex.
function probed(mesh, expression, instance) {
    const count = mesh.geometry.attributes.position.count;
    const width = Math.ceil(Math.sqrt(count));
    const height = Math.ceil(count / width);
    const geometry = mesh.geometry.clone().setIndex(null);
    const points = new THREE.Points(geometry, probeOf(mesh.material, expression, width, height));
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
    const pixels = drawn(points, new THREE.PerspectiveCamera(), width, height);
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

function base64(floats) {
    const bytes = new Uint8Array(floats.buffer, floats.byteOffset, floats.byteLength);
    let text = '';
    for (let at = 0; at < bytes.length; at += 8192) {
        text += String.fromCharCode(...bytes.subarray(at, at + 8192));
    }
    return btoa(text);
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
    async vertices({ module, material, instance, expressions, ...options }) {
        const scene = await load(options);
        const meshes = skinnedMeshes(scene);
        if (material) meshes.forEach((mesh) => (mesh.material = MATERIALS[material]()));
        const patched = module ? (await import(module)).patchSkinnedMeshes(scene) : 0;
        return meshes.map((mesh) => ({
            patched,
            world: mesh.matrixWorld.toArray(),
            values: expressions.map((expression) => base64(probed(mesh, expression, instance))),
        }));
    },

    // The model's first mesh from a camera, by MeshNormalMaterial as it is, patched, and in the colours given.
    // Options: those of load; module; camera: { projection, view }, matrices; size; colours, three a vertex.
    async pictures({ module, camera, size, colours, ...options }) {
        const scene = await load(options);
        const { patchMaterial } = await import(module);
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
            patchMaterial(new THREE.MeshNormalMaterial()),
            new THREE.MeshBasicMaterial({ vertexColors: true }),
        ];
        return materials.map((material) => {
            mesh.material = material;
            return base64(drawn(mesh, seen, size, size));
        });
    },

    // Draw the model once in each material, lit, fogged and with shadows; the console has what goes wrong.
    async compile({ module, materials, ...options }) {
        const { patchSkinnedMeshes } = await import(module);
        const scene = new THREE.Scene();
        const model = await load(options);
        scene.fog = new THREE.Fog(0xffffff, 1, 100);
        const light = new THREE.DirectionalLight();
        light.castShadow = true;
        scene.add(model, light, new THREE.HemisphereLight());
        renderer.shadowMap.enabled = true;
        const counts = materials.map((name) => {
            for (const mesh of skinnedMeshes(model)) {
                mesh.material = MATERIALS[name]();
                mesh.castShadow = mesh.receiveShadow = true;
                mesh.frustumCulled = false;
            }
            const count = patchSkinnedMeshes(model);
            renderer.render(scene, new THREE.PerspectiveCamera());
            return count;
        });
        renderer.shadowMap.enabled = false;
        return { counts, error: renderer.getContext().getError() };
    },

    // Which meshes a module patches, and what becomes of materials that they share.
    async sharing({ module, url }) {
        const { patchMaterial, patchSkinnedMeshes } = await import(module);
        const scene = await load({ url });
        const [first] = skinnedMeshes(scene);
        const material = (first.material = new THREE.MeshStandardMaterial({ name: 'shared' }));
        const own = (shader) => (shader.ran = true);
        material.onBeforeCompile = own;
        material.customProgramCacheKey = () => 'own key';
        const second = first.clone();
        const plain = first.clone();
        plain.name = 'plain';
        plain.geometry = first.geometry.clone();
        for (const name of Object.keys(plain.geometry.attributes)) {
            if (name.startsWith('_')) plain.geometry.deleteAttribute(name);
        }
        const rigid = new THREE.Mesh(first.geometry, material);
        const several = first.clone();
        several.material = [material, new THREE.MeshBasicMaterial()];
        scene.add(second, plain, rigid, several);
        const counts = [patchSkinnedMeshes(scene)];
        const before = [first.material, several.material[1].onBeforeCompile];
        counts.push(patchSkinnedMeshes(scene));
        const shader = { vertexShader: '#include <skinning_pars_vertex>\n#include <skinnormal_vertex>' };
        first.material.onBeforeCompile(shader);
        return {
            counts,
            clone_has_callbacks: shader.ran === true && first.material.customProgramCacheKey().includes('own key'),
            unchanged_by_twice: before[0] === first.material && before[1] === several.material[1].onBeforeCompile,
            cloned: first.material !== material && first.material.name === 'shared',
            one_clone: first.material === second.material && first.material === several.material[0],
            others_keep: plain.material === material && rigid.material === material,
            others_unpatched: material.onBeforeCompile === own,
            same_material: patchMaterial(first.material) === first.material,
        };
    },

    // Whether patching changes the picture of a material that has been drawn already.
    async late({ module, ...options }) {
        const { patchMaterial } = await import(module);
        const [mesh] = skinnedMeshes(await load(options));
        mesh.frustumCulled = mesh.matrixWorldAutoUpdate = false;
        mesh.material = new THREE.MeshNormalMaterial({ side: THREE.DoubleSide });
        const camera = new THREE.OrthographicCamera(-3, 3, 3, -3, -9, 9);
        const before = drawn(mesh, camera, 64, 64);
        patchMaterial(mesh.material);
        const after = drawn(mesh, camera, 64, 64);
        return before.some((value, index) => value !== after[index]);
    },

    // Two materials whose own onBeforeCompile differ: both run, and neither gets the other's program.
    async chained({ module, url }) {
        const { patchMaterial } = await import(module);
        const ran = [];
        const keys = [];
        for (const colour of ['red', 'blue']) {
            const scene = await load({ url });
            const [mesh] = skinnedMeshes(scene);
            mesh.material = new THREE.MeshBasicMaterial();
            const onBeforeCompile =
                colour === 'red'
                    ? (shader) => (ran.push('red'), (shader.fragmentShader = painted(shader.fragmentShader, 1, 0)))
                    : (shader) => (ran.push('blue'), (shader.fragmentShader = painted(shader.fragmentShader, 0, 1)));
            mesh.material.onBeforeCompile = onBeforeCompile;
            patchMaterial(mesh.material);
            keys.push(mesh.material.customProgramCacheKey());
            const camera = new THREE.OrthographicCamera(-9, 9, 9, -9, -9, 9);
            mesh.frustumCulled = mesh.matrixWorldAutoUpdate = false;
            mesh.material.side = THREE.DoubleSide;
            const pixels = drawn(mesh, camera, 64, 64);
            const at = pixels.findIndex((value, index) => index % 4 === 3 && value === 1);
            ran.push(...pixels.subarray(at - 3, at));
        }
        return { ran, different: keys[0] !== keys[1] };
    },

    // Two modules, each for one of two meshes that share a material; then the first for the other's material.
    async mixed({ modules, urls }) {
        const [first, second] = await Promise.all(modules.map((module) => import(module)));
        const scene = new THREE.Scene();
        const material = new THREE.MeshStandardMaterial({ name: 'both' });
        const models = await Promise.all(urls.map((url) => load({ url })));
        const meshes = models.map((model) => skinnedMeshes(model)[0]);
        for (const [index, mesh] of meshes.entries()) {
            mesh.name = ['normal', 'tangent'][index];
            mesh.material = material;
            mesh.frustumCulled = false;
        }
        scene.add(...models);
        const counts = [first.patchSkinnedMeshes(scene), second.patchSkinnedMeshes(scene)];
        const patch = material.onBeforeCompile;
        first.patchMaterial(material);
        renderer.render(scene, new THREE.PerspectiveCamera());
        return {
            counts,
            shared: meshes[0].material === meshes[1].material,
            refused: material.onBeforeCompile === patch,
            error: renderer.getContext().getError(),
        };
    },

    // How many meshes are patched where something of them is not as baked, by the names of the changes; the
    // console has the reasons.
    async misfits({ module, url, names }) {
        const { patchSkinnedMeshes } = await import(module);
        const changes = {
            size: ({ attributes: a }) => {
                const size = 7 - a._skinbake_alpha_0.itemSize;
                a._skinbake_alpha_0 = new THREE.BufferAttribute(new Float32Array(4 * size), size, true);
            },
            integers: ({ attributes: a }) => (a._skinbake_alpha_0.normalized = false),
            floats: ({ attributes: a }) => (a._skinbake_alpha_0 = new THREE.BufferAttribute(new Float32Array(9), 3)),
            lacking: (geometry) => geometry.deleteAttribute('_skinbake_beta_0'),
            scale: ({ userData }) => (userData.skinbake.scale *= 2),
            frame: ({ userData }) => (userData.skinbake = { frame: 'other' }),
            normal: (geometry) => geometry.deleteAttribute('normal'),
            influences: ({ attributes: a }) => (a.joints_1 = a.skinIndex),
            coordinates: ({ userData: { skinbake: s } }) => {
                s.alpha = ['TEXCOORD_0', 'TEXCOORD_1'];
                s.beta = ['TEXCOORD_1', 'TEXCOORD_2'];
            },
            pair: (geometry) => geometry.deleteAttribute('uv2'),
            bare: ({ userData }) => delete userData.skinbake,
        };
        const counts = [];
        for (const name of names) {
            const scene = await load({ url });
            const [mesh] = skinnedMeshes(scene);
            mesh.name = name;
            changes[name](mesh.geometry);
            counts.push(patchSkinnedMeshes(scene));
        }
        return counts;
    },

    // Compile a patched material whose vertex shader has none of three.js's chunks.
    async without_chunks({ module }) {
        const { patchMaterial } = await import(module);
        const sprite = patchMaterial(new THREE.ShaderMaterial({ name: 'bare' }));
        sprite.onBeforeCompile({ vertexShader: 'void main() {}', fragmentShader: '' });
    },
};

function painted(shader, red, blue) {
    return beforeLastBrace(shader, `gl_FragColor = vec4(${red}.0, 0.0, ${blue}.0, 1.0);`);
}

Object.assign(window, api);
