// Which meshes are lit accurately, whatever draws them.
//
// Everything that a shader needs lies on the geometry, because a geometry survives what materials do not:
// clone(), copy(), another material, a hook that is set later, a mesh that is written anew around it.

import { changeSince, FLOAT, FRAMES, isLeft, isLike, isObject, movesOf, namesOf, NOT_BAKED, printOf, problemOf } from './bake.js';

// GLTFExporter leaves out attributes whose names begin with "morph".
export const ATTRIBUTES = ['Alpha', 'Beta', 'Tangent', 'Storage', 'Dual', 'Moved', 'Capped'].map((name) => `morphSkinbake${name}`);
export const [ALPHA, BETA, TANGENT, STORAGE, DUAL, MOVED, CAPPED] = ATTRIBUTES;
const METHODS = { lbs: 0, dqs: 2 };
const CAPS = [1e-6, 1e6]; // shaders square it in float32

// Copies of this module on one page share what they know.
export const state = (globalThis[Symbol.for('skinbake.three')] ??= {
    geometries: new WeakMap(), // geometry -> { problem, constants, arrays, unfit }
    // metadata -> { method, cap } of geometries that were asked for; undefined after dispose(). Their clones have it too.
    options: new WeakMap(),
    moves: new WeakMap(), // metadata -> how the morph targets of the mesh that first had it move the frame
    sheet: undefined, // texture of these numbers, of all geometries
    rows: new Set(), // { first, count } of the rows of the sheet that are in use
    unused: new FinalizationRegistry((rows) => state.rows.delete(rows)),
    fits: new WeakMap(), // metadata -> why the mesh that first had it does not fit it, or empty
    prints: new WeakMap(), // geometry, or metadata -> { skinbake, prints }: of its arrays when it was first seen
    meshes: new WeakMap(), // mesh -> WeakMap of material -> { program, lighting, reason, repaired }
    standard: new WeakSet(), // meshes that lighting() has switched
    disposed: new WeakSet(), // meshes that dispose() has given back, and whose geometries others may still use
    users: new WeakMap(), // geometry -> { known, meshes: WeakRefs }, of those that were asked for or drawn with it
    lit: new WeakMap(), // material (WebGLRenderer) or mesh (WebGPURenderer) -> time of its last accurate draw
    told: new WeakMap(), // mesh -> messages
    passed: new WeakSet(), // geometries that were not asked for: they are told of once
    backends: new Map(), // name -> { install, uninstall, choose, verify, renew }
    count: 0, // of geometries that are lit
    collected: new FinalizationRegistry(() => state.count--),
});

export function apply(root, options) {
    return light([root], options);
}

const left = new WeakSet(); // scenes of files that are meant to have no bake

// What GLTFLoader has loaded: it waits for what a plugin returns. The report is in userData.skinbake.
export function applyToAll(gltf, parser, options) {
    const meshes = gltf.scenes.flatMap(skinnedMeshes);
    if (isLeft(parser.json)) gltf.scenes.forEach((scene) => left.add(scene));
    meshes.forEach((mesh) => takeMetadata(mesh, parser));
    const act = () => {
        gltf.userData ??= {};
        gltf.userData.skinbake = light(gltf.scenes, options);
        return null;
    };
    const loading = meshes.map((mesh) => takeMoves(mesh, parser)).filter(Boolean);
    return loading.length ? Promise.all(loading).then(act) : act();
}

const asInFile = ({ userData }) => ({ extras: userData });

function light(roots, options) {
    const { method, cap } = options;
    if (METHODS[method] === undefined) throw new Error(`skinbake: method ${method} is neither lbs nor dqs`);
    if (cap !== undefined && !(cap >= CAPS[0] && cap <= CAPS[1])) {
        throw new Error(`skinbake: cap ${cap} is not a number from ${CAPS.join(' to ')}`);
    }
    install();
    const meshes = roots.flatMap(skinnedMeshes);
    const problems = new Map(meshes.map((mesh) => [mesh, strangeness(mesh) || takeUp(mesh, options)]));
    likeWorst(meshes, problems, options);
    for (const [mesh, problem] of problems) if (problem && problem !== NOT_BAKED) tell(mesh, problem);
    const isWanted = roots.some((root) => left.has(root)) || isLeft({ meshes: meshes.map(asInFile) });
    const isBare = meshes.length && [...problems.values()].every((problem) => problem === NOT_BAKED);
    if (isBare && !isWanted) tellOfNone(roots[0]);
    for (const root of roots) {
        root.traverse((object) => {
            // Classes of libraries that have a skeleton skin by chunks.
            if (!object.isMesh || object.isSkinnedMesh || object.skeleton || problemOfGeometry(object.geometry) === NOT_BAKED) return;
            tell(object, `three.js does not skin ${kindOf(object)}`);
        });
    }
    return meshes.map((mesh) => new MeshReport(mesh));
}

/**
 * Tell the lighting of the skinned meshes below an object. An entry stays up to date.
 *
 * @param {Object3D} root - A scene, a model, or a mesh.
 * @returns {MeshReport[]} What each skinned mesh is drawn with, baked or not.
 */
export function report(root) {
    return skinnedMeshes(root).map((mesh) => new MeshReport(mesh));
}

