// Accurate lighting in Babylon.js for skinned meshes that skinbake has baked, under WebGL 2 and WebGPU.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang glsl --method lbs --lighting accurate --influences 4 --frame normal --target babylon
//
// One module serves all characters: frame, encoding, scale, layout, names and influences come from their
// files. Use:
//
//     import { registerSkinbake } from './skinbake.js'; // npm: 'skinbake-babylon'
//
//     registerSkinbake(); // once, before the first file is loaded
//
// Algorithm 3 of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned Models",
// Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. Frame: T. Duff et al., "Building an Orthonormal
// Basis, Revisited", JCGT 6(1), 2017.

import { Buffer, VertexBuffer } from '@babylonjs/core/Buffers/buffer.js';
import { Material } from '@babylonjs/core/Materials/material.js';
import { MaterialPluginBase } from '@babylonjs/core/Materials/materialPluginBase.js';
import { PushMaterial } from '@babylonjs/core/Materials/pushMaterial.js';
import { DracoDecoder } from '@babylonjs/core/Meshes/Compression/dracoDecoder.js';
import {
    registerGLTFExtension,
    unregisterGLTFExtension,
} from '@babylonjs/loaders/glTF/2.0/glTFLoaderExtensionRegistry.js';

const NAME = 'SKINBAKE';
const SETS = 2; // Babylon.js reads eight influences for each vertex.
const FRAMES = { normal: 2, tangent: 3 };
const ENCODINGS = { packed8: 5120, snorm16: 5122 }; // BYTE, SHORT
const FLOAT = 5126;
const kindsOf = (set) => [`skinbakeAlpha${set}`, `skinbakeBeta${set}`];

// Copies of this module on one page share what they know.
const state = (globalThis[Symbol.for('skinbake.babylon')] ??= {
    geometries: new WeakMap(), // geometry -> { problem, changed, frame, scale, sets, loaded }
    scenes: new WeakMap(), // scene -> { geometries, meshes } that came from baked primitives
    standard: new WeakSet(), // meshes that lighting() has switched
    told: new WeakMap(), // mesh -> messages
    writes: new WeakMap(), // vertex buffer -> how often it has been written
});

/** Load alpha and beta with every glTF file from now on. Skinned meshes that have them are lit accurately. */
export function registerSkinbake() {
    unregisterGLTFExtension(NAME);
    registerGLTFExtension(NAME, false, (loader) => new Loading(loader));
}

/** Load files as before. What is loaded stays as it is. */
export function unregisterSkinbake() {
    unregisterGLTFExtension(NAME);
}

// An extension of Babylon.js's glTF loader, which drops attributes with a leading underscore.
class Loading {
    constructor(loader) {
        this.name = NAME;
        this.enabled = true;
        this.order = 50; // before extensions that load the other attributes of a primitive, as Draco's does
        this.loader = loader;
    }

    dispose() {
        this.loader = null;
    }

    _loadVertexDataAsync(context, primitive, mesh) {
        const { gltf } = this.loader;
        const metadata = metadataOf(gltf, primitive);
        const problem = problemOf(gltf, primitive, metadata);
        if (problem === NOT_BAKED) return null;
        const scene = mesh.getScene();
        if (problem) {
            tell(mesh, problem);
            const loading = this.loader._loadVertexDataAsync(context, primitive, mesh);
            return this.#with(scene, { problem, changed: '' }, loading);
        }
        const baked = bakedOf(metadata);
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
            return geometry;
        });
    }

    async #with(scene, baked, loading) {
        const geometry = await loading;
        state.geometries.set(geometry, baked);
        watch(scene).geometries.add(geometry);
        return geometry;
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

const isObject = (value) => typeof value === 'object' && value !== null;

// All of alpha, then all of beta.
function namesOf({ alpha, beta }) {
    return [...new Set([...alpha, ...beta])];
}

function bakedOf({ frame, encoding, scale, influences }) {
    const sets = Math.ceil(influences / 4);
    return { problem: '', changed: '', frame: FRAMES[frame], scale: encoding ? scale : 1, sets };
}

