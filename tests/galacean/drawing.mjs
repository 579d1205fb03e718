// What the tests call in the browser. Galacean loads, poses and draws characters as it always does. What comes back is
// what the vertex shaders handed on.

import {
    Animator,
    AssetType,
    BlinnPhongMaterial,
    Camera,
    DepthTextureMode,
    DirectLight,
    Material,
    Quaternion,
    Shader,
    ShadowType,
    SkinnedMeshRenderer,
    Texture2D,
    UnlitMaterial,
    WebGLEngine,
} from '@galacean/engine';
import * as skinbake from 'skinbake-galacean';
import { base64 } from '/support/base64.mjs';

const started = (async () => {
    const canvas = document.createElement('canvas');
    canvas.width = canvas.height = 64;
    document.body.append(canvas);
    const engine = await WebGLEngine.create({ canvas });
    const [scene] = engine.sceneManager.scenes;
    const root = scene.createRootEntity('root');
    const eye = root.createChild('camera');
    eye.transform.setPosition(0, 0, 10);
    const camera = eye.addComponent(Camera);
    camera.enableFrustumCulling = false;
    camera.depthTextureMode = DepthTextureMode.PrePass;
    const sun = root.createChild('sun').addComponent(DirectLight);
    return { engine, scene, root, sun };
})();

const renderersOf = (entity) => entity.getComponentsIncludeChildren(SkinnedMeshRenderer, []).filter(({ skin }) => skin);

// Galacean keeps what it has loaded from a URL.
let loads = 0;

async function loaded({ url, method, plugin = true, keepMeshData = false }) {
    const { engine } = await started;
    if (plugin) skinbake.registerSkinbake({ method });
    else skinbake.unregisterSkinbake();
    return engine.resourceManager.load({ url: `${url}?${loads++}`, type: AssetType.GLTF, params: { keepMeshData } });
}

function place({ transform }, { position, angles, scale }) {
    transform.setPosition(...position);
    transform.setRotation(...angles);
    transform.setScale(...scale);
}

// At a time of a clip, or with joints turned further.
function pose({ bones }, resource, animator, { clip, time, turned = [] }) {
    if (clip !== undefined) {
        const { name, length } = resource.animations[clip];
        animator.play(name, 0, time / length);
        animator.speed = 0;
    }
    for (const [joint, [w, x, y, z]] of turned.entries()) {
        const { transform } = bones[joint];
        const turn = new Quaternion();
        Quaternion.multiply(transform.rotationQuaternion, new Quaternion(x, y, z, w), turn);
        transform.rotationQuaternion = turn;
    }
}

// Draw until everything is compiled, then once more, recorded: each draw of that varying.
async function read(name) {
    const { engine } = await started;
    engine.update();
    CAPTURE.draws = [];
    CAPTURE.on = true;
    engine.update();
    CAPTURE.on = false;
    return CAPTURE.draws.filter((one) => one.name === name).map(({ values }) => base64(values));
}

// A program hands one varying on: that of the macro which it is compiled with.
CAPTURE.namesFor = (text) => {
    const name = /#define TEST_(\w+)/.exec(text)?.[1];
    return name === 'gl_Position' || /v_normal ?= ?/.test(text) ? [name] : [];
};

// Load a character, change it as a page might, draw it, and return what its vertex shaders hand on.
export async function draw(options) {
    const { change = '', mapped = null, morphs = [], node = null, root: placed = null, shadows = false, varying = 'v_normal' } = options;
    const { engine, root, sun } = await started;
    sun.shadowType = shadows ? ShadowType.Hard : ShadowType.None;
    const resource = await loaded(options);
    const parent = root.createChild('parent');
    if (placed) place(parent, placed);
    let entity = resource.instantiateSceneRoot();
    parent.addChild(entity);
    for (const renderer of renderersOf(entity)) {
        pose(renderer.skin, resource, entity.getComponent(Animator), options.pose ?? {});
        if (morphs.length) renderer.blendShapeWeights = new Float32Array(morphs);
        if (node) place(renderer.entity, node);
        if (mapped) map(engine, renderer.getInstanceMaterial(), mapped, options.anisotropic);
    }
    entity = (await CHANGES[change]({ engine, parent, entity, renderers: renderersOf(entity), options })) ?? entity;
    // Galacean copies no macros to clones.
    for (const { shaderData } of renderersOf(entity)) shaderData.enableMacro(`TEST_${varying}`);
    const values = await read(varying);
    const [renderer] = renderersOf(entity);
    const result = {
        values,
        report: skinbake.report(entity).map(({ lighting, reason }) => [lighting, reason]),
        root: Array.from(parent.transform.worldMatrix.elements),
        world: Array.from((renderer?.skin.rootBone.parent ?? parent).transform.worldMatrix.elements),
    };
    parent.destroy();
    return result;
}