// Between parts of one skin in two lightings, a seam would show.
function likeWorst(meshes, problems, options) {
    const noteOf = (mesh) => mesh.geometry.userData.skinbake;
    const stale = new Map(); // skeleton -> the first mesh that does not fit its bake
    for (const mesh of meshes) {
        if (state.fits.get(noteOf(mesh)) && !stale.has(mesh.skeleton)) stale.set(mesh.skeleton, mesh);
    }
    for (const mesh of meshes) {
        const other = stale.get(mesh.skeleton);
        if (!other || problems.get(mesh)) continue;
        state.fits.set(noteOf(mesh), `"${other.name}", of the same skin, does not fit its bake: bake last`);
        forget(mesh.geometry);
        problems.set(mesh, takeUp(mesh, options));
    }
}

function takeUp(mesh, options) {
    takeOwnHooks(mesh);
    state.disposed.delete(mesh);
    use(mesh);
    const { skinbake } = mesh.geometry.userData;
    if (isObject(skinbake)) state.options.set(skinbake, options);
    const adopted = adopt(mesh.geometry, options);
    adopted.unfit?.delete(mesh);
    tellOfMoves(mesh, adopted);
    return adopted.problem;
}

/**
 * Switch the skinned meshes below an object to three.js's own lighting, or back.
 *
 * @param {Object3D} root - A scene, a model, or a mesh.
 * @param {'standard' | 'accurate'} which - The lighting.
 */
export function lighting(root, which) {
    if (which !== 'standard' && which !== 'accurate') {
        throw new Error(`skinbake: lighting ${which} is neither standard nor accurate`);
    }
    for (const mesh of skinnedMeshes(root)) {
        if (which === 'standard') state.standard.add(mesh);
        else state.standard.delete(mesh);
        // A bundle keeps the program that it was recorded with.
        mesh.traverseAncestors((group) => {
            if (group.isBundleGroup) group.needsUpdate = true;
        });
    }
}

/**
 * Undo applySkinbake for the skinned meshes below an object. Clones in a scene, which share their geometries, stay.
 *
 * @param {Object3D} root - A scene, a model, or a mesh.
 */
export function dispose(root) {
    for (const mesh of skinnedMeshes(root)) {
        state.standard.delete(mesh);
        state.meshes.delete(mesh);
        state.disposed.add(mesh);
        if (isUsedBeside(mesh)) continue;
        const { userData } = mesh.geometry;
        if (isObject(userData.skinbake)) state.options.set(userData.skinbake, undefined);
        state.passed.add(mesh.geometry);
        forget(mesh.geometry);
    }
    if (state.count > 0) return;
    for (const backend of state.backends.values()) backend.uninstall();
    state.backends.clear();
}

function use(mesh) {
    const { geometry } = mesh;
    if (!state.users.has(geometry)) state.users.set(geometry, { known: new WeakSet(), meshes: [] });
    const { known, meshes } = state.users.get(geometry);
    if (!known.has(mesh)) meshes.push(new WeakRef(mesh));
    known.add(mesh);
}

// Whether another mesh in a scene has this geometry, and was not disposed of.
function isUsedBeside({ geometry }) {
    const meshes = (state.users.get(geometry)?.meshes ?? []).map((one) => one.deref());
    return meshes.some((mesh) => mesh?.geometry === geometry && !state.disposed.has(mesh) && isInScene(mesh));
}

const isInScene = ({ parent, isScene }) => (parent ? isInScene(parent) : isScene === true);
const isSwitched = (mesh) => state.standard.has(mesh) || state.disposed.has(mesh);

// Add a renderer that this page may use. classes are those of three.js, and oldest is the first revision that will do.
export function serve(name, backend, classes, revision, oldest) {
    state.three ??= classes;
    if (Number.parseInt(revision, 10) < oldest) {
        state.backends.set(name, unserving(`three.js 0.${revision} is too old: this needs 0.${oldest} or newer`));
        return;
    }
    const other = state.backends.get(name);
    if (!other) state.backends.set(name, backend);
    else if (other.text !== backend.text) {
        console.warn('skinbake: a module with other choices is in use on this page, and this one is not');
    }
}

// A backend that leaves three.js as it is.
function unserving(reason) {
    const nothing = () => {};
    const found = { lighting: 'standard', reason };
    return { install: nothing, uninstall: nothing, choose: nothing, renew: nothing, verify: () => found };
}

// What a mesh was last drawn with. It is read from the program that drew it.
class MeshReport {
    constructor(mesh) {
        this.mesh = mesh;
    }

    get lighting() {
        return this.#found()[0];
    }

    get reason() {
        return this.#found()[1];
    }

    // 'none'; 'accurate'; 'derivatives': without TANGENT, three.js finds its frame at the pixel, from the triangles as
    // they are now; 'standard': three.js's frame, of normal and tangent alone.
    get normalMap() {
        const drawn = state.meshes.get(this.mesh) ?? new WeakMap();
        const found = materialsOf(this.mesh).map((material) => drawn.get(material)?.normalMap ?? 'none');
        if (this.lighting !== 'accurate') return found.every((one) => one === 'none') ? 'none' : 'standard';
        return ['standard', 'derivatives', 'accurate'].find((one) => found.includes(one)) ?? 'none';
    }

