// Read glTF 2.0: a GLB, or a .gltf with its files. Everything of a file stays data: names are never markup.

import { cross, IDENTITY, minus } from './matrices.js';

// Tables without a prototype: a file may call anything "__proto__" or "constructor".
const COMPONENTS = {
    __proto__: null, 5120: Int8Array, 5121: Uint8Array, 5122: Int16Array, 5123: Uint16Array, 5125: Uint32Array, 5126: Float32Array,
};
const SIZES = { __proto__: null, SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4, MAT2: 4, MAT3: 9, MAT4: 16 };
const LARGEST = { 5120: 127, 5121: 255, 5122: 32767, 5123: 65535 };
const MOST = 1e15; // Squares of lengths then stay floats.
const UNREAD = ['KHR_draco_mesh_compression', 'EXT_meshopt_compression', 'KHR_meshopt_compression'];
const TRIANGLES = [4, 5, 6];
const MOST_SETS = 2; // WebGL 2 has 16 attributes.

// Why a file cannot be shown, in words for its reader.
export class ReadError extends Error {}

// files are the files dropped beside it, by name.
export async function readModel(bytes, name, files = new Map()) {
    const { json, binary } = split(bytes);
    const holders = [...list(json.bufferViews), ...list(json.meshes).flatMap((mesh) => list(mesh.primitives))];
    const used = new Set(holders.flatMap((holder) => Object.keys(holder.extensions ?? {})));
    const unread = UNREAD.filter((one) => used.has(one));
    if (unread.length) {
        throw new ReadError(`it is compressed (${unread.join(', ')}): run “skinbake view” on it instead`);
    }
    const source = new Source(json, binary, files);
    await source.load();
    const nodes = readNodes(json);
    const skins = list(json.skins).map((skin) => readSkin(source, skin));
    // Characters of VRM 0 look along −Z, all others along +Z.
    const facesBackward = Boolean(json.extensions?.VRM && !json.extensions.VRMC_vrm);
    const model = { name, json, source, nodes, skins, facesBackward, primitives: new Map(), draws: [] };
    nodes.forEach((node, number) => {
        if (node.mesh === undefined || !node.isShown) return;
        list(json.meshes[node.mesh]?.primitives).forEach((_, index) => {
            const [isSkinned, { primitives }] = [node.skin !== undefined, model];
            const key = `${node.mesh}/${index}/${isSkinned}`;
            if (!primitives.has(key)) primitives.set(key, readPrimitive(model, node.mesh, index, isSkinned));
            const primitive = primitives.get(key);
            if (primitive) model.draws.push({ node: number, skin: node.skin, primitive });
        });
    });
    if (!model.draws.length) throw new ReadError('no mesh of it is made of triangles');
    const names = clipNames(list(json.animations));
    model.clips = names.map((name, number) => readClip(source, json.animations[number], number, name, nodes));
    model.clips = model.clips.filter((clip) => clip.channels.length);
    model.materials = list(json.materials);
    model.images = new Map();
    for (const [, { index }] of model.materials.flatMap(shownTextures)) if (index !== undefined) readImage(model, index);
    return model;
}

const list = (value) => (Array.isArray(value) ? value : []);

function split(bytes) {
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    const text = (part) => JSON.parse(new TextDecoder().decode(part));
    try {
        if (bytes.length < 12 || view.getUint32(0, true) !== 0x46546c67) return { json: text(bytes) };
    } catch {
        throw new ReadError('it is neither a GLB nor glTF');
    }
    let at = 12;
    let json, binary;
    while (at + 8 <= bytes.length) {
        const length = view.getUint32(at, true);
        const kind = view.getUint32(at + 4, true);
        const part = bytes.subarray(at + 8, at + 8 + length);
        if (kind === 0x4e4f534a) json = text(part);
        if (kind === 0x004e4942) binary ??= part;
        at += 8 + length;
    }
    if (!json) throw new ReadError('the GLB has no JSON');
    return { json, binary };
}

export function fromBase64(text) {
    if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
    return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}

// The buffers and accessors of a document.
class Source {
    constructor(json, binary, files) {
        Object.assign(this, { json, binary, files, buffers: [], known: new Map() });
    }

    async load() {
        const buffers = list(this.json.buffers);
        this.buffers = await Promise.all(
            buffers.map((buffer, number) =>
                buffer.uri === undefined && number === 0 ? this.binary : this.resource(buffer.uri)
            )
        );
    }

