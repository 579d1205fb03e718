//% if method != "lbs"
//%   set _ = refuse("--target three: three.js blends joint matrices; use --method lbs")
//% elif lighting == "approximated"
//%   set _ = refuse("--target three: approximated lighting is three.js's own; use --lighting accurate or direct")
//% elif influences > 4
//%   set _ = refuse("--target three: three.js reads four influences per vertex, not " ~ influences ~ "; bake with --limit-influences 4")
//% elif influences < 2
//%   set _ = refuse("--target three: one influence needs no shader; use --influences 4")
//% elif decodes and not scale
//%   set _ = refuse("--target three: " ~ encoding ~ " needs the scale of the baked file; give --for BAKED_FILE")
//% endif
//% set text = text_for(reads=["snorm16", "packed8", "texcoord"], morphs="normal")
//% set names, read = [], {}
//% if assembles
//%   set renamed = {"texcoord_0": "uv", "texcoord_1": "uv1", "texcoord_2": "uv2", "texcoord_3": "uv3"}
//%   for part in assembled
//%     set own = []
//%     for name in part.names | map("lower")
//%       set _ = own.append(renamed.get(name, name))
//%     endfor
//%     set _ = names.extend(own), read.update({part.kind: "skinbake_" ~ part.name ~ "(" ~ own | join(", ") ~ ")"})
//%   endfor
//%   set names = names | unique | list
//% else
//%   for kind, name in [["alpha", sets[0].alpha_name.lower()], ["beta", sets[0].beta_name.lower()]]
//%     if not (name.startswith("_") and name.isascii() and name.isidentifier() and "__" not in name)
//%       set _ = refuse("--target three: GLSL cannot have a vertex attribute " ~ name ~ "; bake with other names")
//%     endif
//%     set _ = names.append(name), read.update({kind: "skinbake_decoded(" ~ name ~ ", " ~ scale ~ ")" if decodes else name})
//%   endfor
//% endif
//% set size = 2 if assembles else 4 if decodes else 3
//% set bones = ["boneMatX", "boneMatY", "boneMatZ", "boneMatW"][:influences]
@{ text.header }
//
@{ text.inputs }
// Here they have the names that GLTFLoader gives them: normal, skinWeight, @{ names[0] }, ...
//
// A module for three.js @{ "r152" if assembles else "r137" } or newer, its WebGLRenderer on WebGL 2. WebGPURenderer takes no GLSL. Use:
//
//     import { patchSkinnedMeshes } from './skinbake.js';
//
//     const { scene } = await new GLTFLoader().loadAsync('baked.glb');
//     patchSkinnedMeshes(scene);
//
// Under morph targets the frame follows the normal, because three.js morphs no tangents. alpha and beta stay as in
// the mesh at rest. three.js draws shadows with its own materials. If a displacementMap moves vertices along the
// normal, their shadows move along the standard normal.
@{ """// Normals point outside also where joints mirror, as those of three.js do. Its DoubleSide materials turn them
// where the winding is turned, and are lit right without --mirrored-joints.
""" if mirrored_joints }
const ATTRIBUTES = ['@{ names | join("', '") }'];
const FRAME = '@{ frame }';
//% if decodes
const SCALE = @{ scale };
//% endif
//% if assembles
const COORDINATES = '@{ pairs | map(attribute="name") | join(" ") }'; // of the file: those that are not read, too
//% endif
const KEY = `@{ text.command } ${ATTRIBUTES}@{ " ${SCALE}" if decodes }@{ " ${COORDINATES}" if assembles }`;
const PATCHED = Symbol.for('skinbake');

const DECLARATIONS = /* glsl */ `
#ifdef USE_SKINNING

//% if frame == "tangent"
#ifndef USE_TANGENT
attribute vec4 tangent;
#endif
//% endif
//% for name in names
//%   if name in ["uv1", "uv2", "uv3"]
#ifndef USE_@{ name | upper }
attribute vec2 @{ name };
#endif
//%   elif name != "uv"
attribute vec@{ size } @{ name };
//%   endif
//% endfor

@{ text.snippet | replace("\\", "\\\\") | replace("`", "\\`") | replace("${", "\\${") }

#endif
`;

