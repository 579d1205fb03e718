// What the tests call in the browser. PlayCanvas loads, poses and draws characters as it always does. To read a
// varying back, each vertex is drawn as a point into a pixel of its own, by two chunks at the ends of
// PlayCanvas's own main functions. This works alike in WebGL 2 and WebGPU.

import * as pc from 'playcanvas';
import * as skinbake from 'skinbake-playcanvas';

const WIDTH = 256;
const draco = '/draco/draco_decoder_gltf';
pc.dracoInitialize({ jsUrl: `${draco}_nodejs.js`, wasmUrl: `${draco}.wasm`, numWorkers: 1 });
const apps = new Map();

async function application(backend) {
    if (apps.has(backend)) return apps.get(backend);
    const canvas = document.createElement('canvas');
    canvas.width = canvas.height = 64;
    document.body.append(canvas);
    const device = await pc.createGraphicsDevice(canvas, { deviceTypes: [backend], antialias: false });
    const options = new pc.AppOptions();
    options.graphicsDevice = device;
    const { RenderComponentSystem, CameraComponentSystem, LightComponentSystem } = pc;
    options.componentSystems = [RenderComponentSystem, CameraComponentSystem, LightComponentSystem];
    const { AnimClipHandler, ContainerHandler, RenderHandler, TextureHandler } = pc;
    options.resourceHandlers = [TextureHandler, ContainerHandler, AnimClipHandler, RenderHandler];
    const app = new pc.AppBase(canvas);
    app.init(options);
    app.start();
    app.autoRender = false;
    const sun = new pc.Entity();
    sun.addComponent('light', { type: 'directional', shadowDistance: 100, shadowResolution: 64 });
    app.root.addChild(sun);
    const camera = new pc.Entity();
    camera.addComponent('camera', {});
    camera.setPosition(0, 0, 10);
    app.root.addChild(camera);
    const one = { app, camera: camera.camera, sun: sun.light };
    apps.set(backend, one);
    return one;
}

export async function backend(name) {
    return (await application(name)).app.graphicsDevice.deviceType;
}

function loaded(app, { url, method, plugin = true }) {
    // PlayCanvas keeps morph targets in half floats otherwise.
    const others = { morphPreferHighPrecision: true };
    const options = plugin ? skinbake.skinbakeOptions(app, { method }, others) : others;
    return started(app, url, options);
}

function started(app, url, options) {
    const asset = new pc.Asset(url, 'container', { url, filename: url.split('/').pop() }, null, options);
    app.assets.add(asset);
    return new Promise((resolve, reject) => {
        asset.ready(() => resolve(asset));
        asset.once('error', (error) => reject(new Error(error)));
        app.assets.load(asset);
    });
}

const skinned = (entity) =>
    entity
        .findComponents('render')
        .flatMap(({ meshInstances }) => meshInstances)
        .filter(({ skinInstance }) => skinInstance);

function pose(instance, { turned = [] }, morphs) {
    for (const [joint, [w, x, y, z]] of turned.entries()) {
        const bone = instance.skinInstance.bones[joint];
        bone.setLocalRotation(bone.getLocalRotation().clone().mul(new pc.Quat(x, y, z, w)));
    }
    morphs.forEach((weight, index) => instance.morphInstance.setWeight(index, weight));
}

function place(node, { position, angles, scale }) {
    node.setLocalPosition(...position);
    node.setLocalEulerAngles(...angles);
    node.setLocalScale(...scale);
}

const VERTEX = {
    [pc.SHADERLANGUAGE_GLSL]: `
        gl_Position = vec4(2.0 * (float(gl_VertexID % ${WIDTH}) + 0.5) / ${WIDTH}.0 - 1.0,
            2.0 * (float(gl_VertexID / ${WIDTH}) + 0.5) / HEIGHT - 1.0, 0.5, 1.0);`,
    [pc.SHADERLANGUAGE_WGSL]: `
        output.position = vec4f(2.0 * (f32(pcVertexIndex % ${WIDTH}u) + 0.5) / ${WIDTH}.0 - 1.0,
            1.0 - 2.0 * (f32(pcVertexIndex / ${WIDTH}u) + 0.5) / HEIGHT, 0.5, 1.0);`,
};
const FRAGMENT = {
    [pc.SHADERLANGUAGE_GLSL]: 'gl_FragColor = vec4(VARYING, 1.0);',
    [pc.SHADERLANGUAGE_WGSL]: 'output.color = vec4f(VARYING, 1.0);',
};
// Shadows are drawn without the varyings.
// dNormalW is the mapped normal of the pixel.
const guarded = (text, varying) => {
    const name = varying === 'dNormalW' ? 'VNORMALW' : varying.toUpperCase();
    return `\n#ifdef VARYING_${name}\n${text.replace('VARYING', varying)}\n#endif\n`;
};


