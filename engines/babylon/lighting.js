// Which meshes are lit accurately. Before each frame the materials of baked meshes get a plugin.

import { VertexBuffer } from '@babylonjs/core/Buffers/buffer.js';
import { AbstractEngine } from '@babylonjs/core/Engines/abstractEngine.js';
import { Material } from '@babylonjs/core/Materials/material.js';
import { MaterialPluginBase } from '@babylonjs/core/Materials/materialPluginBase.js';
import { PushMaterial } from '@babylonjs/core/Materials/pushMaterial.js';
import { Mesh } from '@babylonjs/core/Meshes/mesh.js';
import { isLike } from './bake.js';
import { ATTRIBUTES, kindsOf, printIn, state, tell, watchBuffer } from './loading.js';
import { GLSL, GLSL_FRAGMENT, WGSL, WGSL_FRAGMENT } from './shaders.js';

const PLUGIN = 'Skinbake';
// By Babylon.js's numbers of the languages.
const HOOKS = { vertex: [GLSL, WGSL], fragment: [GLSL_FRAGMENT, WGSL_FRAGMENT] };

// What a material needs to light baked meshes. Meshes that are not baked run Babylon.js's own lines alone.
class Plugin extends MaterialPluginBase {
    constructor(material) {
        super(material, PLUGIN, 200, { SKINBAKE: 0, SKINBAKE_MORPHS: 0, SKINBAKE_DUAL: 0 }, true, false);
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
        defines.SKINBAKE_DUAL = defines.SKINBAKE && bakeOf(mesh).method === 'dqs' ? 1 : 0;
        if (defines.SKINBAKE) defines.USESPHERICALINVERTEX = false;
        const isMoved = defines.SKINBAKE && defines.MORPHTARGETS && !moveObstacle(mesh, defines);
        defines.SKINBAKE_MORPHS = isMoved ? bakeOf(mesh).morphs?.numbers ?? 0 : 0;
    }

    getAttributes(attributes, scene, mesh) {
        const { sets } = bakeOf(mesh) ?? {};
        for (let set = 0; set < (litBy(mesh) ? sets : 0); set++) attributes.push(...kindsOf(set));
    }

    getUniforms() {
        return { externalUniforms: ['skinbakeScale'] };
    }

    getSamplers(samplers) {
        samplers.push('skinbakeMorphs');
    }

    hardBindForSubMesh(buffer, scene, engine, subMesh) {
        const baked = bakeOf(subMesh.getMesh());
        if (!baked || baked.problem) return;
        subMesh.effect.setFloat('skinbakeScale', baked.scale);
        if (subMesh.materialDefines?.SKINBAKE_MORPHS) subMesh.effect.setTexture('skinbakeMorphs', baked.morphs.texture);
    }

    getCustomCode(type, language = 0) {
        return HOOKS[type]?.[language] ?? null;
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
    if (TOO_OLD) return TOO_OLD;
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

// Before 8.28 Babylon.js gives plugins no uniforms of their own (externalUniforms).
const OLDEST = [8, 28];
const [major, minor] = AbstractEngine.Version.split('.').map(Number);
const isTooOld = major < OLDEST[0] || (major === OLDEST[0] && minor < OLDEST[1]);
const TOO_OLD = isTooOld ? `Babylon.js ${AbstractEngine.Version} is too old: this needs ${OLDEST.join('.')} or newer` : '';

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
export function watch(scene) {
    const known = state.scenes.get(scene);
    if (known) return known;
    const watched = { geometries: new Set(), meshes: new Set() };
    state.scenes.set(scene, watched);
    watchMerges();
    scene.onBeforeRenderObservable.add(() => prepare(watched));
    scene.onAfterRenderObservable.add(() => watched.meshes.forEach(tellOf));
    return watched;
}

const MERGED = 'MergeMeshes() keeps no alpha and beta: merge its parts in a tool before the bake';

// A merged mesh has the attributes that Babylon.js knows.
function watchMerges() {
    if (state.isMerging) return;
    state.isMerging = true;
    for (const name of ['MergeMeshes', 'MergeMeshesAsync']) {
        const usual = Mesh[name];
        Mesh[name] = function (meshes, ...others) {
            const isLit = meshes.some((mesh) => mesh?.geometry && bakeOf(mesh)?.problem === '');
            const found = usual.call(this, meshes, ...others);
            const act = (merged) => {
                if (!isLit || !merged) return merged;
                state.geometries.set(merged.geometry, { problem: MERGED, changed: '' });
                watch(merged.getScene()).geometries.add(merged.geometry);
                tell(merged, MERGED);
                return merged;
            };
            return found instanceof Promise ? found.then(act) : act(found);
        };
    }
}

function prepare({ geometries, meshes }) {
    for (const geometry of geometries) {
        if (geometry.isDisposed()) {
            geometries.delete(geometry);
            state.geometries.get(geometry)?.morphs?.texture.dispose();
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
    const isStill = (mesh) => !mesh.computeBonesUsingShaders || state.standard.has(mesh);
    if (geometry.meshes.every(isStill)) return known.isSame;
    watchBuffer(buffer);
    known.buffer = buffer;
    known.writes = writes;
    known.isSame = Boolean(buffer) && isLike(printIn(geometry, kind), known.print);
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
        if (lighting !== 'accurate') continue;
        if (isInGeometryBuffer(mesh)) tell(mesh, GEOMETRY_BUFFER, "Babylon.js's standard lighting in its geometry buffer");
        const problem = moveObstacle(mesh, subMesh.materialDefines ?? {});
        if (problem) tell(mesh, problem, 'a frame that follows NORMAL or TANGENT under morph targets');
    }
}

// Return why morph targets do not move the frame by the numbers of the file; empty if they do, or it has none.
function moveObstacle(mesh, defines) {
    const { morphs } = bakeOf(mesh);
    if (!morphs || !defines.MORPHTARGETS) return '';
    if (!defines.MORPHTARGETS_TEXTURE) return 'Babylon.js keeps its targets in attributes, not in a texture';
    const manager = mesh.morphTargetManager;
    const isSame = (target, index) => manager.getTarget(index).getPositions() === target.getPositions();
    const isWhole = manager.numTargets === morphs.targets.length && morphs.targets.every(isSame);
    return isWhole ? '' : 'a page has added or removed targets, and the numbers are for those of the file';
}

// Its shaders are Babylon.js's alone: no material, and no plugin of one, has a part in them.
const GEOMETRY_BUFFER =
    'shadows, reflections and occlusion that read it (IblShadows, SSR, SSAO2) follow its normals. ' +
    'The prepass has the accurate ones';

function isInGeometryBuffer(mesh) {
    const { renderList } = mesh.getScene()._geometryBufferRenderer?.getGBuffer() ?? {};
    return renderList === null || Boolean(renderList?.includes(mesh));
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
