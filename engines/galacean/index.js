// Accurate lighting in Galacean Engine for skinned meshes that skinbake has baked, under WebGL 2.
//
// One module serves all characters: frame, encoding, scale, layout and names come from their files. Use:
//
//     import { registerSkinbake } from 'skinbake-galacean'; // or what `skinbake shader` has written
//
//     registerSkinbake(); // once, before the first file is loaded
//
// Which renderers are lit accurately. Before each frame Galacean updates those that it will draw; then the module
// looks at the mesh of each, so that clones, other materials and other meshes need no further call.

import {
    GLTFMeshParser,
    GLTFParserType,
    Matrix,
    registerGLTFParser,
    ShaderLib,
    SkinnedMeshRenderer,
    version,
} from '@galacean/engine';
import { bakes, changedIn, loading, SkinbakeMeshParser } from './loading.js';
import { AFTER_NORMALS, AFTER_SKINNING, BEFORE_SKINNING, DECLARATIONS, METHOD } from './shaders.js';

const standard = new WeakSet(); // renderers that lighting() has switched
const drawn = new WeakSet(); // renderers
const lit = new WeakMap(); // shader data of a renderer -> its bake, or null
const told = new WeakMap(); // renderer -> messages
let installed = false;

/**
 * Load alpha and beta with every glTF file from now on. Skinned meshes that have them are lit accurately.
 *
 * @param {{ method?: 'lbs' | 'dqs' }} [options] - Linear blending, as Galacean has it, or dual quaternions.
 * @throws {Error} If the method is neither.
 */
export function registerSkinbake({ method = METHOD } = {}) {
    if (method !== 'lbs' && method !== 'dqs') throw new Error(`skinbake: method ${method} is neither lbs nor dqs`);
    loading.method = method;
    registerGLTFParser(GLTFParserType.Mesh)(SkinbakeMeshParser);
    if (installed) return;
    installed = true;
    if (!TOO_OLD) {
        // Programs without the macro RENDERER_SKINBAKE stay as they are.
        ShaderLib.common_vert += DECLARATIONS;
        ShaderLib.skinning_vert = BEFORE_SKINNING + ShaderLib.skinning_vert + AFTER_SKINNING;
        ShaderLib.normal_vert += AFTER_NORMALS;
    }
    const usual = SkinnedMeshRenderer.prototype._update;
    SkinnedMeshRenderer.prototype._update = function (...parameters) {
        light(this);
        return usual.apply(this, parameters);
    };
}

/** Load files as before. What is loaded stays as it is. */
export function unregisterSkinbake() {
    registerGLTFParser(GLTFParserType.Mesh)(GLTFMeshParser);
}

function light(renderer) {
    drawn.add(renderer);
    const { mesh, shaderData } = renderer;
    const bake = bakes.get(mesh);
    const problem = bake ? obstacle(renderer, bake) : UNKNOWN;
    if (bake && problem && problem !== SWITCHED) tell(renderer, problem);
    const wanted = problem ? null : bake;
    if (wanted?.method === 'dqs') setRoot(renderer);
    if (lit.get(shaderData) === wanted) return;
    lit.set(shaderData, wanted);
    const set = (name, value) => (value ? shaderData.enableMacro(name, value) : shaderData.disableMacro(name));
    set('RENDERER_SKINBAKE', wanted && String(wanted.frame));
    set('RENDERER_SKINBAKE_PAIRS', wanted?.isPaired && '1');
    set('RENDERER_SKINBAKE_DUAL', wanted?.method === 'dqs' && '1');
    shaderData.setFloat('renderer_SkinbakeScale', wanted?.scale ?? 0);
}

// Dual quaternions turn joints as they are seen from the parent of their root.
function setRoot({ entity, shaderData, skin }) {
    const { localMatrix } = (skin.rootBone ?? entity).transform;
    const inverse = shaderData.getMatrix('renderer_SkinbakeInverse') ?? new Matrix();
    Matrix.invert(localMatrix, inverse);
    shaderData.setMatrix('renderer_SkinbakeLocal', localMatrix);
    shaderData.setMatrix('renderer_SkinbakeInverse', inverse);
}

const UNKNOWN = 'it is not baked, or its file was loaded before registerSkinbake()';
const SWITCHED = 'lighting() has switched it';

const OLDEST = [1, 3];
const [major, minor] = version.split('.').map(Number);
const isTooOld = major < OLDEST[0] || (major === OLDEST[0] && minor < OLDEST[1]);
const TOO_OLD = isTooOld ? `Galacean ${version} is too old: this needs ${OLDEST.join('.')} or newer` : '';

