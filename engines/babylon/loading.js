// What the loader reads: alpha and beta of each baked primitive, into vertex buffers of Babylon.js.

import { Buffer, VertexBuffer } from '@babylonjs/core/Buffers/buffer.js';
import { RawTexture2DArray } from '@babylonjs/core/Materials/Textures/rawTexture2DArray.js';
import { DracoDecoder } from '@babylonjs/core/Meshes/Compression/dracoDecoder.js';

export const NAME = 'SKINBAKE';
const SETS = 2; // Babylon.js reads eight influences for each vertex.
const FRAMES = { normal: 2, tangent: 3 };
const ENCODINGS = { packed8: 5120, snorm16: 5122 }; // BYTE, SHORT
const FLOAT = 5126;
export const kindsOf = (set) => [`skinbakeAlpha${set}`, `skinbakeBeta${set}`];

// Copies of this module on one page share what they know.
export const state = (globalThis[Symbol.for('skinbake.babylon')] ??= {
    geometries: new WeakMap(), // geometry -> { problem, changed, frame, scale, sets, method, loaded }
    scenes: new WeakMap(), // scene -> { geometries, meshes } that came from baked primitives
    standard: new WeakSet(), // meshes that lighting() has switched
    told: new WeakMap(), // mesh -> messages
    writes: new WeakMap(), // vertex buffer -> how often it has been written
});

// An extension of Babylon.js's glTF loader, which drops attributes with a leading underscore.
export class Loading {
    // watch takes a scene, and returns what was loaded into it: { geometries, meshes }.
    constructor(loader, watch, method) {
        this.name = NAME;
        this.enabled = true;
        this.order = 50; // before extensions that load the other attributes of a primitive, as Draco's does
        this.loader = loader;
        this.watch = watch;
        this.method = method;
    }

    dispose() {
        this.loader = null;
    }

    // Babylon.js calls it once, when it has read the JSON of a file.
    onLoading() {
        const { gltf } = this.loader;
        const primitives = (gltf.meshes ?? []).flatMap((mesh) => mesh.primitives);
        if (!gltf.skins?.length || primitives.some((one) => problemOf(gltf, one, metadataOf(gltf, one)) !== NOT_BAKED)) return;
        const name = this.loader.rootUrl + (this.loader._fileName ?? '');
        console.info(`skinbake: "${name}" has no bake, and Babylon.js's standard lighting: run skinbake bake on it`);
    }