    #found() {
        const { geometry } = this.mesh;
        const adopted = state.geometries.get(geometry);
        const problem = strangeness(this.mesh) || (adopted ?? { problem: problemOfGeometry(geometry) }).problem;
        if (problem) return ['standard', problem];
        if (!adopted) return optionsOf(geometry) ? UNDRAWN : ['standard', NOT_ASKED];
        if (state.disposed.has(this.mesh)) return ['standard', NOT_ASKED];
        if (state.standard.has(this.mesh)) return ['standard', 'lighting() has switched it'];
        const unfit = adopted.unfit.get(this.mesh);
        if (unfit) return ['standard', unfit];
        const drawn = state.meshes.get(this.mesh) ?? new WeakMap();
        const found = materialsOf(this.mesh).map((material) => drawn.get(material));
        const standard = found.find((one) => one?.lighting === 'standard');
        if (standard) return ['standard', standard.reason];
        if (!found.length || !found.every((one) => one && one.lighting !== 'not drawn')) return UNDRAWN;
        if (found.every((one) => one.lighting === 'unlit')) return ['unlit', 'its materials read no normals'];
        return ['accurate', ''];
    }
}

const NOT_ASKED = 'applySkinbake has not been called for it';
const ASK = 'Register SkinbakePlugin wherever its file is loaded, in useGLTF.preload() too';
const UNDRAWN = ['not drawn', 'it has not been drawn yet'];

function strangeness(mesh) {
    const Mesh = Object.getPrototypeOf(state.three.SkinnedMesh);
    const Object3D = Object.getPrototypeOf(Mesh);
    if (mesh instanceof Object3D) return '';
    return "it is of another copy of three.js: let every import of 'three' find the same files";
}

function skinnedMeshes(root) {
    if (!root?.isObject3D) {
        throw new Error('skinbake: the root is not an Object3D: pass gltf.scene, not gltf');
    }
    const found = [];
    root.traverse((object) => {
        if (object.isSkinnedMesh) found.push(object);
    });
    return found;
}

// Of several materials, those that draw a group.
function materialsOf({ material, geometry }) {
    if (!Array.isArray(material)) return [material];
    const used = new Set(geometry.groups.map(({ materialIndex }) => material[materialIndex]));
    return [...used].filter((one) => one?.visible);
}

function kindOf({ isBatchedMesh, isInstancedMesh, type }) {
    return isBatchedMesh ? 'a BatchedMesh' : isInstancedMesh ? 'an InstancedMesh' : `a ${type}`;
}

// Where extras of the primitive were not an object, bake has put the metadata into those of alpha's accessor.
function takeMetadata(mesh, { json, associations }) {
    const { userData } = mesh.geometry;
    if (isObject(userData.skinbake) && Number.isInteger(userData.skinbake.version)) return;
    const { meshes, primitives = 0 } = associations.get(mesh) ?? {};
    const { attributes = {} } = json.meshes?.[meshes]?.primitives[primitives] ?? {};
    for (const accessor of Object.values(attributes)) {
        const metadata = json.accessors[accessor].extras?.skinbake;
        if (metadata) userData.skinbake = metadata;
    }
}

export const WIDTH = 2048; // texels of a row of a texture
const MOST_ROWS = 8192; // WebGPU has them everywhere, and WebGL 2 nearly so

// Load the numbers by which morph targets move the frame. Return a promise, or undefined where a file has none.
function takeMoves(mesh, parser) {
    const { meshes, primitives = 0 } = parser.associations.get(mesh) ?? {};
    const made = parser.json.meshes?.[meshes];
    const names = movesOf(parser.json, made, primitives);
    if (!names.length || !isObject(mesh.geometry.userData.skinbake)) return undefined;
    const indices = made.primitives[primitives].targets.flatMap((target) => names.map((name) => target[name]));
    const loading = Promise.all(indices.map((index) => parser.getDependency('accessor', index)));
    return loading.then((columns) => keepMoves(mesh, columns, names.length));
}

// A vertex has one texel for each target, or two: of the numbers in the plane, and of those upward.
function keepMoves({ geometry: { attributes, morphAttributes, userData } }, columns, texels) {
    const { position } = attributes;
    if (state.moves.has(userData.skinbake) || !columns.every(({ count }) => count === position.count)) return;
    const rows = { first: 0, count: Math.ceil((columns.length * position.count) / WIDTH) };
    for (const used of [...state.rows].sort((one, other) => one.first - other.first)) {
        if (used.first - rows.first >= rows.count) break;
        rows.first = used.first + used.count;
    }
    const prints = [position, ...morphAttributes.position].map(printIn);
    if (rows.first + rows.count > MOST_ROWS) {
        state.moves.set(userData.skinbake, { place: 0, prints, problem: 'no room is left for the numbers of its targets' });
        return;
    }
    const sheet = sheetOf(rows.first + rows.count);
    columns.forEach((column, index) => {
        for (let vertex = 0; vertex < position.count; vertex++) {
            const to = 4 * (WIDTH * rows.first + columns.length * vertex + index);
            for (let at = 0; at < column.itemSize; at++) sheet.image.data[to + at] = column.getComponent(vertex, at);
        }
    });
    sheet.needsUpdate = true;
    state.rows.add(rows);
    state.unused.register(userData.skinbake, rows);
    state.moves.set(userData.skinbake, { place: (texels === 1 ? -1 : 1) * (rows.first + 1), prints });
}