    // The bytes that a URI names: in a data: URI, or among the files dropped together. Nothing is fetched.
    async resource(uri) {
        if (typeof uri !== 'string') return undefined;
        const [head, body] = uri.split(',', 2);
        if (head.startsWith('data:')) {
            return head.endsWith(';base64') ? fromBase64(body) : new TextEncoder().encode(decodeURIComponent(body));
        }
        const file = this.files.get(decodeURIComponent(uri).split('/').pop());
        return file && new Uint8Array(await file.arrayBuffer());
    }

    view(number) {
        const { buffer, byteOffset = 0, byteLength, byteStride } = this.json.bufferViews[number];
        const bytes = this.buffers[buffer];
        if (!bytes) throw new ReadError('a buffer of it is missing: drop the .gltf together with its files');
        return { bytes: bytes.subarray(byteOffset, byteOffset + byteLength), byteStride };
    }

    // The numbers of an accessor as they are stored, tightly packed.
    accessor(number) {
        if (this.known.has(number)) return this.known.get(number);
        const one = this.json.accessors?.[number];
        const Type = COMPONENTS[one?.componentType];
        const size = SIZES[one?.type];
        if (!Type || !size) throw new ReadError(`its accessor ${number} is damaged`);
        let array = new Type(one.count * size);
        if (one.bufferView !== undefined) array = this.strided(one, Type, size);
        if (one.sparse) array = this.withSparse(one, array.slice(), Type, size);
        const { normalized = false, count, componentType } = one;
        const found = { array, size, count, normalized, type: componentType };
        this.known.set(number, found);
        return found;
    }

    strided({ bufferView, byteOffset = 0, count, type }, Type, size) {
        const { bytes, byteStride } = this.view(bufferView);
        const width = size * Type.BYTES_PER_ELEMENT;
        const stride = byteStride ?? width;
        if (byteOffset + (count - 1) * stride + width > bytes.length) throw new ReadError('a buffer of it is cut short');
        const packed = new Uint8Array(count * width);
        if (stride === width) packed.set(bytes.subarray(byteOffset, byteOffset + count * width));
        else {
            for (let i = 0; i < count; i++) {
                const start = byteOffset + i * stride;
                packed.set(bytes.subarray(start, start + width), i * width);
            }
        }
        return new Type(packed.buffer);
    }

    withSparse({ sparse }, array, Type, size) {
        const { indices, values, count } = sparse;
        const at = this.strided({ ...indices, count }, COMPONENTS[indices.componentType], 1);
        const what = this.strided({ ...values, count }, Type, size);
        at.forEach((place, i) => array.set(what.subarray(i * size, (i + 1) * size), place * size));
        return array;
    }

    // The numbers of an accessor as floats; integers that are normalised become fractions.
    floats(number) {
        const { array, size, normalized, type } = this.accessor(number);
        if (!normalized) return { array: new Float32Array(array), size };
        return { array: new Float32Array(array).map((value) => Math.max(value / LARGEST[type], -1)), size };
    }
}

function readNodes(json) {
    const nodes = list(json.nodes).map((node) => ({
        name: String(node.name ?? ''),
        mesh: node.mesh,
        skin: node.skin,
        matrix: node.matrix,
        translation: node.translation ?? [0, 0, 0],
        rotation: node.rotation ?? [0, 0, 0, 1],
        scale: node.scale ?? [1, 1, 1],
        weights: node.weights ?? json.meshes?.[node.mesh]?.weights ?? [],
        parent: -1,
    }));
    list(json.nodes).forEach((node, number) => list(node.children).forEach((child) => (nodes[child].parent = number)));
    const shown = shownNodes(json, nodes);
    nodes.forEach((node, number) => (node.isShown = shown.has(number)));
    return nodes;
}

// The nodes of the default scene, or, if it draws nothing skinned, those of the first scene that does.
// All nodes, if no scene does. A file without skins is shown in the same way by its meshes.
function shownNodes(json, nodes) {
    const below = (scene) => {
        const found = new Set();
        const add = (number) => {
            if (found.has(number)) return;
            found.add(number);
            list(json.nodes[number].children).forEach(add);
        };
        list(scene?.nodes).forEach(add);
        return found;
    };
    const meshes = [...nodes.entries()].filter(([, { mesh }]) => mesh !== undefined);
    const skinned = meshes.filter(([, { skin }]) => skin !== undefined);
    const wanted = (skinned.length ? skinned : meshes).map(([number]) => number);
    const scenes = list(json.scenes);
    const every = [scenes[json.scene ?? 0], ...scenes].map(below);
    return every.find((shown) => wanted.some((number) => shown.has(number))) ?? new Set(nodes.keys());
}

