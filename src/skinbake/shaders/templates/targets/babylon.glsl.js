//% if method == "dqs" and lighting != "exact"
//%   set _ = refuse("method", "use --lighting exact with --method dqs")
//% elif lighting == "direct"
//%   set _ = refuse("lighting", "its module corrects normals by the accurate algorithm only; use --lighting accurate")
//% elif lighting == "standard"
//%   set _ = refuse("lighting", "use --lighting accurate; standard lighting is Babylon.js's own")
//% elif influences > 8
//%   set _ = refuse("influences", "Babylon.js reads eight influences per vertex, not " ~ influences ~ "; bake with --limit-influences 8")
//% elif influences < 4
//%   set _ = refuse("influences", "Babylon.js always reads four or eight influences per vertex; use --influences 4")
//% endif
//% set common = {"reads": ["packed8"], "morphs": "normal", "frame": "tangent", "encoding": "packed8", "layout": "attributes", "attributes": None, "mirrored_joints": True, "normal_map": True, "method": "lbs", "lighting": "accurate", "scaled_joints": False}
//% set glsl = text_for(language="glsl", influences=8, also=["frame_normal", "morphed_tangent", "moved_frame", "moved_frame_by_normal"], **common)
//% set glsl_four = text_for(language="glsl", influences=4, **common)
//% set wgsl = text_for(language="wgsl", influences=8, also=["frame_normal", "morphed_tangent", "moved_frame", "moved_frame_by_normal"], **common)
//% set scaled = {"method": "dqs", "lighting": "exact", "scaled_joints": True}
//% set glsl_dual = text_for(language="glsl", influences=8, **dict(common, **scaled))
//% set glsl_dual_four = text_for(language="glsl", influences=4, **dict(common, **scaled))
//% set wgsl_dual = text_for(language="wgsl", influences=8, **dict(common, **scaled))
//% set wgsl_dual_four = text_for(language="wgsl", influences=4, **dict(common, **scaled))
//% set dual_parts = ["dual_quaternion", "product", "scaled_joint", "scaled_motion"]
//% set wgsl_four = text_for(language="wgsl", influences=4, **common)
// Shader text, written by skinbake @{ version }:
//     @{ command }
//
// Algorithm @{ glsl.algorithm } of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned Models",
// Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. Frame: T. Duff et al., "Building an Orthonormal
// Basis, Revisited", JCGT 6(1), 2017. Dual quaternions: the exact derivative of their blend, for joints that may scale,
// which is skinbake's own.

export const METHOD = '@{ method }';