// Return the row of the sheet, from 1 on, where a geometry has its numbers: negative where they are four. 0 is none,
// also where a page has combined targets, or put them into another order.
function placeOf({ attributes, morphAttributes, userData }) {
    const moves = state.moves.get(userData.skinbake);
    const present = [attributes.position, ...(morphAttributes.position ?? [])];
    const isSame = (one, index) => isLike(printIn(one), moves.prints[index]);
    return moves && present.length === moves.prints.length && present.every(isSame) ? moves.place : 0;
}

// One texture for all geometries, because materials share what WebGLRenderer hands them.
export function sheetOf(rows = 1) {
    const { DataTexture, FloatType } = state.three;
    if (!state.sheet) {
        state.sheet = new DataTexture(new Float32Array(4 * WIDTH), WIDTH, 1, undefined, FloatType);
        state.sheet.clone = () => state.sheet; // three.js clones what its own materials begin with
        state.sheet.needsUpdate = true;
    }
    const { data, height } = state.sheet.image;
    if (rows > height) {
        const image = { width: WIDTH, height: Math.min(Math.max(rows, 2 * height), MOST_ROWS) };
        image.data = new Float32Array(4 * WIDTH * image.height);
        image.data.set(data);
        state.sheet.dispose();
        state.sheet.image = image;
        state.sheet.needsUpdate = true;
    }
    return state.sheet;
}

export function isBaked(geometry) {
    const adopted = state.geometries.get(geometry);
    return adopted !== undefined && !adopted.problem;
}

function isIntact({ attributes, morphAttributes }, { sources, targets, hidden, arrays }) {
    return (
        Boolean(attributes[STORAGE] ?? hidden) &&
        sources.every(([name, source]) => attributes[name] === source) &&
        targets.every((target, index) => morphAttributes.position?.[index] === target) &&
        arrays.every((one) => isAsBefore(attributes[one.name], one))
    );
}

// Alpha and beta are right for these arrays alone.
function namesOfArrays(metadata) {
    const tangent = metadata.frame === 'tangent' ? ['tangent'] : [];
    return ['position', 'normal', ...tangent, 'skinWeight', ...coordinatesOf(metadata)];
}

// Return the arrays of a geometry, and the name of one that is not as it was when it was first seen.
function takeArrays(geometry) {
    const { attributes, userData } = geometry;
    const names = namesOfArrays(userData.skinbake).filter((name) => attributes[name]);
    const found = new Map(names.map((name) => [name, printIn(attributes[name])]));
    const prints = firstPrints(geometry, found);
    const arrays = names.map((name) => {
        const attribute = attributes[name];
        return { name, attribute, version: versionOf(attribute), print: prints.get(name) };
    });
    return { arrays, changed: names.find((name) => !isLike(found.get(name), prints.get(name))) };
}

// Those of the geometry itself, or of the one that it is a copy of. Where alpha and beta differ too, a tool has made
// all arrays anew, as mergeVertices() does.
function firstPrints(geometry, found) {
    const { skinbake } = geometry.userData;
    const own = state.prints.get(geometry);
    if (own?.skinbake === skinbake) return own.prints;
    const first = state.prints.get(skinbake)?.prints;
    const isCopy = first && coordinatesOf(skinbake).every((name) => isLike(found.get(name), first.get(name)));
    const seen = { skinbake, prints: isCopy ? first : found };
    state.prints.set(geometry, seen);
    if (!first) state.prints.set(skinbake, { prints: found });
    return seen.prints;
}

// A page may write the same values anew.
function isAsBefore(attribute, one) {
    if (!attribute) return false;
    const version = versionOf(attribute);
    if (attribute === one.attribute && version === one.version) return true;
    if (!isLike(printIn(attribute), one.print)) return false;
    Object.assign(one, { attribute, version });
    return true;
}

const holderOf = (attribute) => (attribute.isInterleavedBufferAttribute ? attribute.data : attribute);
const versionOf = (attribute) => holderOf(attribute).version;

// Nothing is known of a buffer that only the GPU has. A page may have given the array away after its upload (onUpload):
// then it cannot have changed it.
function printIn(attribute) {
    const { itemSize } = attribute;
    const count = attribute.count * itemSize;
    if (attribute.isGLBufferAttribute) return { count, sum: Infinity, length: 0 };
    if (!holderOf(attribute).array) return undefined;
    return printOf(count, (index) => attribute.getComponent(Math.floor(index / itemSize), index % itemSize));
}

// Give a geometry the attributes that the shader reads.
function adopt(geometry, options) {
    const adopted = state.geometries.get(geometry);
    if (adopted && !adopted.problem) {
        // What has been changed since is put right.
        const isSame = adopted.options.method === options.method && adopted.options.cap === options.cap;
        if (isIntact(geometry, adopted) && isSame) return adopted;
        forget(geometry);
    }
    const made = madeOf(geometry, options);
    state.geometries.set(geometry, made);
    if (made.problem) withoutOurs(geometry); // A clone has them.
    else count(geometry, made);
    return made;
}