// Draw, and return the varying of each vertex of one mesh, and what `look` finds before anything else is drawn.
async function read({ app, camera }, instance, varying, look) {
    const { graphicsDevice: device } = app;
    const { mesh, material } = instance;
    const vertices = mesh.vertexBuffer.numVertices;
    const height = Math.ceil(vertices / WIDTH);
    for (const language of [pc.SHADERLANGUAGE_GLSL, pc.SHADERLANGUAGE_WGSL]) {
        const chunks = material.getShaderChunks(language);
        chunks.set('litUserMainEndVS', VERTEX[language].replaceAll('HEIGHT', `${height}.0`));
        chunks.set('litUserMainEndPS', guarded(FRAGMENT[language], varying));
    }
    material.blendType = pc.BLEND_NONE;
    material.alphaTest = 0;
    material.update();
    const usual = mesh.primitive[0];
    const [indices] = mesh.indexBuffer;
    mesh.indexBuffer[0] = null;
    mesh.primitive[0] = { type: pc.PRIMITIVE_POINTS, base: 0, baseVertex: 0, count: vertices, indexed: false };
    const colorBuffer = new pc.Texture(device, {
        width: WIDTH,
        height,
        format: pc.PIXELFORMAT_RGBA32F,
        mipmaps: false,
        minFilter: pc.FILTER_NEAREST,
        magFilter: pc.FILTER_NEAREST,
    });
    const target = new pc.RenderTarget({ colorBuffer, depth: true });
    camera.renderTarget = target;
    app.render();
    camera.renderTarget = null;
    const seen = look();
    const values = await colorBuffer.read(0, 0, WIDTH, height, { renderTarget: target, immediate: true });
    mesh.primitive[0] = usual;
    mesh.indexBuffer[0] = indices;
    for (const language of [pc.SHADERLANGUAGE_GLSL, pc.SHADERLANGUAGE_WGSL]) {
        for (const name of ['litUserMainEndVS', 'litUserMainEndPS']) material.getShaderChunks(language).delete(name);
    }
    material.update();
    target.destroy();
    colorBuffer.destroy();
    const vectors = new Float32Array(3 * vertices);
    for (let vertex = 0; vertex < vertices; vertex++) vectors.set(values.subarray(4 * vertex, 4 * vertex + 3), 3 * vertex);
    const text = btoa(Array.from(new Uint8Array(vectors.buffer), (byte) => String.fromCharCode(byte)).join(''));
    return { text, ...seen };
}

// Load a character, change it as a page might, draw it, and return what its vertex shader hands on.
export async function draw(options) {
    const { backend = 'webgl2', change = '', anisotropic = false, mapped = null, morphs = [], node = null, root = null, shadows = false, varyings = ['vNormalW'] } = options;
    const one = await application(backend);
    const { app } = one;
    one.sun.castShadows = shadows;
    const asset = await loaded(app, options);
    let entity = asset.resource.instantiateRenderEntity();
    const parent = new pc.Entity();
    if (root) place(parent, root);
    app.root.addChild(parent);
    parent.addChild(entity);
    const changed = await CHANGES[change](one, entity, options);
    if (changed) {
        entity.destroy();
        parent.addChild(changed);
        entity = changed;
    }
    for (const instance of skinned(entity)) {
        pose(instance, options.pose ?? {}, morphs);
        if (node) place(instance.node, node);
        instance.cull = false;
        if (mapped) map(app, instance.material, mapped, anisotropic);
    }
    const report = skinbake.report(entity);
    app.update(0);
    const [instance] = skinned(entity);
    const look = () => ({
        report: report.map(({ lighting, reason }) => [lighting, reason]),
        programs: [...instance._shaderCache.values()].map(({ shader }) => shader.definition.vshader),
    });
    const found = [];
    for (const varying of varyings) found.push(await read(one, instance, varying, look));
    const result = {
        values: found.map(({ text }) => text),
        world: Array.from(instance.node.getWorldTransform().data),
        root: Array.from(parent.getWorldTransform().data),
        report: found[0].report,
        programs: found[0].programs.map((text) => text.includes('skinbake_turned')),
    };
    parent.destroy();
    app.assets.remove(asset);
    asset.unload();
    return result;
}

