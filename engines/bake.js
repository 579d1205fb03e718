// What every adapter asks of a baked primitive: its metadata, why they do not serve, whether a tool has changed it since
// its bake, and whether a page has changed an array since it was loaded.
//
// `make golden` copies engines/bake.js into each package, as it stands alone.

export const FLOAT = 5126;
export const FRAMES = { normal: 2, tangent: 3 };
const ENCODINGS = { packed8: 5120, snorm16: 5122 }; // BYTE, SHORT
const LAYOUTS = ['attributes', 'custom', 'texcoord'];
export const NOT_BAKED = 'it is not baked';

export const isObject = (value) => typeof value === 'object' && value !== null;

// All of alpha, then all of beta.
export const namesOf = ({ alpha, beta }) => [...new Set([...alpha, ...beta])];

// Where extras of the primitive were not an object, bake has put the metadata into those of alpha's accessor.
export function metadataOf({ accessors = [] }, { extras, attributes = {} }) {
    const places = [extras, ...Object.values(attributes).map((number) => accessors[number]?.extras)];
    return places.map((place) => place?.skinbake).find((one) => isObject(one) && Number.isInteger(one.version));
}

// Correctives light a mesh of the file, which engines play without a shader.
const isCorrected = ({ extras }) => Number.isInteger(extras?.skinbake?.targets);

// Whether a file without alpha and beta is as its author has wanted: it has correctives, or a bake has left it so.
export const isLeft = ({ asset, meshes = [] }) => isObject(asset?.extras?.skinbake?.left) || meshes.some(isCorrected);

// Return why an engine that reads so many influences cannot use the metadata; empty if it can. find returns an accessor by
// the name of its attribute, undefined if there is none.
export function problemOf(metadata, find, engine, most) {
    if (!metadata) {
        if (!find('_SKINBAKE_ALPHA_0')) return NOT_BAKED;
        return 'it has lost the metadata of its bake: keep the extras of primitives, or bake last';
    }
    const { version, frame, encoding, layout = 'attributes', influences, scale, alpha, beta } = metadata;
    if (version !== 1) return `its bake has version ${version}, and this module reads version 1: update it`;
    if (influences > most || find(`JOINTS_${most / 4}`)) {
        const count = influences > most ? influences : most + 4;
        const reads = `${engine} reads ${{ 4: 'four', 8: 'eight' }[most]}`;
        return `it has ${count} influences for each vertex, and ${reads}: bake it again with --limit-influences ${most}`;
    }
    if (!Object.hasOwn(FRAMES, frame)) return `its frame is ${frame}, and this module knows normal and tangent: update it`;
    if (!LAYOUTS.includes(layout)) return `its layout is ${layout}, and this module knows ${LAYOUTS.join(', ')}: update it`;
    if (encoding !== undefined && !Object.hasOwn(ENCODINGS, encoding)) {
        return `its encoding is ${encoding}, and this module knows packed8 and snorm16: update it`;
    }
    if (encoding && !(scale >= 0 && Number.isFinite(scale))) return 'the metadata of its bake lacks the scale: bake it again';
    const isPaired = layout === 'texcoord';
    const isShort = (list) => Array.isArray(list) && list.length <= influences;
    const isNamed = [alpha, beta].every((list) => isShort(list) && list.every((name) => typeof name === 'string'));
    const count = isPaired ? influences - 1 : influences / 2;
    if (!isNamed || namesOf(metadata).length !== count || (!isPaired && alpha.length !== beta.length)) {
        return 'the metadata of its bake is damaged: bake it again';
    }
    const lost = ['POSITION', 'NORMAL', ...(frame === 'tangent' ? ['TANGENT'] : [])].find((name) => !find(name));
    if (lost) return `it has lost the attribute ${lost}, which its bake needs: bake last`;
    for (const [index, name] of namesOf(metadata).entries()) {
        const isFirst = index % alpha.length === 0;
        const type = isPaired ? 'VEC2' : encoding || !isFirst ? 'VEC4' : 'VEC3';
        const problem = misfit(find(name), { type, count: find('POSITION').count, encoding });
        if (problem) return `its attribute ${name} ${problem}: bake last, or keep attributes as they are`;
    }
    return '';
}

