// What the tests of the package call in the browser: scenes drawn as a page draws them, with whatever a page does
// to materials and meshes; what comes back are the normals that the vertex shaders handed on.

import * as THREE from 'three';
import { CSM } from 'three/addons/csm/CSM.js';
import { OutlineEffect } from 'three/addons/effects/OutlineEffect.js';
import { GLTFExporter } from 'three/addons/exporters/GLTFExporter.js';
import { MeshoptDecoder } from 'three/addons/libs/meshopt_decoder.module.js';
import { DRACOLoader } from 'three/addons/loaders/DRACOLoader.js';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import * as SkeletonUtils from 'three/addons/utils/SkeletonUtils.js';
import { MToonMaterial, VRMLoaderPlugin, VRMUtils } from '@pixiv/three-vrm';
import * as skinbake from 'skinbake-three';
import { base64 } from '/support/base64.mjs';
import { parented, pass, posed, skinnedMeshes, stretch } from './posed.mjs';

// A page that has used the package is not told of what it draws before it asks for more.
skinbake.applySkinbake(new THREE.Group());
skinbake.dispose(new THREE.Group());

const renderer = new THREE.WebGLRenderer({ antialias: false });
renderer.setSize(64, 64);
document.body.append(renderer.domElement);
const camera = new THREE.PerspectiveCamera(); // At the origin: view space is the world.

const draco = new DRACOLoader().setDecoderPath('/three/examples/jsm/libs/draco/gltf/');

async function load({ url, pose = {}, plugin = true, vrm = false, method, cap, morphs }) {
    const loader = new GLTFLoader().setDRACOLoader(draco).setMeshoptDecoder(MeshoptDecoder);
    if (vrm) loader.register((parser) => new VRMLoaderPlugin(parser));
    if (plugin) loader.register((parser) => new skinbake.SkinbakePlugin(parser, { method, cap }));
    const gltf = await loader.loadAsync(url);
    for (const mesh of posed(gltf, pose, morphs)) mesh.frustumCulled = false;
    return gltf;
}

// Draw until hooks have done their work, then once more, recorded.
async function draw(scene, frames = 3, by = renderer) {
    for (let frame = 0; frame < frames; frame++) {
        by.render(scene, camera);
        await null;
    }
    CAPTURE.draws = [];
    CAPTURE.on = true;
    by.render(scene, camera);
    CAPTURE.on = false;
    return CAPTURE.draws;
}

const recorder = new THREE.WebGLRenderer({ antialias: false });

// Draw so that positions in clip space are recorded.
async function drawPositions(scene) {
    CAPTURE.names = ['gl_Position'];
    const [{ values }] = await draw(scene, 3, recorder);
    CAPTURE.names = ['vNormal'];
    return base64(values);
}

const told = (reports) => reports.map(({ lighting, reason }) => [lighting, reason]);

const MATERIALS = {
    normal: THREE.MeshNormalMaterial,
    lambert: THREE.MeshLambertMaterial,
    phong: THREE.MeshPhongMaterial,
    toon: THREE.MeshToonMaterial,
    matcap: THREE.MeshMatcapMaterial,
    standard: THREE.MeshStandardMaterial,
    physical: THREE.MeshPhysicalMaterial,
    mtoon: MToonMaterial,
};

// What applications do, before the first frame or after it.
const CHANGES = {
    nothing: () => {},
    'later hook': ({ mesh }) => {
        mesh.material.onBeforeCompile = (shader) => {
            shader.fragmentShader = shader.fragmentShader.replace('void main() {', 'void main() { /* later */');
        };
        mesh.material.needsUpdate = true;
    },
    'hook with a key': ({ mesh }) => {
        mesh.material.onBeforeCompile = () => {};
        mesh.material.customProgramCacheKey = () => 'theirs';
        mesh.material.needsUpdate = true;
    },
    'material.clone()': ({ mesh }) => (mesh.material = mesh.material.clone()),
    'material.copy()': ({ mesh }) => (mesh.material = new mesh.material.constructor().copy(mesh.material)),
    'another material': ({ mesh }) => (mesh.material = new THREE.MeshPhongMaterial()),
    'several materials': ({ mesh }) => {
        mesh.material = [new THREE.MeshPhongMaterial()];
        mesh.geometry.clearGroups();
        mesh.geometry.addGroup(0, Infinity, 0);
    },
    CSM: ({ scene, mesh }) => {
        const csm = new CSM({ camera, parent: scene, maxFar: 10, cascades: 2, shadowMapSize: 64 });
        csm.setupMaterial(mesh.material);
        csm.update();
        mesh.material.needsUpdate = true;
    },
    'targets in another order': ({ mesh }) => {
        mesh.geometry = mesh.geometry.clone();
        for (const targets of Object.values(mesh.geometry.morphAttributes)) targets.reverse();
        mesh.morphTargetInfluences?.reverse();
    },
    'mesh.clone()': ({ mesh }) => replace(mesh, mesh.clone()),
    'a new mesh': ({ mesh }) => {
        const other = new THREE.SkinnedMesh(mesh.geometry, new THREE.MeshLambertMaterial());
        other.bind(mesh.skeleton, mesh.bindMatrix);
        other.position.copy(mesh.position);
        other.quaternion.copy(mesh.quaternion);
        other.scale.copy(mesh.scale);
        replace(mesh, other);
    },
    'geometry.clone()': ({ mesh }) => (mesh.geometry = mesh.geometry.clone()),
    'toJSON()': ({ scene, model }) => {
        model.updateMatrixWorld(true);
        const read = new THREE.ObjectLoader().parse(JSON.parse(JSON.stringify(model.toJSON())));
        skinnedMeshes(read).forEach((one) => (one.frustumCulled = false));
        model.removeFromParent();
        scene.add(read);
    },
    'geometry.copy()': ({ mesh }) => mesh.geometry.copy(mesh.geometry.clone()),
    'tangents anew': ({ mesh: { geometry } }) => {
        const { tangent } = geometry.attributes;
        if (tangent) geometry.setAttribute('tangent', tangent.clone());
    },
    'no tangents': ({ mesh }) => mesh.geometry.deleteAttribute('tangent'),
    'onBeforeRender of its own': ({ mesh }) => {
        const before = mesh.onBeforeRender;
        mesh.onBeforeRender = function (...parameters) {
            before.apply(this, parameters);
            mesh.userData.hooked = true;
        };
        mesh.material = mesh.material.clone();
    },
    'override material': ({ scene }) => (scene.overrideMaterial = new THREE.MeshNormalMaterial()),
    shadows: ({ scene, mesh }) => {
        const light = new THREE.DirectionalLight();
        light.castShadow = mesh.castShadow = mesh.receiveShadow = renderer.shadowMap.enabled = true;
        scene.add(light);
    },
    'applied twice': ({ scene }) => void skinbake.applySkinbake(scene),
    'attribute taken away, applied again': ({ scene, mesh }) => {
        mesh.geometry.deleteAttribute('morphSkinbakeStorage');
        skinbake.applySkinbake(scene);
    },
};
for (const [name, Material] of Object.entries(MATERIALS)) {
    CHANGES[name] = ({ mesh }) => (mesh.material = new Material());
}