function map(app, material, texel, anisotropic) {
    const texture = new pc.Texture(app.graphicsDevice, { width: 1, height: 1, format: pc.PIXELFORMAT_RGBA8 });
    texture.lock().set([...texel, 255]);
    texture.unlock();
    material.normalMap = texture;
    material.enableGGXSpecular = anisotropic;
    material.update();
}

let later = 0;
const now = performance.now.bind(performance);
performance.now = () => now() + later;

// Draw accurately, then switch, and draw again after more than a second.
function switchedForLong({ app }, entity) {
    app.render();
    skinbake.lighting(entity, 'standard');
    app.render();
    later += 1001;
    app.render();
}

const CHANGES = {
    '': () => null,
    clone: ({ app }, entity) => {
        app.root.addChild(entity);
        app.render();
        return entity.clone();
    },
    'another material': (_, entity) => {
        for (const instance of skinned(entity)) instance.material = new pc.StandardMaterial();
    },
    'another mesh': async ({ app }, entity, { other }) => {
        app.root.addChild(entity);
        app.render();
        const { resource } = await loaded(app, { url: other });
        for (const instance of skinned(entity)) instance.mesh = resource.renders[0].resource.meshes[0];
        app.render();
    },
    'a copied material': ({ app }, entity) => {
        app.render();
        for (const instance of skinned(entity)) instance.material = instance.material.clone();
    },
    standard: (_, entity) => skinbake.lighting(entity, 'standard'),
    'and back': ({ app }, entity) => {
        skinbake.lighting(entity, 'standard');
        app.render();
        skinbake.lighting(entity, 'accurate');
    },
    'standard just now': ({ app }, entity) => {
        app.render();
        skinbake.lighting(entity, 'standard');
    },
    'standard for long': (one, entity) => switchedForLong(one, entity),
    'and back after long': (one, entity) => {
        for (let round = 0; round < 2; round++) {
            switchedForLong(one, entity);
            skinbake.lighting(entity, 'accurate');
            one.app.render();
        }
    },
    'standard while disabled': (_, entity) => {
        entity.enabled = false;
        skinbake.lighting(entity, 'standard');
        entity.enabled = true;
    },
    'a clone is standard for long': ({ app }, entity) => {
        const other = entity.clone();
        app.root.addChild(other);
        switchedForLong({ app }, other);
        other.destroy();
    },
    'an own chunk': (_, entity) => {
        for (const { material } of skinned(entity)) {
            material.getShaderChunks(pc.SHADERLANGUAGE_GLSL).set('normalVS', OWN);
            material.update();
        }
    },
    'an own normal': ({ app }, entity) => changeChunk(app, entity, 'normalVS', 'return normalize(', 'return normalize(vec3(1.0) + '),
    'an own skin': ({ app }, entity) => changeChunk(app, entity, 'skinVS', 'return mat4(', 'return 1.5 * mat4('),
    'a main function without the chunk': ({ app }, entity) => changeChunk(app, entity, 'litMainVS', '#include "normalVS"', OWN_NORMAL),
    'a main function that does not call it': ({ app }, entity) => changeChunk(app, entity, 'litMainVS', '= getNormal()', '= getLocalNormal(vertex_normal)'),
    'an own comment': ({ app }, entity) => changeChunk(app, entity, 'normalVS', 'return normalize(', '// as before\n return   normalize('),
    'a shader of its own': (_, entity) => {
        for (const instance of skinned(entity)) instance.material = new pc.ShaderMaterial(SHADER);
    },
    'a scaled joint': (_, entity) => {
        for (const { skinInstance } of skinned(entity)) skinInstance.bones.at(-1).setLocalScale(1, 1.1, 1);
    },
    'normals set': ({ app }, entity) => {
        app.render();
        for (const { mesh } of skinned(entity)) setNormals(mesh, -1);
    },
    'normals set, then as they were': ({ app }, entity) => {
        for (const { mesh } of skinned(entity)) setNormals(mesh, -1);
        app.render();
        for (const { mesh } of skinned(entity)) setNormals(mesh, -1);
    },
    'the same normals': ({ app }, entity) => {
        app.render();
        for (const { mesh } of skinned(entity)) setNormals(mesh, 1);
    },
    'turned by a chunk': ({ app }, entity) => {
        for (const { material } of skinned(entity)) {
            for (const [language, vector] of [[pc.SHADERLANGUAGE_GLSL, 'vec3'], [pc.SHADERLANGUAGE_WGSL, 'vec3f']]) {
                const text = pc.ShaderChunks.get(app.graphicsDevice, language).get('normalCoreVS');
                if (!text) continue;
                const turned = text.replace('return localNormal;', `return localNormal + ${vector}(0.5, 0.25, -0.5);`);
                material.getShaderChunks(language).set('normalCoreVS', turned);
            }
            material.update();
        }
    },
    'other weights': ({ app }, entity) => {
        app.render();
        for (const { mesh } of skinned(entity)) turnWeights(mesh);
    },
    disposed: ({ app }) => {
        app.render();
        skinbake.dispose(app);
    },
    'disposed and again': ({ app }) => {
        app.render();
        skinbake.dispose(app);
        skinbake.skinbakeOptions(app);
    },
};

