// What the tests of the package call in the browser: scenes drawn as a page draws them, with whatever a page does
// to materials and meshes; what comes back are the normals that the vertex shaders handed on.

import * as THREE from 'three';
import { CSM } from 'three/addons/csm/CSM.js';
import { GLTFExporter } from 'three/addons/exporters/GLTFExporter.js';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import * as SkeletonUtils from 'three/addons/utils/SkeletonUtils.js';
import { MToonMaterial, VRMLoaderPlugin } from '@pixiv/three-vrm';
import * as skinbake from 'skinbake-three';

const renderer = new THREE.WebGLRenderer({ antialias: false });
renderer.setSize(64, 64);
document.body.append(renderer.domElement);
const camera = new THREE.PerspectiveCamera(); // At the origin: view space is the world.

async function load({ url, pose = {}, plugin = true, vrm = false, method, morphs }) {
    const loader = new GLTFLoader();
    if (vrm) loader.register((parser) => new VRMLoaderPlugin(parser));
    if (plugin) loader.register((parser) => new skinbake.SkinbakePlugin(parser, { method }));
    const gltf = await loader.loadAsync(url);
    const { scene, animations } = gltf;
    if (pose.clip !== undefined) {
        const mixer = new THREE.AnimationMixer(scene);
        mixer.clipAction(animations[pose.clip]).play();
        mixer.setTime(pose.time);
    }
    const meshes = skinnedMeshes(scene);
    for (const [joint, [w, x, y, z]] of (pose.turned ?? []).entries()) {
        meshes[0].skeleton.bones[joint].quaternion.multiply(new THREE.Quaternion(x, y, z, w));
    }
    for (const mesh of meshes) {
        mesh.frustumCulled = false;
        if (morphs) mesh.morphTargetInfluences = morphs;
    }
    return gltf;
}

function skinnedMeshes(root) {
    const found = [];
    root.traverse((object) => {
        if (object.isSkinnedMesh) found.push(object);
    });
    return found;
}

// Draw until hooks have done their work, then once more, recorded.
async function draw(scene, frames = 3) {
    for (let frame = 0; frame < frames; frame++) {
        renderer.render(scene, camera);
        await null;
    }
    CAPTURE.draws = [];
    CAPTURE.on = true;
    renderer.render(scene, camera);
    CAPTURE.on = false;
    return CAPTURE.draws;
}

function base64(floats) {
    const bytes = new Uint8Array(floats.buffer, floats.byteOffset, floats.byteLength);
    let text = '';
    for (let at = 0; at < bytes.length; at += 8192) {
        text += String.fromCharCode(...bytes.subarray(at, at + 8192));
    }
    return btoa(text);
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
        if (when === 'after') await draw(scene, 1);
        CHANGES[change]({ scene, mesh, model });
        if (lighting) skinbake.lighting(model, lighting);
        const draws = (await draw(scene)).map(({ values }) => base64(values));
        const now = skinnedMeshes(scene)[0];
        renderer.shadowMap.enabled = false;
        const report = options.plugin === false ? [] : told(skinbake.applySkinbake(now).meshes);
        const result = { draws, report, loaded: told(userData.skinbake?.meshes ?? []), world: now.matrixWorld.toArray() };
        skinbake.dispose(scene);
        skinbake.dispose(mesh);
        return { ...result, hooked: mesh.userData.hooked ?? false, error: renderer.getContext().getError() };
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
        skinbake.dispose(scene);
        const disposed = (await draw(scene)).map(({ values }) => base64(values));
        return { draws, again, disposed, world, attributes: Object.keys(skinnedMeshes(model)[0].geometry.attributes) };
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
        const lightings = skinbake.applySkinbake(scene).meshes.map((report) => report.lighting);
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
        const report = told(skinbake.applySkinbake(scene).meshes);
        skinbake.dispose(scene);
        return report;
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
