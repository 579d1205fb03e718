//% if lighting == "standard"
//%   set _ = refuse("lighting", "standard lighting is PlayCanvas's own; use --lighting accurate or direct")
//% elif method == "dqs" and lighting != "exact"
//%   set _ = refuse("method", "use --lighting exact with --method dqs")
//% elif stem == "dqs_scaled"
//%   set _ = refuse("scaled_joints", "the code for PlayCanvas needs joints that are rigid but for one scale; leave it out, or take --method lbs")
//% elif influences > 4
//%   set _ = refuse("influences", "PlayCanvas reads four influences per vertex, not " ~ influences ~ "; bake with --limit-influences 4")
//% elif influences < 4
//%   set _ = refuse("influences", "PlayCanvas always reads four influences per vertex; use --influences 4")
//% endif
//% set blended = lighting if method == "lbs" else "accurate"
//% set mapped = blended == "accurate"
//% set common = {"morphs": "normal", "frame": "tangent", "encoding": "float32", "layout": "attributes", "attributes": None, "also": ["frame_normal"], "normal_map": mapped}
//% set lbs = text_for(language="glsl", method="lbs", lighting=blended, **common)
//% set dqs = text_for(language="glsl", method="dqs", lighting="exact", mirrored_joints=False, **common)
//% set glsl = dict(lbs.parts, **dqs.parts).items() | rejectattr(0, "equalto", "normal_map") | map(attribute=1) | join("\n\n")
//% set lbs = text_for(language="wgsl", method="lbs", lighting=blended, **common)
//% set dqs = text_for(language="wgsl", method="dqs", lighting="exact", mirrored_joints=False, **common)
//% set wgsl = dict(lbs.parts, **dqs.parts).items() | rejectattr(0, "equalto", "normal_map") | map(attribute=1) | join("\n\n")
// Shader text, written by skinbake @{ version }:
//     @{ command }
//
// Linear blending: algorithm @{ lbs.algorithm } of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient
// Lighting for Skinned Models", Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. Dual quaternions:
// algorithm 6 of skinbake, the exact derivative of their blend. Frame: T. Duff et al., "Building an Orthonormal
// Basis, Revisited", JCGT 6(1), 2017.

export const METHOD = '@{ method }';