function changeChunk(app, entity, name, from, to) {
    const usual = pc.ShaderChunks.get(app.graphicsDevice, pc.SHADERLANGUAGE_GLSL).get(name);
    if (!usual.includes(from)) throw new Error(usual);
    for (const { material } of skinned(entity)) {
        material.getShaderChunks(pc.SHADERLANGUAGE_GLSL).set(name, usual.replace(from, to));
        material.update();
    }
}

function setNormals(mesh, factor) {
    const normals = [];
    mesh.getNormals(normals);
    mesh.setNormals(normals.map((one) => factor * one));
    mesh.update();
}

// Write in place, as PlayCanvas's documentation shows it: each weight for the next slot.
function turnWeights({ vertexBuffer }) {
    const iterator = new pc.VertexIterator(vertexBuffer);
    for (let vertex = 0; vertex < vertexBuffer.numVertices; vertex++) {
        const weight = iterator.element[pc.SEMANTIC_BLENDWEIGHT];
        const [a, b, c, d] = weight.array.slice(weight.index, weight.index + 4);
        weight.set(b, c, d, a);
        iterator.next();
    }
    iterator.end();
}

const OWN_NORMAL = `mat3 dNormalMatrix;
    vec3 getNormal() { dNormalMatrix = getNormalMatrix(dModelMatrix); return vertex_normal; }`;
const OWN = 'mat3 dNormalMatrix; vec3 skinnedNormal() { dNormalMatrix = mat3(1.0); return vec3(0.0, 0.0, 1.0); }';
const SHADER = {
    uniqueName: 'own',
    vertexGLSL: 'attribute vec3 vertex_position; void main(void) { gl_Position = vec4(vertex_position, 1.0); }',
    fragmentGLSL: 'void main(void) { gl_FragColor = vec4(1.0); }',
    attributes: { vertex_position: pc.SEMANTIC_POSITION },
};

// What console.info has of a file.
export async function information(options) {
    const said = [];
    const { info } = console;
    console.info = (line) => said.push(line);
    await told(options);
    console.info = info;
    return said.filter((line) => line.startsWith('skinbake'));
}

// Load and draw without reading back: what is told.
export async function told(options) {
    const one = await application('webgl2');
    const asset = await loaded(one.app, options);
    const entity = asset.resource.instantiateRenderEntity();
    one.app.root.addChild(entity);
    await CHANGES[options.change ?? ''](one, entity);
    for (const frame of [1, 2]) one.app.render();
    const report = skinbake.report(entity).map(({ lighting, reason }) => [lighting, reason]);
    entity.destroy();
    return report;
}

// Load, draw and unload a file a few times, and return how many of its materials are still in memory.
export async function remaining({ url }) {
    const { app } = await application('webgl2');
    const materials = [];
    for (let time = 0; time < 3; time++) materials.push(await unloaded(app, url));
    app.render();
    for (let time = 0; time < 5; time++) {
        gc();
        await new Promise((resolve) => setTimeout(resolve, 20));
    }
    return materials.filter((material) => material.deref()).length;
}

async function unloaded(app, url) {
    const asset = await loaded(app, { url });
    const entity = asset.resource.instantiateRenderEntity();
    app.root.addChild(entity);
    app.render();
    const { lighting } = skinbake.report(entity)[0];
    if (lighting !== 'accurate') throw new Error(lighting);
    const material = new WeakRef(skinned(entity)[0].material);
    entity.destroy();
    const parts = [...asset.resource.materials, ...asset.resource.renders];
    app.assets.remove(asset);
    asset.unload();
    for (const part of parts) part.unload();
    return material;
}

// How many animations a file has, loaded without its meshes.
export async function animations({ url }) {
    const { app } = await application('webgl2');
    const asset = await started(app, url, skinbake.skinbakeOptions(app, {}, { skipMeshes: true }));
    return asset.resource.animations.length;
}