// A geometry that a page has disposed of, or lost, no longer counts. It does again when it is drawn again.
function count(geometry, adopted) {
    if (adopted.isCounted) return;
    adopted.isCounted = true;
    state.count++;
    state.collected.register(geometry, undefined, adopted);
    geometry.addEventListener('dispose', uncounted);
}

function uncounted({ target }) {
    uncount(state.geometries.get(target));
}

function uncount(adopted) {
    if (!adopted?.isCounted) return;
    adopted.isCounted = false;
    state.count--;
    state.collected.unregister(adopted);
}

function madeOf(geometry, options) {
    const metadata = geometry.userData.skinbake;
    const { attributes } = geometry;
    const problem = problemOfGeometry(geometry) || misfitOf(geometry, metadata);
    if (problem) return { problem };
    const { arrays, changed } = takeArrays(geometry);
    if (changed) return { problem: `a page has changed its attribute ${changed}: its bake is for the old values` };
    const names = coordinatesOf(metadata);
    const sources = names.map((name) => [name, attributes[name]]);
    const isOwn = metadata.layout === 'texcoord';
    const [alpha, beta] = isOwn ? ownOf(attributes, sources) : sources.map(([, source]) => source);
    define(attributes, ALPHA, alpha, isOwn);
    define(attributes, BETA, beta, isOwn);
    if (metadata.frame === 'tangent') {
        define(attributes, TANGENT, attributes.tangent, false);
        sources.push(['tangent', attributes.tangent]);
    }
    const constants = constantsOf(geometry, options);
    const storage = hasStorage(geometry, options) ? attributes[STORAGE] : storageOf(geometry, constants);
    define(attributes, STORAGE, storage, true);
    const isDual = options.method === 'dqs';
    const targets = constants[3] ? [...geometry.morphAttributes.position] : [];
    // Nothing reads these: WebGPURenderer makes other programs for geometries that have attributes of other names.
    for (const [name, isMeant] of [[DUAL, isDual], [CAPPED, options.cap], [MOVED, targets.length]]) {
        if (isMeant) define(attributes, name, storage, true);
        else delete attributes[name]; // toJSON() may have written it
    }
    const joints = isDual ? jointsOf(attributes) : [];
    return { problem: '', sources, targets, arrays, options, constants, joints, unfit: new WeakMap() };
}

const TYPES = [Int8Array, Uint8Array, Int16Array, Uint16Array]; // as glTF numbers them, from 5120 on
// What GLTFLoader calls attributes, but for those that it only puts in lower case.
const NAMES = { TEXCOORD_0: 'uv', TEXCOORD_1: 'uv1', TEXCOORD_2: 'uv2', TEXCOORD_3: 'uv3' };
const nameOf = (name) => NAMES[name] ?? name.toLowerCase();

// Return an attribute in the words of a file, by its name there.
function accessorOf({ attributes }, name) {
    const attribute = attributes[nameOf(name)];
    if (!attribute) return undefined;
    const { array } = holderOf(attribute);
    const found = TYPES.findIndex((one) => array instanceof one);
    const type = array ? `VEC${attribute.itemSize}` : 'without an array';
    const { count, normalized } = attribute;
    return { type, componentType: found < 0 ? FLOAT : 5120 + found, normalized, count };
}

function problemOfGeometry(geometry) {
    const { skinbake } = geometry.userData;
    const metadata = isObject(skinbake) && Number.isInteger(skinbake.version) ? skinbake : undefined;
    return problemOf(metadata, (name) => accessorOf(geometry, name), 'three.js', 4);
}

// Return why a mesh does not fit its bake; empty if it does, as far as the bake has noted it. A page may trim a mesh
// later: only what it first was is looked at.
function misfitOf(geometry, metadata) {
    if (!state.fits.has(metadata)) {
        const change = changeIn(geometry, metadata);
        state.fits.set(metadata, change && `a tool has changed ${change} since its bake: bake last`);
    }
    return state.fits.get(metadata);
}

function changeIn(geometry, metadata) {
    const { attributes: { position, skinIndex }, index } = geometry;
    const isAtHand = (attribute) => Boolean(attribute && holderOf(attribute).array);
    if (!isAtHand(position)) return '';
    const [min, max] = [new Array(3).fill(Infinity), new Array(3).fill(-Infinity)];
    for (let vertex = 0; vertex < position.count; vertex++) {
        for (let axis = 0; axis < 3; axis++) {
            const value = position.getComponent(vertex, axis);
            min[axis] = Math.min(min[axis], value);
            max[axis] = Math.max(max[axis], value);
        }
    }
    const jointOf = isAtHand(skinIndex) && ((vertex, slot) => skinIndex.getComponent(vertex, slot));
    const vertexOf = (corner) => index?.getX(corner) ?? corner;
    const accessor = { ...accessorOf(geometry, 'POSITION'), min, max };
    return changeSince(metadata, () => accessor, { corners: (index ?? position).count, jointOf, vertexOf });
}

