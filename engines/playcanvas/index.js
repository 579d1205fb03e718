// Accurate lighting in PlayCanvas for skinned meshes that skinbake has baked. For WebGL 2 and WebGPU.
//
// One module serves all characters: frame, encoding, scale, layout and names come from the file. Use:
//
//     import { skinbakeOptions } from 'skinbake-playcanvas'; // or what `skinbake shader` has written
//
//     const asset = new Asset('hero', 'container', { url: 'hero.glb' }, null, skinbakeOptions(app));
//
// Which mesh instances are lit accurately. Before each frame the module looks at all skinned ones of the
// application, so that clones, other materials and late entities need no further call.

import {
    ADDRESS_CLAMP_TO_EDGE,
    FILTER_NEAREST,
    LitMaterial,
    PIXELFORMAT_RGBA32F,
    SHADERLANGUAGE_GLSL,
    SHADERLANGUAGE_WGSL,
    ShaderChunks,
    StandardMaterial,
    Texture,
    version,
} from 'playcanvas';
import { isLeft, metadataOf, NOT_BAKED } from './bake.js';
import { jointsOf, NO_STRETCH } from './joints.js';
import { bakes, changeOf, problemIn, takeBakes } from './loading.js';
import { GLSL, METHOD, WGSL } from './shaders.js';

const watched = new Map(); // Application -> { stop }
const methods = new WeakMap(); // hooks of skinbakeOptions() -> method
const standard = new WeakSet(); // mesh instances that lighting() has switched
const lit = new WeakMap(); // material -> time when it last lit a mesh accurately
const problems = new WeakMap(); // material -> why it cannot have the chunks, or empty
const uneven = new WeakMap(); // mesh instance -> why its joints do not suit dual quaternions, or empty
const ownChunks = new Map(); // a chunk with ours -> the material's own one, undefined if it had none
const told = new WeakMap(); // mesh instance -> messages
const looked = new WeakMap(); // mesh instance -> the last of its programs when it was last looked at

/**
 * Make the options of a container asset whose baked skinned meshes are lit accurately wherever they are drawn.
 *
 * @param {AppBase} app - The application.
 * @param {{ method?: 'lbs' | 'dqs' }} [options] - Linear blending, as PlayCanvas has it, or dual quaternions.
 * @param {object} [others] - Further options of the asset. Their hooks are called too.
 * @returns {object} The fifth parameter of `new Asset(name, 'container', file, data, options)`.
 */
export function skinbakeOptions(app, { method = METHOD } = {}, others = {}) {
    if (method !== 'lbs' && method !== 'dqs') throw new Error(`skinbake: method ${method} is neither lbs nor dqs`);
    if (!app?.assets || !app.scene) throw new TypeError('skinbake: skinbakeOptions() takes the application first');
    watch(app);
    const views = new WeakMap(); // of files that are being loaded: buffer view -> bytes
    const options = {
        ...others,
        bufferView: {
            ...others.bufferView,
            postprocess: (description, bytes) => {
                views.set(description, bytes);
                others.bufferView?.postprocess?.(description, bytes);
            },
        },
        global: {
            ...others.global,
            postprocess: (gltf, result) => {
                takeBakes(gltf, result, views, method);
                others.global?.postprocess?.(gltf, result);
            },
        },
    };
    methods.set(options.global, method);
    return options;
}

/**
 * Tell the lighting of the skinned meshes below an entity. An entry stays up to date.
 *
 * @param {Entity} root - A model, or the root of the scene.
 * @returns {MeshReport[]} What each skinned mesh is drawn with, baked or not.
 */
export function report(root) {
    return skinned(root).map((instance) => new MeshReport(instance));
}

/**
 * Switch the skinned meshes below an entity to PlayCanvas's own lighting, or back.
 *
 * @param {Entity} root - A model, or the root of the scene.
 * @param {'standard' | 'accurate'} which - The lighting.
 */
export function lighting(root, which) {
    if (which !== 'standard' && which !== 'accurate') {
        throw new Error(`skinbake: lighting ${which} is neither standard nor accurate`);
    }
    for (const instance of skinned(root)) {
        if (which === 'standard') standard.add(instance);
        else standard.delete(instance);
    }
}

