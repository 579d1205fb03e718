// Accurate lighting in PlayCanvas for skinned meshes that skinbake has baked. For WebGL 2 and WebGPU.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang glsl --method lbs --lighting accurate --influences 4 --frame normal --target playcanvas
//
// One module serves all characters: frame, encoding, scale, layout and names come from the file. Use:
//
//     import { skinbakeOptions } from 'skinbake-playcanvas';
//
//     const asset = new Asset('hero', 'container', { url: 'hero.glb' }, null, skinbakeOptions(app));
//
// Linear blending: algorithm 3 of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient
// Lighting for Skinned Models", Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. Dual quaternions:
// algorithm 6 of skinbake, the exact derivative of their blend. Frame: T. Duff et al., "Building an Orthonormal
// Basis, Revisited", JCGT 6(1), 2017.

import {
    ADDRESS_CLAMP_TO_EDGE,
    FILTER_NEAREST,
    LitMaterial,
    Mat4,
    PIXELFORMAT_RGBA32F,
    SEMANTIC_BLENDWEIGHT,
    SEMANTIC_NORMAL,
    SEMANTIC_POSITION,
    SHADERLANGUAGE_GLSL,
    SHADERLANGUAGE_WGSL,
    ShaderChunks,
    StandardMaterial,
    Texture,
    Vec3,
} from 'playcanvas';

const METHOD = 'lbs';

// Which mesh instances are lit accurately. Before each frame the module looks at all skinned ones of the
// application, so that clones, other materials and late entities need no further call.

const bakes = new WeakMap(); // Mesh -> { problem, values, stride, method, arrays, texture, kept }
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
 * @returns {SkinbakeReport} What each skinned mesh is drawn with.
 */
