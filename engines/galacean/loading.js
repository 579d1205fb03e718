// Galacean gives shaders each attribute by its name in the file. So alpha and beta need no more than the names that
// the shader text has for them.

import { GLTFMeshParser } from '@galacean/engine';

export const bakes = new WeakMap(); // ModelMesh -> { problem, frame, scale, isPaired, names, method, places }
export const loading = { method: 'lbs' };

const FRAMES = { normal: 2, tangent: 3 };
const ENCODINGS = { packed8: 5120, snorm16: 5122 };
const FLOAT = 5126;
const LOST = 'it has lost the metadata of its bake: keep the extras of primitives, or bake last';

const informed = new WeakSet(); // glTF

export class SkinbakeMeshParser extends GLTFMeshParser {
    parse(context, index) {
        const { glTF, glTFResource } = context;
        tellOfFile(glTF, glTFResource.url);
        watchDevice(glTFResource.engine);
        const { method } = loading;
        const mesh = glTF.meshes[index];
        const found = mesh.primitives.map((primitive) => bakeOf(glTF, primitive, method));
        const attributes = (primitive, number) => ({ ...primitive, attributes: renamed(primitive, found[number]) });
        // Galacean reads the names at once. The JSON is the page's, too.
        glTF.meshes[index] = { ...mesh, primitives: mesh.primitives.map(attributes) };
        try {
            return super.parse(context, index).then((meshes) => {
                for (const [number, made] of meshes.entries()) {
                    if (found[number]) bakes.set(made, { ...found[number], places: placesOf(made) });
                }
                return meshes;
            });
        } finally {
            glTF.meshes[index] = mesh;
        }
    }
}

function tellOfFile(glTF, url) {
    if (informed.has(glTF)) return;
    informed.add(glTF);
    const primitives = glTF.meshes.flatMap((mesh) => mesh.primitives);
    if (!glTF.skins?.length || primitives.some((primitive) => bakeOf(glTF, primitive))) return;
    console.info(`skinbake: "${url}" has no bake, and Galacean's standard lighting: run skinbake bake on it`);
}

function bakeOf(glTF, primitive, method) {
    const metadata = metadataOf(glTF, primitive);
    if (!metadata) return primitive.attributes._SKINBAKE_ALPHA_0 === undefined ? null : { problem: LOST };
    const problem = problemOf(glTF, primitive, metadata) || staleOf(glTF).get(primitive);
    if (problem) return { problem };
    const { frame, encoding, scale, layout, alpha, beta } = metadata;
    const isPaired = layout === 'texcoord';
    const names = [...new Set([...alpha, ...beta])];
    return { problem: '', frame: FRAMES[frame], scale: encoding ? scale : 1, isPaired, names, method };
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

const isObject = (value) => typeof value === 'object' && value !== null;

// Where extras of the primitive were not an object, bake has put the metadata into those of alpha's accessor.
function metadataOf({ accessors = [] }, { extras, attributes }) {
    const places = [extras, ...Object.values(attributes).map((number) => accessors[number]?.extras)];
    const notes = places.map((place) => place?.skinbake);
    return notes.find((note) => isObject(note) && Number.isInteger(note.version));
}

function problemOf({ accessors }, { attributes, extensions }, metadata) {
    const { version, frame, encoding, layout, influences, scale, alpha, beta } = metadata;
    if (version !== 1) return `its bake has version ${version}, and this module reads version 1: update it`;
    if (extensions?.KHR_draco_mesh_compression) {
        return 'Galacean reads nothing of a mesh in Draco: bake it again with --compress none';
    }
    if (influences > 4 || attributes.JOINTS_1 !== undefined) {
        const count = influences > 4 ? influences : 8;
        const remedy = 'bake it again with --limit-influences 4';
        return `it has ${count} influences for each vertex, and Galacean reads four: ${remedy}`;
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
    if (!encoding) return accessor.componentType === FLOAT ? '' : 'is not of floats';
    const isEncoded = accessor.componentType === ENCODINGS[encoding] && accessor.normalized;
    return isEncoded ? '' : `is not encoded as ${encoding}`;
}