// What a page does to the arrays that alpha and beta belong to.
const ALTERED = {
    computeVertexNormals: ({ geometry }) => geometry.computeVertexNormals(),
    'normals in place': ({ geometry }) => negated(geometry.attributes.normal).needsUpdate = true,
    'normals replaced': ({ geometry }) => geometry.setAttribute('normal', negated(geometry.attributes.normal.clone())),
    'a clone with other normals': (mesh) => negated((mesh.geometry = mesh.geometry.clone()).attributes.normal),
    'interleaved normals': ({ geometry }) => {
        const { normal } = geometry.attributes;
        const buffer = new THREE.InterleavedBuffer(normal.array.slice(), 3);
        geometry.setAttribute('normal', negated(new THREE.InterleavedBufferAttribute(buffer, 3, 0)));
    },
    scale: ({ geometry }) => geometry.scale(1, 2, 1),
    'weights in place': ({ geometry: { attributes: { skinWeight } } }) => {
        for (let vertex = 0; vertex < skinWeight.count; vertex++) skinWeight.setXYZW(vertex, 0.5, 0.5, 0, 0);
        skinWeight.needsUpdate = true;
    },
    'alpha in place': ({ geometry }) => negated(geometry.attributes._skinbake_alpha_0).needsUpdate = true,
};

// What leaves the values as they are.
const REWRITTEN = {
    needsUpdate: ({ geometry }) => Object.values(geometry.attributes).forEach((one) => (one.needsUpdate = true)),
    'normalised again': (mesh) => {
        mesh.normalizeSkinWeights();
        mesh.geometry.normalizeNormals();
        mesh.geometry.attributes.skinWeight.needsUpdate = mesh.geometry.attributes.normal.needsUpdate = true;
    },
    'a clone': ({ geometry }) => geometry.setAttribute('normal', geometry.attributes.normal.clone()),
    'arrays given away while it is switched': (mesh) => {
        let scene = mesh;
        while (scene.parent) scene = scene.parent;
        skinbake.lighting(mesh, 'standard');
        for (const attribute of Object.values(mesh.geometry.attributes)) {
            attribute.onUpload(function () {
                this.array = null;
            });
            attribute.needsUpdate = true;
        }
        renderer.render(scene, camera);
        skinbake.lighting(mesh, 'accurate');
    },
    interleaved: ({ geometry }) => {
        const buffer = new THREE.InterleavedBuffer(geometry.attributes.normal.array.slice(), 3);
        geometry.setAttribute('normal', new THREE.InterleavedBufferAttribute(buffer, 3, 0));
    },
};

function negated(attribute) {
    for (let vertex = 0; vertex < attribute.count; vertex++) {
        attribute.setXYZ(vertex, -attribute.getX(vertex), -attribute.getY(vertex), -attribute.getZ(vertex));
    }
    return attribute;
}

const COPIES = {
    'clone()': (geometry) => geometry.clone(),
    'copy()': (geometry) => geometry.copy(geometry.clone()),
    InstancedBufferGeometry: (geometry) =>
        Object.assign(new THREE.InstancedBufferGeometry().copy(geometry), { instanceCount: 1 }),
};