    _loadVertexDataAsync(context, primitive, mesh) {
        const { gltf } = this.loader;
        const metadata = metadataOf(gltf, primitive);
        const problem = problemOf(gltf, primitive, metadata) || staleOf(gltf).get(primitive);
        if (problem === NOT_BAKED) return null;
        const scene = mesh.getScene();
        if (problem) {
            tell(mesh, problem);
            const loading = this.loader._loadVertexDataAsync(context, primitive, mesh);
            return this.#with(scene, { problem, changed: '' }, loading);
        }
        const baked = bakedOf(metadata, this.method);
        const rest = this.loader._loadVertexDataAsync(context, withoutPairs(primitive, metadata), mesh);
        return this.#with(scene, baked, rest).then(async (geometry) => {
            const names = namesOf(metadata);
            const accessors = names.map((name) => gltf.accessors[primitive.attributes[name]]);
            const columns = await this.#columns(primitive, names, accessors);
            const { count } = accessors[0];
            const ordered = metadata.layout === 'texcoord' ? assembled(columns, baked.sets, count) : columns;
            for (const buffer of interleaved(scene.getEngine(), ordered, count)) {
                geometry.setVerticesBuffer(buffer, count);
            }
            baked.loaded = loadedOf(geometry, baked);
            baked.morphs = await this.#morphs(primitive, count, mesh);
            return geometry;
        });
    }

    async #with(scene, baked, loading) {
        const geometry = await loading;
        state.geometries.set(geometry, baked);
        this.watch(scene).geometries.add(geometry);
        return geometry;
    }

    // Return the numbers by which morph targets move the frame, as a texture with a layer for each target; null
    // without any. Of six numbers a vertex has two texels, of four one.
    async #morphs(primitive, count, mesh) {
        const { numbers, targets } = morphsOf(this.loader.gltf, primitive);
        if (!numbers) return null;
        const texels = numbers === 6 ? 2 : 1;
        const height = Math.ceil((texels * count) / WIDTH);
        const values = new Float32Array(4 * WIDTH * height * targets.length);
        for (const [layer, target] of targets.entries()) {
            for (let part = 0; part < texels; part++) {
                const accessor = this.loader.gltf.accessors[target[NUMBERS[part]]];
                const read = await this.loader._loadFloatAccessorAsync(`/accessors/${accessor.index}`, accessor);
                const size = part ? 2 : 4;
                for (let vertex = 0; vertex < count; vertex++) {
                    const to = 4 * (WIDTH * height * layer + texels * vertex + part);
                    for (let at = 0; at < size; at++) values[to + at] = read[size * vertex + at];
                }
            }
        }
        const texture = RawTexture2DArray.CreateRGBATexture(
            values, WIDTH, height, targets.length, mesh.getScene(), false, false, 1, 1, // nearest, floats
        );
        return { numbers, texture, targets: targets.map((_, index) => mesh.morphTargetManager.getTarget(index)) };
    }

    // Return the values of attributes row by row: as they are stored, or as floats.
    async #columns({ extensions }, names, accessors) {
        const unpacked = await this.#unpacked(extensions?.KHR_draco_mesh_compression, names);
        const columns = accessors.map((accessor, index) => {
            const found = unpacked.get(names[index]);
            return found ? { ...found, type: accessor.componentType } : this.#column(accessor);
        });
        return Promise.all(columns);
    }

    // Return the values of the attributes that Draco has compressed, by their names.
    async #unpacked(draco, names) {
        const compressed = names.filter((name) => draco?.attributes[name] !== undefined);
        if (!compressed.length || !DracoDecoder.DefaultAvailable) return new Map();
        const view = this.loader.gltf.bufferViews[draco.bufferView];
        const bytes = await this.loader.loadBufferViewAsync(`/bufferViews/${view.index}`, view);
        const numbers = Object.fromEntries(compressed.map((name) => [name, draco.attributes[name]]));
        const { attributes } = await DracoDecoder.Default.decodeMeshToMeshDataAsync(bytes, numbers);
        return new Map(attributes.map(({ kind, size, data }) => [kind, { size, values: data }]));
    }

    // The same for one attribute that is not compressed.
    async #column(accessor) {
        const size = Number(accessor.type.slice(3));
        const Integers = { 5120: Int8Array, 5122: Int16Array }[accessor.componentType];
        if (!Integers || accessor.sparse || accessor.bufferView === undefined) {
            const context = `/accessors/${accessor.index}`;
            const values = await this.loader._loadFloatAccessorAsync(context, accessor);
            return { size, values, type: FLOAT };
        }
        const view = this.loader.gltf.bufferViews[accessor.bufferView];
        const context = `/bufferViews/${view.index}`;
        const { buffer, byteOffset } = await this.loader.loadBufferViewAsync(context, view);
        const width = size * Integers.BYTES_PER_ELEMENT;
        const values = new Integers(size * accessor.count);
        for (let row = 0; row < accessor.count; row++) {
            const start = byteOffset + (accessor.byteOffset ?? 0) + row * (view.byteStride ?? width);
            values.set(new Integers(buffer.slice(start, start + width)), size * row);
        }
        return { size, values, type: accessor.componentType };
    }
}

// The layout texcoord has alpha 1 ... alpha K-1, beta 1 ... beta K-1 of a vertex, two numbers to a set.
function assembled(pairs, sets, count) {
    const others = 4 * sets - 1;
    return Array.from({ length: 2 * sets }, (_, index) => {
        const set = index % sets;
        const size = set === 0 ? 3 : 4;
        const start = (index < sets ? 0 : others) + (set === 0 ? 0 : 4 * set - 1);
        const values = new Float32Array(size * count);
        for (let row = 0; row < count; row++) {
            for (let at = 0; at < size; at++) {
                const place = start + at;
                values[size * row + at] = pairs[place >> 1].values[2 * row + (place & 1)];
            }
        }
        return { size, values, type: FLOAT };
    });
}

// WebGPU has eight vertex buffers: all of alpha and beta lie in one. A missing fourth component reads as 1.
// Then decoding changes nothing.
function interleaved(engine, columns, count) {
    const sets = columns.length / 2;
    const widths = columns.map(({ size, values }) => size * values.BYTES_PER_ELEMENT);
    const offsets = widths.map((_, index) => widths.slice(0, index).reduce((sum, width) => sum + width, 0));
    const stride = widths.reduce((sum, width) => sum + width, 0);
    const bytes = new Uint8Array(stride * count);
    columns.forEach(({ values }, index) => {
        const width = widths[index];
        const from = new Uint8Array(values.buffer, values.byteOffset, values.byteLength);
        for (let row = 0; row < count; row++) {
            bytes.set(from.subarray(width * row, width * (row + 1)), stride * row + offsets[index]);
        }
    });
    const buffer = new Buffer(engine, bytes, false, stride, false, false, true);
    return columns.map(({ size, type }, index) => {
        const kind = kindsOf(index % sets)[index < sets ? 0 : 1];
        const place = { stride, offset: offsets[index], useBytes: true, takeBufferOwnership: true };
        return new VertexBuffer(engine, buffer, kind, { ...place, size, type, normalized: type !== FLOAT });
    });
}

