// Accurate lighting in three.js for skinned meshes that skinbake has baked. For its WebGLRenderer.
//
// One module serves all characters: frame, encoding, scale, layout and names come from the file, in
// geometry.userData.skinbake. Use:
//
//     import { SkinbakePlugin } from 'skinbake-three'; // or what `skinbake shader` has written
//
//     loader.register((parser) => new SkinbakePlugin(parser)); // GLTFLoader; or applySkinbake(scene)

import {
    BufferAttribute,
    DataTexture,
    FloatType,
    InstancedBufferAttribute,
    REVISION,
    ShaderChunk,
    ShaderLib,
    SkinnedMesh,
} from 'three';
import { apply, applyToAll, CAPPED, DUAL, framedBy, MOVED, serve, sheetOf, watch } from './core.js';
import {
    AFTER_ANISOTROPY,
    AFTER_FRAME,
    AFTER_NORMAL,
    AFTER_POSITION,
    AFTER_VARYINGS,
    BEFORE_NORMAL,
    BEFORE_POSITION,
    CAP,
    DECLARATIONS,
    METHOD,
    VARYINGS,
} from './shaders.js';

export { dispose, lighting, report } from './core.js';

/**
 * Light the baked skinned meshes below an object accurately. Meshes that are not baked stay as they are.
 * Doing it again repairs what was changed since.
 *
 * @param {Object3D} root - A scene, a model, or a mesh.
 * @param {{ method?: 'lbs' | 'dqs', cap?: number }} [options] - Linear blending, as three.js has it, or dual
 * quaternions; and the largest correction of a tangent, in parts of its length. It has no limit by default.
 * @returns {MeshReport[]} What each skinned mesh is drawn with, baked or not. It stays up to date.
 */
export function applySkinbake(root, { method = METHOD, cap = CAP } = {}) {
    serveWebGL();
    return apply(root, { method, cap });
}

/** A plugin of GLTFLoader, with the options of applySkinbake: `loader.register((parser) => new SkinbakePlugin(parser))`. */
export class SkinbakePlugin {
    constructor(parser, { method = METHOD, cap = CAP } = {}) {
        this.name = 'SKINBAKE';
        this.parser = parser;
        this.method = method;
        this.cap = cap;
    }

    // The report is in userData.skinbake of what the loader returns.
    afterRoot(gltf) {
        serveWebGL();
        return applyToAll(gltf, this.parser, this);
    }
}

const CHUNKS = {
    // A ShaderMaterial that skins may lack this one.
    morphtarget_pars_vertex: ['', '\n#define SKINBAKE_HAS_MORPHS\n'],
    skinning_pars_vertex: ['', DECLARATIONS],
    skinnormal_vertex: [BEFORE_NORMAL, AFTER_NORMAL],
    skinning_vertex: [BEFORE_POSITION, AFTER_POSITION],
    normal_pars_vertex: ['', VARYINGS],
    normal_vertex: ['', AFTER_VARYINGS],
    normal_pars_fragment: ['', VARYINGS],
    normal_fragment_begin: ['', AFTER_FRAME],
    lights_physical_fragment: ['', AFTER_ANISOTROPY],
};
const CHUNKED = Object.values(CHUNKS).join();
const usual = {};
let changes = 0;

// three.js puts its chunks together when it compiles a program, after all hooks of the material. So the hooks
// may come and go. Meshes without the constants of a bake run three.js's own lines alone.
// A library that is loaded later may replace some.
function changeChunks() {
    const missing = Object.entries(CHUNKS).filter(([name, texts]) => !texts.every((text) => ShaderChunk[name].includes(text)));
    if (!missing.length) return;
    changes++;
    for (const [name, [before, after]] of missing) {
        usual[name] = ShaderChunk[name];
        ShaderChunk[name] = `${before}${ShaderChunk[name]}${after}`;
    }
    for (const { uniforms } of Object.values(ShaderLib)) uniforms.skinbakeSheet = { value: sheetOf() };
}

function restoreChunks() {
    Object.assign(ShaderChunk, usual);
    for (const { uniforms } of Object.values(ShaderLib)) delete uniforms.skinbakeSheet;
}

// The program of a material may be from before the chunks were changed. Then this define gives it another one.
function renew(material) {
    if (material.defines?.SKINBAKE === changes) return;
    material.defines = { ...material.defines, SKINBAKE: changes };
    material.needsUpdate = true;
}

const failed = new WeakSet(); // materials whose program does not link with alpha and beta
const unmapped = new WeakSet(); // materials whose program does not link with what normal maps need

