// PlayCanvas gives shaders no attributes of other names. So alpha, beta and TANGENT are read from the buffer views
// when the file is loaded, decoded, and put into a texture.

import { SEMANTIC_BLENDWEIGHT, SEMANTIC_NORMAL, SEMANTIC_POSITION } from 'playcanvas';
import { accessorsIn, FRAMES, isLike, metadataOf, namesOf, NOT_BAKED, printOf, problemOf, staleOf, tellOfUnreadMoves } from './bake.js';

export const bakes = new WeakMap(); // Mesh -> { problem, values, stride, method, arrays, texture, kept }

const COMPONENTS = {
    5120: [Int8Array, 127],
    5121: [Uint8Array, 255],
    5122: [Int16Array, 32767],
    5123: [Uint16Array, 65535],
    5125: [Uint32Array, 1],
    5126: [Float32Array, 1],
};
const SIZES = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4 };

export function takeBakes(gltf, { renders }, views, method) {
    const read = (number) => elements(gltf, number, views);
    tellOfUnreadMoves(gltf, 'PlayCanvas');
    const stale = staleOf(gltf, new Map(accessorsIn(gltf).map((number) => [number, read(number)])));
    for (const [number, { primitives }] of (gltf.meshes ?? []).entries()) {
        const meshes = renders[number]?.meshes; // none with the option skipMeshes
        if (meshes?.length !== primitives.length) continue;
        for (const [index, primitive] of primitives.entries()) {
            const mesh = meshes[index];
            const problem = problemIn(gltf, primitive) || stale.get(primitive);
            if (problem === NOT_BAKED) continue;
            const bake = problem ? { problem } : bakeOf(gltf, primitive, read, method);
            bakes.set(mesh, { ...bake, arrays: arraysOf(mesh) });
        }
    }
    for (const description of gltf.bufferViews ?? []) views.delete(description);
}

// Alpha and beta are right for these arrays alone.
const NAMES = { [SEMANTIC_NORMAL]: 'NORMAL', [SEMANTIC_POSITION]: 'POSITION', [SEMANTIC_BLENDWEIGHT]: 'WEIGHTS_0' };
const writes = new WeakMap(); // VertexBuffer -> how often it has been written

function arraysOf(mesh) {
    const { vertexBuffer } = mesh;
    watchBuffer(vertexBuffer);
    const prints = Object.keys(NAMES).map((semantic) => [semantic, printIn(mesh, semantic)]);
    return { vertexBuffer, written: writes.get(vertexBuffer), prints, change: '' };
}

// Return which array of a mesh is not as it was loaded; empty if none. A page may write the same values anew.
export function changeOf(mesh, arrays) {
    const { vertexBuffer } = mesh;
    const written = writes.get(vertexBuffer);
    if (arrays.vertexBuffer === vertexBuffer && arrays.written === written) return arrays.change;
    watchBuffer(vertexBuffer);
    const [semantic] = arrays.prints.find(([name, print]) => !isLike(printIn(mesh, name), print)) ?? [];
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

function printIn(mesh, semantic) {
    const values = [];
    if (mesh.vertexBuffer) mesh.getVertexStream(semantic, values);
    return printOf(values.length, (index) => values[index]);
}

// Return why the bake of a primitive does not serve. PlayCanvas hands on nothing else of a mesh in Draco.
export function problemIn(gltf, primitive) {
    const { attributes, extensions } = primitive;
    const find = (name) => gltf.accessors[attributes[name]];
    const problem = problemOf(metadataOf(gltf, primitive), find, 'PlayCanvas', 4);
    if (problem || !extensions?.KHR_draco_mesh_compression) return problem;
    return 'PlayCanvas reads no alpha and beta of a mesh in Draco: bake it again with --compress none';
}

function bakeOf(gltf, primitive, readAt, method) {
    const metadata = metadataOf(gltf, primitive);
    const read = (name) => readAt(primitive.attributes[name]);
    const stored = namesOf(metadata).map(read);
    const tangents = metadata.frame === 'tangent' ? read('TANGENT') : null;
    if ([...stored, ...(tangents ? [tangents] : [])].some((array) => !array)) {
        return { problem: 'its buffer views could not be read: bake it again without compression' };
    }
    const isPaired = metadata.layout === 'texcoord';
    const [alpha, beta] = isPaired ? assembled(stored) : stored.map((array) => decoded(array, metadata));
    const stride = FRAMES[metadata.frame]; // texels of each vertex
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

// The elements of an accessor as floats, or null where its buffer views are not at hand.
function elements(gltf, number, views) {
    const accessor = gltf.accessors[number];
    const { bufferView, componentType, count, normalized, sparse, type } = accessor;
    const size = SIZES[type];
    const [Numbers, limit] = COMPONENTS[componentType];
    const values = bufferView === undefined ? new Numbers(size * count) : rowsOf(gltf, accessor, count, size, views);
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

// Rows of numbers as they are stored, or null where the buffer view is not at hand, or too short for so many.
function rowsOf({ bufferViews }, { bufferView, byteOffset = 0, componentType }, count, size, views) {
    const description = bufferViews?.[bufferView];
    const bytes = views.get(description);
    if (!bytes) return null;
    const [Numbers] = COMPONENTS[componentType];
    const width = size * Numbers.BYTES_PER_ELEMENT;
    const stride = description.byteStride ?? width;
    if (count > 0 && byteOffset + stride * (count - 1) + width > bytes.length) return null;
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