const ATTRIBUTES = {
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
function watchBuffer(buffer) {
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
function printOf(geometry, kind) {
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
const isLike = (one, other) => !(Math.abs(one.sum - other.sum) > 1e-5 * other.length);

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
    if (![alpha, beta].every(Array.isArray)) return 'the metadata of its bake is damaged: bake it again';
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

function misfit(accessor, index, { encoding, layout, alpha }) {
    if (!accessor) return 'is missing';
    const isFirst = index % alpha.length === 0;
    const type = layout === 'texcoord' ? 'VEC2' : encoding || !isFirst ? 'VEC4' : 'VEC3';
    if (accessor.type !== type) return `is ${accessor.type}, not ${type}`;
    if (!encoding) return accessor.componentType === FLOAT ? '' : 'is not of floats';
    const fits = accessor.componentType === ENCODINGS[encoding] && accessor.normalized;
    return fits ? '' : `is not encoded as ${encoding}`;
}

function tell(mesh, reason) {
    const messages = state.told.get(mesh) ?? state.told.set(mesh, new Set()).get(mesh);
    if (messages.has(reason)) return;
    messages.add(reason);
    console.warn(`skinbake: "${mesh.name}" has Babylon.js's standard lighting: ${reason}`);
}

const GLSL = {
    CUSTOM_VERTEX_DEFINITIONS: /* glsl */ `
#if SKINBAKE > 0
attribute vec4 skinbakeAlpha0;
attribute vec4 skinbakeBeta0;
#if NUM_BONE_INFLUENCERS > 4
attribute vec4 skinbakeAlpha1;
attribute vec4 skinbakeBeta1;
#endif
uniform float skinbakeScale;

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

#ifndef SKINBAKE_DECODED
#define SKINBAKE_DECODED
// alpha or beta of slots 1 to 3, from set 0. xyz are relative to the scale of the vertex. w is the square root of
// that scale, relative to the scale of the file.
vec3 skinbake_decoded(vec4 stored, float scale)
{
    return (scale * stored.w * stored.w) * stored.xyz;
}
#endif

#ifndef SKINBAKE_DECODED_FURTHER
#define SKINBAKE_DECODED_FURTHER
// alpha or beta of the four slots of a further set. first is set 0, whose w counts for all sets.
vec4 skinbake_decoded_further(vec4 stored, vec4 first, float scale)
{
    return (scale * first.w * first.w) * stored;
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

#ifndef SKINBAKE_MORPHED_TANGENT
#define SKINBAKE_MORPHED_TANGENT
// The frame under morph targets that move TANGENT too. tangent is TANGENT.xyz plus the weighted sum of its targets.
// Do not normalise it. If the sum is 0, the frame follows the normal. If the targets of a primitive have no
// TANGENT, use skinbake_morphed_frame().
skinbake_Frame skinbake_morphed_tangent_frame(skinbake_Frame rest, vec3 n, vec3 tangent)
{
    skinbake_Frame frame = skinbake_morphed_frame(rest, n);
    vec3 t = tangent - frame.normal * (dot(frame.normal, tangent) - dot(rest.normal, rest.tangent));
    bool cancelled = dot(t, t) < 1e-4 * dot(rest.tangent, rest.tangent);
    frame.tangent = cancelled ? frame.tangent : t;
    frame.bitangent = cancelled ? frame.bitangent : cross(frame.normal, t) * rest.handedness;
    return frame;
}
#endif

#if NUM_BONE_INFLUENCERS > 4
// The frame moves by the derivative of the skinned position along t0 and b0.
// M: the joint matrices of slots 0 to 7.
skinbake_Vertex skinbake_lbs_accurate(vec3 p, skinbake_Frame frame, mat4 M[8], vec4 weights_0,
        vec4 weights_1, vec3 alpha_0, vec4 alpha_1, vec3 beta_0, vec4 beta_1)
{
    mat3 T = weights_0.x * mat3(M[0]) // 1
            + weights_0.y * mat3(M[1])
            + weights_0.z * mat3(M[2])
            + weights_0.w * mat3(M[3])
            + weights_1.x * mat3(M[4])
            + weights_1.y * mat3(M[5])
            + weights_1.z * mat3(M[6])
            + weights_1.w * mat3(M[7]);
    vec3 q0 = skinbake_moved(M[0], p); // 2
    vec3 q1 = skinbake_moved(M[1], p);
    vec3 q2 = skinbake_moved(M[2], p);
    vec3 q3 = skinbake_moved(M[3], p);
    vec3 q4 = skinbake_moved(M[4], p);
    vec3 q5 = skinbake_moved(M[5], p);
    vec3 q6 = skinbake_moved(M[6], p);
    vec3 q7 = skinbake_moved(M[7], p);
    vec3 d1 = q1 - q0; // 3
    vec3 d2 = q2 - q0;
    vec3 d3 = q3 - q0;
    vec3 d4 = q4 - q0;
    vec3 d5 = q5 - q0;
    vec3 d6 = q6 - q0;
    vec3 d7 = q7 - q0;
    skinbake_Vertex v;
    v.tangent = T * frame.tangent + alpha_0.x * d1 + alpha_0.y * d2 + alpha_0.z * d3 + alpha_1.x * d4
            + alpha_1.y * d5 + alpha_1.z * d6 + alpha_1.w * d7; // 4
    v.bitangent = T * frame.bitangent + beta_0.x * d1 + beta_0.y * d2 + beta_0.z * d3 + beta_1.x * d4
            + beta_1.y * d5 + beta_1.z * d6 + beta_1.w * d7; // 5
    v.normal = frame.handedness * cross(v.tangent, v.bitangent); // 6
    v.normal *= determinant(T) < 0.0 ? -1.0 : 1.0; // a joint that mirrors turns t x b to the inside
    v.position = q0 + weights_0.y * d1 + weights_0.z * d2 + weights_0.w * d3 + weights_1.x * d4
            + weights_1.y * d5 + weights_1.z * d6 + weights_1.w * d7; // 7
    return v;
}
#else
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
    v.normal *= determinant(T) < 0.0 ? -1.0 : 1.0; // a joint that mirrors turns t x b to the inside
    v.position = q0 + weights_0.y * d1 + weights_0.z * d2 + weights_0.w * d3; // 7
    return v;
}
#endif

mat4 skinbake_joint(float index)
{
#ifdef BONETEXTURE
    return readMatrixFromRawSampler(boneSampler, index);
#else
    return mBones[int(index)];
#endif
}

// The world matrix of the mesh or of its instance, without the joints.
mat3 skinbake_world()
{
#ifdef INSTANCES
    mat3 instance = mat3(world0.xyz, world1.xyz, world2.xyz);
#ifdef THIN_INSTANCES
    return mat3(world) * instance;
#else
    return instance;
#endif
#else
    return mat3(world);
#endif
}

skinbake_Frame skinbake_rest()
{
    vec3 n0 = dot(normal, normal) > 0.0 ? normalize(normal) : vec3(0.0, 0.0, 1.0);
#if SKINBAKE > 2
    return skinbake_frame(n0, tangent);
#else
    return skinbake_frame(n0);
#endif
}

skinbake_Vertex skinbake_lit(vec3 p, skinbake_Frame frame)
{
    vec3 alpha_0 = skinbake_decoded(skinbakeAlpha0, skinbakeScale);
    vec3 beta_0 = skinbake_decoded(skinbakeBeta0, skinbakeScale);
    // Alpha and beta are for weights that sum to 1. Babylon.js does not divide them.
    vec4 weights_0 = matricesWeights;
    float total = dot(weights_0, vec4(1.0));
#if NUM_BONE_INFLUENCERS > 4
    vec4 weights_1 = matricesWeightsExtra;
    total += dot(weights_1, vec4(1.0));
    weights_1 = total > 0.0 ? weights_1 / total : vec4(0.0);
    mat4 M[8];
#else
    mat4 M[4];
#endif
    weights_0 = total > 0.0 ? weights_0 / total : vec4(1.0, 0.0, 0.0, 0.0);
    M[0] = skinbake_joint(matricesIndices.x);
    M[1] = skinbake_joint(matricesIndices.y);
    M[2] = skinbake_joint(matricesIndices.z);
    M[3] = skinbake_joint(matricesIndices.w);
#if NUM_BONE_INFLUENCERS > 4
    M[4] = skinbake_joint(matricesIndicesExtra.x);
    M[5] = skinbake_joint(matricesIndicesExtra.y);
    M[6] = skinbake_joint(matricesIndicesExtra.z);
    M[7] = skinbake_joint(matricesIndicesExtra.w);
    vec4 alpha_1 = skinbake_decoded_further(skinbakeAlpha1, skinbakeAlpha0, skinbakeScale);
    vec4 beta_1 = skinbake_decoded_further(skinbakeBeta1, skinbakeBeta0, skinbakeScale);
    return skinbake_lbs_accurate(p, frame, M, weights_0, weights_1, alpha_0, alpha_1, beta_0, beta_1);
#else
    return skinbake_lbs_accurate(p, frame, M, weights_0, alpha_0, beta_0);
#endif
}
#endif
`,
    // After Babylon.js's own lines, whose results are overwritten.
    CUSTOM_VERTEX_UPDATE_WORLDPOS: /* glsl */ `
#if SKINBAKE > 0
skinbake_Frame skinbakeRest = skinbake_rest();
#if SKINBAKE > 2 && defined(MORPHTARGETS) && defined(MORPHTARGETS_TANGENT)
skinbake_Frame skinbakeFrame = skinbake_morphed_tangent_frame(skinbakeRest, normalUpdated,
        tangentUpdated.xyz);
#else
skinbake_Frame skinbakeFrame = skinbakeRest;
// By morph targets, or by code of the page.
if (normalUpdated != normal) skinbakeFrame = skinbake_morphed_frame(skinbakeRest, normalUpdated);
#endif
skinbake_Vertex skinbakeLit = skinbake_lit(positionUpdated, skinbakeFrame);
mat3 skinbakeWorld = skinbake_world();
float skinbakeSide = determinant(skinbakeWorld) < 0.0 ? -1.0 : 1.0;
mat3 skinbakeCofactors = mat3(
    cross(skinbakeWorld[1], skinbakeWorld[2]),
    cross(skinbakeWorld[2], skinbakeWorld[0]),
    cross(skinbakeWorld[0], skinbakeWorld[1]));
vNormalW = skinbakeSide * normalize(skinbakeCofactors * skinbakeLit.normal);
#endif
`,
    CUSTOM_VERTEX_MAIN_END: /* glsl */ `
#if SKINBAKE > 0 && defined(TANGENT)
#if defined(BUMP) || defined(PARALLAX) || defined(CLEARCOAT_BUMP) || defined(ANISOTROPIC) || defined(GEOMETRY_NORMAL) || defined(GEOMETRY_COAT_NORMAL) || defined(FUZZ)
#if SKINBAKE > 2
vec3 skinbakeTangent = skinbakeLit.tangent;
#else
vec3 skinbakeTangent = dot(tangent.xyz, skinbakeRest.tangent) * skinbakeLit.tangent
    + dot(tangent.xyz, skinbakeRest.bitangent) * skinbakeLit.bitangent;
#endif
skinbakeTangent = normalize(skinbakeWorld * skinbakeTangent);
skinbakeSide *= sign(dot(cross(skinbakeLit.tangent, skinbakeLit.bitangent), skinbakeLit.normal));
skinbakeSide *= skinbakeFrame.handedness; // a joint that mirrors turns it round
vTBN = mat3(skinbakeTangent, skinbakeSide * tangent.w * cross(vNormalW, skinbakeTangent), vNormalW);
#endif
#endif
`,
};

const WGSL = {
    CUSTOM_VERTEX_DEFINITIONS: /* wgsl */ `
#if SKINBAKE > 0
attribute skinbakeAlpha0: vec4f;
attribute skinbakeBeta0: vec4f;
#if NUM_BONE_INFLUENCERS > 4
attribute skinbakeAlpha1: vec4f;
attribute skinbakeBeta1: vec4f;
#endif
uniform skinbakeScale: f32;

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

// alpha or beta of slots 1 to 3, from set 0. xyz are relative to the scale of the vertex. w is the square root of
// that scale, relative to the scale of the file.
fn skinbake_decoded(stored: vec4<f32>, scale: f32) -> vec3<f32> {
    return (scale * stored.w * stored.w) * stored.xyz;
}

// alpha or beta of the four slots of a further set. first is set 0, whose w counts for all sets.
fn skinbake_decoded_further(stored: vec4<f32>, first: vec4<f32>, scale: f32) -> vec4<f32> {
    return (scale * first.w * first.w) * stored;
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

// The frame under morph targets that move TANGENT too. tangent is TANGENT.xyz plus the weighted sum of its targets.
// Do not normalise it. If the sum is 0, the frame follows the normal. If the targets of a primitive have no
// TANGENT, use skinbake_morphed_frame().
fn skinbake_morphed_tangent_frame(rest: skinbake_Frame, n: vec3<f32>, tangent: vec3<f32>) -> skinbake_Frame {
    var frame = skinbake_morphed_frame(rest, n);
    let t = tangent - frame.normal * (dot(frame.normal, tangent) - dot(rest.normal, rest.tangent));
    let cancelled = dot(t, t) < 1e-4 * dot(rest.tangent, rest.tangent);
    frame.tangent = select(t, frame.tangent, cancelled);
    frame.bitangent = select(cross(frame.normal, t) * rest.handedness, frame.bitangent, cancelled);
    return frame;
}

#if SKINBAKE > 2
// The frame of NORMAL, which must have length 1, and TANGENT.
fn skinbake_frame(n: vec3<f32>, tangent: vec4<f32>) -> skinbake_Frame {
    return skinbake_Frame(n, tangent.xyz, cross(n, tangent.xyz) * tangent.w, tangent.w);
}
#else
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
#endif

#if NUM_BONE_INFLUENCERS > 4
// The frame moves by the derivative of the skinned position along t0 and b0.
// M: the joint matrices of slots 0 to 7.
fn skinbake_lbs_accurate(p: vec3<f32>, frame: skinbake_Frame, M: array<mat4x4<f32>, 8>, weights_0: vec4<f32>,
        weights_1: vec4<f32>, alpha_0: vec3<f32>, alpha_1: vec4<f32>, beta_0: vec3<f32>,
        beta_1: vec4<f32>) -> skinbake_Vertex {
    let T = weights_0.x * skinbake_upper(M[0]) // 1
          + weights_0.y * skinbake_upper(M[1])
          + weights_0.z * skinbake_upper(M[2])
          + weights_0.w * skinbake_upper(M[3])
          + weights_1.x * skinbake_upper(M[4])
          + weights_1.y * skinbake_upper(M[5])
          + weights_1.z * skinbake_upper(M[6])
          + weights_1.w * skinbake_upper(M[7]);
    let q0 = skinbake_moved(M[0], p); // 2
    let q1 = skinbake_moved(M[1], p);
    let q2 = skinbake_moved(M[2], p);
    let q3 = skinbake_moved(M[3], p);
    let q4 = skinbake_moved(M[4], p);
    let q5 = skinbake_moved(M[5], p);
    let q6 = skinbake_moved(M[6], p);
    let q7 = skinbake_moved(M[7], p);
    let d1 = q1 - q0; // 3
    let d2 = q2 - q0;
    let d3 = q3 - q0;
    let d4 = q4 - q0;
    let d5 = q5 - q0;
    let d6 = q6 - q0;
    let d7 = q7 - q0;
    let tangent = T * frame.tangent + alpha_0.x * d1 + alpha_0.y * d2 + alpha_0.z * d3 + alpha_1.x * d4
            + alpha_1.y * d5 + alpha_1.z * d6 + alpha_1.w * d7; // 4
    let bitangent = T * frame.bitangent + beta_0.x * d1 + beta_0.y * d2 + beta_0.z * d3 + beta_1.x * d4
            + beta_1.y * d5 + beta_1.z * d6 + beta_1.w * d7; // 5
    let outside = select(1.0, -1.0, determinant(T) < 0.0); // a joint that mirrors turns t x b to the inside
    let normal = outside * frame.handedness * cross(tangent, bitangent); // 6
    let position = q0 + weights_0.y * d1 + weights_0.z * d2 + weights_0.w * d3 + weights_1.x * d4
            + weights_1.y * d5 + weights_1.z * d6 + weights_1.w * d7; // 7
    return skinbake_Vertex(position, normal, tangent, bitangent);
}
#else
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
    let outside = select(1.0, -1.0, determinant(T) < 0.0); // a joint that mirrors turns t x b to the inside
    let normal = outside * frame.handedness * cross(tangent, bitangent); // 6
    let position = q0 + weights_0.y * d1 + weights_0.z * d2 + weights_0.w * d3; // 7
    return skinbake_Vertex(position, normal, tangent, bitangent);
}
#endif

fn skinbake_joint(index: f32) -> mat4x4<f32> {
#ifdef BONETEXTURE
    return readMatrixFromRawSampler(boneSampler, index);
#else
    return uniforms.mBones[i32(index)];
#endif
}

// The world matrix of the mesh or of its instance, without the joints.
fn skinbake_world() -> mat3x3<f32> {
#ifdef INSTANCES
    let instance = mat3x3<f32>(vertexInputs.world0.xyz, vertexInputs.world1.xyz, vertexInputs.world2.xyz);
#ifdef THIN_INSTANCES
#ifdef WORLD_UBO
    return skinbake_upper(mesh.world) * instance;
#else
    return skinbake_upper(uniforms.world) * instance;
#endif
#else
    return instance;
#endif
#else
#ifdef WORLD_UBO
    return skinbake_upper(mesh.world);
#else
    return skinbake_upper(uniforms.world);
#endif
#endif
}

fn skinbake_rest() -> skinbake_Frame {
    let given = vertexInputs.normal;
    let n0 = select(vec3<f32>(0.0, 0.0, 1.0), normalize(given), dot(given, given) > 0.0);
#if SKINBAKE > 2
    return skinbake_frame(n0, vertexInputs.tangent);
#else
    return skinbake_frame(n0);
#endif
}

fn skinbake_lit(p: vec3<f32>, frame: skinbake_Frame) -> skinbake_Vertex {
    let scale = uniforms.skinbakeScale;
    let alpha_0 = skinbake_decoded(vertexInputs.skinbakeAlpha0, scale);
    let beta_0 = skinbake_decoded(vertexInputs.skinbakeBeta0, scale);
    // Alpha and beta are for weights that sum to 1. Babylon.js does not divide them.
    var weights_0 = vertexInputs.matricesWeights;
    var total = dot(weights_0, vec4<f32>(1.0));
#if NUM_BONE_INFLUENCERS > 4
    var weights_1 = vertexInputs.matricesWeightsExtra;
    total += dot(weights_1, vec4<f32>(1.0));
    weights_1 = select(vec4<f32>(0.0), weights_1 / total, total > 0.0);
    var M: array<mat4x4<f32>, 8>;
#else
    var M: array<mat4x4<f32>, 4>;
#endif
    weights_0 = select(vec4<f32>(1.0, 0.0, 0.0, 0.0), weights_0 / total, total > 0.0);
    M[0] = skinbake_joint(vertexInputs.matricesIndices.x);
    M[1] = skinbake_joint(vertexInputs.matricesIndices.y);
    M[2] = skinbake_joint(vertexInputs.matricesIndices.z);
    M[3] = skinbake_joint(vertexInputs.matricesIndices.w);
#if NUM_BONE_INFLUENCERS > 4
    M[4] = skinbake_joint(vertexInputs.matricesIndicesExtra.x);
    M[5] = skinbake_joint(vertexInputs.matricesIndicesExtra.y);
    M[6] = skinbake_joint(vertexInputs.matricesIndicesExtra.z);
    M[7] = skinbake_joint(vertexInputs.matricesIndicesExtra.w);
    let alpha_1 = skinbake_decoded_further(vertexInputs.skinbakeAlpha1, vertexInputs.skinbakeAlpha0, scale);
    let beta_1 = skinbake_decoded_further(vertexInputs.skinbakeBeta1, vertexInputs.skinbakeBeta0, scale);
    return skinbake_lbs_accurate(p, frame, M, weights_0, weights_1, alpha_0, alpha_1, beta_0, beta_1);
#else
    return skinbake_lbs_accurate(p, frame, M, weights_0, alpha_0, beta_0);
#endif
}
#endif
`,
    CUSTOM_VERTEX_UPDATE_WORLDPOS: /* wgsl */ `
#if SKINBAKE > 0
let skinbakeRest = skinbake_rest();
#if SKINBAKE > 2 && defined(MORPHTARGETS) && defined(MORPHTARGETS_TANGENT)
let skinbakeFrame = skinbake_morphed_tangent_frame(skinbakeRest, normalUpdated, tangentUpdated.xyz);
#else
var skinbakeFrame = skinbakeRest;
if (any(normalUpdated != vertexInputs.normal)) {
    skinbakeFrame = skinbake_morphed_frame(skinbakeRest, normalUpdated);
}
#endif
let skinbakeLit = skinbake_lit(positionUpdated, skinbakeFrame);
let skinbakeWorld = skinbake_world();
var skinbakeSide = select(1.0, -1.0, determinant(skinbakeWorld) < 0.0);
let skinbakeCofactors = mat3x3<f32>(
    cross(skinbakeWorld[1], skinbakeWorld[2]),
    cross(skinbakeWorld[2], skinbakeWorld[0]),
    cross(skinbakeWorld[0], skinbakeWorld[1]));
vertexOutputs.vNormalW = skinbakeSide * normalize(skinbakeCofactors * skinbakeLit.normal);
#endif
`,
    CUSTOM_VERTEX_MAIN_END: /* wgsl */ `
#if SKINBAKE > 0 && defined(TANGENT)
#if defined(BUMP) || defined(PARALLAX) || defined(CLEARCOAT_BUMP) || defined(ANISOTROPIC) || defined(GEOMETRY_NORMAL) || defined(FUZZ)
#if SKINBAKE > 2
let skinbakeAlong = skinbakeLit.tangent;
#else
let skinbakeAlong = dot(vertexInputs.tangent.xyz, skinbakeRest.tangent) * skinbakeLit.tangent
    + dot(vertexInputs.tangent.xyz, skinbakeRest.bitangent) * skinbakeLit.bitangent;
#endif
skinbakeSide *= sign(dot(cross(skinbakeLit.tangent, skinbakeLit.bitangent), skinbakeLit.normal));
skinbakeSide *= skinbakeFrame.handedness; // a joint that mirrors turns it round
vertexOutputs.vTBN0 = normalize(skinbakeWorld * skinbakeAlong);
skinbakeSide *= vertexInputs.tangent.w;
vertexOutputs.vTBN1 = skinbakeSide * cross(vertexOutputs.vNormalW, vertexOutputs.vTBN0);
vertexOutputs.vTBN2 = vertexOutputs.vNormalW;
#endif
#endif
`,
};

const PLUGIN = 'Skinbake';
const HOOKS = [GLSL, WGSL]; // by Babylon.js's numbers of the languages

// What a material needs to light baked meshes. Meshes that are not baked run Babylon.js's own lines alone.
class Plugin extends MaterialPluginBase {
    constructor(material) {
        super(material, PLUGIN, 200, { SKINBAKE: 0 }, true, false);
        this.doNotSerialize = true;
        this.registerForExtraEvents = true;
        this._enable(true);
    }

    getClassName() {
        return 'SkinbakeMaterialPlugin';
    }

    isCompatible() {
        return true;
    }

    // Irradiance of the environment that the vertex shader computes comes before its normal is corrected.
    prepareDefines(defines, scene, mesh) {
        defines.SKINBAKE = defines.NORMAL ? litBy(mesh, defines) : 0;
        if (defines.SKINBAKE) defines.USESPHERICALINVERTEX = false;
    }

    getAttributes(attributes, scene, mesh) {
        const { sets } = bakeOf(mesh) ?? {};
        for (let set = 0; set < (litBy(mesh) ? sets : 0); set++) attributes.push(...kindsOf(set));
    }

    getUniforms() {
        return { externalUniforms: ['skinbakeScale'] };
    }

    hardBindForSubMesh(buffer, scene, engine, subMesh) {
        const baked = bakeOf(subMesh.getMesh());
        if (baked && !baked.problem) subMesh.effect.setFloat('skinbakeScale', baked.scale);
    }

    getCustomCode(type, language = 0) {
        return type === 'vertex' ? HOOKS[language] : null;
    }
}

const bakeOf = (mesh) => state.geometries.get(mesh.geometry);

// Return the number of the frame by which a mesh is lit, 0 if it is not lit accurately.
function litBy(mesh, defines) {
    return obstacle(mesh, defines) ? 0 : bakeOf(mesh).frame;
}

// Return why a mesh is not lit accurately, whatever its material is; empty if it may be.
function obstacle(mesh, defines = {}) {
    const baked = bakeOf(mesh);
    if (!baked) return 'its geometry is a copy, and Babylon.js copies no attributes that it does not know';
    if (baked.problem) return baked.problem;
    if (state.standard.has(mesh)) return SWITCHED;
    const engine = mesh.getEngine();
    if (!engine.isWebGPU && engine.version < 2) return 'this module needs WebGL 2 or WebGPU';
    if (!mesh.skeleton) return 'it has no skeleton';
    if (!mesh.computeBonesUsingShaders) return 'the processor skins it (computeBonesUsingShaders)';
    if (mesh.numBoneInfluencers !== 4 * baked.sets) {
        return `its numBoneInfluencers is ${mesh.numBoneInfluencers}, and its bake is for ${4 * baked.sets}`;
    }
    if (baked.changed) return baked.changed;
    if (defines.BAKED_VERTEX_ANIMATION_TEXTURE) return 'a baked vertex animation moves it';
    if (defines.USE_VERTEX_PULLING) return 'its material pulls vertices';
    return shortage(mesh, defines, baked.sets);
}

const SWITCHED = 'lighting() has switched it';

// Return which limit of the device the attributes of a mesh exceed, with alpha and beta; empty if none.
function shortage(mesh, defines, sets) {
    const engine = mesh.getEngine();
    const kinds = Object.keys(KINDS).filter((name) => defines[name]).map((name) => KINDS[name]);
    kinds.push('position', 'matricesIndices', 'matricesWeights');
    if (sets > 1) kinds.push('matricesIndicesExtra', 'matricesWeightsExtra');
    const perInstance = defines.INSTANCES || defines.THIN_INSTANCES ? 4 : 0;
    const isMorphed = defines.MORPHTARGETS && !defines.MORPHTARGETS_TEXTURE;
    const moved = isMorphed ? MORPHED.filter((name) => defines[`MORPHTARGETS_${name}`]) : [];
    const morphs = moved.length * (defines.NUM_MORPH_INFLUENCERS ?? 0);
    const count = kinds.length + perInstance + morphs + 2 * sets;
    const most = engine.getCaps().maxVertexAttribs;
    if (count > most) return `it needs ${count} vertex attributes, and this device has ${most}`;
    // Attributes that lie interleaved share a buffer. So do the four of an instance.
    const buffers = new Set(kinds.map((kind) => {
        const one = mesh.getVertexBuffer(kind);
        return one && one.effectiveByteOffset < one.effectiveByteStride ? one.effectiveBuffer : kind;
    }));
    const needed = buffers.size + perInstance / 4 + morphs + 1;
    const available = engine.isWebGPU ? engine.currentLimits.maxVertexBuffers : Infinity;
    return needed > available ? `it needs ${needed} vertex buffers, and this device has ${available}` : '';
}

const MORPHED = ['POSITION', 'NORMAL', 'TANGENT', 'UV', 'UV2', 'COLOR'];

// Babylon.js's defines -> the attributes that they declare.
const KINDS = { NORMAL: 'normal', TANGENT: 'tangent', VERTEXCOLOR: 'color', INSTANCESCOLOR: 'instanceColor' };
for (let number = 1; number <= 6; number++) KINDS[`UV${number}`] = number === 1 ? 'uv' : `uv${number}`;

// Look after the baked meshes of a scene, of whatever origin: clone() makes new ones, and materials change.
function watch(scene) {
    const known = state.scenes.get(scene);
    if (known) return known;
    const watched = { geometries: new Set(), meshes: new Set() };
    state.scenes.set(scene, watched);
    scene.onBeforeRenderObservable.add(() => prepare(watched));
    scene.onAfterRenderObservable.add(() => watched.meshes.forEach(tellOf));
    return watched;
}

function prepare({ geometries, meshes }) {
    for (const geometry of geometries) {
        if (geometry.isDisposed()) {
            geometries.delete(geometry);
            continue;
        }
        geometry.meshes.forEach((mesh) => meshes.add(mesh));
        heedChanges(geometry);
    }
    for (const mesh of meshes) {
        if (mesh.isDisposed()) meshes.delete(mesh);
        else materialsOf(mesh).forEach(equip);
    }
}

// Babylon.js keeps the program of a mesh whose attributes a page replaces or removes.
function heedChanges(geometry) {
    const baked = state.geometries.get(geometry);
    const [kind] = (baked.loaded ?? []).find((one) => !isAsLoaded(geometry, ...one)) ?? [];
    const name = ATTRIBUTES[kind] ?? kind;
    const changed = kind ? `a page has changed or removed its ${name}: its bake is for the old values` : '';
    if (changed === baked.changed) return;
    baked.changed = changed;
    for (const mesh of geometry.meshes) mesh.subMeshes?.forEach(renew);
}

// Babylon.js puts the same normals into another buffer when the processor no longer skins a mesh. Until then it writes
// in each frame. Nothing is read while no mesh is to be lit accurately.
function isAsLoaded(geometry, kind, known) {
    const buffer = geometry.getVertexBuffer(kind);
    const writes = state.writes.get(buffer) ?? 0;
    if (known.buffer === buffer && known.writes === writes) return known.isSame;
    if (geometry.meshes.every((mesh) => !mesh.computeBonesUsingShaders || state.standard.has(mesh))) return known.isSame;
    watchBuffer(buffer);
    known.buffer = buffer;
    known.writes = writes;
    known.isSame = Boolean(buffer) && isLike(printOf(geometry, kind), known.print);
    return known.isSame;
}

function materialsOf(mesh) {
    const usual = (mesh.subMeshes ?? []).map((subMesh) => subMesh.getMaterial());
    // Those that setMaterialForRendering() of a render target has put in their place.
    const others = Object.values(mesh._internalAbstractMeshDataInfo?._materialForRenderPass ?? {});
    return [...usual, ...others.flatMap((material) => material?.subMaterials ?? material)].filter(Boolean);
}

function equip(material) {
    if (material instanceof PushMaterial && !isEquipped(material)) new Plugin(material);
}

const isEquipped = (material) => Boolean(material.pluginManager?.getPlugin(PLUGIN));

const ACCURATE = { lighting: 'accurate', reason: '' };
const UNLIT = { lighting: 'unlit', reason: 'its materials read no normals' };
const NOT_DRAWN = { lighting: 'not drawn', reason: 'it has not been drawn yet' };

// Return what a part of a mesh was last drawn with, read from the program that drew it.
function drawnWith(mesh, subMesh) {
    const problem = obstacle(mesh, subMesh.materialDefines ?? {});
    const isSwitched = problem === SWITCHED;
    if (problem && !isSwitched) return { lighting: 'standard', reason: problem };
    const material = subMesh.getMaterial();
    const { effect } = subMesh;
    const isPending = material instanceof PushMaterial && !isEquipped(material);
    if (!effect?.isReady() || isPending) return NOT_DRAWN;
    const reads = (name) => effect.getAttributeLocationByName(name) >= 0;
    if (reads(kindsOf(0)[0])) return ACCURATE;
    if (!reads(VertexBuffer.NormalKind)) return UNLIT;
    if (isSwitched) return { lighting: 'standard', reason: SWITCHED };
    const kind = material.getClassName();
    return { lighting: 'standard', reason: `its ${kind} "${material.name}" takes no material plugins` };
}

function tellOf(mesh) {
    for (const subMesh of mesh.subMeshes ?? []) {
        if (!subMesh.effect?.isReady()) continue;
        const { lighting, reason } = drawnWith(mesh, subMesh);
        if (lighting === 'standard' && reason !== SWITCHED) tell(mesh, reason);
    }
}

const WORST_FIRST = ['standard', 'not drawn', 'unlit', 'accurate'];

/**
 * Tell what each baked mesh was last drawn with. Instances are as their source.
 *
 * @param {Scene | Node | AssetContainer | InstantiatedEntries | AbstractMesh[]} root - What holds the meshes.
 * @returns {MeshReport[]} One entry for each mesh that is not disposed.
 * @throws {TypeError} If the root is none of these.
 */
export function report(root) {
    return sourcesOf(root).map((mesh) => {
        const found = (mesh.subMeshes ?? []).map((subMesh) => drawnWith(mesh, subMesh));
        const worst = WORST_FIRST.map((one) => found.find(({ lighting }) => lighting === one)).find(Boolean);
        return { mesh, ...(worst ?? NOT_DRAWN) };
    });
}

/**
 * Switch meshes to Babylon.js's own lighting, or back.
 *
 * @param {Scene | Node | AssetContainer | InstantiatedEntries | AbstractMesh[]} root - What holds the meshes.
 * @param {'standard' | 'accurate'} which - The lighting.
 * @throws {Error} If the root or the lighting is none of these.
 */
export function lighting(root, which) {
    if (which !== 'standard' && which !== 'accurate') {
        throw new Error(`skinbake: lighting ${which} is neither standard nor accurate`);
    }
    for (const mesh of sourcesOf(root)) {
        if (which === 'standard') state.standard.add(mesh);
        else state.standard.delete(mesh);
        for (const subMesh of mesh.subMeshes ?? []) renew(subMesh);
    }
}

// Let Babylon.js choose the program anew. It does not look at a frozen material again while there is one.
function renew(subMesh) {
    const material = subMesh.getMaterial();
    if (!material) return;
    const isBlocked = material.blockDirtyMechanism || material.getScene().blockMaterialDirtyMechanism;
    if (material.isFrozen || isBlocked) subMesh.resetDrawCache();
    else material.markAsDirty(Material.AttributesDirtyFlag);
}

function sourcesOf(root) {
    const sources = new Set(meshesOf(root).map((mesh) => mesh.sourceMesh ?? mesh));
    const isBaked = (mesh) => state.geometries.has(mesh.geometry) || isWatched(mesh);
    return [...sources].filter((mesh) => !mesh.isDisposed() && isBaked(mesh));
}

function meshesOf(root) {
    const meshes = Array.isArray(root) ? root : root?.meshes;
    const nodes = meshes ?? root?.rootNodes ?? [root];
    if (!nodes.every((node) => typeof node?.getChildMeshes === 'function')) throw new TypeError(WRONG_ROOT);
    return meshes ?? nodes.flatMap((node) => [node, ...node.getChildMeshes()]);
}

const WRONG_ROOT =
    'skinbake: the root is not a scene, a node, an asset container, ' +
    'what a loader or a container returns, or an array of meshes';
const isWatched = (mesh) => Boolean(state.scenes.get(mesh.getScene())?.meshes.has(mesh));