// Return the indices of the joints that move a vertex, and of those in slot 0: the shader starts from them.
function jointsOf({ skinIndex, skinWeight }) {
    const joints = new Set();
    const count = skinIndex && skinWeight ? skinIndex.count : 0;
    for (let vertex = 0; vertex < count; vertex++) {
        for (let slot = 0; slot < 4; slot++) {
            const isUsed = slot === 0 || skinWeight.getComponent(vertex, slot) > 0;
            if (isUsed) joints.add(skinIndex.getComponent(vertex, slot));
        }
    }
    return [...joints];
}

// Whether a mesh with a baked geometry is drawn as three.js does. Once a pose does not suit dual quaternions, it
// stays so until applySkinbake is called again.
export function isStandard(mesh, { joints, unfit }) {
    if (isSwitched(mesh) || unfit.has(mesh)) return true;
    const bone = firstDistorted(mesh.skeleton, joints);
    if (!bone) return false;
    const rule = 'is not rigid up to one transform common to all joints, which dual quaternions need';
    const reason = `its joint "${bone.name}" ${rule}: use the method lbs`;
    unfit.set(mesh, reason);
    tell(mesh, reason);
    return true;
}

const RIGID = 2e-3; // skinbake verify has 1e-3 from the common scale, so two joints have twice that between them.

// Return the first bone whose motion is not rigid, seen from another one. Bones without extent, as of a hidden
// character, say nothing.
function firstDistorted({ bones, boneInverses }, joints) {
    const used = joints.filter((joint) => bones[joint]);
    const motion = used.length > 0 ? bones[used[0]].matrixWorld.clone() : undefined;
    const motionOf = (joint) => motion.multiplyMatrices(bones[joint].matrixWorld, boneInverses[joint]);
    const reference = used.find((joint) => motionOf(joint).determinant() !== 0);
    if (reference === undefined) return undefined;
    const back = motionOf(reference).clone().invert();
    return bones[used.find((joint) => !isRigid(motionOf(joint).premultiply(back)))];
}

function isRigid(motion) {
    const { elements } = motion;
    return (
        hasProduct(elements, 0, 0, 1) &&
        hasProduct(elements, 4, 4, 1) &&
        hasProduct(elements, 8, 8, 1) &&
        hasProduct(elements, 0, 4, 0) &&
        hasProduct(elements, 4, 8, 0) &&
        hasProduct(elements, 8, 0, 0) &&
        motion.determinant() > 0
    );
}

// Whether two columns of a matrix have a dot product.
function hasProduct(e, a, b, product) {
    return Math.abs(e[a] * e[b] + e[a + 1] * e[b + 1] + e[a + 2] * e[b + 2] - product) <= RIGID;
}

function constantsOf(geometry, { method, cap = 0 }) {
    const { encoding, scale, frame } = geometry.userData.skinbake;
    return [encoding ? scale : 1, FRAMES[frame] + METHODS[method], cap, placeOf(geometry)];
}

const FOR_ALL = 1 << 30; // instances

// Whether a geometry has the constants already, as a clone has.
function hasStorage(geometry, options) {
    const { array, meshPerAttribute } = geometry.attributes[STORAGE] ?? {};
    if (geometry.isInstancedBufferGeometry || meshPerAttribute !== FOR_ALL) return false;
    return constantsOf(geometry, options).every((value, index) => Math.fround(value) === array[index]);
}

// One element for all vertices and instances. Where the attributes say how many instances there are, one for each
// vertex: it must not say so.
function storageOf(geometry, constants) {
    const { BufferAttribute, InstancedBufferAttribute } = state.three;
    if (!geometry.isInstancedBufferGeometry) {
        return new InstancedBufferAttribute(new Float32Array(constants), 4, false, FOR_ALL);
    }
    const { count } = geometry.attributes.position;
    return new BufferAttribute(Float32Array.from({ length: 4 * count }, (_, index) => constants[index % 4]), 4);
}

// Only enumerable attributes are uploaded and cloned. Another name for the same attribute needs neither.
function define(attributes, name, value, enumerable) {
    Object.defineProperty(attributes, name, { value, enumerable, configurable: true, writable: true });
}

function forget(geometry) {
    const adopted = state.geometries.get(geometry);
    if (!adopted) return;
    state.geometries.delete(geometry);
    if (adopted.problem) return;
    uncount(adopted);
    geometry.removeEventListener('dispose', uncounted);
    adopted.image?.dispose();
    withoutOurs(geometry);
}

function withoutOurs({ attributes }) {
    for (const name of ATTRIBUTES) delete attributes[name];
}

// Return the names of the attributes that hold alpha and beta, as GLTFLoader has them.
export const coordinatesOf = (metadata) => namesOf(metadata).map(nameOf);

// Alpha and beta of the layout texcoord. A clone has them already.
function ownOf(attributes, sources) {
    return attributes[ALPHA] ? [attributes[ALPHA], attributes[BETA]] : assembled(sources);
}

// The layout texcoord has alpha 1, alpha 2 | alpha 3, beta 1 | beta 2, beta 3.
function assembled(sources) {
    const { count } = sources[0][1];
    const both = [new Float32Array(3 * count), new Float32Array(3 * count)];
    for (let vertex = 0; vertex < count; vertex++) {
        const row = sources.flatMap(([, source]) => [source.getX(vertex), source.getY(vertex)]);
        both[0].set(row.slice(0, 3), 3 * vertex);
        both[1].set(row.slice(3, 6), 3 * vertex);
    }
    return both.map((array) => new state.three.BufferAttribute(array, 3));
}