const VIEWS = {
    ArrayCamera: () => {},
    'two renders': () => {},
    // What applications do to draw many characters in one pose: three.js has no class for it.
    instances: ({ mesh }) => {
        const matrices = [0, 1].map((number) => new THREE.Matrix4().makeRotationY(2 * number));
        mesh.isInstancedMesh = true;
        mesh.count = matrices.length;
        mesh.instanceColor = mesh.morphTexture = null;
        mesh.instanceMatrix = new THREE.InstancedBufferAttribute(new Float32Array(32), 16);
        matrices.forEach((matrix, index) => matrix.toArray(mesh.instanceMatrix.array, 16 * index));
        mesh.computeBoundingSphere();
    },
    InstancedBufferGeometry: ({ scene, mesh }) => {
        mesh.geometry = new THREE.InstancedBufferGeometry().copy(mesh.geometry);
        mesh.geometry.instanceCount = Infinity;
        mesh.geometry.setAttribute('offset', new THREE.InstancedBufferAttribute(new Float32Array(9), 3));
        mesh.material.onBeforeCompile = (shader) => {
            shader.vertexShader = shader.vertexShader
                .replace('void main() {', 'attribute vec3 offset; void main() {')
                .replace('#include <project_vertex>', 'transformed += offset;\n#include <project_vertex>');
        };
        skinbake.applySkinbake(scene);
    },
};

function plainCopy(geometry) {
    const copy = new THREE.BufferGeometry().setIndex(geometry.index);
    for (const [name, attribute] of Object.entries(geometry.attributes)) {
        if (!name.startsWith('morphSkinbake')) copy.setAttribute(name, attribute);
    }
    return copy;
}

function replace(mesh, other) {
    other.frustumCulled = false;
    mesh.parent.add(other);
    mesh.removeFromParent();
}