/**
 * Undo everything for an application, and free the textures.
 *
 * @param {AppBase} app - The application.
 */
export function dispose(app) {
    watched.get(app)?.stop();
    watched.delete(app);
}

class MeshReport {
    constructor(meshInstance) {
        this.meshInstance = meshInstance;
    }

    get lighting() {
        return found(this.meshInstance)[0];
    }

    get reason() {
        return found(this.meshInstance)[1];
    }
}

const UNKNOWN = `${NOT_BAKED}, or its asset was loaded without skinbakeOptions()`;

// Read from the programs that drew it.
function found(instance) {
    if (!instance.mesh) return ['not drawn', 'it has been destroyed'];
    const bake = bakes.get(instance.mesh);
    if (!bake) return ['standard', UNKNOWN];
    if (bake.problem || bake.arrays.change) return ['standard', bake.problem || bake.arrays.change];
    if (standard.has(instance)) return ['standard', 'lighting() has switched it'];
    const problem = problemOfMaterial(instance.material) || problems.get(instance.material);
    if (problem) return ['standard', problem];
    if (bake.method === 'dqs' && uneven.get(instance)) return ['standard', uneven.get(instance)];
    const drawn = [...instance._shaderCache.values()].filter(({ shader }) => !shader.failed);
    const programs = drawn.map(({ shader }) => shader.definition.vshader ?? '');
    const lit = programs.filter((text) => text.includes('vNormalW'));
    const isLit = instance.getParameter(CONSTANTS) !== undefined;
    if (!isLit || !programs.length) return ['not drawn', 'it has not been drawn yet'];
    if (!lit.length) return ['unlit', 'its material reads no normals'];
    if (lit.every((text) => text.includes('skinbake_normal') && CALL.test(text))) return ['accurate', ''];
    return ['standard', `its material "${instance.material.name}" does not call getNormal() of the chunk normalVS`];
}