function readSkin(source, skin) {
    const joints = list(skin.joints);
    const given = skin.inverseBindMatrices;
    const values = given === undefined ? null : source.floats(given).array;
    const inverseBind = joints.map((_, i) => (values ? Array.from(values.subarray(16 * i, 16 * i + 16)) : IDENTITY));
    return { joints, inverseBind };
}

function readPrimitive({ source, json, skins, nodes }, mesh, index, isSkinned) {
    const one = json.meshes[mesh].primitives[index];
    const { attributes = {}, mode = 4 } = one;
    if (!TRIANGLES.includes(mode) || attributes.POSITION === undefined) return null;
    const positions = source.floats(attributes.POSITION).array;
    if (positions.some((value) => !(Math.abs(value) < MOST))) {
        throw new ReadError('its positions are too large for a renderer: scale the model down');
    }
    const count = positions.length / 3;
    const triangles = readTriangles(source, one.indices, mode, count);
    const optional = (name) => (attributes[name] === undefined ? null : source.floats(attributes[name]));
    const given = optional('NORMAL')?.array;
    const tangents = optional('TANGENT')?.array ?? null;
    const targets = list(one.targets).map((target) => readTarget(source, target));
    const own = targets.length - correctiveCount(json.meshes[mesh], targets.length);
    const primitive = {
        mesh,
        index,
        name: String(json.meshes[mesh].name ?? `mesh ${mesh}`),
        count,
        positions,
        normals: given ? unitNormals(given) : smoothNormals(positions, triangles),
        tangents,
        directions: tangents && tangents.filter((_, i) => i % 4 < 3),
        colors: optional('COLOR_0'),
        triangles,
        material: one.material,
        slots: 0,
        joints: [],
        weights: [],
        gradients: {},
        metadata: null,
        targets: targets.slice(0, own),
        ...morphNumbers(json.meshes[mesh], index, list(one.targets).slice(0, own), targets),
        correctives: targets.slice(own),
    };
    if (own < targets.length) primitive.stored = given ?? primitive.normals; // Of any length: correctives belong to it.
    if (isSkinned) {
        const fewest = Math.min(
            ...nodes.filter((node) => node.mesh === mesh && node.skin !== undefined).map((node) => skins[node.skin].joints.length)
        );
        readInfluences(source, attributes, primitive, fewest, isUnlit(json, list(json.materials)[one.material] ?? {}));
        readGradients(source, json, one, primitive);
    }
    readTexcoords(source, attributes, list(json.materials)[one.material], primitive);
    return primitive;
}

// What bake has added to the targets of a primitive: how many numbers of the differential each has (6, 4 or 0), and
// whether the NORMAL of all that move points is the file's own. Where it is not, the surface tells the true normals.
function morphNumbers(mesh, index, targets, read) {
    const found = mesh.extras?.skinbake?.morphTargets?.[index];
    const noted = found?.targets === targets.length ? found : {};
    const made = list(noted.normals);
    const isThere = (name) => read.length > 0 && read.every((target) => target[name]);
    const numbers = noted.frames === 6 && isThere('inPlane') && isThere('upward') ? 6 : noted.frames === 4 && isThere('inPlane') ? 4 : 0;
    const isAuthored = targets.every((target, i) => target.POSITION === undefined || (target.NORMAL !== undefined && !made.includes(i)));
    return { numbers, isAuthored };
}

// How many of a mesh's targets, the last ones, are the correctives of a bake.
function correctiveCount(mesh, most) {
    const { version, targets } = mesh.extras?.skinbake ?? {};
    if (!(Number.isInteger(version) && Number.isInteger(targets) && targets > 0 && targets <= most)) return 0;
    if (version !== 1) throw new ReadError(`its correctives have version ${version}: make the page with a newer skinbake`);
    return targets;
}

function readTarget(source, target) {
    const read = (name) => (target[name] === undefined ? null : source.floats(target[name]).array);
    return { positions: read('POSITION'), normals: read('NORMAL'), tangents: read('TANGENT'), inPlane: read('_SKINBAKE_MORPH'), upward: read('_SKINBAKE_MORPH_UP') };
}

