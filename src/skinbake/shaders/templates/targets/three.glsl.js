//% if lighting == "standard"
//%   set _ = refuse("lighting", "standard lighting is three.js's own; use --lighting accurate or direct")
//% elif method == "dqs" and lighting != "exact"
//%   set _ = refuse("method", "use --lighting exact with --method dqs")
//% elif stem == "dqs_scaled"
//%   set _ = refuse("scaled_joints", "the code for three.js needs joints that are rigid but for one scale; leave it out, or take --method lbs")
//% elif influences > 4
//%   set _ = refuse("influences", "three.js reads four influences per vertex, not " ~ influences ~ "; bake with --limit-influences 4")
//% elif influences < 4
//%   set _ = refuse("influences", "three.js always reads four influences per vertex; use --influences 4")
//% endif
//% set blended = lighting if method == "lbs" else "accurate"
//% set stored = {"reads": ["packed8"], "morphs": "normal", "frame": "tangent", "encoding": "packed8", "layout": "attributes", "attributes": None, "cap_as": "morphSkinbakeStorage.z"}
//% set lbs = text_for(method="lbs", lighting=blended, also=["frame_normal", "moved_frame", "moved_frame_by_normal"], cap=1 if blended == "accurate" else None, **stored)
//% set dqs = text_for(method="dqs", lighting="exact", mirrored_joints=False, normal_map=True, cap=1, **stored)
//% set free = text_for(method="dqs", lighting="exact", mirrored_joints=False, cap=None, **stored)
// Shader text, written by skinbake @{ version }:
//     @{ command }
//
// Linear blending: algorithm @{ lbs.algorithm } of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient
// Lighting for Skinned Models", Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. Dual quaternions:
// algorithm 6 of skinbake, the exact derivative of their blend. Frame: T. Duff et al., "Building an Orthonormal
// Basis, Revisited", JCGT 6(1), 2017.

export const METHOD = '@{ method }';
export const CAP = @{ number(cap) if cap is not none else "undefined" };

export const DECLARATIONS = /* glsl */ `
#if defined(USE_SKINNING) && !defined(SKINBAKE_STANDARD)
#define SKINBAKE_SKINS // a library may replace the chunk that this stands in: then the others leave three.js as it is

attribute vec4 morphSkinbakeAlpha;
attribute vec4 morphSkinbakeBeta;
attribute vec4 morphSkinbakeTangent;
attribute vec4 morphSkinbakeStorage; // scale; frame: 2 normal, 3 tangent, and 2 more for dual quaternions; cap; row of the sheet
#ifdef SKINBAKE_SHEET
uniform highp sampler2D skinbakeSheet; // of the numbers of morph targets, for all meshes

vec4 skinbake_numbers(int texel)
{
    int width = textureSize(skinbakeSheet, 0).x;
    return texelFetch(skinbakeSheet, ivec2(texel % width, texel / width), 0);
}
#endif

bool skinbake_isBaked()
{
    return morphSkinbakeStorage.y > 1.5;
}

bool skinbake_hasTangentFrame()
{
    return (int(morphSkinbakeStorage.y) & 1) == 1;
}

bool skinbake_hasDualQuaternions()
{
    return morphSkinbakeStorage.y > 3.5;
}

@{ free.parts["derivative"] }

#ifndef SKINBAKE_CAP // then no mesh of the material has a cap, and none costs anything
#define SKINBAKE_CAPPED
#define SKINBAKE_DERIVATIVE_CAPPED
#define skinbake_capped(base, correction, cap) ((base) + (correction))

vec3 skinbake_derivative(mat2x4 b, float k, vec3 p, vec3 i, vec3 delta, vec3 t, mat2x4 db, float cap)
{
    return skinbake_derivative(b, k, p, i, delta, t, db);
}
#endif

//# First the vertex that has cotangents.
//% for name, part in dqs.parts.items() if name != "normal_map"
@{ part }

//% endfor
@{ lbs.snippet }

mat2x4 skinbake_motion(mat4 M, mat3 back, vec3 origin)
{
    mat3 turn = back * mat3(M);
    vec3 shift = back * (M[3].xyz - origin);
    return skinbake_dual_quaternion(
        mat4(vec4(turn[0], 0.0), vec4(turn[1], 0.0), vec4(turn[2], 0.0), vec4(shift, 1.0)));
}

// A parent of the skeleton may scale, shear or mirror all joints alike. The motions that inverse(M[0]) leaves are
// rigid even so. They are blended, and M[0] moves the result: for rigid joints that is the same blend.
skinbake_Vertex skinbake_turned(vec3 p, skinbake_Frame frame, mat4 M[4], vec3 alpha, vec3 beta)
{
    mat3 first = mat3(M[0]);
    mat3 back = inverse(first);
    vec3 origin = M[0][3].xyz;
    mat2x4 Q[4] = mat2x4[4](
        mat2x4(vec4(0.0, 0.0, 0.0, 1.0), vec4(0.0)), skinbake_motion(M[1], back, origin),
        skinbake_motion(M[2], back, origin), skinbake_motion(M[3], back, origin));
    skinbake_Vertex v = skinbake_dqs_exact(p, frame, Q, skinWeight, alpha, beta);
    v.position = first * v.position + origin;
    v.tangent = first * v.tangent;
    v.bitangent = first * v.bitangent;
    v.normal = frame.handedness * cross(v.tangent, v.bitangent);
#ifdef SKINBAKE_NORMAL_MAP
    mat3 cofactors = mat3(cross(first[1], first[2]), cross(first[2], first[0]), cross(first[0], first[1]));
    v.cotangent = cofactors * v.cotangent;
    v.cobitangent = cofactors * v.cobitangent;
#endif
    return v;
}

#ifdef SKINBAKE_NORMAL_MAP
// A normal of the mesh in view space, as three.js moves it, but never to the side of the back.
vec3 skinbake_viewed(vec3 n)
{
#ifdef USE_INSTANCING
    mat3 instance = mat3(instanceMatrix);
    n = instance * (n / vec3(dot(instance[0], instance[0]), dot(instance[1], instance[1]), dot(instance[2], instance[2])));
#endif
    return normalMatrix * n;
}
#endif

#endif
`;