const api = {
    changes: () => Object.keys(CHANGES),

    // The normals of a character after a change, and what is reported. Options: those of load; change; when:
    // before the first frame or after it; lighting.
    async normals({ change = 'nothing', when = 'before', lighting, ...options }) {
        const { scene: model, userData } = await load(options);
        const scene = new THREE.Scene();
        scene.add(model);
        const [mesh] = skinnedMeshes(model);
        const original = mesh.clone();
        if (when === 'after') await draw(scene, 1);
        CHANGES[change]({ scene, mesh, model });
        if (lighting) skinbake.lighting(model, lighting);
        const draws = (await draw(scene)).map(({ values }) => base64(values));
        const now = skinnedMeshes(scene)[0];
        renderer.shadowMap.enabled = false;
        const report = options.plugin === false ? [] : told(skinbake.applySkinbake(now));
        const result = { draws, report, loaded: told(userData.skinbake ?? []), world: now.matrixWorld.toArray() };
        skinbake.dispose(scene);
        skinbake.dispose(mesh);
        skinbake.dispose(original);
        return { ...result, hooked: mesh.userData.hooked ?? false, error: renderer.getContext().getError() };
    },

    // The draws of characters that share a material.
    async together({ characters }) {
        const scene = new THREE.Scene();
        const material = new THREE.MeshStandardMaterial();
        for (const options of characters) {
            const { scene: model } = await load(options);
            skinnedMeshes(model).forEach((mesh) => (mesh.material = material));
            scene.add(model);
        }
        const draws = (await draw(scene)).map(({ values }) => base64(values));
        skinbake.dispose(scene);
        return draws;
    },

    // What is reported of a file, which may have several meshes.
    async reports(options) {
        const { scene } = await load(options);
        await draw(scene);
        const report = told(skinbake.applySkinbake(scene));
        skinbake.dispose(scene);
        return report;
    },

    // What console.info has of a file that is loaded and asked for again.
    async information(options) {
        const said = [];
        const { info } = console;
        console.info = (line) => said.push(line);
        const { scene } = await load(options);
        skinbake.applySkinbake(scene);
        await draw(scene);
        console.info = info;
        skinbake.dispose(scene);
        return said;
    },

    // How many geometries count as lit: while two are drawn, after one was disposed of and drawn again, after both were,
    // and after a page has lost others.
    async counted(options) {
        const state = globalThis[Symbol.for('skinbake.three')];
        const before = state.count;
        const counts = [];
        const look = () => counts.push(state.count - before);
        let { scene } = await load(options);
        let other = skinnedMeshes(scene)[0].clone();
        other.geometry = other.geometry.clone();
        scene.add(other);
        await draw(scene);
        look();
        other.geometry.dispose();
        await null;
        look();
        await draw(scene);
        look();
        skinnedMeshes(scene).forEach(({ geometry }) => geometry.dispose());
        await null;
        look();
        await draw(scene);
        look();
        scene = other = null;
        CAPTURE.draws = [];
        for (let round = 0; round < 50 && state.count > before; round++) {
            renderer.renderLists.dispose();
            renderer.render(new THREE.Scene(), camera);
            gc();
            await new Promise((resolve) => setTimeout(resolve, 20));
        }
        look();
        return counts;
    },

    // The normals and the report of a mesh that is drawn as it was, then altered or written anew, then asked for again.
    // The first draw after the change is the first one.
    async altered(options) {
        const found = {};
        for (const [name, change] of Object.entries({ ...ALTERED, ...REWRITTEN })) {
            const { scene } = await load(options);
            const [mesh] = skinnedMeshes(scene);
            const original = mesh.clone();
            await draw(scene, 1);
            change(mesh);
            mesh.name = name;
            const [{ values: first }] = await draw(scene, 0);
            const [{ values: later }] = await draw(scene);
            const [report] = told(skinbake.applySkinbake(scene, options));
            const [{ values: again }] = await draw(scene);
            const draws = [first, later, again].map(base64);
            found[name] = { draws, report, world: mesh.matrixWorld.toArray(), isAltered: name in ALTERED };
            if (name === 'normals in place') {
                negated(mesh.geometry.attributes.normal).needsUpdate = true;
                skinbake.applySkinbake(scene, options);
                const [{ values }] = await draw(scene);
                found.undone = { ...found[name], draws: [base64(values)], isAltered: false };
                [found.undone.report] = told(skinbake.applySkinbake(scene, options));
            }
            skinbake.dispose(scene);
            skinbake.dispose(original);
        }
        return found;
    },

    // How often components of normals are read in frames in which a page writes them, while the mesh is switched, and
    // what is reported when it is switched back.
    async written(options) {
        const { scene } = await load(options);
        const [mesh] = skinnedMeshes(scene);
        const { normal } = mesh.geometry.attributes;
        await draw(scene);
        skinbake.lighting(scene, 'standard');
        await draw(scene);
        let read = 0;
        normal.getComponent = function (...parameters) {
            read++;
            return THREE.BufferAttribute.prototype.getComponent.apply(this, parameters);
        };
        for (let frame = 0; frame < 3; frame++) {
            negated(normal).needsUpdate = true;
            await draw(scene, 0);
        }
        const found = { read };
        skinbake.lighting(scene, 'accurate');
        await draw(scene);
        [[found.lighting]] = told(skinbake.applySkinbake(scene));
        skinbake.dispose(scene);
        return found;
    },

    // The normals and the report of a character whose unused vertices a tool of three-vrm has removed after a draw.
    async trimmed({ triangles, ...options }) {
        const { scene } = await load(options);
        const [mesh] = skinnedMeshes(scene);
        const original = mesh.clone();
        const { index } = mesh.geometry;
        await draw(scene, 1);
        mesh.geometry.setIndex(new THREE.BufferAttribute(index.array.slice(0, 3 * triangles), 1));
        VRMUtils.removeUnnecessaryVertices(scene);
        const [{ values }] = await draw(scene);
        const report = told(skinbake.applySkinbake(scene));
        skinbake.dispose(scene);
        skinbake.dispose(original);
        return { normals: base64(values), report, world: mesh.matrixWorld.toArray() };
    },

    // The reports of a mesh whose arrays a page gives away after their upload: after a draw, and after another method
    // has been asked for.
    async freed(options) {
        const { scene } = await load(options);
        const [mesh] = skinnedMeshes(scene);
        mesh.computeBoundingSphere(); // three.js would read the positions after their upload.
        for (const attribute of Object.values(mesh.geometry.attributes)) {
            attribute.onUpload(function () {
                this.array = null;
            });
        }
        await draw(scene);
        const reports = told(skinbake.applySkinbake(scene));
        mesh.name = 'freed';
        reports.push(...told(skinbake.applySkinbake(scene, { method: 'dqs' })));
        skinbake.dispose(scene);
        return reports;
    },

    // The normals of altered meshes by three.js alone.
    async alteredAlone(options) {
        const found = {};
        for (const [name, change] of Object.entries(ALTERED)) {
            const { scene } = await load({ ...options, plugin: false });
            const [mesh] = skinnedMeshes(scene);
            change(mesh);
            const [{ values }] = await draw(scene);
            found[name] = base64(values);
        }
        return found;
    },

    // The normals of a mesh whose material changes them before three.js skins them.
    async hooked({ lines, ...options }) {
        const { scene } = await load(options);
        const [mesh] = skinnedMeshes(scene);
        mesh.material.onBeforeCompile = (shader) => {
            const chunk = '#include <beginnormal_vertex>';
            shader.vertexShader = shader.vertexShader.replace(chunk, `${chunk}\n${lines}`);
        };
        const [{ values }] = await draw(scene);
        const report = told(skinbake.applySkinbake(scene));
        skinbake.dispose(scene);
        return { normals: base64(values), report, world: mesh.matrixWorld.toArray() };
    },

    // The normals and the report of a mesh whose material has so many attributes of its own that none are left.
    async crowded(options) {
        const { scene } = await load(options);
        const [mesh] = skinnedMeshes(scene);
        const { geometry } = mesh;
        const names = Array.from({ length: renderer.capabilities.maxAttributes - 5 }, (_, index) => `own${index}`);
        const values = new THREE.BufferAttribute(new Float32Array(geometry.attributes.position.count), 1);
        for (const name of names) geometry.setAttribute(name, values);
        mesh.name = 'crowded';
        mesh.material = new THREE.MeshNormalMaterial({ name: 'many' });
        mesh.material.onBeforeCompile = (shader) => {
            const declared = names.map((name) => `attribute float ${name};`).join('\n');
            const moved = `transformed += ${names.join(' + ')};`;
            shader.vertexShader = `${declared}\n${shader.vertexShader}`.replace('#include <project_vertex>', `${moved}\n#include <project_vertex>`);
        };
        const draws = (await draw(scene)).map(({ values: found }) => base64(found));
        const report = told(skinbake.applySkinbake(scene));
        skinbake.dispose(scene);
        return { draws, report, world: mesh.matrixWorld.toArray() };
    },

    // What is reported of meshes with materials that draw nothing.
    async idle(options) {
        const [used, unused, hidden] = [{}, {}, { visible: false }].map((one) => new THREE.MeshPhongMaterial(one));
        const kinds = { unused: [used, unused], hidden: [used, hidden], 'all hidden': [hidden], one: hidden };
        const found = {};
        for (const [name, material] of Object.entries(kinds)) {
            const { scene } = await load(options);
            const [mesh] = skinnedMeshes(scene);
            mesh.geometry.clearGroups();
            mesh.geometry.addGroup(0, 30, 0);
            if (material[1]?.visible === false) mesh.geometry.addGroup(30, Infinity, 1);
            mesh.material = material;
            await draw(scene);
            [[found[name]]] = told(skinbake.applySkinbake(scene));
            skinbake.dispose(scene);
        }
        return found;
    },

    // A character of VRM with expressions, as three-vrm's own examples load it: with its tools, if asked for.
    async vrm({ expressions, tools = false, triangles, ...options }) {
        const { scene: model, userData } = await load({ ...options, vrm: true });
        const scene = new THREE.Scene();
        scene.add(model);
        const original = skinnedMeshes(model)[0].clone();
        if (tools) {
            const { index } = original.geometry;
            original.geometry.setIndex(new THREE.BufferAttribute(index.array.slice(0, 3 * triangles), 1));
            VRMUtils.removeUnnecessaryVertices(scene);
            VRMUtils.combineSkeletons(scene);
            VRMUtils.combineMorphs(userData.vrm);
        }
        for (const [name, weight] of Object.entries(expressions)) userData.vrm.expressionManager.setValue(name, weight);
        userData.vrm.update(0);
        const draws = (await draw(scene)).map(({ values }) => base64(values));
        const [mesh] = skinnedMeshes(model);
        const materials = [mesh.material].flat().map(({ isMToonMaterial, isOutline }) => [isMToonMaterial, isOutline]);
        const report = told(skinbake.applySkinbake(scene));
        skinbake.dispose(scene);
        skinbake.dispose(original);
        return { draws, materials, report, world: mesh.matrixWorld.toArray() };
    },

    // A mesh that was drawn before it is asked for, then disposed of, drawn with another material, asked for again.
    async late(options) {
        const { scene: model } = await load({ ...options, plugin: false });
        const scene = new THREE.Scene();
        scene.add(model);
        const [mesh] = skinnedMeshes(model);
        const found = [];
        const look = async (report) => {
            const draws = (await draw(scene)).map(({ values }) => base64(values));
            found.push({ draws, report: told(report ?? []) });
        };
        await look();
        for (let round = 0; round < 2; round++) {
            await look(skinbake.applySkinbake(scene));
            await look(skinbake.applySkinbake(scene, { method: 'dqs' }));
            skinbake.dispose(scene);
            mesh.material = new mesh.material.constructor({ defines: mesh.material.defines });
            await look();
        }
        return { found, world: mesh.matrixWorld.toArray() };
    },

    // What cameras and instances do: the draws of one frame, or of two renders, with all that is switched standard.
    async views({ kind, lighting, ...options }) {
        const { scene: model } = await load(options);
        const scene = new THREE.Scene();
        scene.add(model);
        const [mesh] = skinnedMeshes(model);
        const original = mesh.clone();
        if (lighting) skinbake.lighting(scene, lighting);
        const cameras = [0, 1].map((number) => {
            const one = new THREE.PerspectiveCamera();
            one.rotation.set(0, number, 0);
            one.updateMatrixWorld();
            one.viewport = new THREE.Vector4(32 * number, 0, 32, 64);
            return one;
        });
        await VIEWS[kind]({ scene, mesh });
        const all = kind === 'two renders' ? cameras : [kind === 'ArrayCamera' ? new THREE.ArrayCamera(cameras) : cameras[0]];
        for (let frame = 0; frame < 3; frame++) {
            for (const one of all) renderer.render(scene, one);
            await null;
        }
        CAPTURE.draws = [];
        CAPTURE.on = true;
        for (const one of all) renderer.render(scene, one);
        CAPTURE.on = false;
        const draws = CAPTURE.draws.map(({ values, instances }) => ({ values: base64(values), instances }));
        const report = told(skinbake.applySkinbake(scene));
        skinbake.dispose(scene);
        skinbake.dispose(original);
        const views = cameras.map((one) => one.matrixWorldInverse.toArray());
        return { draws, views, report, world: mesh.matrixWorld.toArray() };
    },

    // What the console has of baked meshes that three.js does not skin, or that nobody has asked for.
    async strangers(options) {
        const { scene } = await load(options);
        const [mesh] = skinnedMeshes(scene);
        const { geometry, material } = mesh;
        const batched = new THREE.BatchedMesh(1, geometry.attributes.position.count, geometry.index.count, material);
        batched.addInstance(batched.addGeometry(plainCopy(geometry)));
        const added = {
            batched,
            instanced: new THREE.InstancedMesh(geometry, material, 1),
            still: new THREE.Mesh(geometry, material),
            // As InstancedMesh2 of a library, which skins by chunks: nothing is told of it.
            skinning: Object.assign(new THREE.Mesh(geometry, material), { skeleton: mesh.skeleton }),
        };
        for (const [name, object] of Object.entries(added)) scene.add(Object.assign(object, { name }));
        skinbake.applySkinbake(scene);
        skinbake.applySkinbake(scene);
        const later = (await load({ ...options, plugin: false })).scene;
        skinnedMeshes(later).forEach((one) => (one.name = 'later'));
        scene.add(later);
        await draw(scene);
        skinbake.dispose(scene);
        for (const object of Object.values(added)) object.removeFromParent();
        await draw(scene);
    },

    // A class with a hook of its own, and a mesh of another copy of three.js.
    async classes(options) {
        const { scene } = await load({ ...options, plugin: false });
        const [mesh] = skinnedMeshes(scene);
        class Own extends THREE.SkinnedMesh {
            onBeforeRender() {
                this.userData.hooked = true;
            }
        }
        const own = new Own(mesh.geometry, mesh.material);
        own.bind(mesh.skeleton, mesh.bindMatrix);
        replace(mesh, own);
        for (let time = 0; time < 3; time++) skinbake.applySkinbake(scene);
        skinbake.lighting(own, 'standard');
        const draws = (await draw(scene)).map(({ values }) => base64(values));
        const copy = await import('/three/build/three.core.js?copy');
        const other = Object.assign(new copy.SkinnedMesh(mesh.geometry, mesh.material), { name: 'other' });
        const report = told(skinbake.applySkinbake(other));
        skinbake.dispose(scene);
        return { draws, report, hooked: own.userData.hooked, world: own.matrixWorld.toArray() };
    },

    // Normals of the first frame and of the next one in which a mesh has a copy of its geometry, and what is reported
    // before both and after them. Then what is reported after dispose().
    async copied({ copy, ...options }) {
        const { scene } = await load(options);
        const [mesh] = skinnedMeshes(scene);
        const original = mesh.clone();
        await draw(scene, 1);
        const [report] = skinbake.applySkinbake(mesh);
        mesh.geometry = COPIES[copy](mesh.geometry);
        const frames = [];
        const reports = [report.lighting];
        for (let frame = 0; frame < 2; frame++) {
            const [{ values }] = await draw(scene, 0);
            frames.push(base64(values));
            await null;
        }
        reports.push(report.lighting);
        skinbake.dispose(scene);
        skinbake.dispose(original);
        return { frames, reports, disposed: [report.lighting, report.reason], world: mesh.matrixWorld.toArray() };
    },

    // Normals of a character after frames with outlines, and whether its hook is the one from before. The effect
    // replaces it in each frame, and puts it back.
    async outlined(options) {
        const { scene } = await load(options);
        const [mesh] = skinnedMeshes(scene);
        const { onBeforeRender } = mesh;
        const effect = new OutlineEffect(renderer);
        for (let frame = 0; frame < 3; frame++) effect.render(scene, camera);
        const isSame = mesh.onBeforeRender === onBeforeRender;
        const draws = (await draw(scene)).map(({ values }) => base64(values));
        const report = told(skinbake.applySkinbake(scene));
        skinbake.dispose(scene);
        return { isSame, draws, report, world: mesh.matrixWorld.toArray() };
    },

    // Two characters that share all but what clone() of SkeletonUtils makes anew; one is switched to standard.
    async clones(options) {
        const { scene: model } = await load(options);
        const scene = new THREE.Scene();
        const other = SkeletonUtils.clone(model);
        scene.add(model, other);
        scene.traverse((object) => (object.frustumCulled = false));
        skinbake.lighting(other, 'standard');
        const draws = (await draw(scene)).map(({ values }) => base64(values));
        const world = skinnedMeshes(model)[0].matrixWorld.toArray();
        skinbake.lighting(other, 'accurate');
        const again = (await draw(scene)).map(({ values }) => base64(values));
        skinbake.dispose(other);
        const one = (await draw(scene)).map(({ values }) => base64(values));
        skinbake.applySkinbake(other);
        const back = (await draw(scene)).map(({ values }) => base64(values));
        skinbake.dispose(scene);
        const disposed = (await draw(scene)).map(({ values }) => base64(values));
        return { draws, again, one, back, disposed, world, attributes: Object.keys(skinnedMeshes(model)[0].geometry.attributes) };
    },

    // Normals of each draw of two characters, and the attributes that its program reads: while one is switched, then
    // both, a second after that, and when they are switched back. Then how many programs there are after each of more
    // such rounds, and how often the material was renewed while one was switched in each frame.
    async switched(options) {
        const by = new THREE.WebGLRenderer();
        const gl = by.getContext();
        const { scene: model } = await load(options);
        const other = SkeletonUtils.clone(model);
        skinnedMeshes(other).forEach((mesh) => (mesh.frustumCulled = false));
        const scene = new THREE.Scene();
        scene.add(model, other);
        const found = [];
        const look = async () => {
            const draws = await draw(scene, 3, by);
            found.push(
                draws.map(({ values, program }) => {
                    const count = gl.getProgramParameter(program, gl.ACTIVE_ATTRIBUTES);
                    const names = Array.from({ length: count }, (_, index) => gl.getActiveAttrib(program, index).name);
                    return { values: base64(values), names };
                }),
            );
        };
        await look();
        const programs = [];
        for (let round = 0; round < 3; round++) {
            skinbake.lighting(other, 'standard');
            pass(1001);
            await look();
            skinbake.lighting(model, 'standard');
            await look();
            pass(1001);
            await look();
            skinbake.lighting(scene, 'accurate');
            await look();
            programs.push(by.info.programs.length);
        }
        const [{ material }] = skinnedMeshes(model);
        const { version } = material;
        for (let frame = 0; frame < 6; frame++) {
            skinbake.lighting(scene, frame % 2 ? 'accurate' : 'standard');
            pass(400);
            by.render(scene, camera);
        }
        const renewed = material.version - version;
        const world = skinnedMeshes(model)[0].matrixWorld.toArray();
        skinbake.dispose(scene);
        by.dispose();
        return { found, programs, renewed, world };
    },

    // How many programs draw so many characters of some files.
    async programs({ urls, count }) {
        const scene = new THREE.Scene();
        for (const url of urls) {
            const { scene: model } = await load({ url });
            for (let number = 0; number < count; number++) scene.add(SkeletonUtils.clone(model));
        }
        scene.traverse((object) => {
            object.frustumCulled = false;
            if (object.isSkinnedMesh) object.material = new THREE.MeshStandardMaterial();
        });
        const draws = await draw(scene, 2);
        const lightings = skinbake.applySkinbake(scene).map((report) => report.lighting);
        skinbake.dispose(scene);
        return {
            draws: draws.length,
            programs: new Set(draws.map(({ program }) => program)).size,
            lightings: [...new Set(lightings)],
        };
    },

    // A material that does not use three.js's chunks; how often the console has it is counted by the tests.
    async foreign(options) {
        const { scene } = await load(options);
        const [mesh] = skinnedMeshes(scene);
        mesh.name = 'hero';
        mesh.material = new THREE.ShaderMaterial({
            name: 'own',
            vertexShader: `varying vec3 vNormal; void main() { vNormal = normal; gl_Position = vec4(position, 1.0); }`,
            fragmentShader: `varying vec3 vNormal; void main() { gl_FragColor = vec4(vNormal, 1.0); }`,
        });
        await draw(scene);
        const report = told(skinbake.applySkinbake(scene));
        skinbake.dispose(scene);
        return report;
    },

    // Normals of an unbaked and of a baked character after a library has replaced a chunk of skinning.
    async replaced({ unbaked, ...options }) {
        const three = THREE.ShaderChunk.skinning_pars_vertex;
        const other = await load({ ...options, url: unbaked, plugin: false });
        const { scene } = await load(options);
        THREE.ShaderChunk.skinning_pars_vertex = `${three}\n// as a library has it\n`;
        const found = [];
        for (const root of [other.scene, scene]) {
            for (const mesh of skinnedMeshes(root)) mesh.material = new THREE.MeshStandardMaterial({ name: 'new' });
            for (let frame = 0; frame < 3; frame++) await draw(root);
            found.push((await draw(root)).map(({ values }) => base64(values)));
        }
        const report = told(skinbake.applySkinbake(scene));
        skinbake.dispose(scene);
        const restored = THREE.ShaderChunk.skinning_pars_vertex.includes('as a library has it');
        THREE.ShaderChunk.skinning_pars_vertex = three;
        return { draws: found, report, restored, world: skinnedMeshes(scene)[0].matrixWorld.toArray() };
    },

    // Normals of a morphed character by a material that skins, but does not morph.
    async unmorphed(options) {
        const { scene } = await load(options);
        const [mesh] = skinnedMeshes(scene);
        mesh.material = new THREE.ShaderMaterial({
            vertexShader: `varying vec3 vNormal;
                #include <skinning_pars_vertex>
                void main() {
                    #include <beginnormal_vertex>
                    #include <skinbase_vertex>
                    #include <skinnormal_vertex>
                    #include <begin_vertex>
                    #include <skinning_vertex>
                    #include <project_vertex>
                    vNormal = normalMatrix * objectNormal;
                }`,
            fragmentShader: `varying vec3 vNormal; void main() { gl_FragColor = vec4(vNormal, 1.0); }`,
        });
        const draws = (await draw(scene)).map(({ values }) => base64(values));
        skinbake.dispose(scene);
        return { draws, world: mesh.matrixWorld.toArray() };
    },

    // What is thrown where a root is not an Object3D.
    async roots(options) {
        const gltf = await load({ ...options, plugin: false });
        const { applySkinbake, dispose, lighting } = skinbake;
        return [gltf, undefined].flatMap((root) =>
            [() => applySkinbake(root), () => lighting(root, 'standard'), () => dispose(root)].map((call) => {
                try {
                    return call();
                } catch (error) {
                    return error.message;
                }
            }),
        );
    },

    // Where a shadow's draw puts vertices, in clip space, and the cameras of the frame.
    async shadows({ lighting, ...options }) {
        const renderer = new THREE.WebGLRenderer();
        CAPTURE.names = ['gl_Position'];
        const { scene: model } = await load(options);
        if (lighting) skinbake.lighting(model, lighting);
        const light = new THREE.DirectionalLight();
        light.position.set(1, 2, 3);
        light.castShadow = true;
        const scene = new THREE.Scene();
        scene.add(model, light);
        skinnedMeshes(model).forEach((mesh) => Object.assign(mesh, { castShadow: true, receiveShadow: true }));
        renderer.shadowMap.enabled = true;
        for (let frame = 0; frame < 2; frame++) renderer.render(scene, camera);
        CAPTURE.draws = [];
        CAPTURE.on = true;
        renderer.render(scene, camera);
        CAPTURE.on = false;
        CAPTURE.names = ['vNormal'];
        renderer.dispose();
        const draws = CAPTURE.draws.filter(({ text }) => !text.includes('vNormal;')).map(({ values }) => base64(values));
        const world = skinnedMeshes(model)[0].matrixWorld.toArray();
        const seen = light.shadow.camera;
        skinbake.dispose(scene);
        return { draws, world, view: seen.matrixWorldInverse.toArray(), projection: seen.projectionMatrix.toArray() };
    },

    // A character below a parent with any matrix; if asked for, its mesh elsewhere, with the matrix other.
    async parented(options) {
        const { scene: model } = await load(options);
        const scene = new THREE.Scene();
        const mesh = parented(scene, model, options);
        mesh.material = new THREE.MeshNormalMaterial({ side: THREE.DoubleSide });
        const position = await drawPositions(scene);
        const [normal] = (await draw(scene)).map(({ values }) => base64(values));
        const report = told(skinbake.applySkinbake(scene, options));
        const found = { position, normal, report, world: mesh.matrixWorld.toArray() };
        skinbake.dispose(scene);
        const { matrixWorldInverse, projectionMatrix } = camera;
        return { ...found, view: matrixWorldInverse.toArray(), projection: projectionMatrix.toArray() };
    },

    // Normals with a joint of its own scale, of three.js alone too; then with the scale undone, before and after
    // applySkinbake.
    async stretched(options) {
        const found = [];
        const scene = new THREE.Scene();
        let report;
        const look = async () => {
            const draws = (await draw(scene)).map(({ values }) => base64(values));
            found.push({ draws, report: report ? told(report) : [] });
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
        model.scale.setScalar(0);
        await look();
        skinbake.dispose(scene);
        return { found, world };
    },

    // Whether the programs of shadows know dual quaternions, where other characters cast shadows first.
    async lateShadows({ light: kind, custom, ...options }) {
        const by = new THREE.WebGLRenderer();
        by.shadowMap.enabled = true;
        CAPTURE.names = ['gl_Position'];
        const light = new THREE[kind]();
        light.position.set(1, 2, 3);
        light.castShadow = true;
        const scene = new THREE.Scene();
        scene.add(light);
        const materials = { customDepthMaterial: new THREE.MeshDepthMaterial(), customDistanceMaterial: new THREE.MeshDistanceMaterial() };
        const add = ({ scene: model }) => {
            for (const mesh of skinnedMeshes(scene.add(model))) {
                Object.assign(mesh, { castShadow: true, receiveShadow: true }, custom ? materials : {});
            }
            return model;
        };
        const first = add(await load({ ...options, plugin: false }));
        await draw(scene, 3, by);
        first.removeFromParent();
        add(await load(options));
        const draws = (await draw(scene, 3, by)).filter(({ text }) => !text.includes('vNormal;'));
        const programs = by.info.programs.length;
        await draw(scene, 3, by);
        const more = by.info.programs.length - programs;
        CAPTURE.names = ['vNormal'];
        skinbake.dispose(scene);
        by.dispose();
        return { known: draws.map(({ text }) => text.includes('skinbake_turned')), more };
    },

    // Positions of an unlit material: of one that was drawn by other methods before, and of a new one.
    async unlit(options) {
        const found = [];
        for (const earlier of [['none'], ['none', 'lbs'], []]) {
            const { scene: model } = await load({ ...options, plugin: false });
            const scene = new THREE.Scene();
            scene.add(model);
            const [mesh] = skinnedMeshes(model);
            mesh.material = new THREE.MeshDepthMaterial();
            for (const method of earlier) {
                if (method !== 'none') skinbake.applySkinbake(scene, { method });
                await drawPositions(scene);
            }
            const report = skinbake.applySkinbake(scene, { method: 'dqs' });
            found.push({ position: await drawPositions(scene), report: told(report) });
            skinbake.dispose(scene);
            mesh.material.dispose(); // With its program, which the next one would have.
        }
        return found;
    },

    // How many of the materials that a mesh was drawn with are still held, after they were disposed of.
    async swapped({ count, ...options }) {
        const { scene: model } = await load(options);
        const scene = new THREE.Scene();
        scene.add(model);
        const [mesh] = skinnedMeshes(model);
        const held = [];
        for (let number = 0; number < count; number++) {
            const material = new THREE.MeshLambertMaterial();
            mesh.material.dispose();
            mesh.material = material;
            held.push(new WeakRef(material));
            await draw(scene, 1);
        }
        await new Promise((resolve) => setTimeout(resolve, 0)); // A WeakRef holds its target until the task ends.
        gc();
        const left = held.filter((one) => one.deref()).length;
        skinbake.dispose(scene);
        return left;
    },

    // Names of attributes that GLTFExporter writes of a character that is lit accurately.
    async exported(options) {
        const { scene } = await load(options);
        const json = await new GLTFExporter().parseAsync(scene);
        skinbake.dispose(scene);
        return Object.keys(json.meshes[0].primitives[0].attributes);
    },
};

Object.assign(window, api);