function readTriangles(source, indices, mode, count) {
    const row = indices === undefined ? new Uint32Array(count).map((_, i) => i) : new Uint32Array(source.accessor(indices).array);
    if (row.some((vertex) => vertex >= count)) throw new ReadError('an index of it is past its vertices');
    if (mode === 4) return row.subarray(0, row.length - (row.length % 3));
    const found = new Uint32Array(3 * Math.max(0, row.length - 2));
    for (let i = 0; i + 2 < row.length; i++) {
        const turned = mode === 5 && i % 2;
        found.set(mode === 6 ? [row[0], row[i + 1], row[i + 2]] : [row[i], row[i + 1 + turned], row[i + 2 - turned]], 3 * i);
    }
    return found;
}

// Unit vectors. Where one has no length, that of others, or (0, 0, 1).
export function unitNormals(given, others) {
    const found = new Float32Array(given.length);
    for (let i = 0; i < given.length; i += 3) {
        const length = Math.hypot(given[i], given[i + 1], given[i + 2]);
        const isSound = Number.isFinite(length) && length > 0;
        for (let axis = 0; axis < 3; axis++) found[i + axis] = isSound ? given[i + axis] / length : others?.[i + axis] ?? Number(axis === 2);
    }
    return found;
}

function smoothNormals(positions, triangles) {
    const sums = new Float32Array(positions.length);
    for (let i = 0; i < triangles.length; i += 3) {
        const corners = [3 * triangles[i], 3 * triangles[i + 1], 3 * triangles[i + 2]];
        const [a, b, c] = corners.map((corner) => positions.subarray(corner, corner + 3));
        const normal = cross(minus(b, a), minus(c, a));
        for (const corner of corners) normal.forEach((value, axis) => (sums[corner + axis] += value));
    }
    return unitNormals(sums);
}

// Joints and weights, all slots of a vertex beside each other. Weights are as the bake reads them: none is negative,
// and they sum to 1.
function readInfluences(source, attributes, primitive, jointCount, isSkipped) {
    let sets = 0;
    while (attributes[`JOINTS_${sets}`] !== undefined) sets++;
    const [slots, { count }] = [4 * sets, primitive];
    if (sets > MOST_SETS) {
        const remedy = isSkipped ? 'limit them in the source, because bake skips what is unlit' : 'bake it with --limit-influences 8';
        throw new ReadError(`it has ${slots} influences for a vertex, and this page draws 8: ${remedy}`);
    }
    const [joints, weights] = [new Uint16Array(slots * count), new Float32Array(slots * count)];
    for (let set = 0; set < sets; set++) {
        const [own, shares] = [source.accessor(attributes[`JOINTS_${set}`]).array, source.floats(attributes[`WEIGHTS_${set}`]).array];
        for (let i = 0; i < 4 * count; i++) {
            const at = slots * (i >> 2) + 4 * set + (i & 3);
            joints[at] = own[i] < jointCount ? own[i] : 0;
            weights[at] = shares[i] > 0 ? shares[i] : 0;
        }
    }
    for (let start = 0; start < weights.length; start += slots) {
        const own = weights.subarray(start, start + slots);
        const sum = own.reduce((one, other) => one + other, 0);
        if (sum === 0) own[0] = 1;
        else own.forEach((weight, slot) => (own[slot] = weight / sum));
    }
    Object.assign(primitive, { slots, joints, weights });
}

// α and β as they are stored: the shader decodes them.
function readGradients(source, json, one, primitive) {
    const metadata = one.extras?.skinbake ?? metadataOfAccessor(json, one);
    if (!Number.isInteger(metadata?.version)) return;
    if (metadata.version !== 1) throw new ReadError(`its bake has version ${metadata.version}: make the page with a newer skinbake`);
    const number = (name) => (Object.hasOwn(one.attributes, name) ? one.attributes[name] : undefined);
    if (![...metadata.alpha, ...metadata.beta].every((name) => number(name) !== undefined)) {
        throw new ReadError('it has lost attributes of its bake: bake it again');
    }
    primitive.metadata = metadata;
    const kind = metadata.gradients === 'fitted' ? 'fitted' : 'surface';
    if (metadata.layout === 'texcoord') {
        const names = [...new Set([...metadata.alpha, ...metadata.beta])];
        const others = primitive.slots - 1;
        const row = names.map((name) => source.floats(number(name)).array);
        const value = (vertex, place) => row[place >> 1][2 * vertex + (place & 1)];
        primitive.gradients[kind] = gradientsOf(primitive, (vertex, slot) => [value(vertex, slot), value(vertex, others + slot)]);
        return;
    }
    primitive.gradients[kind] = {
        storage: metadata.encoding ?? 'float32',
        scale: metadata.scale ?? 1,
        alpha: metadata.alpha.map((name) => source.accessor(number(name))),
        beta: metadata.beta.map((name) => source.accessor(number(name))),
    };
}