export const GLSL = {
    CUSTOM_VERTEX_DEFINITIONS: /* glsl */ `
#if SKINBAKE > 0
attribute vec4 skinbakeAlpha0;
attribute vec4 skinbakeBeta0;
#if NUM_BONE_INFLUENCERS > 4
attribute vec4 skinbakeAlpha1;
attribute vec4 skinbakeBeta1;
#endif
uniform float skinbakeScale;

//% for name, part in glsl.parts.items() if name not in [glsl.stem, "morphed_tangent", "moved_frame", "moved_frame_by_normal", "normal_map"]
@{ part }

//% endfor
@{ glsl.parts.morphed_tangent }

#if SKINBAKE_MORPHS > 0
@{ glsl.parts.moved_frame }

@{ glsl.parts.moved_frame_by_normal }

uniform highp sampler2DArray skinbakeMorphs; // a layer for each target

// The weighted sum over the targets that move: of the numbers in the plane (0), and of those upward (1).
vec4 skinbake_morph(int part)
{
    vec4 total = vec4(0.0);
    int texel = gl_VertexID * (SKINBAKE_MORPHS > 4 ? 2 : 1) + part;
    int width = textureSize(skinbakeMorphs, 0).x;
    for (int i = 0; i < NUM_MORPH_INFLUENCERS; i++) {
        if (float(i) >= morphTargetCount) break;
        ivec3 place = ivec3(texel % width, texel / width, int(morphTargetTextureIndices[i]));
        total += morphTargetInfluences[i] * texelFetch(skinbakeMorphs, place, 0);
    }
    return total;
}
#endif

#if SKINBAKE_DUAL > 0
//% for name in dual_parts
@{ glsl_dual.parts[name] }

//% endfor
#if NUM_BONE_INFLUENCERS > 4
@{ glsl_dual.parts.dqs_scaled }
#else
@{ glsl_dual_four.parts.dqs_scaled }
#endif
#endif

#if NUM_BONE_INFLUENCERS > 4
@{ glsl.parts[glsl.stem] }
#else
@{ glsl_four.parts[glsl.stem] }
#endif

mat4 skinbake_joint(float index)
{
#ifdef BONETEXTURE
    return readMatrixFromRawSampler(boneSampler, index);
#else
    return mBones[int(index)];
#endif
}

// The world matrix of the mesh or of its instance, without the joints.
mat3 skinbake_world()
{
#ifdef INSTANCES
    mat3 instance = mat3(world0.xyz, world1.xyz, world2.xyz);
#ifdef THIN_INSTANCES
    return mat3(world) * instance;
#else
    return instance;
#endif
#else
    return mat3(world);
#endif
}

// What this matrix adds to a position.
vec3 skinbake_origin()
{
#ifdef INSTANCES
#ifdef THIN_INSTANCES
    return (world * world3).xyz;
#else
    return world3.xyz;
#endif
#else
    return world[3].xyz;
#endif
}

skinbake_Frame skinbake_rest()
{
    vec3 n0 = dot(normal, normal) > 0.0 ? normalize(normal) : vec3(0.0, 0.0, 1.0);
#if SKINBAKE > 2
    return skinbake_frame(n0, tangent);
#else
    return skinbake_frame(n0);
#endif
}

skinbake_Vertex skinbake_lit(vec3 p, skinbake_Frame frame)
{
    vec3 alpha_0 = skinbake_decoded(skinbakeAlpha0, skinbakeScale);
    vec3 beta_0 = skinbake_decoded(skinbakeBeta0, skinbakeScale);
    // Alpha and beta are for weights that sum to 1. Babylon.js does not divide them.
    vec4 weights_0 = matricesWeights;
    float total = dot(weights_0, vec4(1.0));
#if NUM_BONE_INFLUENCERS > 4
    vec4 weights_1 = matricesWeightsExtra;
    total += dot(weights_1, vec4(1.0));
    weights_1 = total > 0.0 ? weights_1 / total : vec4(0.0);
    mat4 M[8];
#else
    mat4 M[4];
#endif
    weights_0 = total > 0.0 ? weights_0 / total : vec4(1.0, 0.0, 0.0, 0.0);
//% for component in "xyzw"
    M[@{ loop.index0 }] = skinbake_joint(matricesIndices.@{ component });
//% endfor
#if NUM_BONE_INFLUENCERS > 4
//% for component in "xyzw"
    M[@{ loop.index0 + 4 }] = skinbake_joint(matricesIndicesExtra.@{ component });
//% endfor
    vec4 alpha_1 = skinbake_decoded_further(skinbakeAlpha1, skinbakeAlpha0, skinbakeScale);
    vec4 beta_1 = skinbake_decoded_further(skinbakeBeta1, skinbakeBeta0, skinbakeScale);
#endif
#if SKINBAKE_DUAL > 0
    skinbake_ScaledMotion Q[NUM_BONE_INFLUENCERS > 4 ? 8 : 4];
    for (int slot = 0; slot < M.length(); slot++) Q[slot] = skinbake_scaled_motion(M[slot]);
#if NUM_BONE_INFLUENCERS > 4
    return skinbake_dqs_scaled(p, frame, Q, weights_0, weights_1, alpha_0, alpha_1, beta_0, beta_1);
#else
    return skinbake_dqs_scaled(p, frame, Q, weights_0, alpha_0, beta_0);
#endif
#elif NUM_BONE_INFLUENCERS > 4
    return skinbake_@{ glsl.stem }(p, frame, M, weights_0, weights_1, alpha_0, alpha_1, beta_0, beta_1);
#else
    return skinbake_@{ glsl.stem }(p, frame, M, weights_0, alpha_0, beta_0);
#endif
}
#endif
`,
    // After Babylon.js's own lines, whose results are overwritten.
    CUSTOM_VERTEX_UPDATE_WORLDPOS: /* glsl */ `
#if SKINBAKE > 0
skinbake_Frame skinbakeRest = skinbake_rest();
#if SKINBAKE_MORPHS > 4
skinbake_Frame skinbakeFrame = skinbake_moved_frame(skinbakeRest, skinbake_morph(0), skinbake_morph(1).xy);
#elif SKINBAKE_MORPHS > 0
skinbake_Frame skinbakeFrame = skinbake_moved_frame_by_normal(skinbakeRest, normalUpdated, skinbake_morph(0));
#elif SKINBAKE > 2 && defined(MORPHTARGETS) && defined(MORPHTARGETS_TANGENT)
skinbake_Frame skinbakeFrame = skinbake_morphed_tangent_frame(skinbakeRest, normalUpdated, tangentUpdated.xyz);
#else
skinbake_Frame skinbakeFrame = skinbakeRest;
// By morph targets, or by code of the page.
if (normalUpdated != normal) skinbakeFrame = skinbake_morphed_frame(skinbakeRest, normalUpdated);
#endif
skinbake_Vertex skinbakeLit = skinbake_lit(positionUpdated, skinbakeFrame);
mat3 skinbakeWorld = skinbake_world();
float skinbakeSide = determinant(skinbakeWorld) < 0.0 ? -1.0 : 1.0;
mat3 skinbakeCofactors = mat3(
    cross(skinbakeWorld[1], skinbakeWorld[2]),
    cross(skinbakeWorld[2], skinbakeWorld[0]),
    cross(skinbakeWorld[0], skinbakeWorld[1]));
vNormalW = skinbakeSide * normalize(skinbakeCofactors * skinbakeLit.normal);
#if SKINBAKE_DUAL > 0
worldPos = vec4(skinbakeWorld * skinbakeLit.position + skinbake_origin(), 1.0);
vPositionW = worldPos.xyz;
#endif
#endif
`,
    CUSTOM_VERTEX_MAIN_END: /* glsl */ `
#if SKINBAKE > 0 && defined(TANGENT)
#if defined(BUMP) || defined(PARALLAX) || defined(CLEARCOAT_BUMP) || defined(ANISOTROPIC) || defined(GEOMETRY_NORMAL) || defined(GEOMETRY_COAT_NORMAL) || defined(FUZZ)
// A normal map is a relief over the surface: its slopes are carried by cofactors, as the normal is.
#if SKINBAKE > 2
float skinbakeLength = length(SKINBAKE_MORPHS > 0 ? skinbakeRest.tangent : skinbakeFrame.tangent);
vec3 skinbakeCotangent = skinbakeLength * skinbakeLit.cotangent;
vec3 skinbakeCobitangent = skinbakeLength * skinbakeLit.cobitangent;
#else
// Cofactors are linear: those of t and b follow from those of t0, b0 and n0. t may lean from n0.
vec3 skinbakeT = normalize(tangent.xyz);
vec3 skinbakeB = tangent.w * normalize(cross(skinbakeRest.normal, skinbakeT));
vec3 skinbakeCotangent = dot(skinbakeT, skinbakeRest.tangent) * skinbakeLit.cotangent
    + dot(skinbakeT, skinbakeRest.bitangent) * skinbakeLit.cobitangent
    + dot(skinbakeT, skinbakeRest.normal) * skinbakeLit.normal;
vec3 skinbakeCobitangent = dot(skinbakeB, skinbakeRest.tangent) * skinbakeLit.cotangent
    + dot(skinbakeB, skinbakeRest.bitangent) * skinbakeLit.cobitangent;
#endif
vTBN = skinbakeCofactors * mat3(skinbakeCotangent, skinbakeCobitangent, skinbakeLit.normal);
vTBN *= skinbakeSide / length(vTBN[2]);
#endif
#endif
`,
};

