// Galacean gives shaders each attribute by its name in the file. So alpha and beta need no more than the names that
// the shader text has for them.

import { GLTFMeshParser, GLTFUtils } from '@galacean/engine';
import { accessorsIn, FRAMES, isLeft, metadataOf, namesOf, NOT_BAKED, problemOf, staleOf, tellOfUnreadMoves } from './bake.js';

export const bakes = new WeakMap(); // ModelMesh -> { problem, frame, scale, isPaired, names, method, places }
export const loading = { method: 'lbs' };

const files = new WeakMap(); // glTF -> promise of why a tool has spoiled primitives

export class SkinbakeMeshParser extends GLTFMeshParser {
    parse(context, index) {
        const { glTF, glTFResource } = context;
        if (!files.has(glTF)) {
            tellOfFile(glTF, glTFResource.url);
            tellOfUnreadMoves(glTF, 'Galacean');
            files.set(glTF, staleIn(context));
        }
        watchDevice(glTFResource.engine);
        const { method } = loading;
        const mesh = glTF.meshes[index];
        const found = mesh.primitives.map((primitive) => bakeOf(glTF, primitive, method));
        const attributes = (primitive, number) => ({ ...primitive, attributes: renamed(primitive, found[number]) });
        // Galacean reads the names at once. The JSON is the page's, too.
        glTF.meshes[index] = { ...mesh, primitives: mesh.primitives.map(attributes) };
        try {
            return super.parse(context, index).then(async (meshes) => {
                const stale = await files.get(glTF);
                for (const [number, made] of meshes.entries()) {
                    const bake = found[number];
                    const problem = bake?.problem || stale.get(mesh.primitives[number]) || '';
                    if (bake) bakes.set(made, { ...bake, problem, places: placesOf(made) });
                }
                return meshes;
            });
        } finally {
            glTF.meshes[index] = mesh;
        }
    }
}

function tellOfFile(glTF, url) {
    const primitives = glTF.meshes.flatMap((mesh) => mesh.primitives);
    if (!glTF.skins?.length || isLeft(glTF) || primitives.some((primitive) => bakeOf(glTF, primitive))) return;
    console.info(`skinbake: "${url}" has no bake, and Galacean's standard lighting: run skinbake bake on it`);
}

// Galacean may have several arrays in one.
async function staleIn(context) {
    const { accessors, bufferViews } = context.glTF;
    const read = async (number) => {
        const accessor = accessors[number];
        const { data, interleaved, stride } = await GLTFUtils.getAccessorBuffer(context, bufferViews, accessor);
        if (!interleaved) return data;
        const width = stride / data.BYTES_PER_ELEMENT;
        const first = ((accessor.byteOffset ?? 0) % stride) / data.BYTES_PER_ELEMENT;
        const rows = Math.min(accessor.count, Math.ceil(data.length / width)); // a file may claim any number
        return Array.from({ length: 4 * rows }, (_, at) => data[first + width * (at >> 2) + (at & 3)]);
    };
    const arrays = accessorsIn(context.glTF).map(async (number) => [number, await read(number)]);
    return staleOf(context.glTF, new Map(await Promise.all(arrays)));
}

function bakeOf(glTF, primitive, method) {
    const metadata = metadataOf(glTF, primitive);
    const find = (name) => glTF.accessors[primitive.attributes[name]];
    const problem = problemOf(metadata, find, 'Galacean', 4);
    if (problem) return problem === NOT_BAKED ? null : { problem };
    if (primitive.extensions?.KHR_draco_mesh_compression) {
        return { problem: 'Galacean reads nothing of a mesh in Draco: bake it again with --compress none' };
    }
    const { frame, encoding, scale, layout } = metadata;
    const isPaired = layout === 'texcoord';
    return { problem, frame: FRAMES[frame], scale: encoding ? scale : 1, isPaired, names: namesOf(metadata), method };
}

const NAMES = ['skinbakeAlpha', 'skinbakeBeta'];
const PAIRS = ['skinbakePair0', 'skinbakePair1', 'skinbakePair2'];

function renamed({ attributes }, bake) {
    if (!bake || bake.problem) return attributes;
    const given = bake.isPaired ? PAIRS : NAMES;
    const name = (one) => given[bake.names.indexOf(one)] ?? one;
    return Object.fromEntries(Object.entries(attributes).map(([one, accessor]) => [name(one), accessor]));
}

// Alpha and beta are right for these arrays alone.
const ARRAYS = ['POSITION', 'NORMAL', 'TANGENT', 'WEIGHTS_0', ...NAMES, ...PAIRS];

// Where the arrays of a mesh lie, and how often a page has written there.
function placesOf(mesh) {
    const elements = mesh.vertexElements.filter(({ attribute }) => ARRAYS.includes(attribute));
    return elements.map(({ attribute, offset, bindingIndex }) => {
        const { buffer } = mesh.vertexBufferBindings[bindingIndex] ?? {};
        watchBuffer(buffer);
        return { attribute, offset, buffer, written: writes.get(buffer) };
    });
}

// Return the name of an array that a page has written or removed since the mesh was loaded; empty if none.
export function changedIn(mesh, { places }) {
    const now = placesOf(mesh);
    const isThere = (one) => now.some((other) => Object.keys(one).every((key) => one[key] === other[key]));
    return places.find((one) => !isThere(one))?.attribute ?? '';
}

const writes = new WeakMap(); // Buffer -> how often a page has written it

function watchBuffer(buffer) {
    if (!buffer || writes.has(buffer)) return;
    writes.set(buffer, 0);
    const usual = buffer.setData;
    buffer.setData = function (...parameters) {
        if (!lost.has(buffer.engine)) writes.set(buffer, writes.get(buffer) + 1);
        return usual.apply(this, parameters);
    };
}

// Galacean itself writes all buffers anew when a device that was lost is there again.
const engines = new WeakSet();
const lost = new WeakSet();

function watchDevice(engine) {
    if (engines.has(engine)) return;
    engines.add(engine);
    engine.on('devicelost', () => lost.add(engine));
    engine.on('devicerestored', () => lost.delete(engine));
}