function tell(mesh, reason, what = "three.js's standard lighting") {
    const messages = state.told.get(mesh) ?? state.told.set(mesh, new Set()).get(mesh);
    if (messages.has(reason)) return;
    messages.add(reason);
    console.warn(`skinbake: "${mesh.name}" has ${what}: ${reason}`);
}

const toldOfNone = new WeakSet(); // roots

function tellOfNone(root) {
    if (toldOfNone.has(root)) return;
    toldOfNone.add(root);
    console.info(`skinbake: "${root.name}" has no bake, and three.js's standard lighting: run skinbake bake on its file`);
}

// A file with numbers has the attribute on the mesh, too. They belong to the targets as the file has them.
function tellOfMoves(mesh, { constants }) {
    const { attributes, morphAttributes, userData } = mesh.geometry;
    if (!constants || constants[3] || !attributes._skinbake_morph || !morphAttributes.position?.length) return;
    const changed = 'a page has changed its targets, and their numbers are for the old ones';
    const absent = { problem: 'only SkinbakePlugin loads the numbers of its targets, and toJSON() leaves them out' };
    const { problem = changed } = state.moves.get(userData.skinbake) ?? absent;
    tell(mesh, problem, 'a frame that follows NORMAL under morph targets');
}

function tellOfMap(mesh, { name, type, normalMapType }) {
    const why = normalMapType === 1 ? 'it is in object space' : 'the shader has none of the lines for it';
    tell(mesh, why, `three.js's own tangents for the normal map of its ${type} "${name}"`);
}

// Whether a material reads a tangent frame, and three.js gives it TANGENT.
export function framedBy({ geometry }, { normalMap, clearcoatNormalMap, anisotropy }) {
    if (!normalMap && !clearcoatNormalMap && !(anisotropy > 0)) return 'none';
    return geometry.attributes.tangent && (normalMap || anisotropy > 0) ? 'tangent' : 'derivatives';
}

function install() {
    for (const backend of state.backends.values()) backend.install();
    watch(state.three.SkinnedMesh);
}

// Watch each draw of skinned meshes, of whatever origin: gltfjsx and clone() make new ones. A module does so when it is
// imported: a page may load its file in another way, too, and then not even make a plugin.
export function watch({ prototype }) {
    if (Object.hasOwn(prototype, 'onBeforeRender')) return;
    // They stay after dispose(), because they hold what is assigned to meshes.
    for (const name of Object.keys(HOOKS)) Object.defineProperty(prototype, name, hook(name, prototype[name]));
}

const HOOKS = {
    onBeforeRender: beforeDraw,
    onAfterRender: afterDraw,
    onBeforeShadow: beforeShadow,
    onAfterShadow: afterShadow,
};
// name of a hook -> meshes whose method runs: it may call the one that was there before, or that of its class.
const running = Object.fromEntries(Object.keys(HOOKS).map((name) => [name, new WeakSet()]));
const acting = new WeakMap(); // method that acts -> name of its hook

// A method that acts, and calls what is assigned to it.
function hook(name, inherited) {
    const calling = (assigned) => {
        // A page may put back what it has read here, in every frame.
        if (acting.get(assigned) === name) return assigned;
        const method = function (...parameters) {
            if (running[name].has(this)) return assigned.apply(this, parameters);
            running[name].add(this);
            try {
                assigned.apply(this, parameters);
            } finally {
                running[name].delete(this);
            }
            return HOOKS[name].apply(this, parameters);
        };
        acting.set(method, name);
        return method;
    };
    const usual = calling(inherited);
    const assigned = new WeakMap();
    return {
        configurable: true,
        get() {
            return assigned.get(this) ?? usual;
        },
        set(value) {
            assigned.set(this, calling(value));
        },
    };
}

// A mesh may have hooks of its own from before, or from a class of its own.
function takeOwnHooks(mesh) {
    for (const name of Object.keys(HOOKS)) {
        let holder = mesh;
        while (!Object.hasOwn(holder, name)) holder = Object.getPrototypeOf(holder);
        if (!Object.getOwnPropertyDescriptor(holder, name).get) {
            Object.defineProperty(mesh, name, hook(name, mesh[name]));
        }
    }
}

function beforeDraw(renderer, scene, camera, geometry, material) {
    meet(renderer, this, geometry);
    prepare(renderer, this, geometry, material);
}

// Look whether a geometry has what the shader reads. A new one has not, and one that was changed.
function meet(renderer, mesh, geometry) {
    const adopted = state.geometries.get(geometry);
    if (adopted && !adopted.problem && state.backends.size > 0) {
        count(geometry, adopted);
        use(mesh);
    }
    // A mesh that is switched reads nothing of it.
    if (adopted && (adopted.problem || isSwitched(mesh) || isIntact(geometry, adopted))) return;
    forget(geometry);
    const options = adopted?.options ?? optionsOf(geometry);
    if (options) adoptDrawn(renderer, mesh, geometry, options);
    else meetUnasked(mesh, geometry);
    // Without alpha and beta, the shader must not take it for a baked one.
    if (!state.geometries.has(geometry)) delete geometry.attributes[STORAGE];
}