function map(engine, material, texel, anisotropic) {
    const texture = new Texture2D(engine, 1, 1);
    texture.setPixelBuffer(new Uint8Array([...texel, 255]));
    material.normalTexture = texture;
    if (anisotropic) material.anisotropy = 0.5;
}

const withNormals = (mesh, factor) => {
    mesh.setNormals(mesh.getNormals().map((normal) => normal.clone().scale(factor)));
    mesh.uploadData(false);
};

const CHANGES = {
    '': () => null,
    clone: ({ engine, parent, entity }) => {
        engine.update();
        const other = entity.clone();
        entity.destroy();
        parent.addChild(other);
        return other;
    },
    'another material': ({ engine, renderers }) => renderers.forEach((one) => one.setMaterial(new BlinnPhongMaterial(engine))),
    'an unlit material': ({ engine, renderers }) => renderers.forEach((one) => one.setMaterial(new UnlitMaterial(engine))),
    'a shader of its own': ({ engine, renderers }) => {
        OWN ??= Shader.create('own', VERTEX, FRAGMENT);
        renderers.forEach((one) => one.setMaterial(new Material(engine, OWN)));
    },
    'another mesh': async ({ engine, renderers, options }) => {
        engine.update();
        const resource = await loaded({ url: options.other });
        const [{ mesh }] = renderersOf(resource.defaultSceneRoot);
        renderers.forEach((one) => (one.mesh = mesh));
        engine.update();
    },
    'a new renderer': ({ renderers: [old] }) => {
        const { entity, mesh, skin } = old;
        const made = entity.addComponent(SkinnedMeshRenderer);
        made.mesh = mesh;
        made.setMaterial(old.getMaterial());
        old.destroy();
        made.skin = skin;
    },
    'many joints': ({ renderers }) => renderers.forEach((one) => (one._maxVertexUniformVectors = 0)),
    standard: ({ entity }) => skinbake.lighting(entity, 'standard'),
    'standard, and back': ({ engine, entity }) => {
        skinbake.lighting(entity, 'standard');
        engine.update();
        skinbake.lighting(entity, 'accurate');
    },
    'normals set': ({ renderers }) => renderers.forEach(({ mesh }) => withNormals(mesh, -1)),
    'not drawn': ({ parent }) => void (parent.isActive = false),
    'a lost device': async ({ engine }) => {
        engine.update();
        const restored = new Promise((resolve) => engine.once('devicerestored', resolve));
        engine.forceLoseDevice();
        await new Promise((resolve) => engine.once('devicelost', () => setTimeout(resolve)));
        engine.forceRestoreDevice();
        await restored;
    },
};

let OWN;
const VERTEX = `
    attribute vec3 POSITION;
    uniform mat4 renderer_MVPMat;
    void main() { gl_Position = renderer_MVPMat * vec4(POSITION, 1.0); }`;
const FRAGMENT = 'void main() { gl_FragColor = vec4(1.0); }';

// What console.info says while a file is loaded and drawn twice.
export async function information(options) {
    const said = [];
    const { info } = console;
    console.info = (text) => said.push(text);
    await draw(options);
    console.info = info;
    return said;
}

// What is said of roots, lightings and methods that are none.
export async function roots() {
    const { engine, root } = await started;
    const attempts = [
        () => skinbake.report(undefined),
        () => skinbake.report(engine),
        () => skinbake.lighting([{}], 'standard'),
        () => skinbake.lighting(root, 'other'),
        () => skinbake.registerSkinbake({ method: 'other' }),
    ];
    return attempts.map((attempt) => {
        try {
            return attempt();
        } catch (error) {
            return String(error);
        }
    });
}

// The number of reports that a scene, an entity and a list of entities give.
export async function counted(options) {
    const { scene, root } = await started;
    const entity = (await loaded(options)).instantiateSceneRoot();
    root.addChild(entity);
    const found = [scene, root, entity, [entity, entity]].map((one) => skinbake.report(one).length);
    entity.destroy();
    return found;
}

Object.assign(window, { draw, information, roots, counted });