// Load two files by one object of options. The second one begins and ends while the first waits for its texture.
export async function together({ urls: [slow, quick] }) {
    const { app } = await application('webgl2');
    const waiting = {};
    const processAsync = (_, __, done) => {
        waiting.end = () => done(null, null);
        waiting.begin();
    };
    const begun = new Promise((resolve) => (waiting.begin = resolve));
    const options = skinbake.skinbakeOptions(app, {}, { texture: { processAsync } });
    const first = started(app, slow, options);
    await begun;
    const second = await started(app, quick, options);
    waiting.end();
    return [await first, second].map((asset) => {
        const entity = asset.resource.instantiateRenderEntity();
        app.root.addChild(entity);
        app.render();
        const report = skinbake.report(entity).map(({ lighting, reason }) => [lighting, reason]);
        entity.destroy();
        return report;
    });
}

// What dispose() leaves of a material's own chunk, and of that of the material's copy.
export async function disposed({ url }) {
    const { app } = await application('webgl2');
    const asset = await loaded(app, { url });
    const entity = asset.resource.instantiateRenderEntity();
    app.root.addChild(entity);
    const [instance] = skinned(entity);
    const chunksOf = (material) => material.getShaderChunks(pc.SHADERLANGUAGE_GLSL);
    const usual = pc.ShaderChunks.get(app.graphicsDevice, pc.SHADERLANGUAGE_GLSL).get('normalVS');
    const own = `${usual}// the application's own\n`;
    const { material } = instance;
    chunksOf(material).set('normalVS', own);
    material.update();
    app.render();
    instance.material = material.clone();
    app.render();
    const lit = [material, instance.material].map((one) => chunksOf(one).get('normalVS').includes('skinbake'));
    skinbake.dispose(app);
    const kept = [material, instance.material].map((one) => chunksOf(one).get('normalVS') === own);
    const others = [material, instance.material].map((one) => chunksOf(one).has('skinVS'));
    entity.destroy();
    return { lit, kept, others };
}

// Load a file by two methods, without unloading it in between.
export async function twice({ url, methods }) {
    const { app } = await application('webgl2');
    for (const method of methods) await loaded(app, { url, method });
}

// What is told of a mesh whose entity is not in the scene, is disabled, draws by a program that fails, is destroyed.
export async function watchedOver({ url }) {
    const { app } = await application('webgl2');
    const asset = await loaded(app, { url });
    const entity = asset.resource.instantiateRenderEntity();
    const reportOf = () => skinbake.report(entity).map(({ lighting, reason }) => [lighting, reason]);
    const found = { outside: reportOf() };
    app.root.addChild(entity);
    app.render();
    found.drawn = reportOf();
    entity.enabled = false;
    found.disabled = reportOf();
    entity.enabled = true;
    const [instance] = skinned(entity);
    instance.material = new pc.LitMaterial(); // without the chunk that it needs
    app.render();
    found.failed = reportOf();
    const meshes = skinbake.report(entity);
    entity.destroy();
    found.destroyed = meshes.map(({ lighting, reason }) => [lighting, reason]);
    return found;
}

// What is said of roots and applications that are none.
export async function refused() {
    const { app } = await application('webgl2');
    const attempts = [
        () => skinbake.report(undefined),
        () => skinbake.report(app),
        () => skinbake.lighting({}, 'standard'),
        () => skinbake.skinbakeOptions({ method: 'dqs' }),
        () => skinbake.skinbakeOptions(app.scene),
    ];
    return attempts.map((attempt) => {
        try {
            return attempt();
        } catch (error) {
            return String(error);
        }
    });
}

// How often dispose() leaves a function around mesh.destroy(), when it is called again and again.
export async function wrapped({ url }) {
    const { app } = await application('webgl2');
    const asset = await loaded(app, { url });
    const entity = asset.resource.instantiateRenderEntity();
    app.root.addChild(entity);
    const [{ mesh }] = skinned(entity);
    const found = new Set();
    for (let round = 0; round < 3; round++) {
        app.render();
        found.add(mesh.destroy);
        skinbake.dispose(app);
        skinbake.skinbakeOptions(app);
    }
    entity.destroy();
    return found.size;
}

window.watchedOver = watchedOver;
window.refused = refused;
window.wrapped = wrapped;
window.animations = animations;
window.told = told;
window.twice = twice;
window.disposed = disposed;
window.together = together;
window.remaining = remaining;
window.draw = draw;
window.backend = backend;
window.information = information;