// Return why a renderer is not lit accurately; empty if it may be.
function obstacle(renderer, bake) {
    if (bake.problem) return bake.problem;
    if (TOO_OLD) return TOO_OLD;
    if (standard.has(renderer)) return SWITCHED;
    if (!renderer.engine._hardwareRenderer.isWebGL2) return 'this module needs WebGL 2';
    if (!renderer.skin?.bones.length) return 'it has no skin';
    const changed = changedIn(renderer.mesh, bake);
    if (changed) return `a page has written or removed its ${changed}: its bake is for the old values`;
    const missing = shortage(renderer, bake);
    if (missing) return missing;
    for (const material of renderer.getMaterials()) {
        const isOther = passesOf(material).some((text) => !INCLUDES.every((name) => text.includes(`<${name}>`)));
        if (isOther) return `the shader "${material.shader.name}" does not include Galacean's ${INCLUDES.join(' and ')}`;
    }
    return '';
}

// Return which limit of the device the attributes of a mesh exceed, with alpha and beta; empty if none. Galacean keeps few
// targets in attributes, of which it declares as many as it serves.
function shortage({ engine, mesh }, bake) {
    const used = mesh.vertexElements.filter(({ attribute }) => ATTRIBUTES.includes(attribute)).length;
    const targets = mesh._blendShapeManager;
    const isInAttributes = mesh.blendShapeCount > 0 && !targets._useTextureMode();
    const perTarget = targets._useBlendNormal && targets._useBlendTangent ? 6 : 8;
    const count = used + (isInAttributes ? perTarget : 0) + (bake.isPaired ? 3 : 2);
    const { gl } = engine._hardwareRenderer;
    const most = gl.getParameter(gl.MAX_VERTEX_ATTRIBS);
    return count > most ? `it needs ${count} vertex attributes, and this device has ${most}` : '';
}

const ATTRIBUTES = 'POSITION NORMAL TANGENT TEXCOORD_0 TEXCOORD_1 COLOR_0 JOINTS_0 WEIGHTS_0'.split(' ');

const INCLUDES = ['common_vert', 'skinning_vert'];

// The vertex shaders that draw a material, without those of shadow maps and depths.
function passesOf(material) {
    const passes = (material?.shader.subShaders ?? []).flatMap((subShader) => subShader.passes);
    const isSeen = (pass) => (pass.getTagValue('pipelineStage') ?? 'Forward') === 'Forward';
    return passes.filter(isSeen).map((pass) => pass._vertexSource);
}

/**
 * Tell what each skinned mesh below a root was last drawn with.
 *
 * @param {Entity | Scene | Entity[]} root - An entity with all below it, a scene, or entities.
 * @returns {MeshReport[]} One entry for each skinned mesh, baked or not.
 * @throws {TypeError} If the root is none of these.
 */
export function report(root) {
    return renderersOf(root).map((renderer) => {
        const [lighting, reason] = drawnWith(renderer);
        return { renderer, lighting, reason };
    });
}

function drawnWith(renderer) {
    const bake = bakes.get(renderer.mesh);
    const problem = bake ? obstacle(renderer, bake) : UNKNOWN;
    if (problem) return ['standard', problem];
    if (!drawn.has(renderer)) return ['not drawn', 'it has not been drawn yet'];
    const isLit = renderer.getMaterials().some((material) => passesOf(material).some((text) => /normal/i.test(text)));
    return isLit ? ['accurate', ''] : ['unlit', 'its materials read no normals'];
}

/**
 * Switch the skinned meshes below a root to Galacean's own lighting, or back.
 *
 * @param {Entity | Scene | Entity[]} root - An entity with all below it, a scene, or entities.
 * @param {'standard' | 'accurate'} which - The lighting.
 * @throws {Error} If the root or the lighting is none of these.
 */
export function lighting(root, which) {
    if (which !== 'standard' && which !== 'accurate') {
        throw new Error(`skinbake: lighting ${which} is neither standard nor accurate`);
    }
    for (const renderer of renderersOf(root)) {
        if (which === 'standard') standard.add(renderer);
        else standard.delete(renderer);
    }
}

function renderersOf(root) {
    const entities = Array.isArray(root) ? root : root?.rootEntities ?? [root];
    if (!entities.every((entity) => typeof entity?.getComponentsIncludeChildren === 'function')) {
        throw new TypeError('skinbake: the root is not an entity, a scene or an array of entities');
    }
    // Galacean lists the last one first.
    const below = (entity) => entity.getComponentsIncludeChildren(SkinnedMeshRenderer, []).reverse();
    const found = entities.flatMap(below);
    return found.filter((renderer) => renderer.mesh && (renderer.skin || bakes.has(renderer.mesh)));
}

function tell(renderer, reason) {
    const messages = told.get(renderer) ?? told.set(renderer, new Set()).get(renderer);
    if (messages.has(reason)) return;
    messages.add(reason);
    console.warn(`skinbake: "${renderer.entity.name}" has Galacean's standard lighting: ${reason}`);
}