// The chunks, after PlayCanvas's own functions of the same names, which they rename and still call.
export const GLSL = {
    skinVS: /* glsl */ `
uniform vec4 skinbakeConstants; // texels of each vertex: 2 normal, 3 tangent frame; 1 for dual quaternions
uniform highp sampler2D skinbakeData; // alpha, beta, TANGENT
uniform mat3 skinbakeStretch; // by which joints differ from rigid ones, for dual quaternions

@{ glsl }

bool skinbake_isBaked()
{
    return skinbakeConstants.x > 1.5;
}

bool skinbake_hasDualQuaternions()
{
    return skinbakeConstants.y > 0.5;
}

vec4 skinbake_datum(int index)
{
    int texel = gl_VertexID * int(skinbakeConstants.x) + index;
    int width = textureSize(skinbakeData, 0).x;
    return texelFetch(skinbakeData, ivec2(texel % width, texel / width), 0);
}

mat4 skinbake_joint(float index)
{
    vec4 x, y, z;
    getBoneMatrix(textureSize(texture_poseMap, 0).x, 3 * int(index + 0.5), x, y, z);
    return transpose(mat4(x, y, z, vec4(0.0, 0.0, 0.0, 1.0)));
}

mat4[4] skinbake_joints()
{
    return mat4[4](
        skinbake_joint(vertex_boneIndices.x), skinbake_joint(vertex_boneIndices.y),
        skinbake_joint(vertex_boneIndices.z), skinbake_joint(vertex_boneIndices.w));
}

// PlayCanvas divides positions by the sum of the weights.
vec4 skinbake_weights()
{
    float sum = dot(vertex_boneWeights, vec4(1.0));
    return sum > 0.0 ? vertex_boneWeights / sum : vec4(1.0, 0.0, 0.0, 0.0);
}

// Each joint is L Q X: Q is rigid, L and X are common to all joints. X is the uniform, up to a rotation and a scale.
// The joints relative to the first one, X M[0]^-1 M[i] X^-1, are rigid too. L is not needed.
struct skinbake_Relation
{
    mat3 stretch; // X
    mat3 outer; // M[0] X^-1, without its translation
    mat2x4 motions[4];
};

skinbake_Relation skinbake_related(mat4 M[4])
{
    skinbake_Relation found;
    found.stretch = skinbakeStretch;
    mat3 unstretched = inverse(found.stretch);
    found.outer = mat3(M[0]) * unstretched;
    mat3 inner = inverse(found.outer);
    for (int i = 0; i < 4; i++) {
        mat4 motion = mat4(inner * mat3(M[i]) * unstretched);
        motion[3].xyz = inner * (M[i][3].xyz - M[0][3].xyz);
        found.motions[i] = skinbake_dual_quaternion(motion);
    }
    return found;
}

// Joints undo a mirror of the mesh's node. Then they turn the cross product of tangent and bitangent round.
float skinbake_side(mat4 M[4])
{
    return determinant(mat3(M[0])) < 0.0 ? -1.0 : 1.0;
}

skinbake_Vertex skinbake_turned(vec3 p, skinbake_Frame frame, mat4 M[4], vec3 alpha, vec3 beta)
{
    skinbake_Relation joints = skinbake_related(M);
    frame.tangent = joints.stretch * frame.tangent;
    frame.bitangent = joints.stretch * frame.bitangent;
//% if mapped
    frame.normal = joints.stretch * frame.normal; // moves what is displaced along it
//% endif
    skinbake_Vertex v = skinbake_dqs_exact(
        joints.stretch * p, frame, joints.motions, skinbake_weights(), alpha, beta);
    v.position = joints.outer * v.position + M[0][3].xyz;
    v.tangent = joints.outer * v.tangent;
    v.bitangent = joints.outer * v.bitangent;
    v.normal = frame.handedness * skinbake_side(M) * cross(v.tangent, v.bitangent);
//% if mapped
    mat3 outer = joints.outer;
    mat3 cofactors = mat3(cross(outer[1], outer[2]), cross(outer[2], outer[0]), cross(outer[0], outer[1]));
    v.cotangent = skinbake_side(M) * (cofactors * v.cotangent);
    v.cobitangent = skinbake_side(M) * (cofactors * v.cobitangent);
//% endif
    return v;
}

// Relative to the first joint, dual quaternions move a vertex rigidly.
mat4 getSkinMatrix(const in vec4 indices, const in vec4 weights)
{
    if (!skinbake_isBaked() || !skinbake_hasDualQuaternions()) return skinbake_usualSkinMatrix(indices, weights);
    mat4 M[4] = skinbake_joints();
    skinbake_Relation joints = skinbake_related(M);
    skinbake_Frame frame = skinbake_Frame(vec3(0.0), vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), 1.0);
    skinbake_Vertex v = skinbake_dqs_exact(
        vec3(0.0), frame, joints.motions, skinbake_weights(), vec3(0.0), vec3(0.0));
    mat4 found = mat4(joints.outer * mat3(v.tangent, v.bitangent, v.normal) * joints.stretch);
    found[3].xyz = joints.outer * v.position + M[0][3].xyz;
    return found;
}
`,
    normalVS: /* glsl */ `
//% if mapped
#ifdef TANGENTS
varying vec2 vSkinbakeLengths;
#endif
//% endif
#if defined(SKIN) && !defined(BATCH)
//% if mapped
// For normal maps.
skinbake_Vertex skinbakeLit;
skinbake_Frame skinbakeRest;
float skinbakeUnit; // the length of t0
mat3 skinbakeCofactors;

//% endif
vec3 skinbake_normal()
{
    vec3 n0 = dot(vertex_normal, vertex_normal) > 0.0 ? normalize(vertex_normal) : vec3(0.0, 0.0, 1.0);
    skinbake_Frame rest = skinbake_frame(n0);
    if (skinbakeConstants.x > 2.5) rest = skinbake_frame(n0, skinbake_datum(2));
    skinbake_Frame frame = rest;
    vec3 local = getLocalNormal(vertex_normal); // morphed, or turned by a chunk normalCoreVS of the page
    if (local != vertex_normal) frame = skinbake_morphed_frame(rest, local);
    mat4 M[4] = skinbake_joints();
    vec3 p = getLocalPosition(vertex_position.xyz);
    vec3 alpha = skinbake_datum(0).xyz;
    vec3 beta = skinbake_datum(1).xyz;
    skinbake_Vertex v;
    if (skinbake_hasDualQuaternions()) {
        v = skinbake_turned(p, frame, M, alpha, beta);
    } else {
//% if blended == "direct"
        v = skinbake_lbs_direct(p, frame, M, skinbake_weights(), skinbake_gradients(frame, alpha, beta));
//% else
        v = skinbake_lbs_accurate(p, frame, M, skinbake_weights(), alpha, beta);
        v.normal *= skinbake_side(M);
//%   if mapped
        v.cotangent *= skinbake_side(M);
        v.cobitangent *= skinbake_side(M);
//%   endif
//% endif
    }
    mat3 world = mat3(matrix_model);
    mat3 cofactors = mat3(cross(world[1], world[2]), cross(world[2], world[0]), cross(world[0], world[1]));
    vec3 normal = normalize((cofactors * v.normal) * (determinant(world) < 0.0 ? -1.0 : 1.0));
    // PlayCanvas multiplies TANGENT by this matrix. TANGENT lies in the plane of the frame at rest.
    dNormalMatrix = world * (outerProduct(v.tangent, rest.tangent / dot(rest.tangent, rest.tangent))
            + outerProduct(v.bitangent, rest.bitangent / dot(rest.bitangent, rest.bitangent)));
#ifndef TANGENTS
    dNormalMatrix += outerProduct(normal, n0);
#endif
//% if mapped
    skinbakeLit = v;
    skinbakeRest = rest;
    skinbakeUnit = length(frame.tangent);
    skinbakeCofactors = cofactors * (determinant(world) < 0.0 ? -1.0 : 1.0);
//% endif
    return normal;
}
#endif

vec3 getNormal()
{
#if defined(SKIN) && !defined(BATCH)
    if (skinbake_isBaked()) return skinbake_normal();
#endif
    return skinbake_usualNormal();
}
`,
//% if mapped
    // A normal map is a relief over the surface: its slopes are carried by cofactors, as the normal is. Directions have
    // length 1, and their lengths over that of the normal vary beside them.
    litUserMainEndVS: /* glsl */ `
#ifdef TANGENTS
vSkinbakeLengths = vec2(1.0);
#if defined(SKIN) && !defined(BATCH)
if (skinbake_isBaked()) {
    vec3 cotangent = skinbakeUnit * skinbakeLit.cotangent;
    vec3 cobitangent = skinbakeUnit * skinbakeLit.cobitangent;
    if (skinbakeConstants.x < 2.5) {
        // Cofactors are linear: those of t and b follow from those of t0, b0 and n0. t may lean from n0.
        vec3 t = normalize(vertex_tangent.xyz);
        vec3 b = vertex_tangent.w * normalize(cross(skinbakeRest.normal, t));
        vec3 c = cotangent;
        cotangent = dot(t, skinbakeRest.tangent) * c + dot(t, skinbakeRest.bitangent) * cobitangent
            + dot(t, skinbakeRest.normal) * skinbakeLit.normal;
        cobitangent = dot(b, skinbakeRest.tangent) * c + dot(b, skinbakeRest.bitangent) * cobitangent;
    }
    vTangentW = skinbakeCofactors * cotangent;
    vBinormalW = skinbakeCofactors * cobitangent;
    vSkinbakeLengths = vec2(length(vTangentW), length(vBinormalW)) / length(skinbakeCofactors * skinbakeLit.normal);
    vTangentW = normalize(vTangentW);
    vBinormalW = normalize(vBinormalW);
}
#endif
#endif
`,
    TBNPS: /* glsl */ `
#ifdef TBN_TANGENTS
varying vec2 vSkinbakeLengths;
#endif

void getTBN(vec3 tangent, vec3 binormal, vec3 normal)
{
    skinbake_usualTBN(tangent, binormal, normal);
#ifdef TBN_TANGENTS
#ifdef LIT_GGX_SPECULAR
    // Anisotropy follows the image of TANGENT itself.
    float side = dot(cross(dTBN[0], dTBN[1]), dTBN[2]) < 0.0 ? -1.0 : 1.0;
    dTBN[0] = side * normalize(cross(dTBN[1], dTBN[2]));
    dTBN[1] = side * cross(dTBN[2], dTBN[0]);
#else
    dTBN[0] *= vSkinbakeLengths.x;
    dTBN[1] *= vSkinbakeLengths.y;
#endif
#endif
}
`,
//% endif
};

