// PlayCanvas gives shaders no attributes of other names. So alpha, beta and TANGENT are read from the buffer views
// when the file is loaded, decoded, and put into a texture.

import { SEMANTIC_BLENDWEIGHT, SEMANTIC_NORMAL, SEMANTIC_POSITION } from 'playcanvas';

export const bakes = new WeakMap(); // Mesh -> { problem, values, stride, method, arrays, texture, kept }

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

export function takeBakes(gltf, { renders }, views, method) {
    for (const [number, { primitives }] of (gltf.meshes ?? []).entries()) {
        const meshes = renders[number]?.meshes; // none with the option skipMeshes
        if (meshes?.length !== primitives.length) continue;
        for (const [index, primitive] of primitives.entries()) {
            const metadata = metadataOf(gltf, primitive);
            const mesh = meshes[index];
            if (metadata) {
                const bake = bakeOf(gltf, primitive, metadata, views, method);
                bakes.set(mesh, { ...bake, arrays: arraysOf(mesh) });
            } else if (primitive.attributes._SKINBAKE_ALPHA_0 !== undefined) bakes.set(mesh, { problem: LOST });
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
    const prints = Object.keys(NAMES).map((semantic) => [semantic, printOf(mesh, semantic)]);
    return { vertexBuffer, written: writes.get(vertexBuffer), prints, change: '' };
}

// Return which array of a mesh is not as it was loaded; empty if none. A page may write the same values anew.
export function changeOf(mesh, arrays) {
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
export function metadataOf({ accessors = [] }, { extras, attributes }) {
    const places = [extras, ...Object.values(attributes).map((number) => accessors[number]?.extras)];
    const notes = places.map((place) => place?.skinbake);
    return notes.find((note) => isObject(note) && Number.isInteger(note.version));
}

function bakeOf(gltf, primitive, metadata, views, method) {
    const problem = problemOf(gltf, primitive, metadata) || staleOf(gltf).get(primitive);
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
        return 'PlayCanvas reads no alpha and beta of a mesh in Draco: bake it again with --compress none';
    }
    if (influences > 4 || attributes.JOINTS_1 !== undefined) {
        const count = influences > 4 ? influences : 8;
        const remedy = 'bake it again with --limit-influences 4';
        return `it has ${count} influences for each vertex, and PlayCanvas reads four: ${remedy}`;
    }
    if (![alpha, beta].every(isNames)) return 'the metadata of its bake is damaged: bake it again';
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