// After three.js's own chunk. Its results are overwritten, so a compiler keeps nothing of it. three.js has
// M[s] = bindMatrixInverse * bone * bindMatrix; the outer two act on vectors here, which is cheaper.
const SKINNORMAL = /* glsl */ `
#ifdef USE_SKINNING
vec3 skinbakeMorphedNormal = objectNormal;
#endif
#include <skinnormal_vertex>
#ifdef USE_SKINNING
{
    vec3 p;
    {
        #include <begin_vertex>
        #include <morphtarget_vertex>
        p = transformed;
    }
    vec3 n0 = dot(normal, normal) > 0.0 ? normalize(normal) : vec3(0.0, 0.0, 1.0);
    skinbake_Frame frame = skinbake_frame(n0@{ ", tangent" if frame == "tangent" });
//% if frame == "normal"
#ifdef USE_TANGENT
    vec2 along = vec2(dot(tangent.xyz, frame.tangent), dot(tangent.xyz, frame.bitangent));
#endif
//% endif
#ifdef USE_MORPHNORMALS
    frame = skinbake_morphed_frame(frame, skinbakeMorphedNormal);
#endif
//% if lighting == "direct"
    mat4 M[@{ influences }] = mat4[@{ influences }](
        @{ bones | join(" * bindMatrix, ") } * bindMatrix);
    skinbake_Vertex v = skinbake_@{ stem }(p, frame, M, skinWeight,
        skinbake_gradients(frame, @{ read.alpha }, @{ read.beta }));
//% else
    mat3 bind = mat3(bindMatrix);
    frame.tangent = bind * frame.tangent;
    frame.bitangent = bind * frame.bitangent;
    p = (bindMatrix * vec4(p, 1.0)).xyz;
    mat4 M[@{ influences }] = mat4[@{ influences }](@{ bones | join(", ") });
    skinbake_Vertex v = skinbake_@{ stem }(p, frame, M, skinWeight,
        @{ read.alpha }, @{ read.beta });
//% endif
    // The cofactors turn t' x b' into the cross product of their images under bindMatrixInverse.
    mat3 back = mat3(bindMatrixInverse);
    mat3 cofactors = mat3(cross(back[1], back[2]), cross(back[2], back[0]), cross(back[0], back[1]));
    objectNormal = cofactors * v.normal;
//% if lighting == "direct"
    objectNormal *= determinant(back) < 0.0 ? -1.0 : 1.0;
//% elif mirrored_joints
    objectNormal *= determinant(back) * determinant(bind) < 0.0 ? -1.0 : 1.0; // v.normal heeds the joint's alone
//% endif
#ifdef USE_TANGENT
//% if frame == "tangent"
    objectTangent = back * v.tangent;
//% else
    objectTangent = back * (along.x * v.tangent + along.y * v.bitangent);
//% endif
#endif
}
#endif
`;

/**
 * Patch the materials of all skinned meshes below an object that were baked for this module; meshes without
 * the attributes keep their materials. A material that a baked mesh shares with a skinned mesh that is not
 * baked is cloned first. Doing it twice changes nothing.
 *
 * @param {Object3D} root - A scene, a model, or a mesh.
 * @returns {number} How many meshes are lit accurately now.
 */
export function patchSkinnedMeshes(root) {
    const baked = [];
    const others = new Set();
    root.traverse((mesh) => {
        if (!mesh.isSkinnedMesh) return;
        const materials = [mesh.material].flat();
        if (isBaked(mesh.geometry) && fits(mesh, materials)) baked.push(mesh);
        else materials.forEach((material) => others.add(material));
    });
    const clones = new Map();
    const accurate = (material) => {
        if (material[PATCHED] === KEY || !others.has(material)) return patchMaterial(material);
        if (!clones.has(material)) clones.set(material, patchMaterial(cloneOf(material)));
        return clones.get(material);
    };
    for (const mesh of baked) {
        mesh.material = Array.isArray(mesh.material) ? mesh.material.map(accurate) : accurate(mesh.material);
    }
    return baked.length;
}