// With SKINBAKE_STANDARD, the program of a material is three.js's own. With the others, normal maps and anisotropy
// follow the surface, morph targets move the frame by their numbers, and corrections are capped. Materials that meshes
// share keep those.
function choose(mesh, material, isSettled) {
    const { defines = {}, isRawShaderMaterial, isNodeMaterial } = material;
    if (isRawShaderMaterial || isNodeMaterial) return;
    const isShadow = material.isMeshDepthMaterial || material.isMeshDistanceMaterial;
    const had = (name) => defines[name] !== undefined;
    const wanted = {
        SKINBAKE_STANDARD: isSettled || failed.has(material),
        SKINBAKE_NORMAL_MAP: !unmapped.has(material) && (had('SKINBAKE_NORMAL_MAP') || framedBy(mesh, material) === 'tangent'),
        SKINBAKE_SHEET: !isShadow && (had('SKINBAKE_SHEET') || mesh.geometry.hasAttribute(MOVED)),
        SKINBAKE_CAP: !isShadow && (had('SKINBAKE_CAP') || mesh.geometry.hasAttribute(CAPPED)),
    };
    // Of a page's own uniforms, which it may copy or write to a file, this one is no part.
    if (wanted.SKINBAKE_SHEET && material.isShaderMaterial) {
        const uniform = { value: { value: sheetOf() }, configurable: true };
        if (!material.uniforms.skinbakeSheet) Object.defineProperty(material.uniforms, 'skinbakeSheet', uniform);
    }
    const names = Object.keys(wanted);
    if (names.every((name) => wanted[name] === had(name))) return;
    const others = Object.entries(defines).filter(([name]) => !names.includes(name));
    const ours = names.filter((name) => wanted[name]).map((name) => [name, '']);
    material.defines = Object.fromEntries([...others, ...ours]);
    material.needsUpdate = true;
}

// Look whether the program takes the texels of a normal map over the surface as it is now.
function normalMapOf(renderer, mesh, material, program) {
    const frame = framedBy(mesh, material);
    if (frame !== 'tangent') return material.normalMapType === 1 && frame !== 'none' ? 'standard' : frame;
    const text = renderer.getContext().getShaderSource(program.fragmentShader) ?? '';
    return material.normalMapType !== 1 && text.includes('tbn[0] *= vSkinbakeLengths') ? 'accurate' : 'standard';
}

// Look at the program that drew a mesh: the compiler drops attributes that nothing reads.
function verifyProgram(renderer, mesh, material, before) {
    const program = renderer.properties.get(material).currentProgram;
    const isDual = mesh.geometry.hasAttribute(DUAL);
    if (before?.program === program && before.isDual === isDual) return before;
    const attributes = program?.getAttributes() ?? {};
    const found = { program, isDual, lighting: 'accurate', reason: '', repaired: before?.repaired };
    if (attributes.morphSkinbakeAlpha) {
        return { ...found, normalMap: normalMapOf(renderer, mesh, material, program) };
    }
    if (program && !Object.keys(attributes).length && !isLinked(renderer, program)) {
        if (material.defines?.SKINBAKE_NORMAL_MAP !== undefined) {
            unmapped.add(material);
            return { ...found, lighting: 'not drawn' };
        }
        failed.add(material);
    }
    if (failed.has(material)) {
        const reason = `its ${material.type} "${material.name}" does not link with alpha and beta: see the error above`;
        return { ...found, lighting: 'standard', reason };
    }
    // Dual quaternions move the positions of unlit meshes too.
    const isUpToDate = !isDual || attributes.morphSkinbakeStorage;
    if (!attributes.normal && isUpToDate) return { ...found, lighting: 'unlit' };
    if (!before?.repaired && !material.isRawShaderMaterial) {
        changeChunks();
        renew(material);
        return { ...found, lighting: 'not drawn', repaired: true };
    }
    const remedy = material.isNodeMaterial ? ": call applySkinbake of 'skinbake-three/webgpu' too" : '';
    const reason = `its ${material.type} "${material.name}" does not skin by three.js's chunks${remedy}`;
    return { ...found, lighting: 'standard', reason };
}

// A program may need more attributes than the device has.
function isLinked(renderer, { program }) {
    const context = renderer.getContext();
    return context.isContextLost() || context.getProgramParameter(program, context.LINK_STATUS);
}

function serveWebGL() {
    const backend = {
        text: CHUNKED,
        install: changeChunks,
        uninstall: restoreChunks,
        choose,
        verify: verifyProgram,
        renew,
    };
    const classes = { BufferAttribute, DataTexture, FloatType, InstancedBufferAttribute, SkinnedMesh };
    serve('webgl', backend, classes, REVISION, 160);
}

watch(SkinnedMesh);
