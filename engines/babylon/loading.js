// What the loader reads: alpha and beta of each baked primitive, into vertex buffers of Babylon.js.

import { Buffer, VertexBuffer } from '@babylonjs/core/Buffers/buffer.js';
import { RawTexture2DArray } from '@babylonjs/core/Materials/Textures/rawTexture2DArray.js';
import { DracoDecoder } from '@babylonjs/core/Meshes/Compression/dracoDecoder.js';
import { accessorsIn, FLOAT, FRAMES, isLeft, metadataOf, movesOf, namesOf, NOT_BAKED, printOf, problemOf, staleOf } from './bake.js';

export const NAME = 'SKINBAKE';
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
        if (!gltf.skins?.length || isLeft(gltf) || primitives.some((one) => problemIn(gltf, one) !== NOT_BAKED)) return;
        const name = this.loader.rootUrl + (this.loader._fileName ?? '');
        console.info(`skinbake: "${name}" has no bake, and Babylon.js's standard lighting: run skinbake bake on it`);
    }

    _loadVertexDataAsync(context, primitive, mesh) {
        return problemIn(this.loader.gltf, primitive) === NOT_BAKED ? null : this.#load(context, primitive, mesh);
    }

    async #load(context, primitive, mesh) {
        const { gltf } = this.loader;
        const metadata = metadataOf(gltf, primitive);
        const misfit = problemIn(gltf, primitive);
        // At once: while this method runs, Babylon.js does not call it anew.
        const rest = misfit ? primitive : withoutPairs(primitive, metadata);
        const loading = this.loader._loadVertexDataAsync(context, rest, mesh);
        this.stale ??= this.#stale(gltf);
        const [geometry, stale] = await Promise.all([loading, this.stale]);
        const problem = misfit || stale.get(primitive);
        const baked = problem ? { problem, changed: '' } : bakedOf(metadata, this.method);
        const scene = mesh.getScene();
        if (problem) tell(mesh, problem);
        state.geometries.set(geometry, baked);
        this.watch(scene).geometries.add(geometry);
        if (problem) return geometry;
        const names = namesOf(metadata);
        const accessors = names.map((name) => gltf.accessors[primitive.attributes[name]]);
        const columns = await this.#columns(primitive, names, accessors);
        const { count } = accessors[0];
        const ordered = metadata.layout === 'texcoord' ? assembled(columns, baked.sets, count) : columns;
        for (const buffer of interleaved(scene.getEngine(), ordered, count)) {
            geometry.setVerticesBuffer(buffer, count);
            watchExport(geometry, buffer);
        }
        baked.loaded = loadedOf(geometry, baked);
        baked.morphs = await this.#morphs(primitive, count, mesh);
        return geometry;
    }

    async #stale(gltf) {
        const context = (number) => `/accessors/${number}`;
        const read = (number, accessor) =>
            accessor.type === 'SCALAR' ? this.loader._loadIndicesAccessorAsync(context(number), accessor) : this.#floats(accessor);
        const arrays = accessorsIn(gltf).map(async (number) => [number, await read(number, gltf.accessors[number])]);
        return staleOf(gltf, new Map(await Promise.all(arrays)));
    }

    #floats(accessor) {
        return this.loader._loadFloatAccessorAsync(`/accessors/${accessor.index}`, accessor);
    }

    // Return the numbers by which morph targets move the frame, as a texture with a layer for each target; null
    // without any. Of six numbers a vertex has two texels, of four one.
    async #morphs(primitive, count, mesh) {
        const { gltf } = this.loader;
        const owner = gltf.meshes.find(({ primitives }) => primitives.includes(primitive));
        const names = movesOf(gltf, owner, owner?.primitives.indexOf(primitive));
        if (!names.length) return null;
        const { targets } = primitive;
        const texels = names.length;
        const height = Math.ceil((texels * count) / WIDTH);
        const values = new Float32Array(4 * WIDTH * height * targets.length);
        for (const [layer, target] of targets.entries()) {
            for (let part = 0; part < texels; part++) {
                const accessor = gltf.accessors[target[names[part]]];
                const read = await this.#floats(accessor);
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
        return { numbers: texels === 2 ? 6 : 4, texture, targets: targets.map((_, index) => mesh.morphTargetManager.getTarget(index)) };
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
            return { size, values: await this.#floats(accessor), type: FLOAT };
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
        return [kind, { buffer, writes: 0, print: printIn(geometry, kind), isSame: true }];
    });
}

export function printIn(geometry, kind) {
    const values = geometry.getVerticesData(kind) ?? [];
    return printOf(values.length, (index) => values[index]);
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

// Once a geometry has a buffer, only an exporter asks for its kind. GLTF2Export passes over those that it does not know.
function watchExport(geometry, buffer) {
    const { getKind } = buffer;
    buffer.getKind = function () {
        const reason = 'GLTF2Export leaves them out. Keep the baked file, or bake the exported one';
        for (const mesh of geometry.meshes) tell(mesh, reason, 'no alpha and beta where it is exported');
        return getKind.call(this);
    };
}

// Babylon.js need not hand on the texture coordinates that hold alpha and beta.
function withoutPairs(primitive, metadata) {
    if (metadata.layout !== 'texcoord') return primitive;
    const attributes = { ...primitive.attributes };
    for (const name of namesOf(metadata)) delete attributes[name];
    return { ...primitive, attributes };
}

function problemIn({ accessors }, primitive) {
    const find = (name) => accessors?.[primitive.attributes?.[name]];
    return problemOf(metadataOf({ accessors }, primitive), find, 'Babylon.js', 8);
}

export function tell(mesh, reason, what = "Babylon.js's standard lighting") {
    const messages = state.told.get(mesh) ?? state.told.set(mesh, new Set()).get(mesh);
    if (messages.has(reason)) return;
    messages.add(reason);
    console.warn(`skinbake: "${mesh.name}" has ${what}: ${reason}`);
}