function misfit(accessor, { type, count, encoding }) {
    if (!accessor) return 'is missing';
    if (accessor.type !== type) return `is ${accessor.type}, not ${type}`;
    if (accessor.count !== count) return `is of ${accessor.count} vertices, not of ${count}`;
    if (!encoding) return accessor.componentType === FLOAT ? '' : 'is not of floats';
    return accessor.componentType === ENCODINGS[encoding] && accessor.normalized ? '' : `is not encoded as ${encoding}`;
}

const SAME_BOUNDS = 1e-3; // of the diagonal, as in skinbake: Draco rounds positions

// Return what a tool has changed, as far as the bake has noted it in `positions`; empty if nothing. corners is how many are
// drawn. Where joints are at hand, jointOf returns one by vertex and slot, and vertexOf the vertex of a corner.
export function changeSince({ positions: noted, influences }, find, { corners, jointOf, vertexOf }) {
    const accessor = find('POSITION');
    if (!isObject(noted) || !accessor) return '';
    const { componentType, count, min, max } = accessor;
    if (componentType !== noted.componentType) return 'the type of its positions';
    if (noted.corners !== undefined && noted.corners !== corners) return 'its triangles';
    if ([noted.min, noted.max, min, max].every((bound) => Array.isArray(bound) && bound.length === 3)) {
        const allowed = SAME_BOUNDS * Math.hypot(...noted.max.map((most, axis) => most - noted.min[axis]));
        const isSame = (one, other) => one.every((value, axis) => Math.abs(value - other[axis]) <= allowed);
        if (!isSame(noted.min, min) || !isSame(noted.max, max)) return 'the bounds of its positions';
    }
    if (noted.joints === undefined || !jointOf) return '';
    const hashes = new Int32Array(count);
    for (let vertex = 0; vertex < count; vertex++) hashes[vertex] = hashOf(jointOf, vertex, influences);
    let sum = 0; // In any order of vertices, merged or not, it is the same.
    for (let corner = 0; corner < corners - (corners % 3); corner++) sum = (sum + hashes[vertexOf(corner)]) | 0;
    return noted.joints === sum >>> 0 ? '' : 'the order of its joints';
}

// FNV-1a of the joints of a vertex, slot by slot.
function hashOf(jointOf, vertex, influences) {
    let hash = 0x811c9dc5;
    for (let slot = 0; slot < influences; slot++) hash = Math.imul(hash ^ jointOf(vertex, slot), 0x01000193);
    return hash;
}

// Return the numbers of the accessors that an engine reads for staleOf(): joints and indices.
export function accessorsIn(gltf) {
    const primitives = (gltf.meshes ?? []).flatMap((mesh) => mesh.primitives);
    const isBare = ({ extensions }) => !extensions?.KHR_draco_mesh_compression;
    const isNoted = (one) => isBare(one) && metadataOf(gltf, one)?.positions?.joints !== undefined;
    const numbersOf = ({ attributes, indices }) => [...setsOf(attributes), ...(indices === undefined ? [] : [indices])];
    return [...new Set(primitives.filter(isNoted).flatMap(numbersOf))];
}

function setsOf(attributes) {
    const names = Object.keys(attributes).filter((name) => name.startsWith('JOINTS_'));
    return names.sort().map((name) => attributes[name]);
}

const MOST_INFLUENCES = 8; // that an engine reads