// The texture coordinates of the material's images: each array once, and by use its number among them.
function readTexcoords(source, attributes, material, primitive) {
    const { metadata, count } = primitive;
    const ours = metadata ? [...metadata.alpha, ...metadata.beta] : []; // They may be stored as such sets.
    const keys = [];
    Object.assign(primitive, { texcoords: [], texcoordOf: {} });
    for (const [use, info] of shownTextures(material)) {
        const { set, transform } = placement(info);
        const name = `TEXCOORD_${set}`;
        if (attributes[name] === undefined || ours.includes(name)) continue;
        const { array, size } = source.floats(attributes[name]);
        if (size !== 2 || array.length !== 2 * count) continue;
        const key = [set, ...transform].join();
        if (!keys.includes(key)) primitive.texcoords[keys.push(key) - 1] = transformed(array, transform);
        primitive.texcoordOf[use] = keys.indexOf(key);
    }
}

// Where a texture info puts its image: the set of texture coordinates, and the rows of what moves them
// (KHR_texture_transform): scale, then rotation, then offset. Values of other types are as if they were not there.
function placement(info) {
    const told = info.extensions?.KHR_texture_transform ?? {};
    const isNumber = (value) => typeof value === 'number' && Number.isFinite(Math.fround(value));
    const isPair = (value) => Array.isArray(value) && value.length === 2 && value.every(isNumber);
    const set = [told.texCoord, info.texCoord, 0].find((value) => Number.isInteger(value) && value >= 0);
    const [x, y] = isPair(told.offset) ? told.offset : [0, 0];
    const [sx, sy] = isPair(told.scale) ? told.scale : [1, 1];
    const angle = isNumber(told.rotation) ? told.rotation : 0;
    const [c, s] = [Math.cos(angle), Math.sin(angle)];
    return { set, transform: [c * sx, s * sy, x, -s * sx, c * sy, y] };
}

function transformed(array, [a, b, x, c, d, y]) {
    const found = new Float32Array(array.length);
    for (let i = 0; i < array.length; i += 2) {
        found[i] = a * array[i] + b * array[i + 1] + x;
        found[i + 1] = c * array[i] + d * array[i + 1] + y;
    }
    return found;
}

function metadataOfAccessor(json, one) {
    const owner = Object.values(one.attributes).find((number) => json.accessors[number].extras?.skinbake);
    return owner === undefined ? undefined : json.accessors[owner].extras.skinbake;
}

// Attributes of floats from the values of slots 1 …: value gives α and β of a vertex and a slot, from 0.
export function gradientsOf(primitive, value) {
    const make = () => Array.from({ length: primitive.slots / 4 }, (_, set) => {
        const size = set ? 4 : 3;
        return { array: new Float32Array(size * primitive.count), size, count: primitive.count, normalized: false, type: 5126 };
    });
    const found = { storage: 'float32', scale: 1, alpha: make(), beta: make() };
    for (let vertex = 0; vertex < primitive.count; vertex++) {
        for (let slot = 0; slot + 1 < primitive.slots; slot++) {
            const set = (slot + 1) >> 2;
            const place = set ? 4 * vertex + ((slot + 1) & 3) : 3 * vertex + slot;
            [found.alpha[set].array[place], found.beta[set].array[place]] = value(vertex, slot);
        }
    }
    return found;
}

// Where several clips share a name, their numbers tell them apart, as clip_names in animation.py has it.
function clipNames(animations) {
    const names = animations.map(({ name }, number) => String(name || `animation ${number}`));
    const counts = new Map();
    for (const name of names) counts.set(name, (counts.get(name) ?? 0) + 1);
    return names.map((name, number) => (counts.get(name) === 1 && !/\(animation \d+\)$/.test(name) ? name : `${name} (animation ${number})`));
}

