//% if lighting == "approximated"
//%   set _ = refuse("lighting", "approximated lighting is three.js's own; use --lighting accurate or direct")
//% elif method == "dqs" and lighting != "exact"
//%   set _ = refuse("method", "use --lighting exact with --method dqs")
//% elif influences > 4
//%   set _ = refuse("influences", "three.js reads four influences per vertex, not " ~ influences ~ "; bake with --limit-influences 4")
//% elif influences < 4
//%   set _ = refuse("influences", "three.js always reads four influences per vertex; use --influences 4")
//% endif
//% set blended = lighting if method == "lbs" else "accurate"
//% set lbs = text_for(reads=["packed8"], morphs="normal", frame="tangent", encoding="packed8", layout="attributes", attributes=None, method="lbs", lighting=blended, also=["frame_normal"])
//% set dqs = text_for(reads=["packed8"], morphs="normal", frame="tangent", encoding="packed8", layout="attributes", attributes=None, method="dqs", lighting="exact", mirrored_joints=False)
// Shader text, written by skinbake @{ version }:
//     @{ command }
//
// Linear blending: algorithm @{ lbs.algorithm } of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient
// Lighting for Skinned Models", Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. Dual quaternions:
// algorithm 6 of skinbake, the exact derivative of their blend. Frame: T. Duff et al., "Building an Orthonormal
// Basis, Revisited", JCGT 6(1), 2017.

export const METHOD = '@{ method }';

export const DECLARATIONS = /* glsl */ `
#if defined(USE_SKINNING) && !defined(SKINBAKE_STANDARD)

attribute vec4 morphSkinbakeAlpha;
attribute vec4 morphSkinbakeBeta;
attribute vec4 morphSkinbakeTangent;
attribute vec4 morphSkinbakeStorage; // scale; frame: 2 normal, 3 tangent; 1 for dual quaternions

bool skinbake_isBaked()
{
    return morphSkinbakeStorage.y > 1.5;
}

bool skinbake_hasTangentFrame()
{
    return morphSkinbakeStorage.y > 2.5;
}

bool skinbake_hasDualQuaternions()
{
    return morphSkinbakeStorage.z > 0.5;
}

@{ lbs.snippet }

@{ dqs.snippet }

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
    return v;
}

#endif
`;

export const BEFORE_NORMAL = /* glsl */ `
#if defined(USE_SKINNING) && !defined(SKINBAKE_STANDARD)
vec3 skinbakeMorphedNormal = objectNormal;
#endif
`;

// After three.js's own chunk, whose results are overwritten. three.js has M[s] = bindMatrixInverse * bone *
// bindMatrix; the outer two act on vectors here, which is cheaper.
export const AFTER_NORMAL = /* glsl */ `
#if defined(USE_SKINNING) && !defined(SKINBAKE_STANDARD)
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
    skinbake_Frame frame = skinbake_frame(n0);
    if (skinbake_hasTangentFrame()) frame = skinbake_frame(n0, morphSkinbakeTangent);
#ifdef USE_TANGENT
    vec2 along = vec2(dot(tangent.xyz, frame.tangent), dot(tangent.xyz, frame.bitangent));
    if (skinbake_hasTangentFrame()) along = vec2(1.0, 0.0);
#endif
    // By morph targets, or by a hook of the page.
    if (skinbakeMorphedNormal != normal) frame = skinbake_morphed_frame(frame, skinbakeMorphedNormal);
    skinbake_Frame moved = frame;
    mat3 bind = mat3(bindMatrix);
    moved.tangent = bind * frame.tangent;
    moved.bitangent = bind * frame.bitangent;
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
#endif
}
#endif
`;

export const BEFORE_POSITION = /* glsl */ `
#if defined(USE_SKINNING) && !defined(SKINBAKE_STANDARD)
vec3 skinbakeUnskinned = transformed;
#endif
`;

export const AFTER_POSITION = /* glsl */ `
#if defined(USE_SKINNING) && !defined(SKINBAKE_STANDARD)
if (skinbake_isBaked() && skinbake_hasDualQuaternions()) {
    skinbake_Frame frame = skinbake_frame(vec3(0.0, 0.0, 1.0));
    mat4 M[4] = mat4[4](boneMatX, boneMatY, boneMatZ, boneMatW);
    vec3 q = (bindMatrix * vec4(skinbakeUnskinned, 1.0)).xyz;
    transformed = (bindMatrixInverse * vec4(skinbake_turned(q, frame, M, vec3(0.0), vec3(0.0)).position, 1.0)).xyz;
}
#endif
`;