// Return why each primitive of a file is lit standard that a tool has changed since its bake, and the other parts of its
// skin: between two lightings, a seam would show. arrays: the values of accessorsIn() by number, as far as they are at hand.
// What is shorter than the file says counts as not at hand: a file may claim any number of vertices.
export function staleOf(gltf, arrays) {
    const found = new Map();
    const { accessors, meshes = [], nodes = [] } = gltf;
    for (const primitive of meshes.flatMap(({ primitives }) => primitives)) {
        const metadata = metadataOf(gltf, primitive);
        if (!metadata) continue;
        const { attributes, indices } = primitive;
        const find = (name) => accessors[attributes[name]];
        const count = find('POSITION')?.count;
        const corners = accessors[indices]?.count ?? count;
        const joints = setsOf(attributes).map((number) => arrays.get(number));
        const drawn = indices === undefined ? count : (arrays.get(indices)?.length ?? 0);
        const isAtHand = joints.every((array) => array?.length >= 4 * count) && drawn >= corners;
        const isWhole = isAtHand && 4 * joints.length === metadata.influences && metadata.influences <= MOST_INFLUENCES;
        const jointOf = isWhole && ((vertex, slot) => joints[slot >> 2][4 * vertex + (slot & 3)]);
        const vertexOf = (corner) => arrays.get(indices)?.[corner] ?? corner;
        const change = changeSince(metadata, find, { corners, jointOf, vertexOf });
        if (change) found.set(primitive, `a tool has changed ${change} since its bake: bake last`);
    }
    const parts = new Map(); // skin -> its meshes
    for (const { mesh, skin } of nodes) {
        if (!meshes[mesh] || skin === undefined) continue;
        if (!parts.has(skin)) parts.set(skin, new Set());
        parts.get(skin).add(meshes[mesh]);
    }
    const stale = new Set(meshes.filter(({ primitives }) => primitives.some((one) => found.has(one))));
    const spread = new Set();
    for (const own of parts.values()) {
        const changed = [...own].find((mesh) => stale.has(mesh));
        for (const mesh of changed ? own : []) {
            if (spread.has(mesh)) continue; // many skins may draw it
            spread.add(mesh);
            stale.add(mesh);
            for (const primitive of mesh.primitives) {
                if (found.has(primitive)) continue;
                found.set(primitive, `a part of "${changed.name}", of the same skin, does not fit its bake: bake last`);
            }
        }
    }
    return found;
}

const MOVES = ['_SKINBAKE_MORPH', '_SKINBAKE_MORPH_UP'];

// Return the names of the numbers by which the morph targets of a primitive move the frame, as a file has them at each
// target: one name for four numbers, two for six; none without such numbers.
export function movesOf({ accessors }, mesh, index) {
    const noted = mesh?.extras?.skinbake?.morphTargets?.[index];
    const targets = mesh?.primitives[index].targets ?? [];
    const names = { 4: MOVES.slice(0, 1), 6: MOVES }[noted?.frames] ?? [];
    const isSound = (target) => names.every((name) => accessors[target[name]]?.componentType === FLOAT);
    return noted?.targets === targets.length && targets.every(isSound) ? names : [];
}

// Say of a file once what an engine misses that does not read these numbers.
export function tellOfUnreadMoves(gltf, engine) {
    for (const mesh of gltf.meshes ?? []) {
        const isUnread = (primitive, index) => metadataOf(gltf, primitive) && movesOf(gltf, mesh, index).length > 0;
        const targets = mesh.primitives.filter(isUnread).flatMap((primitive) => primitive.targets);
        if (!targets.length) continue;
        const isBare = targets.some(({ NORMAL, POSITION }) => NORMAL === undefined && POSITION !== undefined);
        const remedy = isBare ? ', and its targets lack NORMAL: bake it with --morph-normals too' : '';
        const why = `${engine} does not read the numbers of --morph-frames${remedy}`;
        console.warn(`skinbake: "${mesh.name}" has a frame that follows NORMAL under morph targets: ${why}`);
    }
}

// A sum of all components, by random factors from -1 to 1.
export function printOf(count, valueAt) {
    let sum = 0;
    let square = 0;
    for (let index = 0; index < count; index++) {
        const value = valueAt(index);
        let bits = Math.imul((index + 1) ^ ((index + 1) >>> 15), 0x85ebca6b);
        bits = Math.imul(bits ^ (bits >>> 13), 0xc2b2ae35);
        sum += value * (bits / 2 ** 31);
        square += value * value;
    }
    return { count, sum, length: Math.sqrt(square) };
}

// Rounding, as when a page normalises again, changes less. Arrays of zeros, as alpha of a rigid part, differ by count. Of
// what cannot be read nothing is known.
export function isLike(one, other) {
    return !one || !other || (one.count === other.count && !(Math.abs(one.sum - other.sum) > 1e-5 * other.length));
}