function readClip(source, animation, number, name, nodes) {
    const channels = [];
    const moved = list(animation.channels).flatMap(({ sampler, target }) =>
        targetsOf(target ?? {}, source.json).map((one) => ({ sampler, ...one }))
    );
    for (const { sampler, node, path, weight } of moved) {
        const one = animation.samplers?.[sampler];
        if (nodes[node] === undefined || !one || !['translation', 'rotation', 'scale', 'weights'].includes(path)) continue;
        const times = source.floats(one.input).array;
        const values = source.floats(one.output).array;
        const method = one.interpolation ?? 'LINEAR';
        const size = values.length / times.length / (method === 'CUBICSPLINE' ? 3 : 1);
        if (times.length && Number.isInteger(size)) channels.push({ node, path, weight, times, values, method, size });
    }
    return {
        number,
        name,
        channels,
        start: Math.min(...channels.map(({ times }) => times[0])),
        end: Math.max(...channels.map(({ times }) => times[times.length - 1])),
    };
}

const POINTER = /^\/(nodes|meshes)\/(0|[1-9]\d*)\/(\w+)(?:\/(0|[1-9]\d*))?$/;

// The nodes and their property that a channel moves, also through the pointer of KHR_animation_pointer: to a property
// of a node, or to morph weights of a node or a mesh, all or one. Those of a mesh are its nodes' without their own.
function targetsOf({ node, path, extensions }, json) {
    if (path !== 'pointer') return [{ node, path }];
    const found = POINTER.exec(extensions?.KHR_animation_pointer?.pointer);
    if (!found) return [];
    const [of, number, name, weight] = [found[1], Number(found[2]), found[3], found[4] && Number(found[4])];
    if (name !== 'weights') return of === 'nodes' && weight === undefined ? [{ node: number, path: name }] : [];
    if (of === 'nodes') return [{ node: number, path: name, weight }];
    const drawing = list(json.nodes).flatMap(({ mesh, weights }, one) => (mesh === number && !weights ? [one] : []));
    return drawing.map((one) => ({ node: one, path: name, weight }));
}

// The textures of a material that are drawn, by use.
export function shownTextures(material) {
    const { pbrMetallicRoughness: pbr, normalTexture, emissiveTexture } = material ?? {};
    const every = { base: pbr?.baseColorTexture, normal: normalTexture, emissive: emissiveTexture };
    return Object.entries(every).filter(([, info]) => info);
}

// The toon materials of VRM name KHR_materials_unlit for viewers that do not know them, and are lit.
export function isUnlit({ extensions, materials }, material) {
    const { KHR_materials_unlit: unlit, VRMC_materials_mtoon: toon } = material.extensions ?? {};
    return Boolean(unlit && !toon && extensions?.VRM?.materialProperties?.[materials.indexOf(material)]?.shader !== 'VRM/MToon');
}

const [NEAREST, LINEAR, REPEAT, CLAMP_TO_EDGE, MIRRORED_REPEAT] = [9728, 9729, 10497, 33071, 33648];

// How the image of a texture is read beyond its edges and between its pixels, in the numbers of glTF, which are WebGL's.
// What is missing or no such number is as usual.
export function samplingOf({ json }, texture) {
    const { wrapS, wrapT, magFilter } = json.samplers?.[json.textures?.[texture]?.sampler] ?? {};
    const known = (wrap) => [CLAMP_TO_EDGE, MIRRORED_REPEAT].includes(wrap) ? wrap : REPEAT;
    return { wraps: [known(wrapS), known(wrapT)], magnified: magFilter === NEAREST ? NEAREST : LINEAR };
}

// The image of a texture. It is decoded once, beside the page; null if it is missing or cannot be decoded.
export function readImage(model, texture) {
    if (!model.images.has(texture)) model.images.set(texture, decodedImage(model, texture).catch(() => null));
    return model.images.get(texture);
}

async function decodedImage(model, texture) {
    const { json, source } = model;
    const { source: usual, extensions } = json.textures?.[texture] ?? {};
    const number = extensions?.EXT_texture_webp?.source ?? usual;
    const image = json.images?.[number];
    if (!image) return null;
    const bytes = image.bufferView === undefined ? await source.resource(image.uri) : source.view(image.bufferView).bytes;
    return bytes ? createImageBitmap(new Blob([bytes]), { colorSpaceConversion: 'none', premultiplyAlpha: 'none' }) : null;
}