let isWaiting = false; // whether a page that has asked for nothing has drawn a baked mesh

// Such a page may still call applySkinbake after its first frame, which may be its only one.
function meetUnasked(mesh, geometry) {
    const isUsed = state.count > 0;
    if (isUsed ? state.passed.has(geometry) : state.three || isWaiting) return;
    if (isUsed) state.passed.add(geometry);
    const problem = problemOfGeometry(geometry);
    if (problem === NOT_BAKED) return;
    const act = () => tell(mesh, problem || `${NOT_ASKED}. ${ASK}`);
    if (isUsed) {
        act();
    } else {
        isWaiting = true;
        setTimeout(() => state.three || act(), SETTLED);
    }
}

// Return the options of a geometry that was asked for, or of a clone of it: also one that toJSON() has written, whose
// metadata is another object.
function optionsOf({ attributes, userData: { skinbake } }) {
    if (!isObject(skinbake) || state.backends.size === 0) return undefined;
    if (state.options.has(skinbake)) return state.options.get(skinbake);
    if (!attributes[STORAGE]) return undefined;
    return { method: attributes[DUAL] ? 'dqs' : 'lbs', cap: attributes[STORAGE].getZ(0) || undefined };
}

// WebGLRenderer does not upload attributes that come during a frame: then the next frame has them. Those of a clone
// are there. WebGPURenderer needs all in this frame.
function adoptDrawn(renderer, mesh, geometry, options) {
    const act = () => {
        const adopted = adopt(geometry, options);
        if (adopted.problem) tell(mesh, adopted.problem);
        else tellOfMoves(mesh, adopted);
    };
    if (renderer.isWebGLRenderer && !hasStorage(geometry, options)) queueMicrotask(act);
    else act();
}

function afterDraw(renderer, scene, camera, geometry, material) {
    const adopted = state.geometries.get(geometry);
    if (!adopted || adopted.problem) return;
    show(geometry, adopted);
    if (isSwitched(this) || adopted.unfit.has(this) || !isIntact(geometry, adopted)) return;
    const drawn = state.meshes.get(this) ?? state.meshes.set(this, new WeakMap()).get(this);
    const backend = state.backends.get(renderer.isWebGLRenderer ? 'webgl' : 'webgpu');
    const before = drawn.get(material);
    const found = backend?.verify(renderer, this, material, before) ?? UNSERVED;
    if (found === before) return;
    drawn.set(material, found);
    if (found.lighting === 'standard') tell(this, found.reason);
    else if (found.normalMap === 'standard') tellOfMap(this, material);
}

const UNSERVED = {
    lighting: 'standard',
    reason:
        'no module serves this renderer. WebGLRenderer needs skinbake-three, ' +
        'WebGPURenderer needs skinbake-three/webgpu',
};

// All meshes share the material of shadows, and dual quaternions move them too.
function beforeShadow(renderer, object, camera, shadowCamera, geometry, material) {
    meet(renderer, this, geometry);
    prepare(renderer, this, geometry, material);
    const adopted = state.geometries.get(geometry);
    if (renderer.isWebGLRenderer && adopted?.options?.method === 'dqs') state.backends.get('webgl')?.renew(material);
}

function afterShadow(renderer, object, camera, shadowCamera, geometry) {
    show(geometry, state.geometries.get(geometry));
}

// WebGLRenderer draws a mesh without these constants as three.js does, by either program. WebGPURenderer makes
// another program for a geometry without them: three.js's own.
function prepare(renderer, mesh, geometry, material) {
    const adopted = state.geometries.get(geometry);
    if (!adopted || adopted.problem) return;
    const { isWebGLRenderer } = renderer;
    const isOff = isWebGLRenderer ? isStandard(mesh, adopted) : isSwitched(mesh) || adopted.unfit.has(mesh);
    const isPlain = isSettled(isWebGLRenderer ? material : mesh, isOff);
    state.backends.get(isWebGLRenderer ? 'webgl' : 'webgpu')?.choose(mesh, material, isPlain);
    show(geometry, adopted);
    if (isWebGLRenderer ? isOff : isPlain) hide(geometry, adopted);
}

const SETTLED = 1000; // milliseconds

// Whether three.js's own program draws. For a second after the last accurate draw, the program of accurate lighting
// draws standard lighting too: a page that switches in each frame needs no other program in each frame. The subject
// is a material of WebGLRenderer, whose meshes share a program, or a mesh of WebGPURenderer.
function isSettled(subject, isOff) {
    if (isOff) return performance.now() - (state.lit.get(subject) ?? -Infinity) > SETTLED;
    state.lit.set(subject, performance.now());
    return false;
}

function hide(geometry, adopted) {
    adopted.hidden = geometry.attributes[STORAGE];
    delete geometry.attributes[STORAGE];
}

function show(geometry, adopted) {
    if (!adopted?.hidden) return;
    define(geometry.attributes, STORAGE, adopted.hidden, true);
    adopted.hidden = undefined;
}