export const WGSL = {
    skinVS: /* wgsl */ `
uniform skinbakeConstants: vec4f;
uniform skinbakeStretch: mat3x3f;
var skinbakeData: texture_2d<uff>;

@{ wgsl | replace("fn skinbake_frame(n: vec3<f32>, tangent", "fn skinbake_tangent_frame(n: vec3<f32>, tangent") }

fn skinbake_isBaked() -> bool {
    return uniform.skinbakeConstants.x > 1.5;
}

fn skinbake_hasDualQuaternions() -> bool {
    return uniform.skinbakeConstants.y > 0.5;
}

fn skinbake_datum(index: i32) -> vec4f {
    let texel = i32(pcVertexIndex) * i32(uniform.skinbakeConstants.x) + index;
    let width = i32(textureDimensions(skinbakeData).x);
    return textureLoad(skinbakeData, vec2i(texel % width, texel / width), 0);
}

fn skinbake_joint(index: f32) -> mat4x4f {
    let rows = getBoneMatrix(i32(textureDimensions(texture_poseMap).x), 3 * i32(index + 0.5));
    return transpose(mat4x4f(rows.v1, rows.v2, rows.v3, vec4f(0.0, 0.0, 0.0, 1.0)));
}

fn skinbake_joints() -> array<mat4x4f, 4> {
    return array<mat4x4f, 4>(
        skinbake_joint(vertex_boneIndices.x), skinbake_joint(vertex_boneIndices.y),
        skinbake_joint(vertex_boneIndices.z), skinbake_joint(vertex_boneIndices.w));
}

fn skinbake_weights() -> vec4f {
    let sum = dot(vertex_boneWeights, vec4f(1.0));
    return select(vec4f(1.0, 0.0, 0.0, 0.0), vertex_boneWeights / sum, sum > 0.0);
}

fn skinbake_linear(M: mat4x4f) -> mat3x3f {
    return mat3x3f(M[0].xyz, M[1].xyz, M[2].xyz);
}

fn skinbake_cofactors(M: mat3x3f) -> mat3x3f {
    return mat3x3f(cross(M[1], M[2]), cross(M[2], M[0]), cross(M[0], M[1]));
}

fn skinbake_inverse(M: mat3x3f) -> mat3x3f {
    return transpose(skinbake_cofactors(M)) * (1.0 / determinant(M));
}

fn skinbake_placed(M: mat3x3f, translation: vec3f) -> mat4x4f {
    return mat4x4f(vec4f(M[0], 0.0), vec4f(M[1], 0.0), vec4f(M[2], 0.0), vec4f(translation, 1.0));
}

// As in GLSL.
struct skinbake_Relation {
    stretch: mat3x3f,
    outer: mat3x3f,
    motions: array<mat2x4f, 4>,
}

fn skinbake_related(given: array<mat4x4f, 4>) -> skinbake_Relation {
    var M = given;
    var found: skinbake_Relation;
    found.stretch = uniform.skinbakeStretch;
    let unstretched = skinbake_inverse(found.stretch);
    found.outer = skinbake_linear(M[0]) * unstretched;
    let inner = skinbake_inverse(found.outer);
    for (var i = 0; i < 4; i++) {
        let linear = inner * skinbake_linear(M[i]) * unstretched;
        let translation = inner * (M[i][3].xyz - M[0][3].xyz);
        found.motions[i] = skinbake_dual_quaternion(skinbake_placed(linear, translation));
    }
    return found;
}

fn skinbake_side(M: array<mat4x4f, 4>) -> f32 {
    return select(1.0, -1.0, determinant(skinbake_linear(M[0])) < 0.0);
}

fn skinbake_turned(
    p: vec3f, rest: skinbake_Frame, M: array<mat4x4f, 4>, alpha: vec3f, beta: vec3f
) -> skinbake_Vertex {
    let joints = skinbake_related(M);
    let tangent = joints.stretch * rest.tangent;
    let frame = skinbake_Frame(
        joints.stretch * rest.normal, tangent, joints.stretch * rest.bitangent, rest.handedness);
    var v = skinbake_dqs_exact(joints.stretch * p, frame, joints.motions, skinbake_weights(), alpha, beta);
    v.position = joints.outer * v.position + M[0][3].xyz;
    v.tangent = joints.outer * v.tangent;
    v.bitangent = joints.outer * v.bitangent;
    v.normal = rest.handedness * skinbake_side(M) * cross(v.tangent, v.bitangent);
//% if mapped
    v.cotangent = skinbake_side(M) * (skinbake_cofactors(joints.outer) * v.cotangent);
    v.cobitangent = skinbake_side(M) * (skinbake_cofactors(joints.outer) * v.cobitangent);
//% endif
    return v;
}

fn getSkinMatrix(indices: vec4f, weights: vec4f) -> mat4x4f {
    if (!skinbake_isBaked() || !skinbake_hasDualQuaternions()) { return skinbake_usualSkinMatrix(indices, weights); }
    let M = skinbake_joints();
    let joints = skinbake_related(M);
    let frame = skinbake_Frame(vec3f(0.0), vec3f(1.0, 0.0, 0.0), vec3f(0.0, 1.0, 0.0), 1.0);
    let v = skinbake_dqs_exact(vec3f(0.0), frame, joints.motions, skinbake_weights(), vec3f(0.0), vec3f(0.0));
    let linear = joints.outer * mat3x3f(v.tangent, v.bitangent, v.normal) * joints.stretch;
    return skinbake_placed(linear, joints.outer * v.position + M[0][3].xyz);
}
`,
    normalVS: /* wgsl */ `
//% if mapped
#ifdef TANGENTS
varying vSkinbakeLengths: vec2f;
#endif
//% endif
#if defined(SKIN) && !defined(BATCH)
//% if mapped
var<private> skinbakeLit: skinbake_Vertex;
var<private> skinbakeRest: skinbake_Frame;
var<private> skinbakeUnit: f32;
var<private> skinbakeCofactors: mat3x3f;

//% endif
// The matrix whose columns are a * b.x, a * b.y, a * b.z.
fn skinbake_outer(a: vec3f, b: vec3f) -> mat3x3f {
    return mat3x3f(a * b.x, a * b.y, a * b.z);
}

fn skinbake_model() -> mat4x4f {
#ifdef MESH_INSTANCE_STORAGE
    return getStoredModelMatrix();
#else
    return uniform.matrix_model;
#endif
}

fn skinbake_normal() -> vec3f {
    let n0 = select(vec3f(0.0, 0.0, 1.0), normalize(vertex_normal), dot(vertex_normal, vertex_normal) > 0.0);
    var rest = skinbake_frame(n0);
    if (uniform.skinbakeConstants.x > 2.5) { rest = skinbake_tangent_frame(n0, skinbake_datum(2)); }
    var frame = rest;
    let local = getLocalNormal(vertex_normal);
    if (any(local != vertex_normal)) { frame = skinbake_morphed_frame(rest, local); }
    let M = skinbake_joints();
    let p = getLocalPosition(vertex_position.xyz);
    let alpha = skinbake_datum(0).xyz;
    let beta = skinbake_datum(1).xyz;
    var v: skinbake_Vertex;
    if (skinbake_hasDualQuaternions()) {
        v = skinbake_turned(p, frame, M, alpha, beta);
    } else {
//% if blended == "direct"
        v = skinbake_lbs_direct(p, frame, M, skinbake_weights(), skinbake_gradients(frame, alpha, beta));
//% else
        v = skinbake_lbs_accurate(p, frame, M, skinbake_weights(), alpha, beta);
        v.normal *= skinbake_side(M);
//%   if mapped
        v.cotangent *= skinbake_side(M);
        v.cobitangent *= skinbake_side(M);
//%   endif
//% endif
    }
    let world = skinbake_linear(skinbake_model());
    let normal = normalize((skinbake_cofactors(world) * v.normal) * select(1.0, -1.0, determinant(world) < 0.0));
    dNormalMatrix = world * (skinbake_outer(v.tangent, rest.tangent / dot(rest.tangent, rest.tangent))
            + skinbake_outer(v.bitangent, rest.bitangent / dot(rest.bitangent, rest.bitangent)));
#ifndef TANGENTS
    dNormalMatrix = dNormalMatrix + skinbake_outer(normal, n0);
#endif
//% if mapped
    skinbakeLit = v;
    skinbakeRest = rest;
    skinbakeUnit = length(frame.tangent);
    skinbakeCofactors = skinbake_cofactors(world) * select(1.0, -1.0, determinant(world) < 0.0);
//% endif
    return normal;
}
#endif

fn getNormal() -> vec3f {
#if defined(SKIN) && !defined(BATCH)
    if (skinbake_isBaked()) { return skinbake_normal(); }
#endif
    return skinbake_usualNormal();
}
`,
//% if mapped
    litUserMainEndVS: /* wgsl */ `
#ifdef TANGENTS
output.vSkinbakeLengths = vec2f(1.0);
#if defined(SKIN) && !defined(BATCH)
if (skinbake_isBaked()) {
    var cotangent = skinbakeUnit * skinbakeLit.cotangent;
    var cobitangent = skinbakeUnit * skinbakeLit.cobitangent;
    if (uniform.skinbakeConstants.x < 2.5) {
        let t = normalize(vertex_tangent.xyz);
        let b = vertex_tangent.w * normalize(cross(skinbakeRest.normal, t));
        let c = cotangent;
        cotangent = dot(t, skinbakeRest.tangent) * c + dot(t, skinbakeRest.bitangent) * cobitangent
            + dot(t, skinbakeRest.normal) * skinbakeLit.normal;
        cobitangent = dot(b, skinbakeRest.tangent) * c + dot(b, skinbakeRest.bitangent) * cobitangent;
    }
    cotangent = skinbakeCofactors * cotangent;
    cobitangent = skinbakeCofactors * cobitangent;
    output.vSkinbakeLengths =
        vec2f(length(cotangent), length(cobitangent)) / length(skinbakeCofactors * skinbakeLit.normal);
    output.vTangentW = normalize(cotangent);
    output.vBinormalW = normalize(cobitangent);
}
#endif
#endif
`,
    TBNPS: /* wgsl */ `
#ifdef TBN_TANGENTS
varying vSkinbakeLengths: vec2f;
#endif

fn getTBN(tangent: vec3f, binormal: vec3f, normal: vec3f) {
    skinbake_usualTBN(tangent, binormal, normal);
#ifdef TBN_TANGENTS
#ifdef LIT_GGX_SPECULAR
    let side = select(1.0, -1.0, dot(cross(dTBN[0], dTBN[1]), dTBN[2]) < 0.0);
    let t = side * normalize(cross(dTBN[1], dTBN[2]));
    dTBN = mat3x3f(t, side * cross(dTBN[2], t), dTBN[2]);
#else
    dTBN = mat3x3f(vSkinbakeLengths.x * dTBN[0], vSkinbakeLengths.y * dTBN[1], dTBN[2]);
#endif
#endif
}
`,
//% endif
};