export const BEFORE_NORMAL = /* glsl */ `
#ifdef SKINBAKE_SKINS
vec3 skinbakeMorphedNormal = objectNormal;
#ifdef SKINBAKE_NORMAL_MAP
vec3 skinbakeCotangent = vec3(0.0);
vec3 skinbakeCobitangent = vec3(0.0);
vec3 skinbakeThird = vec3(0.0); // n' = t' x b', which the other two belong to
#endif
#endif
`;

// After three.js's own chunk, whose results are overwritten. three.js has M[s] = bindMatrixInverse * bone *
// bindMatrix; the outer two act on vectors here, which is cheaper.
export const AFTER_NORMAL = /* glsl */ `
#ifdef SKINBAKE_SKINS
if (skinbake_isBaked()) {
    vec3 p;
    {
        #include <begin_vertex>
#ifdef SKINBAKE_HAS_MORPHS
        #include <morphtarget_vertex>
#endif
        p = transformed;
    }
    vec3 n0 = dot(normal, normal) > 0.0 ? normalize(normal) : vec3(0.0, 0.0, 1.0);
    skinbake_Frame rest = skinbake_frame(n0);
    if (skinbake_hasTangentFrame()) rest = skinbake_frame(n0, morphSkinbakeTangent);
    skinbake_Frame frame = rest;
#ifdef USE_TANGENT
    vec2 along = vec2(dot(tangent.xyz, rest.tangent), dot(tangent.xyz, rest.bitangent));
    if (skinbake_hasTangentFrame()) along = vec2(1.0, 0.0);
#endif
    // By morph targets, or by a hook of the page.
    bool turned = skinbakeMorphedNormal != normal;
    if (turned) frame = skinbake_morphed_frame(rest, skinbakeMorphedNormal);
    bool six = false;
#if defined(SKINBAKE_SHEET) && defined(SKINBAKE_HAS_MORPHS) && defined(USE_MORPHTARGETS)
    bool four = morphSkinbakeStorage.w < 0.0;
    vec3 unhooked = normal;
#ifdef USE_MORPHNORMALS
    {
        #include <beginnormal_vertex>
        #include <morphnormal_vertex>
        unhooked = objectNormal;
    }
#endif
    six = morphSkinbakeStorage.w > 0.0 && distance(skinbakeMorphedNormal, unhooked) <= 1e-5 * length(unhooked);
    if (four || six) {
        int first = (int(abs(morphSkinbakeStorage.w)) - 1) * textureSize(skinbakeSheet, 0).x;
        int texels = four ? 1 : 2;
        vec4 m = vec4(0.0);
        vec2 up = vec2(0.0);
        for (int i = 0; i < MORPHTARGETS_COUNT; i++) {
            float influence = morphTargetInfluences[i];
            if (influence == 0.0) continue;
            int texel = first + texels * (MORPHTARGETS_COUNT * gl_VertexID + i);
            m += influence * skinbake_numbers(texel);
            if (!four) up += influence * skinbake_numbers(texel + 1).xy;
        }
        if (four) frame = skinbake_moved_frame_by_normal(rest, skinbakeMorphedNormal, m);
        else frame = skinbake_moved_frame(rest, m, up);
    }
#endif
    skinbake_Frame moved = frame;
    mat3 bind = mat3(bindMatrix);
    moved.tangent = bind * frame.tangent;
    moved.bitangent = bind * frame.bitangent;
#ifdef SKINBAKE_NORMAL_MAP
    moved.normal = bind * frame.normal;
    // What is displaced along the normal moves as three.js moves normals.
    vec3 carried = objectNormal / max(length(skinbakeMorphedNormal), 1e-20);
    if (six) carried = (skinMatrix * vec4(frame.normal, 0.0)).xyz;
#endif
    mat4 M[4] = mat4[4](boneMatX, boneMatY, boneMatZ, boneMatW);
    vec3 q = (bindMatrix * vec4(p, 1.0)).xyz;
    vec3 alpha = skinbake_decoded(morphSkinbakeAlpha, morphSkinbakeStorage.x);
    vec3 beta = skinbake_decoded(morphSkinbakeBeta, morphSkinbakeStorage.x);
    skinbake_Vertex v;
    // The cofactors turn t' x b' into the cross product of their images under bindMatrixInverse.
    mat3 back = mat3(bindMatrixInverse);
    mat3 cofactors = mat3(cross(back[1], back[2]), cross(back[2], back[0]), cross(back[0], back[1]));
    if (skinbake_hasDualQuaternions()) {
        v = skinbake_turned(q, moved, M, alpha, beta);
        objectNormal = cofactors * v.normal;
//% if mirrored_joints
        objectNormal *= determinant(back) * determinant(mat3(M[0])) * determinant(bind) < 0.0 ? -1.0 : 1.0;
//% endif
    } else {
//% if blended == "direct"
        for (int i = 0; i < 4; i++) M[i] = M[i] * bindMatrix;
        v = skinbake_lbs_direct(p, frame, M, skinWeight, skinbake_gradients(frame, alpha, beta));
        objectNormal = cofactors * v.normal * (determinant(back) < 0.0 ? -1.0 : 1.0);
//% else
        v = skinbake_lbs_accurate(q, moved, M, skinWeight, alpha, beta);
        objectNormal = cofactors * v.normal;
//%   if mirrored_joints
        objectNormal *= determinant(back) * determinant(bind) < 0.0 ? -1.0 : 1.0; // v.normal heeds the joint's alone
//%   endif
//% endif
    }
#ifdef USE_TANGENT
    objectTangent = back * (along.x * v.tangent + along.y * v.bitangent);
#ifdef SKINBAKE_NORMAL_MAP
    vec3 image = back * v.tangent;
    vec3 other = back * v.bitangent;
    skinbakeThird = frame.handedness * cross(image, other);
    vec3 first = frame.handedness * cross(other, carried);
    vec3 second = frame.handedness * cross(carried, image);
    if (skinbake_hasDualQuaternions()) {
        first = cofactors * v.cotangent;
        second = cofactors * v.cobitangent;
    }
    if (skinbake_hasTangentFrame()) {
        skinbakeCotangent = length(rest.tangent) * first;
        skinbakeCobitangent = length(rest.tangent) * second;
    } else {
        // Cofactors are linear: those of t and b follow from those of t0, b0 and n0. t may lean from n0.
        vec3 t = normalize(tangent.xyz);
        vec3 b = tangent.w * normalize(cross(n0, t));
        skinbakeCotangent = dot(t, rest.tangent) * first + dot(t, rest.bitangent) * second + dot(t, n0) * skinbakeThird;
        skinbakeCobitangent = dot(b, rest.tangent) * first + dot(b, rest.bitangent) * second;
    }
    // The normal may be turned outside.
    float side = dot(skinbakeThird, objectNormal) < 0.0 ? -1.0 : 1.0;
    skinbakeCotangent *= side;
    skinbakeCobitangent *= side;
#endif
#endif
}
#endif
`;