export const WGSL = {
    CUSTOM_VERTEX_DEFINITIONS: /* wgsl */ `
#if SKINBAKE > 0
attribute skinbakeAlpha0: vec4f;
attribute skinbakeBeta0: vec4f;
#if NUM_BONE_INFLUENCERS > 4
attribute skinbakeAlpha1: vec4f;
attribute skinbakeBeta1: vec4f;
#endif
uniform skinbakeScale: f32;

//% for name, part in wgsl.parts.items() if name not in [wgsl.stem, "morphed_tangent", "moved_frame", "moved_frame_by_normal", "frame_tangent", "frame_normal", "normal_map"]
@{ part }

//% endfor
@{ wgsl.parts.morphed_tangent }

#if SKINBAKE_MORPHS > 0
@{ wgsl.parts.moved_frame }

@{ wgsl.parts.moved_frame_by_normal }

var skinbakeMorphs: texture_2d_array<f32>;

fn skinbake_morph(part: i32) -> vec4<f32> {
    var total = vec4<f32>(0.0);
#if SKINBAKE_MORPHS > 4
    let texel = i32(vertexInputs.vertexIndex) * 2 + part;
#else
    let texel = i32(vertexInputs.vertexIndex) + part;
#endif
    let width = i32(textureDimensions(skinbakeMorphs).x);
    for (var i = 0; i < NUM_MORPH_INFLUENCERS; i = i + 1) {
        if (f32(i) >= uniforms.morphTargetCount) { break; }
        let layer = i32(uniforms.morphTargetTextureIndices[i]);
        let place = vec2<i32>(texel % width, texel / width);
        total += uniforms.morphTargetInfluences[i] * textureLoad(skinbakeMorphs, place, layer, 0);
    }
    return total;
}
#endif

#if SKINBAKE_DUAL > 0
//% for name in dual_parts
@{ wgsl_dual.parts[name] }

//% endfor
#if NUM_BONE_INFLUENCERS > 4
@{ wgsl_dual.parts.dqs_scaled }
#else
@{ wgsl_dual_four.parts.dqs_scaled }
#endif
#endif

#if SKINBAKE > 2
@{ wgsl.parts.frame_tangent }
#else
@{ wgsl.parts.frame_normal }
#endif

#if NUM_BONE_INFLUENCERS > 4
@{ wgsl.parts[wgsl.stem] }
#else
@{ wgsl_four.parts[wgsl.stem] }
#endif

fn skinbake_joint(index: f32) -> mat4x4<f32> {
#ifdef BONETEXTURE
    return readMatrixFromRawSampler(boneSampler, index);
#else
    return uniforms.mBones[i32(index)];
#endif
}

// The world matrix of the mesh or of its instance, without the joints.
fn skinbake_world() -> mat3x3<f32> {
#ifdef INSTANCES
    let instance = mat3x3<f32>(vertexInputs.world0.xyz, vertexInputs.world1.xyz, vertexInputs.world2.xyz);
#ifdef THIN_INSTANCES
#ifdef WORLD_UBO
    return skinbake_upper(mesh.world) * instance;
#else
    return skinbake_upper(uniforms.world) * instance;
#endif
#else
    return instance;
#endif
#else
#ifdef WORLD_UBO
    return skinbake_upper(mesh.world);
#else
    return skinbake_upper(uniforms.world);
#endif
#endif
}

// What this matrix adds to a position.
fn skinbake_origin() -> vec3<f32> {
#ifdef INSTANCES
#ifdef THIN_INSTANCES
#ifdef WORLD_UBO
    return (mesh.world * vertexInputs.world3).xyz;
#else
    return (uniforms.world * vertexInputs.world3).xyz;
#endif
#else
    return vertexInputs.world3.xyz;
#endif
#else
#ifdef WORLD_UBO
    return mesh.world[3].xyz;
#else
    return uniforms.world[3].xyz;
#endif
#endif
}

fn skinbake_rest() -> skinbake_Frame {
    let given = vertexInputs.normal;
    let n0 = select(vec3<f32>(0.0, 0.0, 1.0), normalize(given), dot(given, given) > 0.0);
#if SKINBAKE > 2
    return skinbake_frame(n0, vertexInputs.tangent);
#else
    return skinbake_frame(n0);
#endif
}

fn skinbake_lit(p: vec3<f32>, frame: skinbake_Frame) -> skinbake_Vertex {
    let scale = uniforms.skinbakeScale;
    let alpha_0 = skinbake_decoded(vertexInputs.skinbakeAlpha0, scale);
    let beta_0 = skinbake_decoded(vertexInputs.skinbakeBeta0, scale);
    // Alpha and beta are for weights that sum to 1. Babylon.js does not divide them.
    var weights_0 = vertexInputs.matricesWeights;
    var total = dot(weights_0, vec4<f32>(1.0));
#if NUM_BONE_INFLUENCERS > 4
    var weights_1 = vertexInputs.matricesWeightsExtra;
    total += dot(weights_1, vec4<f32>(1.0));
    weights_1 = select(vec4<f32>(0.0), weights_1 / total, total > 0.0);
    var M: array<mat4x4<f32>, 8>;
#else
    var M: array<mat4x4<f32>, 4>;
#endif
    weights_0 = select(vec4<f32>(1.0, 0.0, 0.0, 0.0), weights_0 / total, total > 0.0);
//% for component in "xyzw"
    M[@{ loop.index0 }] = skinbake_joint(vertexInputs.matricesIndices.@{ component });
//% endfor
#if NUM_BONE_INFLUENCERS > 4
//% for component in "xyzw"
    M[@{ loop.index0 + 4 }] = skinbake_joint(vertexInputs.matricesIndicesExtra.@{ component });
//% endfor
    let alpha_1 = skinbake_decoded_further(vertexInputs.skinbakeAlpha1, vertexInputs.skinbakeAlpha0, scale);
    let beta_1 = skinbake_decoded_further(vertexInputs.skinbakeBeta1, vertexInputs.skinbakeBeta0, scale);
#endif
#if SKINBAKE_DUAL > 0
#if NUM_BONE_INFLUENCERS > 4
    var Q: array<skinbake_ScaledMotion, 8>;
    for (var slot = 0; slot < 8; slot++) { Q[slot] = skinbake_scaled_motion(M[slot]); }
    return skinbake_dqs_scaled(p, frame, Q, weights_0, weights_1, alpha_0, alpha_1, beta_0, beta_1);
#else
    var Q: array<skinbake_ScaledMotion, 4>;
    for (var slot = 0; slot < 4; slot++) { Q[slot] = skinbake_scaled_motion(M[slot]); }
    return skinbake_dqs_scaled(p, frame, Q, weights_0, alpha_0, beta_0);
#endif
#else
#if NUM_BONE_INFLUENCERS > 4
    return skinbake_@{ wgsl.stem }(p, frame, M, weights_0, weights_1, alpha_0, alpha_1, beta_0, beta_1);
#else
    return skinbake_@{ wgsl.stem }(p, frame, M, weights_0, alpha_0, beta_0);
#endif
#endif
}
#endif
`,
    CUSTOM_VERTEX_UPDATE_WORLDPOS: /* wgsl */ `
#if SKINBAKE > 0
let skinbakeRest = skinbake_rest();
#if SKINBAKE_MORPHS > 4
let skinbakeFrame = skinbake_moved_frame(skinbakeRest, skinbake_morph(0), skinbake_morph(1).xy);
#elif SKINBAKE_MORPHS > 0
let skinbakeFrame = skinbake_moved_frame_by_normal(skinbakeRest, normalUpdated, skinbake_morph(0));
#elif SKINBAKE > 2 && defined(MORPHTARGETS) && defined(MORPHTARGETS_TANGENT)
let skinbakeFrame = skinbake_morphed_tangent_frame(skinbakeRest, normalUpdated, tangentUpdated.xyz);
#else
var skinbakeFrame = skinbakeRest;
if (any(normalUpdated != vertexInputs.normal)) {
    skinbakeFrame = skinbake_morphed_frame(skinbakeRest, normalUpdated);
}
#endif
let skinbakeLit = skinbake_lit(positionUpdated, skinbakeFrame);
let skinbakeWorld = skinbake_world();
var skinbakeSide = select(1.0, -1.0, determinant(skinbakeWorld) < 0.0);
let skinbakeCofactors = mat3x3<f32>(
    cross(skinbakeWorld[1], skinbakeWorld[2]),
    cross(skinbakeWorld[2], skinbakeWorld[0]),
    cross(skinbakeWorld[0], skinbakeWorld[1]));
vertexOutputs.vNormalW = skinbakeSide * normalize(skinbakeCofactors * skinbakeLit.normal);
#if SKINBAKE_DUAL > 0
worldPos = vec4f(skinbakeWorld * skinbakeLit.position + skinbake_origin(), 1.0);
vertexOutputs.vPositionW = worldPos.xyz;
#endif
#endif
`,
    CUSTOM_VERTEX_MAIN_END: /* wgsl */ `
#if SKINBAKE > 0 && defined(TANGENT)
#if defined(BUMP) || defined(PARALLAX) || defined(CLEARCOAT_BUMP) || defined(ANISOTROPIC) || defined(GEOMETRY_NORMAL) || defined(FUZZ)
#if SKINBAKE > 2
#if SKINBAKE_MORPHS > 0
let skinbakeLength = length(skinbakeRest.tangent);
#else
let skinbakeLength = length(skinbakeFrame.tangent);
#endif
let skinbakeCotangent = skinbakeLength * skinbakeLit.cotangent;
let skinbakeCobitangent = skinbakeLength * skinbakeLit.cobitangent;
#else
let skinbakeT = normalize(vertexInputs.tangent.xyz);
let skinbakeB = vertexInputs.tangent.w * normalize(cross(skinbakeRest.normal, skinbakeT));
let skinbakeCotangent = dot(skinbakeT, skinbakeRest.tangent) * skinbakeLit.cotangent
    + dot(skinbakeT, skinbakeRest.bitangent) * skinbakeLit.cobitangent
    + dot(skinbakeT, skinbakeRest.normal) * skinbakeLit.normal;
let skinbakeCobitangent = dot(skinbakeB, skinbakeRest.tangent) * skinbakeLit.cotangent
    + dot(skinbakeB, skinbakeRest.bitangent) * skinbakeLit.cobitangent;
#endif
let skinbakeSize = skinbakeSide / length(skinbakeCofactors * skinbakeLit.normal);
vertexOutputs.vTBN0 = skinbakeSize * (skinbakeCofactors * skinbakeCotangent);
vertexOutputs.vTBN1 = skinbakeSize * (skinbakeCofactors * skinbakeCobitangent);
vertexOutputs.vTBN2 = vertexOutputs.vNormalW;
#endif
#endif
`,
};