const WIDTH = 1024; // texels
const NUMBERS = ['_SKINBAKE_MORPH', '_SKINBAKE_MORPH_UP'];

// What bake has noted in the extras of the mesh, where all targets have what it says.
function morphsOf({ meshes, accessors }, primitive) {
    const mesh = meshes.find(({ primitives }) => primitives.includes(primitive));
    const noted = mesh?.extras?.skinbake?.morphTargets?.[mesh.primitives.indexOf(primitive)];
    const targets = primitive.targets ?? [];
    const names = { 4: NUMBERS.slice(0, 1), 6: NUMBERS }[noted?.frames] ?? [];
    const isSound = (target) => names.every((name) => accessors[target[name]]?.componentType === FLOAT);
    const isThere = names.length > 0 && noted.targets === targets.length && targets.every(isSound);
    return { numbers: isThere ? noted.frames : 0, targets };
}

const isObject = (value) => typeof value === 'object' && value !== null;

// All of alpha, then all of beta.
function namesOf({ alpha, beta }) {
    return [...new Set([...alpha, ...beta])];
}

function bakedOf({ frame, encoding, scale, influences }, method) {
    const sets = Math.ceil(influences / 4);
    return { problem: '', changed: '', frame: FRAMES[frame], scale: encoding ? scale : 1, sets, method };
}

export const ATTRIBUTES = {
    normal: 'NORMAL',
    tangent: 'TANGENT',
    position: 'POSITION',
    matricesWeights: 'WEIGHTS_0',
    matricesWeightsExtra: 'WEIGHTS_1',
};

// The vertex buffers that alpha and beta belong together with, and their own, as they are now.
function loadedOf(geometry, { frame, sets }) {
    const kinds = Object.keys(ATTRIBUTES).filter((kind) => kind !== 'tangent' || frame === FRAMES.tangent);
    for (let set = 0; set < sets; set++) kinds.push(...kindsOf(set));
    const present = kinds.filter((kind) => geometry.getVertexBuffer(kind));
    return present.map((kind) => {
        const buffer = geometry.getVertexBuffer(kind);
        watchBuffer(buffer);
        return [kind, { buffer, writes: 0, print: printOf(geometry, kind), isSame: true }];
    });
}

// Count how often a page writes into a buffer.
export function watchBuffer(buffer) {
    if (!buffer || state.writes.has(buffer)) return;
    state.writes.set(buffer, 0);
    for (const name of ['update', 'updateDirectly']) {
        const usual = buffer[name];
        buffer[name] = function (...parameters) {
            state.writes.set(buffer, state.writes.get(buffer) + 1);
            return usual.apply(this, parameters);
        };
    }
}

// A sum of all components, by random factors from -1 to 1.
export function printOf(geometry, kind) {
    let sum = 0;
    let square = 0;
    const values = geometry.getVerticesData(kind) ?? [];
    for (let index = 0; index < values.length; index++) {
        let bits = Math.imul((index + 1) ^ (index >>> 15), 0x85ebca6b);
        bits = Math.imul(bits ^ (bits >>> 13), 0xc2b2ae35);
        sum += values[index] * (bits / 2 ** 31);
        square += values[index] ** 2;
    }
    return { sum, length: Math.sqrt(square) };
}

// Rounding, as when a page normalises again, changes less.
export const isLike = (one, other) => !(Math.abs(one.sum - other.sum) > 1e-5 * other.length);

// Babylon.js need not hand on the texture coordinates that hold alpha and beta.
function withoutPairs(primitive, metadata) {
    if (metadata.layout !== 'texcoord') return primitive;
    const attributes = { ...primitive.attributes };
    for (const name of namesOf(metadata)) delete attributes[name];
    return { ...primitive, attributes };
}

// Where extras of the primitive were not an object, bake has put the metadata into those of alpha's accessor.
function metadataOf({ accessors }, { extras, attributes }) {
    const found = [extras, ...Object.values(attributes ?? {}).map((index) => accessors[index]?.extras)];
    return found.map((one) => one?.skinbake).find((one) => isObject(one) && Number.isInteger(one.version));
}

const NOT_BAKED = 'it is not baked';