export const BEFORE_POSITION = /* glsl */ `
#ifdef SKINBAKE_SKINS
vec3 skinbakeUnskinned = transformed;
#endif
`;

export const AFTER_POSITION = /* glsl */ `
#ifdef SKINBAKE_SKINS
if (skinbake_isBaked() && skinbake_hasDualQuaternions()) {
    skinbake_Frame frame = skinbake_frame(vec3(0.0, 0.0, 1.0));
    mat4 M[4] = mat4[4](boneMatX, boneMatY, boneMatZ, boneMatW);
    vec3 q = (bindMatrix * vec4(skinbakeUnskinned, 1.0)).xyz;
    transformed = (bindMatrixInverse * vec4(skinbake_turned(q, frame, M, vec3(0.0), vec3(0.0)).position, 1.0)).xyz;
}
#endif
`;

// For normal maps: directions of length 1, in place of three.js's, and their lengths over that of the normal. tbn then
// takes a texel as a relief over the surface. Meshes that are not baked have three.js's own, and 1.
export const VARYINGS = /* glsl */ `
#if defined(SKINBAKE_NORMAL_MAP) && defined(USE_TANGENT) && !defined(FLAT_SHADED) && !defined(SKINBAKE_STANDARD)
varying vec2 vSkinbakeLengths;
#endif
`;