// Anisotropy and fuzz follow t' and b' themselves. They are at right angles to the cofactors in TBN.
export const GLSL_FRAGMENT = {
    '!mat3 anisoTBN=[^;]*;': /* glsl */ `
#if SKINBAKE > 0 && defined(TANGENT)
mat3 anisoTBN = mat3(normalize(cross(TBN[1], TBN[2])), normalize(cross(TBN[2], TBN[0])), normalize(TBN[2]));
#else
$0
#endif
`,
    '!vec3 fuzzTangent=normalize[^;]*;': /* glsl */ `
#if SKINBAKE > 0 && defined(TANGENT)
vec3 fuzzTangent = normalize(cross(TBN[1], TBN[2]));
#else
$0
#endif
`,
};

export const WGSL_FRAGMENT = {
    '!(?:let|var) anisoTBN[^;]*;': /* wgsl */ `
#if SKINBAKE > 0 && defined(TANGENT)
let anisoTBN = mat3x3f(normalize(cross(TBN[1], TBN[2])), normalize(cross(TBN[2], TBN[0])), normalize(TBN[2]));
#else
$0
#endif
`,
    '!var fuzzTangent[^;]*;': /* wgsl */ `
#if SKINBAKE > 0 && defined(TANGENT)
var fuzzTangent: vec3f = normalize(cross(TBN[1], TBN[2]));
#else
$0
#endif
`,
};