const CALL = /vNormalW\s*=\s*getNormal\s*\(/;

// Tell of a program when it is new.
function tellOfProgram(instance) {
    const last = [...instance._shaderCache.values()].at(-1);
    if (!last || looked.get(instance) === last) return;
    looked.set(instance, last);
    const [lighting, reason] = found(instance);
    if (lighting === 'standard') tell(instance, reason);
}

function drawnBy(root) {
    if (typeof root?.findComponents !== 'function') throw new TypeError('skinbake: the root is not an entity');
    const components = [...root.findComponents('render'), ...root.findComponents('model')];
    return components.flatMap(({ meshInstances }) => meshInstances ?? []);
}

// The meshes of entities that are disabled, or not in the scene yet, have no skin.
function skinned(root) {
    return drawnBy(root).filter(({ mesh, skinInstance }) => skinInstance || bakes.has(mesh));
}

// A set that keeps nothing alive.
class LooseSet {
    #references = new Set();
    #referenceOf = new WeakMap();
    #collected = new FinalizationRegistry((reference) => this.#references.delete(reference));

    has(member) {
        return this.#referenceOf.has(member);
    }

    add(member) {
        if (this.has(member)) return;
        const reference = new WeakRef(member);
        this.#references.add(reference);
        this.#referenceOf.set(member, reference);
        this.#collected.register(member, reference);
    }

    delete(member) {
        this.#references.delete(this.#referenceOf.get(member));
        this.#referenceOf.delete(member);
    }

    *[Symbol.iterator]() {
        for (const reference of this.#references) {
            const member = reference.deref();
            if (member) yield member;
        }
    }
}

function watch(app) {
    if (watched.has(app)) return;
    rememberChunks(app.graphicsDevice);
    const kept = { materials: new LooseSet(), bakes: new Set(), instances: new LooseSet() };
    const before = () => lightAll(app, kept);
    const after = (asset) => warnOf(asset);
    app.on('prerender', before);
    app.assets.on('load', after);
    app.once('destroy', () => dispose(app));
    kept.stop = () => {
        app.off('prerender', before);
        app.assets.off('load', after);
        for (const instance of kept.instances) withoutParameters(instance);
        for (const material of kept.materials) withoutChunks(material);
        kept.bakes.forEach(free);
        kept.nothing?.destroy();
    };
    watched.set(app, kept);
}

function lightAll(app, kept) {
    for (const instance of kept.instances) if (!instance.mesh) kept.instances.delete(instance);
    const layers = app.scene.layers.layerList;
    const drawn = new Set(layers.flatMap(({ meshInstances, shadowCasters }) => [...meshInstances, ...shadowCasters]));
    const instances = [...drawn].filter(({ skinInstance }) => skinInstance);
    for (const instance of instances) light(app, kept, instance);
    for (const instance of instances) {
        if (standard.has(instance) && isSettled(instance.material)) withoutChunks(instance.material);
    }
}

const SETTLED = 1000; // milliseconds

// Whether a material has lit nothing accurately for a second. Until then it keeps the chunks: a page that switches in
// each frame needs no other program in each frame.
function isSettled(material) {
    return performance.now() - (lit.get(material) ?? -Infinity) > SETTLED;
}

const CONSTANTS = 'skinbakeConstants';
const DATA = 'skinbakeData';
const STRETCH = 'skinbakeStretch';

function light(app, kept, instance) {
    const bake = bakes.get(instance.mesh);
    if (!bake) {
        unlight(kept, instance);
        return;
    }
    const { material } = instance;
    if (standard.has(instance) && !bake.problem) {
        unlight(kept, instance);
        return;
    }
    const isDual = !bake.problem && bake.method === 'dqs';
    const joints = isDual ? jointsOf(instance, bake.used) : { problem: '', stretch: NO_STRETCH };
    if (isDual) uneven.set(instance, joints.problem);
    const problem = bake.problem || changeOf(instance.mesh, bake.arrays) || problemOfMaterial(material) ||
        prepare(app, kept, material) || joints.problem;
    if (problem) tell(instance, problem);
    if (problem) {
        unlight(kept, instance);
        return;
    }
    lit.set(material, performance.now());
    if (isDual) instance.setParameter(STRETCH, joints.stretch);
    if (kept.instances.has(instance) && instance.getParameter(DATA)?.data === bake.texture) {
        tellOfProgram(instance);
        return;
    }
    if (!bake.texture) {
        bake.texture = dataTexture(app.graphicsDevice, bake.values, bake.stride);
        kept.bakes.add(bake);
        if (!bake.kept) freeWith(instance.mesh, bake);
        bake.kept = kept;
    }
    instance.setParameter(CONSTANTS, [bake.stride, isDual ? 1 : 0, 0, 0]);
    instance.setParameter(DATA, bake.texture);
    kept.instances.add(instance);
}

function unlight(kept, instance) {
    withoutParameters(instance);
    kept.instances.delete(instance);
}

function withoutParameters(instance) {
    instance.deleteParameter(CONSTANTS);
    instance.deleteParameter(DATA);
    instance.deleteParameter(STRETCH);
}

// bake.kept is what the application keeps. It is another one after dispose().
function freeWith(mesh, bake) {
    const { destroy } = mesh;
    mesh.destroy = () => {
        bake.kept.bakes.delete(bake);
        free(bake);
        destroy.call(mesh);
    };
}

function free(bake) {
    bake.texture?.destroy();
    bake.texture = null;
}

// Texels of four floats, row by row.
function dataTexture(device, values, stride) {
    const width = Math.min(Math.max(values.length / 4, 1), 2048);
    const height = Math.ceil(values.length / (4 * width));
    const levels = new Float32Array(4 * width * height);
    levels.set(values);
    return new Texture(device, {
        name: 'skinbake',
        width,
        height,
        format: PIXELFORMAT_RGBA32F,
        mipmaps: false,
        minFilter: FILTER_NEAREST,
        magFilter: FILTER_NEAREST,
        addressU: ADDRESS_CLAMP_TO_EDGE,
        addressV: ADDRESS_CLAMP_TO_EDGE,
        levels: [levels],
    });
}

// Older ones have other chunks.
const OLDEST = [2, 10];
const [major, minor] = version.split('.').map(Number);
const isTooOld = major < OLDEST[0] || (major === OLDEST[0] && minor < OLDEST[1]);

function problemOfMaterial(material) {
    if (isTooOld) return `PlayCanvas ${version} is too old: this needs ${OLDEST.join('.')} or newer`;
    if (material instanceof StandardMaterial || material instanceof LitMaterial) return '';
    return `its material "${material.name}" is not a StandardMaterial or LitMaterial`;
}

// Give a material the chunks. It draws other meshes as before.
function prepare(app, kept, material) {
    if (kept.materials.has(material) && isPrepared(material)) return '';
    const texts = chunksFor(app.graphicsDevice, material);
    const name = `its material "${material.name}"`;
    const problem = texts ? '' : `${name}, or the application, has other chunks than PlayCanvas's`;
    problems.set(material, problem);
    if (problem) return problem;
    kept.materials.add(material);
    kept.nothing ??= dataTexture(app.graphicsDevice, new Float32Array(4), 1);
    material.setParameter(CONSTANTS, [0, 0, 0, 0]);
    material.setParameter(DATA, kept.nothing);
    material.setParameter(STRETCH, NO_STRETCH);
    for (const [language, chunks] of texts) {
        for (const [name, text] of Object.entries(chunks)) material.getShaderChunks(language).set(name, text);
    }
    material.update();
    return '';
}

function isPrepared(material) {
    if (!material.hasShaderChunks) return false;
    const chunks = [SHADERLANGUAGE_GLSL, SHADERLANGUAGE_WGSL].map((language) => material.getShaderChunks(language));
    const isOurs = (name) => chunks.some((one) => one.get(name)?.includes('skinbake'));
    if (!isOurs('skinVS') || !isOurs('normalVS')) return false;
    return !GLSL.TBNPS || isOurs('TBNPS') === isOurs('litUserMainEndVS');
}

// The text that follows PlayCanvas's own of each chunk.
const ADDED = { [SHADERLANGUAGE_GLSL]: GLSL, [SHADERLANGUAGE_WGSL]: WGSL };

// What normal maps need. It goes before what a page has at the end of main(). Where a page has another frame of tangents,
// neither is added.
const FOR_MAPS = ['litUserMainEndVS', 'TBNPS'];

// PlayCanvas's own functions stay under another name: a mesh that is not baked runs them alone.
const FUNCTIONS = {
    [SHADERLANGUAGE_GLSL]: {
        skinVS: [/mat4\s+getSkinMatrix\s*\(/, 'mat4 skinbake_usualSkinMatrix('],
        normalVS: [/vec3\s+getNormal\s*\(/, 'vec3 skinbake_usualNormal('],
        TBNPS: [/void\s+getTBN\s*\(/, 'void skinbake_usualTBN('],
    },
    [SHADERLANGUAGE_WGSL]: {
        skinVS: [/fn\s+getSkinMatrix\s*\(/, 'fn skinbake_usualSkinMatrix('],
        normalVS: [/fn\s+getNormal\s*\(/, 'fn skinbake_usualNormal('],
        TBNPS: [/fn\s+getTBN\s*\(/, 'fn skinbake_usualTBN('],
    },
};

function chunksFor(device, material) {
    const texts = [];
    for (const [language, added] of Object.entries(ADDED)) {
        const chunks = {};
        const chunkOf = (name) => (material.hasShaderChunks ? material.getShaderChunks(language).get(name) : undefined);
        const frame = chunkOf('TBNPS') ?? ShaderChunks.get(device, language).get('TBNPS') ?? '';
        const hasFrame = frame.includes('skinbake') ||
            isUsual(frame, usualChunks.get(device)[language].TBNPS, FUNCTIONS[language].TBNPS[0]);
        for (const [name, text] of Object.entries(added)) {
            if (FOR_MAPS.includes(name) && !hasFrame) continue;
            const own = chunkOf(name);
            const current = own ?? ShaderChunks.get(device, language).get(name);
            // A device has the chunks of one language only.
            if (current === undefined) continue;
            // The copy of a material has them already.
            const isOurs = current.includes('skinbake');
            if (!FUNCTIONS[language][name]) {
                chunks[name] = isOurs ? current : `${text}${current}`;
                if (!isOurs) ownChunks.set(chunks[name], own);
                continue;
            }
            const [signature, renamed] = FUNCTIONS[language][name];
            if (!isOurs && !isUsual(current, usualChunks.get(device)[language][name], signature)) return null;
            if (isOurs) {
                chunks[name] = current;
                continue;
            }
            chunks[name] = `${current.replace(signature, renamed)}${text}`;
            ownChunks.set(chunks[name], own);
        }
        texts.push([language, chunks]);
    }
    return texts;
}

const usualChunks = new WeakMap(); // device -> its chunks when the module first saw it, by language and name

function rememberChunks(device) {
    if (usualChunks.has(device)) return;
    const languages = [SHADERLANGUAGE_GLSL, SHADERLANGUAGE_WGSL].map((language) => {
        const chunks = ShaderChunks.get(device, language);
        return [language, Object.fromEntries(Object.keys(GLSL).map((name) => [name, chunks.get(name)]))];
    });
    usualChunks.set(device, Object.fromEntries(languages));
}

// Whether a chunk has PlayCanvas's own function: a baked mesh does not call what a page has in its place.
function isUsual(text, usual, signature) {
    return signature.test(text) && (usual === undefined || bodyOf(text, signature) === bodyOf(usual, signature));
}

// The function, without comments and white space.
function bodyOf(text, signature) {
    const code = text.slice(text.search(signature)).replace(/\/\*[^]*?\*\/|\/\/.*|\s+/g, '');
    let depth = 0;
    for (let end = 0; end < code.length; end++) {
        if (code[end] === '{') depth++;
        if (code[end] === '}' && --depth === 0) return code.slice(0, end);
    }
    return code;
}

function withoutChunks(material) {
    if (!isPrepared(material)) return;
    for (const language of [SHADERLANGUAGE_GLSL, SHADERLANGUAGE_WGSL]) {
        const chunks = material.getShaderChunks(language);
        for (const name of Object.keys(GLSL)) {
            const own = ownChunks.get(chunks.get(name));
            if (own === undefined) chunks.delete(name);
            else chunks.set(name, own);
        }
    }
    material.deleteParameter(CONSTANTS);
    material.deleteParameter(DATA);
    material.deleteParameter(STRETCH);
    material.update();
}

function tell(instance, reason) {
    const messages = told.get(instance) ?? told.set(instance, new Set()).get(instance);
    if (messages.has(reason)) return;
    messages.add(reason);
    console.warn(`skinbake: "${instance.node.name}" has PlayCanvas's standard lighting: ${reason}`);
}

// An asset that was loaded without the options, in an application that uses them. Or one that PlayCanvas has taken from
// its cache of URLs, loaded before by the other method.
function warnOf({ name, type, resource, options }) {
    const { gltf, renders = [] } = (type === 'container' && resource?.data) || {};
    const primitives = (gltf?.meshes ?? []).flatMap((mesh) => mesh.primitives);
    const isUnbaked = (primitive) => problemIn(gltf, primitive) === NOT_BAKED;
    if (methods.has(options?.global) && gltf?.skins?.length && !isLeft(gltf) && primitives.every(isUnbaked)) {
        console.info(`skinbake: "${name}" has no bake, and PlayCanvas's standard lighting: run skinbake bake on its file`);
    }
    for (const [number, { primitives, name: mesh = number }] of (gltf?.meshes ?? []).entries()) {
        if (!primitives.some((primitive) => metadataOf(gltf, primitive))) continue;
        const made = (renders[number]?.meshes ?? []).map((one) => bakes.get(one));
        const wanted = methods.get(options?.global);
        const other = made.find((bake) => bake?.method && wanted && bake.method !== wanted);
        if (other) {
            const reason = `its asset "${name}" comes from PlayCanvas's cache, where it was loaded before`;
            console.warn(`skinbake: "${mesh}" is drawn by ${other.method}, not by ${wanted}: ${reason}`);
        }
        if (renders[number]?.meshes && made.every((bake) => !bake)) {
            const reason = `its asset "${name}" was loaded without skinbakeOptions()`;
            console.warn(`skinbake: "${mesh}" has PlayCanvas's standard lighting: ${reason}`);
        }
    }
}