export const AFTER_VARYINGS = /* glsl */ `
#if defined(SKINBAKE_NORMAL_MAP) && defined(USE_TANGENT) && !defined(FLAT_SHADED) && !defined(SKINBAKE_STANDARD)
vSkinbakeLengths = vec2(1.0);
#ifdef SKINBAKE_SKINS
if (skinbake_isBaked()) {
    vTangent = skinbake_viewed(skinbakeCotangent);
    vBitangent = skinbake_viewed(skinbakeCobitangent);
    vSkinbakeLengths = vec2(length(vTangent), length(vBitangent)) / length(skinbake_viewed(skinbakeThird));
    vTangent = normalize(vTangent);
    vBitangent = normalize(vBitangent);
}
#endif
#endif
`;

export const AFTER_FRAME = /* glsl */ `
#if defined(SKINBAKE_NORMAL_MAP) && defined(USE_TANGENT) && !defined(FLAT_SHADED) && !defined(SKINBAKE_STANDARD)
#if defined(USE_NORMALMAP_TANGENTSPACE) || defined(USE_CLEARCOAT_NORMALMAP) || defined(USE_ANISOTROPY)
tbn[0] *= vSkinbakeLengths.x;
tbn[1] *= vSkinbakeLengths.y;
#endif
#ifdef USE_CLEARCOAT_NORMALMAP
tbn2[0] *= vSkinbakeLengths.x;
tbn2[1] *= vSkinbakeLengths.y;
#endif
#endif
`;

// Hair and brushed metal follow t' and b' themselves.
export const AFTER_ANISOTROPY = /* glsl */ `
#if defined(SKINBAKE_NORMAL_MAP) && defined(USE_TANGENT) && !defined(FLAT_SHADED) && !defined(SKINBAKE_STANDARD)
#ifdef USE_ANISOTROPY
material.anisotropyT = normalize(cross(tbn[1], tbn[2]) * anisotropyV.x + cross(tbn[2], tbn[0]) * anisotropyV.y);
material.anisotropyB = cross(tbn[2], material.anisotropyT);
#endif
#endif
`;