export function skinbakeReport(root) {
    return { meshes: skinned(root).map((instance) => new MeshReport(instance)) };
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

const NOT_BAKED = 'it is not baked, or its asset was loaded without skinbakeOptions()';

// Read from the programs that drew it.
function found(instance) {
    if (!instance.mesh) return ['not drawn', 'it has been destroyed'];
    const bake = bakes.get(instance.mesh);
    if (!bake) return ['standard', NOT_BAKED];
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
    return ['standard',
            `its material "${instance.material.name}" does not call getNormal() of the chunk normalVS`];
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
    const drawn = new Set(layers.flatMap(({ meshInstances, shadowCasters }) => [...meshInstances,
            ...shadowCasters]));
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
const NO_STRETCH = [1, 0, 0, 0, 1, 0, 0, 0, 1];

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

function problemOfMaterial(material) {
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
    const chunks = [SHADERLANGUAGE_GLSL,
            SHADERLANGUAGE_WGSL].map((language) => material.getShaderChunks(language));
    return Object.keys(GLSL).every((name) => chunks.some((one) => one.get(name)?.includes('skinbake')));
}

// PlayCanvas's own functions stay under another name: a mesh that is not baked runs them alone.
function chunksFor(device, material) {
    const texts = [];
    const languages = new Map([[SHADERLANGUAGE_GLSL, GLSL], [SHADERLANGUAGE_WGSL, WGSL]]);
    for (const [language, added] of languages) {
        const chunks = {};
        for (const [name, { usual, text }] of Object.entries(added)) {
            const own = material.hasShaderChunks ? material.getShaderChunks(language).get(name) : undefined;
            const current = own ?? ShaderChunks.get(device, language).get(name);
            // A device has the chunks of one language only.
            if (current === undefined) continue;
            const [signature, renamed] = usual;
            // The copy of a material has them already.
            const isOurs = current.includes('skinbake');
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
    return signature.test(text) && (usual === undefined || bodyOf(text, signature) === bodyOf(usual,
            signature));
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
// Dual quaternions need rigid joints. In the space of the skeleton's parent, a joint's matrix may be a rigid motion
// after a linear map that all joints have in common, for example a scale or a mirror. The map is the stretch.

const RIGID = 1e-3; // the largest entry of |Q^T Q - 1|, as in skinbake

const matrix = new Mat4();
const toParent = new Mat4();
const unstretched = new Mat4();
const axes = [new Vec3(), new Vec3(), new Vec3()];
const normal = new Vec3();

// Return the stretch of the joints in use, nine numbers column by column, or why they are not rigid.
function jointsOf({ skinInstance: { bones, skin } }, used) {
    const joints = (used ?? [...bones.keys()]).filter((joint) => joint < bones.length);
    if (!joints.length) return { problem: '', stretch: NO_STRETCH }; // the skeleton is not there yet
    const { parent } = topOf(bones, bones[joints[0]]);
    toParent.copy(parent ? parent.getWorldTransform() : Mat4.IDENTITY).invert();
    let stretch = null;
    for (const joint of joints) {
        matrix.mul2(toParent, bones[joint].getWorldTransform()).mul(skin.inverseBindPose[joint]);
        matrix.data.fill(0, 12, 15);
        if (!stretch) {
            const size = Math.cbrt(Math.abs(determinantOf(matrix)));
            stretch = [0, 1, 2, 4, 5, 6, 8, 9, 10].map((at) => matrix.data[at] / size);
            unstretched.copy(matrix).invert();
        }
        if (isRotation(matrix.mul(unstretched))) continue;
        const name = bones[joint].name;
        const problem = `its joint "${name}" is scaled otherwise than other joints: load it with the method lbs`;
        return { problem, stretch: NO_STRETCH };
    }
    return { problem: '', stretch };
}

function topOf(bones, bone) {
    let top = bone;
    for (let node = bone.parent; node; node = node.parent) if (bones.includes(node)) top = node;
    return top;
}

function determinantOf(one) {
    const [x, y, z] = [one.getX(axes[0]), one.getY(axes[1]), one.getZ(axes[2])];
    return normal.cross(x, y).dot(z);
}

function isRotation(one) {
    const isPositive = determinantOf(one) > 0;
    const isOne = (i, j) => Math.abs(axes[i].dot(axes[j]) - (i === j ? 1 : 0)) <= RIGID;
    return isPositive && axes.every((_, i) => axes.every((__, j) => isOne(i, j)));
}
// PlayCanvas gives shaders no attributes of other names. So alpha, beta and TANGENT are read from the buffer views
// when the file is loaded, decoded, and put into a texture.

const FRAMES = { normal: 2, tangent: 3 }; // texels of each vertex
const ENCODINGS = { packed8: 5120, snorm16: 5122 };
const COMPONENTS = {
    5120: [Int8Array, 127],
    5121: [Uint8Array, 255],
    5122: [Int16Array, 32767],
    5123: [Uint16Array, 65535],
    5125: [Uint32Array, 1],
    5126: [Float32Array, 1],
};
const SIZES = { VEC2: 2, VEC3: 3, VEC4: 4 };

const LOST = 'it has lost the metadata of its bake: keep the extras of primitives, or bake last';

const isObject = (value) => typeof value === 'object' && value !== null;

function takeBakes(gltf, { renders }, views, method) {
    for (const [number, { primitives }] of (gltf.meshes ?? []).entries()) {
        const meshes = renders[number]?.meshes; // none with the option skipMeshes
        if (meshes?.length !== primitives.length) continue;
        for (const [index, primitive] of primitives.entries()) {
            const metadata = metadataOf(gltf, primitive);
            const mesh = meshes[index];
            if (metadata) {
                const bake = bakeOf(gltf, primitive, metadata, views, method);
                bakes.set(mesh, { ...bake, arrays: arraysOf(mesh) });
            } else if (primitive.attributes._SKINBAKE_ALPHA_0 !== undefined) bakes.set(mesh,
                    { problem: LOST });
        }
    }
    for (const description of gltf.bufferViews ?? []) views.delete(description);
}

// Alpha and beta are right for these arrays alone.
const NAMES = { [SEMANTIC_NORMAL]: 'NORMAL', [SEMANTIC_POSITION]: 'POSITION',
        [SEMANTIC_BLENDWEIGHT]: 'WEIGHTS_0' };
const writes = new WeakMap(); // VertexBuffer -> how often it has been written

function arraysOf(mesh) {
    const { vertexBuffer } = mesh;
    watchBuffer(vertexBuffer);
    const prints = Object.keys(NAMES).map((semantic) => [semantic, printOf(mesh, semantic)]);
    return { vertexBuffer, written: writes.get(vertexBuffer), prints, change: '' };
}

// Return which array of a mesh is not as it was loaded; empty if none. A page may write the same values anew.
function changeOf(mesh, arrays) {
    const { vertexBuffer } = mesh;
    const written = writes.get(vertexBuffer);
    if (arrays.vertexBuffer === vertexBuffer && arrays.written === written) return arrays.change;
    watchBuffer(vertexBuffer);
    const [semantic] = arrays.prints.find(([name, print]) => !isLike(printOf(mesh, name), print)) ?? [];
    const change = semantic ? `a page has changed its ${NAMES[semantic]}: its bake is for the old values` : '';
    Object.assign(arrays, { vertexBuffer, written: writes.get(vertexBuffer), change });
    return change;
}

function watchBuffer(vertexBuffer) {
    if (!vertexBuffer || writes.has(vertexBuffer)) return;
    writes.set(vertexBuffer, 0);
    const { unlock } = vertexBuffer;
    vertexBuffer.unlock = function (...parameters) {
        writes.set(vertexBuffer, writes.get(vertexBuffer) + 1);
        return unlock.apply(this, parameters);
    };
}

// A sum of all components, by random factors from -1 to 1.
function printOf(mesh, semantic) {
    const values = [];
    if (mesh.vertexBuffer) mesh.getVertexStream(semantic, values);
    let sum = 0;
    let square = 0;
    for (let index = 0; index < values.length; index++) {
        let bits = Math.imul((index + 1) ^ (index >>> 15), 0x85ebca6b);
        bits = Math.imul(bits ^ (bits >>> 13), 0xc2b2ae35);
        sum += values[index] * (bits / 2 ** 31);
        square += values[index] ** 2;
    }
    return { sum, length: Math.sqrt(square) };
}

// Rounding, as when a page normalises again, changes less.
const isLike = (one, other) => !(Math.abs(one.sum - other.sum) > 1e-5 * other.length);

// Where extras of the primitive were not an object, bake has put the metadata into those of alpha's accessor.
function metadataOf({ accessors = [] }, { extras, attributes }) {
    const places = [extras, ...Object.values(attributes).map((number) => accessors[number]?.extras)];
    const notes = places.map((place) => place?.skinbake);
    return notes.find((note) => isObject(note) && Number.isInteger(note.version));
}

function bakeOf(gltf, primitive, metadata, views, method) {
    const problem = problemOf(gltf, primitive, metadata);
    if (problem) return { problem };
    const read = (name) => elements(gltf, primitive.attributes[name], views);
    const names = [...new Set([...metadata.alpha, ...metadata.beta])];
    const stored = names.map(read);
    const tangents = metadata.frame === 'tangent' ? read('TANGENT') : null;
    if ([...stored, ...(tangents ? [tangents] : [])].some((array) => !array)) {
        return { problem: 'its buffer views could not be read: bake it again without compression' };
    }
    const isPaired = metadata.layout === 'texcoord';
    const [alpha, beta] = isPaired ? assembled(stored) : stored.map((array) => decoded(array, metadata));
    const stride = FRAMES[metadata.frame];
    const count = alpha.length / 3;
    const values = new Float32Array(4 * stride * count);
    for (let vertex = 0; vertex < count; vertex++) {
        const at = 4 * stride * vertex;
        values.set(alpha.subarray(3 * vertex, 3 * vertex + 3), at);
        values.set(beta.subarray(3 * vertex, 3 * vertex + 3), at + 4);
        if (tangents) values.set(tangents.subarray(4 * vertex, 4 * vertex + 4), at + 8);
    }
    const used = method === 'dqs' ? jointsInUse(read('JOINTS_0'), read('WEIGHTS_0')) : null;
    return { problem: '', values, stride, method, used, texture: null };
}

// The joints that move a vertex, or that are the first one of a vertex. Null where the arrays are not at hand.
function jointsInUse(joints, weights) {
    if (!joints || !weights) return null;
    return [...new Set(joints.filter((_, index) => index % 4 === 0 || weights[index] > 0))];
}

function problemOf({ accessors }, { attributes, extensions }, metadata) {
    const { version, frame, encoding, layout, influences, scale, alpha, beta } = metadata;
    if (version !== 1) return `its bake has version ${version}, and this module reads version 1: update it`;
    if (extensions?.KHR_draco_mesh_compression) {
        return 'its alpha and beta are compressed by Draco: bake it again with --compress none';
    }
    if (influences > 4 || attributes.JOINTS_1 !== undefined) {
        const count = influences > 4 ? influences : 8;
        const remedy = 'bake it again with --limit-influences 4';
        return `it has ${count} influences for each vertex, and PlayCanvas reads four: ${remedy}`;
    }
    if (!Array.isArray(alpha) || !Array.isArray(beta)) return 'the metadata of its bake is damaged: bake it again';
    if (!FRAMES[frame]) return `its frame is ${frame}, and this module knows normal and tangent: update it`;
    if (encoding !== undefined && !ENCODINGS[encoding]) {
        return `its encoding is ${encoding}, and this module knows packed8 and snorm16: update it`;
    }
    if (encoding && !Number.isFinite(scale)) return 'the metadata of its bake lacks the scale: bake it again';
    for (const name of frame === 'tangent' ? ['NORMAL', 'TANGENT'] : ['NORMAL']) {
        if (attributes[name] !== undefined) continue;
        return `it has lost the attribute ${name}, which its bake needs: bake last`;
    }
    for (const name of [...alpha, ...beta]) {
        const problem = misfit(accessors[attributes[name]], encoding, layout);
        if (problem) return `its attribute ${name} ${problem}: bake last, or keep attributes as they are`;
    }
    return '';
}

function misfit(accessor, encoding, layout) {
    if (!accessor) return 'is missing';
    const type = layout === 'texcoord' ? 'VEC2' : encoding ? 'VEC4' : 'VEC3';
    if (accessor.type !== type) return `is ${accessor.type}, not ${type}`;
    if (!encoding) return accessor.componentType === 5126 ? '' : 'is not of floats';
    const isEncoded = accessor.componentType === ENCODINGS[encoding] && accessor.normalized;
    return isEncoded ? '' : `is not encoded as ${encoding}`;
}

// The elements of an accessor as floats, or null where its buffer views are not at hand.
function elements(gltf, number, views) {
    const accessor = gltf.accessors[number];
    const { bufferView, componentType, count, normalized, sparse, type } = accessor;
    const size = SIZES[type];
    const [Numbers, limit] = COMPONENTS[componentType];
    const isZero = sparse && bufferView === undefined;
    const values = isZero ? new Numbers(size * count) : rowsOf(gltf, accessor, count, size, views);
    if (!values || (sparse && !replaced(gltf, accessor, values, size, views))) return null;
    return Float32Array.from(values, (value) => (normalized ? Math.max(value / limit, -1) : value));
}

// Put the elements of a sparse accessor into their places, and return whether they are at hand.
function replaced(gltf, { componentType, sparse }, target, size, views) {
    const places = rowsOf(gltf, sparse.indices, sparse.count, 1, views);
    const values = rowsOf(gltf, { ...sparse.values, componentType }, sparse.count, size, views);
    places?.forEach((place, row) => target.set(values.subarray(size * row, size * (row + 1)), size * place));
    return Boolean(places && values);
}

// Rows of numbers as they are stored, or null where the buffer view is not at hand.
function rowsOf({ bufferViews }, { bufferView, byteOffset = 0, componentType }, count, size, views) {
    const description = bufferViews?.[bufferView];
    const bytes = views.get(description);
    if (!bytes) return null;
    const [Numbers] = COMPONENTS[componentType];
    const width = size * Numbers.BYTES_PER_ELEMENT;
    const stride = description.byteStride ?? width;
    const packed = new Uint8Array(width * count);
    for (let row = 0; row < count; row++) {
        const start = byteOffset + row * stride;
        packed.set(bytes.subarray(start, start + width), width * row);
    }
    return new Numbers(packed.buffer);
}

function decoded(stored, { encoding, scale }) {
    if (!encoding) return stored;
    const count = stored.length / 4;
    const result = new Float32Array(3 * count);
    for (let vertex = 0; vertex < count; vertex++) {
        const factor = scale * stored[4 * vertex + 3] ** 2;
        for (let at = 0; at < 3; at++) result[3 * vertex + at] = factor * stored[4 * vertex + at];
    }
    return result;
}

// The layout texcoord has alpha 1, alpha 2 | alpha 3, beta 1 | beta 2, beta 3.
function assembled(stored) {
    const count = stored[0].length / 2;
    const both = [new Float32Array(3 * count), new Float32Array(3 * count)];
    for (let vertex = 0; vertex < count; vertex++) {
        const row = stored.flatMap((pairs) => [pairs[2 * vertex], pairs[2 * vertex + 1]]);
        both[0].set(row.slice(0, 3), 3 * vertex);
        both[1].set(row.slice(3, 6), 3 * vertex);
    }
    return both;
}
// The chunks, after PlayCanvas's own functions of the same names, which they rename and still call.
const GLSL = {
    skinVS: {
        usual: [/mat4\s+getSkinMatrix\s*\(/, 'mat4 skinbake_usualSkinMatrix('],
        text: /* glsl */ `
uniform vec4 skinbakeConstants; // texels of each vertex: 2 normal, 3 tangent frame; 1 for dual quaternions
uniform highp sampler2D skinbakeData; // alpha, beta, TANGENT
uniform mat3 skinbakeStretch; // by which joints differ from rigid ones, for dual quaternions

#ifndef SKINBAKE_VERTEX
#define SKINBAKE_VERTEX
// A skinned vertex. Its vectors have any length. tangent and bitangent are the images of t0 and b0.
struct skinbake_Vertex {
    vec3 position;
    vec3 normal;
    vec3 tangent;
    vec3 bitangent;
};

// The tangent frame at rest.
struct skinbake_Frame {
    vec3 normal;
    vec3 tangent;
    vec3 bitangent;
    float handedness; // n0 = handedness * cross(t0, b0) / |t0|^2
};
#endif

#ifndef SKINBAKE_FRAME_FROM_TANGENT
#define SKINBAKE_FRAME_FROM_TANGENT
// The frame of NORMAL, which must have length 1, and TANGENT.
skinbake_Frame skinbake_frame(vec3 n, vec4 tangent)
{
    return skinbake_Frame(n, tangent.xyz, cross(n, tangent.xyz) * tangent.w, tangent.w);
}
#endif

#ifndef SKINBAKE_FRAME_FROM_NORMAL
#define SKINBAKE_FRAME_FROM_NORMAL
// The frame that bake took from NORMAL alone. n must have length 1. Every product in a sum is exact, so a compiler
// that fuses multiply-adds gets the same bits. side is the last factor, because Mesa turns side * ((x * x) * a)
// into side * (x * (x * a)).
skinbake_Frame skinbake_frame(vec3 n)
{
    float side = n.z >= 0.0 ? 1.0 : -1.0; // 1 also at -0.0
    float a = -1.0 / (side + n.z);
    float b = (n.x * n.y) * a;
    vec3 t0 = vec3(1.0 + ((n.x * n.x) * a) * side, side * b, -side * n.x);
    vec3 b0 = vec3(b, side * (1.0 + ((n.y * n.y) * a) * side), -n.y);
    return skinbake_Frame(n, t0, b0, 1.0);
}
#endif

#ifndef SKINBAKE_MORPHED
#define SKINBAKE_MORPHED
// The frame under morph targets, by the morphed normal n: NORMAL plus the weighted sum of its targets, of any
// length. The frame at rest turns by the smallest rotation that takes its normal to n. Do not use
// skinbake_frame(n): alpha and beta belong to the frame at rest.
skinbake_Frame skinbake_morphed_frame(skinbake_Frame rest, vec3 n)
{
    float square = dot(n, n);
    vec3 normal = square > 0.0 ? n * inversesqrt(square) : rest.normal;
    vec3 s = rest.normal + normal;
    vec3 d = normal - rest.normal;
    bool opposite = dot(s, s) < 1e-4; // then every half turn is the smallest: take the one about t0
    float k = opposite ? 0.0 : 2.0 / dot(s, s);
    vec3 tangent = rest.tangent - s * (k * dot(d, rest.tangent));
    vec3 bitangent = rest.bitangent - s * (k * dot(d, rest.bitangent));
    return skinbake_Frame(normal, tangent, opposite ? -bitangent : bitangent, rest.handedness);
}
#endif

#ifndef SKINBAKE_MOVED
#define SKINBAKE_MOVED
// M p: the position p moved by the joint matrix M alone.
vec3 skinbake_moved(mat4 M, vec3 p)
{
    return M[0].xyz * p.x + (M[1].xyz * p.y + (M[2].xyz * p.z + M[3].xyz));
}
#endif

// The frame moves by the derivative of the skinned position along t0 and b0.
// M: the joint matrices of slots 0 to 3.
skinbake_Vertex skinbake_lbs_accurate(vec3 p, skinbake_Frame frame, mat4 M[4], vec4 weights_0, vec3 alpha_0,
        vec3 beta_0)
{
    mat3 T = weights_0.x * mat3(M[0]) // 1
            + weights_0.y * mat3(M[1])
            + weights_0.z * mat3(M[2])
            + weights_0.w * mat3(M[3]);
    vec3 q0 = skinbake_moved(M[0], p); // 2
    vec3 q1 = skinbake_moved(M[1], p);
    vec3 q2 = skinbake_moved(M[2], p);
    vec3 q3 = skinbake_moved(M[3], p);
    vec3 d1 = q1 - q0; // 3
    vec3 d2 = q2 - q0;
    vec3 d3 = q3 - q0;
    skinbake_Vertex v;
    v.tangent = T * frame.tangent + alpha_0.x * d1 + alpha_0.y * d2 + alpha_0.z * d3; // 4
    v.bitangent = T * frame.bitangent + beta_0.x * d1 + beta_0.y * d2 + beta_0.z * d3; // 5
    v.normal = frame.handedness * cross(v.tangent, v.bitangent); // 6
    v.position = q0 + weights_0.y * d1 + weights_0.z * d2 + weights_0.w * d3; // 7
    return v;
}

#ifndef SKINBAKE_DUAL_QUATERNION
#define SKINBAKE_DUAL_QUATERNION
// The unit dual quaternion of a rigid joint matrix. [0] is its real part (x, y, z, w), w the scalar; [1] is its
// dual part. Compute it on the host or in a pass over the joints: once per joint and frame, not per vertex.
// Dual quaternions have no scale. If all joint matrices share a uniform scale s, divide their upper 3x3 parts by
// s first, and skin s * p, s * t0, s * b0 in place of p, t0, b0.
mat2x4 skinbake_dual_quaternion(mat4 M)
{
    vec3 d = vec3(M[0].x, M[1].y, M[2].z);
    vec4 squares = 1.0 + vec4( // 4 * (x, y, z, w)^2
        d.x - d.y - d.z, d.y - d.z - d.x, d.z - d.x - d.y, d.x + d.y + d.z);
    vec3 differences = vec3(M[1].z - M[2].y, M[2].x - M[0].z, M[0].y - M[1].x); // 4 w * (x, y, z)
    vec3 sums = vec3(M[1].z + M[2].y, M[2].x + M[0].z, M[0].y + M[1].x); // 4 * (yz, zx, xy)
    vec4 real = vec4(differences, squares.w);
    float largest = squares.w;
    if (squares.x > largest) {
        largest = squares.x;
        real = vec4(squares.x, sums.z, sums.y, differences.x);
    }
    if (squares.y > largest) {
        largest = squares.y;
        real = vec4(sums.z, squares.y, sums.x, differences.y);
    }
    if (squares.z > largest) {
        real = vec4(sums.y, sums.x, squares.z, differences.z);
    }
    real = normalize(real);
    vec3 t = M[3].xyz;
    return mat2x4(real, 0.5 * vec4(cross(t, real.xyz) + real.w * t, -dot(t, real.xyz)));
}
#endif

#ifndef SKINBAKE_HEMISPHERE
#define SKINBAKE_HEMISPHERE
// -1 if the real part of the joint points away from that of the pivot: q and -q are the same rotation.
float skinbake_hemisphere(mat2x4 joint, mat2x4 pivot)
{
    return dot(joint[0], pivot[0]) < 0.0 ? -1.0 : 1.0;
}
#endif

#ifndef SKINBAKE_DERIVATIVE
#define SKINBAKE_DERIVATIVE
// The derivative of p + delta along t, if the mix b changes at the rate db. delta = k h, and i is as in the caller.
vec3 skinbake_derivative(mat2x4 b, float k, vec3 p, vec3 i, vec3 delta, vec3 t, mat2x4 db)
{
    vec3 di = b[0].w * t + db[1].xyz + cross(b[0].xyz, t) + db[0].w * p + cross(db[0].xyz, p);
    vec3 dh = b[0].w * db[1].xyz + cross(b[0].xyz, di) + cross(db[0].xyz, i)
            + db[0].w * b[1].xyz - db[1].w * b[0].xyz - b[1].w * db[0].xyz - dot(b[0], db[0]) * delta;
    return t + k * dh;
}
#endif

// The frame moves by the derivative of the motion p' = p + delta of the mix, delta = k h,
//     i = r x p + r0 p + d, h = r x i + r0 d - d0 r, k = 2 / (r0^2 + |r|^2), the mix b = (r0, r, d0, d).
// Q: the dual quaternions of slots 0 to 3.
skinbake_Vertex skinbake_dqs_exact(vec3 p, skinbake_Frame frame, mat2x4 Q[4], vec4 weights_0, vec3 alpha_0,
        vec3 beta_0)
{
    float s1 = skinbake_hemisphere(Q[1], Q[0]); // 1
    float s2 = skinbake_hemisphere(Q[2], Q[0]);
    float s3 = skinbake_hemisphere(Q[3], Q[0]);
    mat2x4 b = weights_0.x * Q[0]
              + (s1 * weights_0.y) * Q[1]
              + (s2 * weights_0.z) * Q[2]
              + (s3 * weights_0.w) * Q[3];
    float square = dot(b[0], b[0]);
    float k = square == 0.0 ? 2.0 : 2.0 / square; // 2
    vec3 i = b[0].w * p + b[1].xyz + cross(b[0].xyz, p); // 3
    vec3 delta = k * (b[0].w * b[1].xyz - b[1].w * b[0].xyz + cross(b[0].xyz, i));
    skinbake_Vertex v;
    v.position = p + delta;
    mat2x4 D1 = s1 * Q[1] - Q[0]; // 4
    mat2x4 D2 = s2 * Q[2] - Q[0];
    mat2x4 D3 = s3 * Q[3] - Q[0];
    mat2x4 db_t = alpha_0.x * D1 + alpha_0.y * D2 + alpha_0.z * D3; // 5
    mat2x4 db_b = beta_0.x * D1 + beta_0.y * D2 + beta_0.z * D3; // 6
    v.tangent = skinbake_derivative(b, k, p, i, delta, frame.tangent, db_t); // 7
    v.bitangent = skinbake_derivative(b, k, p, i, delta, frame.bitangent, db_b); // 8
    v.normal = frame.handedness * cross(v.tangent, v.bitangent); // 9
    return v;
}

bool skinbake_isBaked()
{
    return skinbakeConstants.x > 1.5;
}

bool skinbake_hasDualQuaternions()
{
    return skinbakeConstants.y > 0.5;
}

vec4 skinbake_datum(int index)
{
    int texel = gl_VertexID * int(skinbakeConstants.x) + index;
    int width = textureSize(skinbakeData, 0).x;
    return texelFetch(skinbakeData, ivec2(texel % width, texel / width), 0);
}

mat4 skinbake_joint(float index)
{
    vec4 x, y, z;
    getBoneMatrix(textureSize(texture_poseMap, 0).x, 3 * int(index + 0.5), x, y, z);
    return transpose(mat4(x, y, z, vec4(0.0, 0.0, 0.0, 1.0)));
}

mat4[4] skinbake_joints()
{
    return mat4[4](
        skinbake_joint(vertex_boneIndices.x), skinbake_joint(vertex_boneIndices.y),
        skinbake_joint(vertex_boneIndices.z), skinbake_joint(vertex_boneIndices.w));
}

// PlayCanvas divides positions by the sum of the weights.
vec4 skinbake_weights()
{
    float sum = dot(vertex_boneWeights, vec4(1.0));
    return sum > 0.0 ? vertex_boneWeights / sum : vec4(1.0, 0.0, 0.0, 0.0);
}

// Each joint is L Q X: Q is rigid, L and X are common to all joints. X is the uniform, up to a rotation and a scale.
// The joints relative to the first one, X M[0]^-1 M[i] X^-1, are rigid too. L is not needed.
struct skinbake_Relation
{
    mat3 stretch; // X
    mat3 outer; // M[0] X^-1, without its translation
    mat2x4 motions[4];
};

skinbake_Relation skinbake_related(mat4 M[4])
{
    skinbake_Relation found;
    found.stretch = skinbakeStretch;
    mat3 unstretched = inverse(found.stretch);
    found.outer = mat3(M[0]) * unstretched;
    mat3 inner = inverse(found.outer);
    for (int i = 0; i < 4; i++) {
        mat4 motion = mat4(inner * mat3(M[i]) * unstretched);
        motion[3].xyz = inner * (M[i][3].xyz - M[0][3].xyz);
        found.motions[i] = skinbake_dual_quaternion(motion);
    }
    return found;
}

// Joints undo a mirror of the mesh's node. Then they turn the cross product of tangent and bitangent round.
float skinbake_side(mat4 M[4])
{
    return determinant(mat3(M[0])) < 0.0 ? -1.0 : 1.0;
}

skinbake_Vertex skinbake_turned(vec3 p, skinbake_Frame frame, mat4 M[4], vec3 alpha, vec3 beta)
{
    skinbake_Relation joints = skinbake_related(M);
    frame.tangent = joints.stretch * frame.tangent;
    frame.bitangent = joints.stretch * frame.bitangent;
    skinbake_Vertex v = skinbake_dqs_exact(
        joints.stretch * p, frame, joints.motions, skinbake_weights(), alpha, beta);
    v.position = joints.outer * v.position + M[0][3].xyz;
    v.tangent = joints.outer * v.tangent;
    v.bitangent = joints.outer * v.bitangent;
    v.normal = frame.handedness * skinbake_side(M) * cross(v.tangent, v.bitangent);
    return v;
}

// Relative to the first joint, dual quaternions move a vertex rigidly.
mat4 getSkinMatrix(const in vec4 indices, const in vec4 weights)
{
    if (!skinbake_isBaked() || !skinbake_hasDualQuaternions()) return skinbake_usualSkinMatrix(indices,
            weights);
    mat4 M[4] = skinbake_joints();
    skinbake_Relation joints = skinbake_related(M);
    skinbake_Frame frame = skinbake_Frame(vec3(0.0), vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), 1.0);
    skinbake_Vertex v = skinbake_dqs_exact(
        vec3(0.0), frame, joints.motions, skinbake_weights(), vec3(0.0), vec3(0.0));
    mat4 found = mat4(joints.outer * mat3(v.tangent, v.bitangent, v.normal) * joints.stretch);
    found[3].xyz = joints.outer * v.position + M[0][3].xyz;
    return found;
}
`,
    },
    normalVS: {
        usual: [/vec3\s+getNormal\s*\(/, 'vec3 skinbake_usualNormal('],
        text: /* glsl */ `
#if defined(SKIN) && !defined(BATCH)
vec3 skinbake_normal()
{
    vec3 n0 = dot(vertex_normal, vertex_normal) > 0.0 ? normalize(vertex_normal) : vec3(0.0, 0.0, 1.0);
    skinbake_Frame rest = skinbake_frame(n0);
    if (skinbakeConstants.x > 2.5) rest = skinbake_frame(n0, skinbake_datum(2));
    skinbake_Frame frame = rest;
    vec3 local = getLocalNormal(vertex_normal); // morphed, or turned by a chunk normalCoreVS of the page
    if (local != vertex_normal) frame = skinbake_morphed_frame(rest, local);
    mat4 M[4] = skinbake_joints();
    vec3 p = getLocalPosition(vertex_position.xyz);
    vec3 alpha = skinbake_datum(0).xyz;
    vec3 beta = skinbake_datum(1).xyz;
    skinbake_Vertex v;
    if (skinbake_hasDualQuaternions()) {
        v = skinbake_turned(p, frame, M, alpha, beta);
    } else {
        v = skinbake_lbs_accurate(p, frame, M, skinbake_weights(), alpha, beta);
        v.normal *= skinbake_side(M);
    }
    mat3 world = mat3(matrix_model);
    mat3 cofactors = mat3(cross(world[1], world[2]), cross(world[2], world[0]), cross(world[0], world[1]));
    vec3 normal = normalize((cofactors * v.normal) * (determinant(world) < 0.0 ? -1.0 : 1.0));
    // PlayCanvas multiplies TANGENT by this matrix. TANGENT lies in the plane of the frame at rest.
    dNormalMatrix = world * (outerProduct(v.tangent, rest.tangent / dot(rest.tangent, rest.tangent))
            + outerProduct(v.bitangent, rest.bitangent / dot(rest.bitangent, rest.bitangent)));
#ifndef TANGENTS
    dNormalMatrix += outerProduct(normal, n0);
#endif
    return normal;
}
#endif

vec3 getNormal()
{
#if defined(SKIN) && !defined(BATCH)
    if (skinbake_isBaked()) return skinbake_normal();
#endif
    return skinbake_usualNormal();
}
`,
    },
};
const WGSL = {
    skinVS: {
        usual: [/fn\s+getSkinMatrix\s*\(/, 'fn skinbake_usualSkinMatrix('],
        text: /* wgsl */ `
uniform skinbakeConstants: vec4f;
uniform skinbakeStretch: mat3x3f;
var skinbakeData: texture_2d<uff>;

// A skinned vertex. Its vectors have any length. tangent and bitangent are the images of t0 and b0.
struct skinbake_Vertex {
    position: vec3<f32>,
    normal: vec3<f32>,
    tangent: vec3<f32>,
    bitangent: vec3<f32>,
}

// The tangent frame at rest.
struct skinbake_Frame {
    normal: vec3<f32>,
    tangent: vec3<f32>,
    bitangent: vec3<f32>,
    handedness: f32, // n0 = handedness * cross(t0, b0) / |t0|^2
}

// The frame of NORMAL, which must have length 1, and TANGENT.
fn skinbake_tangent_frame(n: vec3<f32>, tangent: vec4<f32>) -> skinbake_Frame {
    return skinbake_Frame(n, tangent.xyz, cross(n, tangent.xyz) * tangent.w, tangent.w);
}

// The frame that bake took from NORMAL alone. n must have length 1. Every product in a sum is exact, so a compiler
// that fuses multiply-adds gets the same bits. side is the last factor, because Mesa turns side * ((x * x) * a)
// into side * (x * (x * a)).
fn skinbake_frame(n: vec3<f32>) -> skinbake_Frame {
    let side = select(-1.0, 1.0, n.z >= 0.0); // 1 also at -0.0
    let a = -1.0 / (side + n.z);
    let b = (n.x * n.y) * a;
    let t0 = vec3<f32>(1.0 + ((n.x * n.x) * a) * side, side * b, -side * n.x);
    let b0 = vec3<f32>(b, side * (1.0 + ((n.y * n.y) * a) * side), -n.y);
    return skinbake_Frame(n, t0, b0, 1.0);
}

// The frame under morph targets, by the morphed normal n: NORMAL plus the weighted sum of its targets, of any
// length. The frame at rest turns by the smallest rotation that takes its normal to n. Do not use
// skinbake_frame(n): alpha and beta belong to the frame at rest.
fn skinbake_morphed_frame(rest: skinbake_Frame, n: vec3<f32>) -> skinbake_Frame {
    let square = dot(n, n);
    let normal = select(rest.normal, n * inverseSqrt(square), square > 0.0);
    let s = rest.normal + normal;
    let d = normal - rest.normal;
    let opposite = dot(s, s) < 1e-4; // then every half turn is the smallest: take the one about t0
    let k = select(2.0 / dot(s, s), 0.0, opposite);
    let tangent = rest.tangent - s * (k * dot(d, rest.tangent));
    let bitangent = rest.bitangent - s * (k * dot(d, rest.bitangent));
    return skinbake_Frame(normal, tangent, select(bitangent, -bitangent, opposite), rest.handedness);
}

// The upper 3x3 part of M.
fn skinbake_upper(M: mat4x4<f32>) -> mat3x3<f32> {
    return mat3x3<f32>(M[0].xyz, M[1].xyz, M[2].xyz);
}

// M p: the position p moved by the joint matrix M alone.
fn skinbake_moved(M: mat4x4<f32>, p: vec3<f32>) -> vec3<f32> {
    return M[0].xyz * p.x + (M[1].xyz * p.y + (M[2].xyz * p.z + M[3].xyz));
}

// The frame moves by the derivative of the skinned position along t0 and b0.
// M: the joint matrices of slots 0 to 3.
fn skinbake_lbs_accurate(p: vec3<f32>, frame: skinbake_Frame, M: array<mat4x4<f32>, 4>, weights_0: vec4<f32>,
        alpha_0: vec3<f32>, beta_0: vec3<f32>) -> skinbake_Vertex {
    let T = weights_0.x * skinbake_upper(M[0]) // 1
          + weights_0.y * skinbake_upper(M[1])
          + weights_0.z * skinbake_upper(M[2])
          + weights_0.w * skinbake_upper(M[3]);
    let q0 = skinbake_moved(M[0], p); // 2
    let q1 = skinbake_moved(M[1], p);
    let q2 = skinbake_moved(M[2], p);
    let q3 = skinbake_moved(M[3], p);
    let d1 = q1 - q0; // 3
    let d2 = q2 - q0;
    let d3 = q3 - q0;
    let tangent = T * frame.tangent + alpha_0.x * d1 + alpha_0.y * d2 + alpha_0.z * d3; // 4
    let bitangent = T * frame.bitangent + beta_0.x * d1 + beta_0.y * d2 + beta_0.z * d3; // 5
    let normal = frame.handedness * cross(tangent, bitangent); // 6
    let position = q0 + weights_0.y * d1 + weights_0.z * d2 + weights_0.w * d3; // 7
    return skinbake_Vertex(position, normal, tangent, bitangent);
}

// The unit dual quaternion of a rigid joint matrix. [0] is its real part (x, y, z, w), w the scalar; [1] is its
// dual part. Compute it on the host or in a pass over the joints: once per joint and frame, not per vertex.
// Dual quaternions have no scale. If all joint matrices share a uniform scale s, divide their upper 3x3 parts by
// s first, and skin s * p, s * t0, s * b0 in place of p, t0, b0.
fn skinbake_dual_quaternion(M: mat4x4<f32>) -> mat2x4<f32> {
    let d = vec3<f32>(M[0].x, M[1].y, M[2].z);
    let squares = 1.0 + vec4<f32>( // 4 * (x, y, z, w)^2
        d.x - d.y - d.z, d.y - d.z - d.x, d.z - d.x - d.y, d.x + d.y + d.z);
    let differences = vec3<f32>(M[1].z - M[2].y, M[2].x - M[0].z, M[0].y - M[1].x); // 4 w * (x, y, z)
    let sums = vec3<f32>(M[1].z + M[2].y, M[2].x + M[0].z, M[0].y + M[1].x); // 4 * (yz, zx, xy)
    var real = vec4<f32>(differences, squares.w);
    var largest = squares.w;
    if (squares.x > largest) {
        largest = squares.x;
        real = vec4<f32>(squares.x, sums.z, sums.y, differences.x);
    }
    if (squares.y > largest) {
        largest = squares.y;
        real = vec4<f32>(sums.z, squares.y, sums.x, differences.y);
    }
    if (squares.z > largest) {
        real = vec4<f32>(sums.y, sums.x, squares.z, differences.z);
    }
    real = normalize(real);
    let t = M[3].xyz;
    return mat2x4<f32>(real, 0.5 * vec4<f32>(cross(t, real.xyz) + real.w * t, -dot(t, real.xyz)));
}

// -1 if the real part of the joint points away from that of the pivot: q and -q are the same rotation.
fn skinbake_hemisphere(joint: mat2x4<f32>, pivot: mat2x4<f32>) -> f32 {
    return select(1.0, -1.0, dot(joint[0], pivot[0]) < 0.0);
}

// The derivative of p + delta along t, if the mix b changes at the rate db. delta = k h, and i is as in the caller.
fn skinbake_derivative(b: mat2x4<f32>, k: f32, p: vec3<f32>, i: vec3<f32>, delta: vec3<f32>, t: vec3<f32>,
        db: mat2x4<f32>) -> vec3<f32> {
    let di = b[0].w * t + db[1].xyz + cross(b[0].xyz, t) + db[0].w * p + cross(db[0].xyz, p);
    let dh = b[0].w * db[1].xyz + cross(b[0].xyz, di) + cross(db[0].xyz, i)
           + db[0].w * b[1].xyz - db[1].w * b[0].xyz - b[1].w * db[0].xyz - dot(b[0], db[0]) * delta;
    return t + k * dh;
}

// The frame moves by the derivative of the motion p' = p + delta of the mix, delta = k h,
//     i = r x p + r0 p + d, h = r x i + r0 d - d0 r, k = 2 / (r0^2 + |r|^2), the mix b = (r0, r, d0, d).
// Q: the dual quaternions of slots 0 to 3.
fn skinbake_dqs_exact(p: vec3<f32>, frame: skinbake_Frame, Q: array<mat2x4<f32>, 4>, weights_0: vec4<f32>,
        alpha_0: vec3<f32>, beta_0: vec3<f32>) -> skinbake_Vertex {
    let s1 = skinbake_hemisphere(Q[1], Q[0]); // 1
    let s2 = skinbake_hemisphere(Q[2], Q[0]);
    let s3 = skinbake_hemisphere(Q[3], Q[0]);
    let b = weights_0.x * Q[0]
          + (s1 * weights_0.y) * Q[1]
          + (s2 * weights_0.z) * Q[2]
          + (s3 * weights_0.w) * Q[3];
    let square = dot(b[0], b[0]);
    let k = select(2.0 / square, 2.0, square == 0.0); // 2
    let i = b[0].w * p + b[1].xyz + cross(b[0].xyz, p); // 3
    let delta = k * (b[0].w * b[1].xyz - b[1].w * b[0].xyz + cross(b[0].xyz, i));
    let position = p + delta;
    let D1 = s1 * Q[1] - Q[0]; // 4
    let D2 = s2 * Q[2] - Q[0];
    let D3 = s3 * Q[3] - Q[0];
    let db_t = alpha_0.x * D1 + alpha_0.y * D2 + alpha_0.z * D3; // 5
    let db_b = beta_0.x * D1 + beta_0.y * D2 + beta_0.z * D3; // 6
    let tangent = skinbake_derivative(b, k, p, i, delta, frame.tangent, db_t); // 7
    let bitangent = skinbake_derivative(b, k, p, i, delta, frame.bitangent, db_b); // 8
    let normal = frame.handedness * cross(tangent, bitangent); // 9
    return skinbake_Vertex(position, normal, tangent, bitangent);
}

fn skinbake_isBaked() -> bool {
    return uniform.skinbakeConstants.x > 1.5;
}

fn skinbake_hasDualQuaternions() -> bool {
    return uniform.skinbakeConstants.y > 0.5;
}

fn skinbake_datum(index: i32) -> vec4f {
    let texel = i32(pcVertexIndex) * i32(uniform.skinbakeConstants.x) + index;
    let width = i32(textureDimensions(skinbakeData).x);
    return textureLoad(skinbakeData, vec2i(texel % width, texel / width), 0);
}

fn skinbake_joint(index: f32) -> mat4x4f {
    let rows = getBoneMatrix(i32(textureDimensions(texture_poseMap).x), 3 * i32(index + 0.5));
    return transpose(mat4x4f(rows.v1, rows.v2, rows.v3, vec4f(0.0, 0.0, 0.0, 1.0)));
}

fn skinbake_joints() -> array<mat4x4f, 4> {
    return array<mat4x4f, 4>(
        skinbake_joint(vertex_boneIndices.x), skinbake_joint(vertex_boneIndices.y),
        skinbake_joint(vertex_boneIndices.z), skinbake_joint(vertex_boneIndices.w));
}

fn skinbake_weights() -> vec4f {
    let sum = dot(vertex_boneWeights, vec4f(1.0));
    return select(vec4f(1.0, 0.0, 0.0, 0.0), vertex_boneWeights / sum, sum > 0.0);
}

fn skinbake_linear(M: mat4x4f) -> mat3x3f {
    return mat3x3f(M[0].xyz, M[1].xyz, M[2].xyz);
}

fn skinbake_cofactors(M: mat3x3f) -> mat3x3f {
    return mat3x3f(cross(M[1], M[2]), cross(M[2], M[0]), cross(M[0], M[1]));
}

fn skinbake_inverse(M: mat3x3f) -> mat3x3f {
    return transpose(skinbake_cofactors(M)) * (1.0 / determinant(M));
}

fn skinbake_placed(M: mat3x3f, translation: vec3f) -> mat4x4f {
    return mat4x4f(vec4f(M[0], 0.0), vec4f(M[1], 0.0), vec4f(M[2], 0.0), vec4f(translation, 1.0));
}

// As in GLSL.
struct skinbake_Relation {
    stretch: mat3x3f,
    outer: mat3x3f,
    motions: array<mat2x4f, 4>,
}

fn skinbake_related(given: array<mat4x4f, 4>) -> skinbake_Relation {
    var M = given;
    var found: skinbake_Relation;
    found.stretch = uniform.skinbakeStretch;
    let unstretched = skinbake_inverse(found.stretch);
    found.outer = skinbake_linear(M[0]) * unstretched;
    let inner = skinbake_inverse(found.outer);
    for (var i = 0; i < 4; i++) {
        let linear = inner * skinbake_linear(M[i]) * unstretched;
        let translation = inner * (M[i][3].xyz - M[0][3].xyz);
        found.motions[i] = skinbake_dual_quaternion(skinbake_placed(linear, translation));
    }
    return found;
}

fn skinbake_side(M: array<mat4x4f, 4>) -> f32 {
    return select(1.0, -1.0, determinant(skinbake_linear(M[0])) < 0.0);
}

fn skinbake_turned(p: vec3f, rest: skinbake_Frame, M: array<mat4x4f, 4>, alpha: vec3f,
        beta: vec3f) -> skinbake_Vertex {
    let joints = skinbake_related(M);
    let tangent = joints.stretch * rest.tangent;
    let frame = skinbake_Frame(rest.normal, tangent, joints.stretch * rest.bitangent, rest.handedness);
    var v = skinbake_dqs_exact(joints.stretch * p, frame, joints.motions, skinbake_weights(), alpha, beta);
    v.position = joints.outer * v.position + M[0][3].xyz;
    v.tangent = joints.outer * v.tangent;
    v.bitangent = joints.outer * v.bitangent;
    v.normal = rest.handedness * skinbake_side(M) * cross(v.tangent, v.bitangent);
    return v;
}

fn getSkinMatrix(indices: vec4f, weights: vec4f) -> mat4x4f {
    if (!skinbake_isBaked() || !skinbake_hasDualQuaternions()) { return skinbake_usualSkinMatrix(indices,
            weights); }
    let M = skinbake_joints();
    let joints = skinbake_related(M);
    let frame = skinbake_Frame(vec3f(0.0), vec3f(1.0, 0.0, 0.0), vec3f(0.0, 1.0, 0.0), 1.0);
    let v = skinbake_dqs_exact(vec3f(0.0), frame, joints.motions, skinbake_weights(), vec3f(0.0), vec3f(0.0));
    let linear = joints.outer * mat3x3f(v.tangent, v.bitangent, v.normal) * joints.stretch;
    return skinbake_placed(linear, joints.outer * v.position + M[0][3].xyz);
}
`,
    },
    normalVS: {
        usual: [/fn\s+getNormal\s*\(/, 'fn skinbake_usualNormal('],
        text: /* wgsl */ `
#if defined(SKIN) && !defined(BATCH)
// The matrix whose columns are a * b.x, a * b.y, a * b.z.
fn skinbake_outer(a: vec3f, b: vec3f) -> mat3x3f {
    return mat3x3f(a * b.x, a * b.y, a * b.z);
}

fn skinbake_model() -> mat4x4f {
#ifdef MESH_INSTANCE_STORAGE
    return getStoredModelMatrix();
#else
    return uniform.matrix_model;
#endif
}

fn skinbake_normal() -> vec3f {
    let n0 = select(vec3f(0.0, 0.0, 1.0), normalize(vertex_normal), dot(vertex_normal, vertex_normal) > 0.0);
    var rest = skinbake_frame(n0);
    if (uniform.skinbakeConstants.x > 2.5) { rest = skinbake_tangent_frame(n0, skinbake_datum(2)); }
    var frame = rest;
    let local = getLocalNormal(vertex_normal);
    if (any(local != vertex_normal)) { frame = skinbake_morphed_frame(rest, local); }
    let M = skinbake_joints();
    let p = getLocalPosition(vertex_position.xyz);
    let alpha = skinbake_datum(0).xyz;
    let beta = skinbake_datum(1).xyz;
    var v: skinbake_Vertex;
    if (skinbake_hasDualQuaternions()) {
        v = skinbake_turned(p, frame, M, alpha, beta);
    } else {
        v = skinbake_lbs_accurate(p, frame, M, skinbake_weights(), alpha, beta);
        v.normal *= skinbake_side(M);
    }
    let world = skinbake_linear(skinbake_model());
    let normal = normalize((skinbake_cofactors(world) * v.normal) * select(1.0, -1.0,
            determinant(world) < 0.0));
    dNormalMatrix = world * (skinbake_outer(v.tangent, rest.tangent / dot(rest.tangent, rest.tangent))
            + skinbake_outer(v.bitangent, rest.bitangent / dot(rest.bitangent, rest.bitangent)));
#ifndef TANGENTS
    dNormalMatrix = dNormalMatrix + skinbake_outer(normal, n0);
#endif
    return normal;
}
#endif

fn getNormal() -> vec3f {
#if defined(SKIN) && !defined(BATCH)
    if (skinbake_isBaked()) { return skinbake_normal(); }
#endif
    return skinbake_usualNormal();
}
`,
    },
};