/**
 * Patch one material: where it draws a skinned mesh, that mesh must have the baked attributes. Other meshes
 * it draws as before. An onBeforeCompile that is there already runs first.
 *
 * @param {Material} material - Any material of three.js whose vertex shader has its chunks.
 * @returns {Material} The same material.
 */
export function patchMaterial(material) {
    if (material[PATCHED] === KEY) return material;
    if (material[PATCHED] !== undefined) {
        console.warn(`skinbake: material "${material.name}" is patched already, for other choices`);
        return material;
    }
    const compile = material.onBeforeCompile;
    const cacheKey = material.customProgramCacheKey;
    material.onBeforeCompile = function (shader, renderer) {
        compile.call(this, shader, renderer);
        shader.vertexShader = withAccurateNormals(shader.vertexShader, this);
    };
    // The usual key is the text of onBeforeCompile, which is the same now for all patched materials.
    material.customProgramCacheKey = function () {
        return `${KEY} ${compile} ${cacheKey.call(this)}`;
    };
    Object.defineProperty(material, PATCHED, { value: KEY });
    material.needsUpdate = true;
    return material;
}

function withAccurateNormals(shader, material) {
    const declarations = '#include <skinning_pars_vertex>';
    const normals = '#include <skinnormal_vertex>';
    if (!shader.includes(declarations) || !shader.includes(normals)) {
        console.warn(`skinbake: ${material.type} "${material.name}" lacks ${normals}, and stays as it was`);
        return shader;
    }
    return shader
        .replace(declarations, () => `${declarations}\n${DECLARATIONS}`)
        .replace(normals, () => SKINNORMAL);
}

//% if assembles
// Texture coordinates alone tell nothing; GLTFLoader leaves the bake's metadata in userData.
function isBaked(geometry) {
    return geometry.userData.skinbake?.layout === 'texcoord';
}
//% else
function isBaked(geometry) {
    return ATTRIBUTES.some((name) => geometry.hasAttribute(name));
}
//% endif


function fits(mesh, materials) {
    const problem = problemOf(mesh.geometry);
    const served = materials.every((one) => one[PATCHED] !== undefined && one[PATCHED] !== KEY);
    if (problem && !served) console.warn(`skinbake: "${mesh.name}" stays as it was: ${problem}`);
    return !problem;
}

function problemOf(geometry) {
    const metadata = geometry.userData.skinbake ?? {}; // GLTFLoader leaves the bake's there
//% if assembles
    const coordinates = [...new Set([...metadata.alpha, ...metadata.beta])].join(' ');
    if (coordinates !== COORDINATES) return `it is stored in ${coordinates}, not in ${COORDINATES}`;
//% endif
    for (const name of ATTRIBUTES) {
        const attribute = geometry.getAttribute(name);
//% if decodes
        if (attribute?.itemSize !== 4 || !attribute.normalized) return `${name} is not a normalised VEC4 attribute`;
//% else
        if (attribute?.itemSize !== @{ size }) return `${name} is not a VEC@{ size } attribute`;
//% endif
    }
//% if decodes
    const scale = Math.fround(metadata.scale ?? SCALE);
    if (scale !== Math.fround(SCALE)) return `its scale is ${scale}, and this module is for ${SCALE}`;
//% endif
    const frame = metadata.frame ?? FRAME;
    if (frame !== FRAME) return `its frame is ${frame}, and this module is for --frame ${FRAME}`;
    for (const name of @{ "['normal', 'tangent']" if frame == "tangent" else "['normal']" }) {
        if (!geometry.hasAttribute(name)) return `it has no ${name} attribute`;
    }
    if (geometry.hasAttribute('joints_1')) return 'three.js skins by four influences, it has more';
    return '';
}

// three.js does not clone onBeforeCompile and customProgramCacheKey.
function cloneOf(material) {
    const clone = material.clone();
    clone.onBeforeCompile = material.onBeforeCompile;
    clone.customProgramCacheKey = material.customProgramCacheKey;
    return clone;
}
