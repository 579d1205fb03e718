//% if method == "dqs" and lighting != "exact"
//%   set _ = refuse("method", "use --lighting exact with --method dqs")
//% elif lighting == "direct"
//%   set _ = refuse("lighting", "its module corrects normals by the accurate algorithm only; use --lighting accurate")
//% elif lighting == "standard"
//%   set _ = refuse("lighting", "use --lighting accurate; standard lighting is Galacean's own")
//% elif influences > 4
//%   set _ = refuse("influences", "Galacean reads four influences per vertex, not " ~ influences ~ "; bake with --limit-influences 4")
//% elif influences < 4
//%   set _ = refuse("influences", "Galacean always reads four influences per vertex; use --influences 4")
//% endif
//% set common = {"reads": ["packed8"], "morphs": "normal", "frame": "tangent", "encoding": "packed8", "layout": "attributes", "attributes": None, "mirrored_joints": True, "normal_map": True, "method": "lbs", "lighting": "accurate", "scaled_joints": False}
//% set glsl = text_for(language="glsl", influences=4, also=["frame_normal"], **common)
//% set scaled = {"method": "dqs", "lighting": "exact", "scaled_joints": True}
//% set glsl_dual = text_for(language="glsl", influences=4, **dict(common, **scaled))
// Shader text, written by skinbake @{ version }:
//     @{ command }
//
// Algorithm @{ glsl.algorithm } of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned Models",
// Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. Frame: T. Duff et al., "Building an Orthonormal
// Basis, Revisited", JCGT 6(1), 2017. Dual quaternions: the exact derivative of their blend, for joints that may scale,
// which is skinbake's own.

export const METHOD = '@{ method }';

// Macros: RENDERER_SKINBAKE is 2 in the normal frame, 3 in the tangent frame. RENDERER_SKINBAKE_PAIRS: the layout
// texcoord. RENDERER_SKINBAKE_DUAL: dual quaternions.
export const DECLARATIONS = /* glsl */ `
#if defined(RENDERER_SKINBAKE) && defined(RENDERER_HAS_SKIN)
#if defined(RENDERER_HAS_NORMAL) && !defined(MATERIAL_OMIT_NORMAL)
#define SKINBAKE_NORMALS
#endif
#if defined(SKINBAKE_NORMALS) || defined(RENDERER_SKINBAKE_DUAL)
#define SKINBAKE_ON
#ifdef RENDERER_SKINBAKE_PAIRS
attribute vec2 skinbakePair0; // alpha 1, alpha 2
attribute vec2 skinbakePair1; // alpha 3, beta 1
attribute vec2 skinbakePair2; // beta 2, beta 3
#else
attribute vec4 skinbakeAlpha;
attribute vec4 skinbakeBeta;
#endif
uniform float renderer_SkinbakeScale;
#ifdef RENDERER_SKINBAKE_DUAL
uniform mat4 renderer_SkinbakeLocal; // of the root of the skeleton
uniform mat4 renderer_SkinbakeInverse;
#endif

//% for name, part in glsl.parts.items() if name not in [glsl.stem, "normal_map"]
@{ part }

//% endfor
#ifdef RENDERER_SKINBAKE_DUAL
//% for name in ["dual_quaternion", "product", "scaled_joint", "scaled_motion", "dqs_scaled"]
@{ glsl_dual.parts[name] }

//% endfor
#else
@{ glsl.parts[glsl.stem] }
#endif

mat4 skinbake_joint(float index)
{
#ifdef RENDERER_USE_JOINT_TEXTURE
    return getJointMatrix(renderer_JointSampler, index);
#else
    return renderer_JointMatrix[int(index)];
#endif
}

skinbake_Vertex skinbake_lit(vec3 p, skinbake_Frame frame)
{
#ifdef RENDERER_SKINBAKE_PAIRS
    vec3 alpha_0 = vec3(skinbakePair0, skinbakePair1.x);
    vec3 beta_0 = vec3(skinbakePair1.y, skinbakePair2);
#else
    vec3 alpha_0 = skinbake_decoded(skinbakeAlpha, renderer_SkinbakeScale);
    vec3 beta_0 = skinbake_decoded(skinbakeBeta, renderer_SkinbakeScale);
#endif
    // Alpha and beta are for weights that sum to 1. Galacean does not divide them.
    float total = dot(WEIGHTS_0, vec4(1.0));
    vec4 weights_0 = total > 0.0 ? WEIGHTS_0 / total : vec4(1.0, 0.0, 0.0, 0.0);
    mat4 M[4];
//% for component in "xyzw"
    M[@{ loop.index0 }] = skinbake_joint(JOINTS_0.@{ component });
//% endfor
#ifdef RENDERER_SKINBAKE_DUAL
    // Galacean's joint matrices lead to the root of the skeleton, which may be scaled itself. What turns the joints,
    // as quaternions have it, is seen from its parent.
    skinbake_ScaledMotion Q[4];
    for (int slot = 0; slot < 4; slot++) Q[slot] = skinbake_scaled_motion(renderer_SkinbakeLocal * M[slot]);
    skinbake_Vertex v = skinbake_dqs_scaled(p, frame, Q, weights_0, alpha_0, beta_0);
    v.position = skinbake_moved(renderer_SkinbakeInverse, v.position);
    v.tangent = mat3(renderer_SkinbakeInverse) * v.tangent;
    v.bitangent = mat3(renderer_SkinbakeInverse) * v.bitangent;
    v.normal = v.normal * mat3(renderer_SkinbakeLocal);
    v.cotangent = v.cotangent * mat3(renderer_SkinbakeLocal);
    v.cobitangent = v.cobitangent * mat3(renderer_SkinbakeLocal);
    return v;
#else
    return skinbake_@{ glsl.stem }(p, frame, M, weights_0, alpha_0, beta_0);
#endif
}
#endif
#endif
`;