function problemOf({ accessors }, { attributes }, metadata) {
    if (!metadata) {
        if (attributes._SKINBAKE_ALPHA_0 === undefined) return NOT_BAKED;
        return 'it has lost the metadata of its bake: keep the extras of primitives, or bake last';
    }
    const { version, frame, encoding, influences, scale, alpha, beta } = metadata;
    if (version !== 1) return `its bake has version ${version}, and this module reads version 1: update it`;
    if (influences > 4 * SETS || attributes.JOINTS_2 !== undefined) {
        const count = Math.max(influences, attributes.JOINTS_2 === undefined ? 0 : 12);
        return `it has ${count} influences for each vertex, and Babylon.js reads eight: ` +
            'bake it again with --limit-influences 8';
    }
    if (![alpha, beta].every(isNames)) return 'the metadata of its bake is damaged: bake it again';
    if (!FRAMES[frame]) return `its frame is ${frame}, and this module knows normal and tangent: update it`;
    if (encoding !== undefined && !ENCODINGS[encoding]) {
        return `its encoding is ${encoding}, and this module knows packed8 and snorm16: update it`;
    }
    if (encoding && !Number.isFinite(scale)) return 'the metadata of its bake lacks the scale: bake it again';
    for (const name of frame === 'tangent' ? ['NORMAL', 'TANGENT'] : ['NORMAL']) {
        if (attributes[name] === undefined) return `it has lost ${name}, which its bake needs: bake last`;
    }
    for (const [index, name] of namesOf(metadata).entries()) {
        const problem = misfit(accessors[attributes[name]], index, metadata);
        if (problem) return `its attribute ${name} ${problem}: bake last, or keep attributes as they are`;
    }
    return '';
}

const isNames = (list) => Array.isArray(list) && list.length > 0 && list.every((name) => typeof name === 'string');

const SAME_BOUNDS = 1e-3; // of the diagonal, as in skinbake: Draco rounds positions
const stale = new WeakMap(); // glTF -> Map of primitive -> why it is lit standard

// Return the primitives that a tool has changed since their bake, as far as the bake has noted what they were, and the
// other parts of their skins: between two lightings, a seam would show.
function staleOf(gltf) {
    if (stale.has(gltf)) return stale.get(gltf);
    const found = new Map();
    stale.set(gltf, found);
    for (const { primitives } of gltf.meshes ?? []) {
        for (const primitive of primitives) {
            const change = changeSince(metadataOf(gltf, primitive)?.positions, gltf.accessors, primitive);
            if (change) found.set(primitive, `a tool has changed ${change} since its bake: bake last`);
        }
    }
    const parts = new Map(); // skin -> { name, primitive }
    for (const { mesh, skin } of gltf.nodes ?? []) {
        if (mesh === undefined || skin === undefined) continue;
        const { name, primitives } = gltf.meshes[mesh];
        parts.set(skin, [...(parts.get(skin) ?? []), ...primitives.map((primitive) => ({ name, primitive }))]);
    }
    for (const own of parts.values()) {
        const changed = own.find(({ primitive }) => found.has(primitive));
        for (const { primitive } of changed ? own : []) {
            if (found.has(primitive)) continue;
            found.set(primitive, `a part of "${changed.name}", of the same skin, does not fit its bake: bake last`);
        }
    }
    return found;
}

function changeSince(noted, accessors, { attributes, indices }) {
    const positions = accessors?.[attributes.POSITION];
    if (!isObject(noted) || !positions) return '';
    if (positions.componentType !== noted.componentType) return 'the type of its positions';
    for (const [name, type] of Object.entries(noted.types ?? {})) {
        const accessor = accessors[attributes[name]];
        if (accessor && accessor.componentType !== type) return `the type of its ${name}`;
    }
    const { count } = accessors[indices] ?? positions;
    if (noted.corners !== undefined && noted.corners !== count) return 'its triangles';
    if (![noted, positions].every(({ min, max }) => [min, max].every(Array.isArray))) return '';
    const allowed = SAME_BOUNDS * Math.hypot(...noted.max.map((most, axis) => most - noted.min[axis]));
    const isSame = (key) => noted[key].every((value, axis) => Math.abs(value - positions[key][axis]) <= allowed);
    return isSame('min') && isSame('max') ? '' : 'the bounds of its positions';
}

function misfit(accessor, index, { encoding, layout, alpha }) {
    if (!accessor) return 'is missing';
    const isFirst = index % alpha.length === 0;
    const type = layout === 'texcoord' ? 'VEC2' : encoding || !isFirst ? 'VEC4' : 'VEC3';
    if (accessor.type !== type) return `is ${accessor.type}, not ${type}`;
    if (!encoding) return accessor.componentType === FLOAT ? '' : 'is not of floats';
    const fits = accessor.componentType === ENCODINGS[encoding] && accessor.normalized;
    return fits ? '' : `is not encoded as ${encoding}`;
}

export function tell(mesh, reason, what = "Babylon.js's standard lighting") {
    const messages = state.told.get(mesh) ?? state.told.set(mesh, new Set()).get(mesh);
    if (messages.has(reason)) return;
    messages.add(reason);
    console.warn(`skinbake: "${mesh.name}" has ${what}: ${reason}`);
}