// Before and after Galacean's own lines, whose results are overwritten.
export const BEFORE_SKINNING = /* glsl */ `
#ifdef SKINBAKE_ON
vec3 skinbakePosition = position.xyz;
#ifdef SKINBAKE_NORMALS
vec3 skinbakeNormal = normal;
#endif
#endif
`;

export const AFTER_SKINNING = /* glsl */ `
#ifdef SKINBAKE_ON
#ifdef SKINBAKE_NORMALS
vec3 skinbakeUnit = dot(NORMAL, NORMAL) > 0.0 ? normalize(NORMAL) : vec3(0.0, 0.0, 1.0);
#if RENDERER_SKINBAKE > 2
skinbake_Frame skinbakeRest = skinbake_frame(skinbakeUnit, TANGENT);
#else
skinbake_Frame skinbakeRest = skinbake_frame(skinbakeUnit);
#endif
skinbake_Frame skinbakeFrame = skinbakeRest;
// By morph targets, or by code of the page.
if (skinbakeNormal != NORMAL) skinbakeFrame = skinbake_morphed_frame(skinbakeRest, skinbakeNormal);
#else
skinbake_Frame skinbakeFrame = skinbake_Frame(vec3(0.0), vec3(0.0), vec3(0.0), 1.0);
#endif
skinbake_Vertex skinbakeLit = skinbake_lit(skinbakePosition, skinbakeFrame);
#ifdef SKINBAKE_NORMALS
normal = skinbakeLit.normal;
#endif
#ifdef RENDERER_SKINBAKE_DUAL
position = vec4(skinbakeLit.position, 1.0);
#endif
#endif
`;

export const AFTER_NORMALS = /* glsl */ `
#if defined(SKINBAKE_NORMALS) && defined(RENDERER_HAS_TANGENT)
#ifdef MATERIAL_ENABLE_ANISOTROPY
// Anisotropy follows the image of TANGENT itself.
vec3 skinbakeAlong = vec3(dot(TANGENT.xyz, skinbakeRest.tangent), dot(TANGENT.xyz, skinbakeRest.bitangent), 0.0);
v_TBN[0] = normalize(mat3(renderer_ModelMat)
    * (skinbakeAlong.x * skinbakeLit.tangent + skinbakeAlong.y * skinbakeLit.bitangent));
v_TBN[1] = TANGENT.w * cross(v_normal, v_TBN[0]);
#elif defined(MATERIAL_HAS_NORMALTEXTURE) || defined(MATERIAL_HAS_CLEAR_COAT_NORMAL_TEXTURE)
// A normal map is a relief over the surface: its slopes are carried by cofactors, as the normal is.
#if RENDERER_SKINBAKE > 2
float skinbakeLength = length(skinbakeFrame.tangent);
vec3 skinbakeCotangent = skinbakeLength * skinbakeLit.cotangent;
vec3 skinbakeCobitangent = skinbakeLength * skinbakeLit.cobitangent;
#else
// Cofactors are linear: those of t and b follow from those of t0, b0 and n0. t may lean from n0.
vec3 skinbakeT = normalize(TANGENT.xyz);
vec3 skinbakeB = TANGENT.w * normalize(cross(skinbakeRest.normal, skinbakeT));
vec3 skinbakeCotangent = dot(skinbakeT, skinbakeRest.tangent) * skinbakeLit.cotangent
    + dot(skinbakeT, skinbakeRest.bitangent) * skinbakeLit.cobitangent
    + dot(skinbakeT, skinbakeRest.normal) * skinbakeLit.normal;
vec3 skinbakeCobitangent = dot(skinbakeB, skinbakeRest.tangent) * skinbakeLit.cotangent
    + dot(skinbakeB, skinbakeRest.bitangent) * skinbakeLit.cobitangent;
#endif
v_TBN = mat3(renderer_NormalMat) * mat3(skinbakeCotangent, skinbakeCobitangent, skinbakeLit.normal);
v_TBN *= 1.0 / length(v_TBN[2]);
#endif
#endif
`;
