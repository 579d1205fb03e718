// Shader text, written by skinbake 0.1.0:
//     skinbake shader --lang glsl --method lbs --lighting accurate --influences 4 --frame normal --target three
//
// Linear blending: algorithm 3 of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient
// Lighting for Skinned Models", Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. Dual quaternions:
// algorithm 6 of skinbake, the exact derivative of their blend. Frame: T. Duff et al., "Building an Orthonormal
// Basis, Revisited", JCGT 6(1), 2017.

export const METHOD = 'lbs';
export const CAP = undefined;

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

#ifndef SKINBAKE_DERIVATIVE
#define SKINBAKE_DERIVATIVE
// The derivative of p + delta along t, if the mix b changes at the rate db. delta = k h, and i is as in the caller.
vec3 skinbake_derivative(mat2x4 b, float k, vec3 p, vec3 i, vec3 delta, vec3 t, mat2x4 db)
{
    vec3 di = b[0].w * t + db[1].xyz + cross(b[0].xyz, t) + db[0].w * p + cross(db[0].xyz, p);
    vec3 dh = b[0].w * db[1].xyz + cross(b[0].xyz, di) + cross(db[0].xyz, i)
            + db[0].w * b[1].xyz - db[1].w * b[0].xyz - b[1].w * db[0].xyz - dot(b[0], db[0]) * delta;
    return t + k * dh;
}
#endif

#ifndef SKINBAKE_CAP // then no mesh of the material has a cap, and none costs anything
#define SKINBAKE_CAPPED
#define SKINBAKE_DERIVATIVE_CAPPED
#define skinbake_capped(base, correction, cap) ((base) + (correction))

vec3 skinbake_derivative(mat2x4 b, float k, vec3 p, vec3 i, vec3 delta, vec3 t, mat2x4 db, float cap)
{
    return skinbake_derivative(b, k, p, i, delta, t, db);
}
#endif


#ifndef SKINBAKE_VERTEX
#define SKINBAKE_VERTEX
// A skinned vertex. Its vectors have any length. tangent and bitangent are the images of t0 and b0.
struct skinbake_Vertex {
    vec3 position;
    vec3 normal;
    vec3 tangent;
    vec3 bitangent;
    vec3 cotangent; // for normal maps: the cofactors of (t', b', T n0), of which normal is the third
    vec3 cobitangent;
};

// The tangent frame at rest.
struct skinbake_Frame {
    vec3 normal;
    vec3 tangent;
    vec3 bitangent;
    float handedness; // n0 = handedness * cross(t0, b0) / |t0|^2
};
#endif

#ifndef SKINBAKE_FRAME_FROM_TANGENT
#define SKINBAKE_FRAME_FROM_TANGENT
// The frame of NORMAL, which must have length 1, and TANGENT.
skinbake_Frame skinbake_frame(vec3 n, vec4 tangent)
{
    return skinbake_Frame(n, tangent.xyz, cross(n, tangent.xyz) * tangent.w, tangent.w);
}
#endif

#ifndef SKINBAKE_DECODED
#define SKINBAKE_DECODED
// alpha or beta of slots 1 to 3, from set 0. xyz are relative to the scale of the vertex. w is the square root of
// that scale, relative to the scale of the file.
vec3 skinbake_decoded(vec4 stored, float scale)
{
    return (scale * stored.w * stored.w) * stored.xyz;
}
#endif

#ifndef SKINBAKE_MORPHED
#define SKINBAKE_MORPHED
// The frame under morph targets, by the morphed normal n: NORMAL plus the weighted sum of its targets, of any
// length. The frame at rest turns by the smallest rotation that takes its normal to n. Do not use
// skinbake_frame(n): alpha and beta belong to the frame at rest.
skinbake_Frame skinbake_morphed_frame(skinbake_Frame rest, vec3 n)
{
    float square = dot(n, n);
    vec3 normal = square > 0.0 ? n * inversesqrt(square) : rest.normal;
    vec3 s = rest.normal + normal;
    vec3 d = normal - rest.normal;
    bool opposite = dot(s, s) < 1e-4; // then every half turn is the smallest: take the one about t0
    float k = opposite ? 0.0 : 2.0 / dot(s, s);
    vec3 tangent = rest.tangent - s * (k * dot(d, rest.tangent));
    vec3 bitangent = rest.bitangent - s * (k * dot(d, rest.bitangent));
    return skinbake_Frame(normal, tangent, opposite ? -bitangent : bitangent, rest.handedness);
}
#endif

#ifndef SKINBAKE_DUAL_QUATERNION
#define SKINBAKE_DUAL_QUATERNION
// The unit dual quaternion of a rigid joint matrix. [0] is its real part (x, y, z, w), w the scalar; [1] is its
// dual part. Compute it on the host or in a pass over the joints: once per joint and frame, not per vertex.
// Dual quaternions have no scale. If all joint matrices share a uniform scale s, divide their upper 3x3 parts by
// s first, and skin s * p, s * t0, s * b0 in place of p, t0, b0.
mat2x4 skinbake_dual_quaternion(mat4 M)
{
    vec3 d = vec3(M[0].x, M[1].y, M[2].z);
    vec4 squares = 1.0 + vec4( // 4 * (x, y, z, w)^2
        d.x - d.y - d.z, d.y - d.z - d.x, d.z - d.x - d.y, d.x + d.y + d.z);
    vec3 differences = vec3(M[1].z - M[2].y, M[2].x - M[0].z, M[0].y - M[1].x); // 4 w * (x, y, z)
    vec3 sums = vec3(M[1].z + M[2].y, M[2].x + M[0].z, M[0].y + M[1].x); // 4 * (yz, zx, xy)
    vec4 real = vec4(differences, squares.w);
    float largest = squares.w;
    if (squares.x > largest) {
        largest = squares.x;
        real = vec4(squares.x, sums.z, sums.y, differences.x);
    }
    if (squares.y > largest) {
        largest = squares.y;
        real = vec4(sums.z, squares.y, sums.x, differences.y);
    }
    if (squares.z > largest) {
        real = vec4(sums.y, sums.x, squares.z, differences.z);
    }
    real = normalize(real);
    vec3 t = M[3].xyz;
    return mat2x4(real, 0.5 * vec4(cross(t, real.xyz) + real.w * t, -dot(t, real.xyz)));
}
#endif

#ifndef SKINBAKE_HEMISPHERE
#define SKINBAKE_HEMISPHERE
// -1 if the real part of the joint points away from that of the pivot: q and -q are the same rotation.
float skinbake_hemisphere(mat2x4 joint, mat2x4 pivot)
{
    return dot(joint[0], pivot[0]) < 0.0 ? -1.0 : 1.0;
}
#endif

#ifndef SKINBAKE_CAPPED
#define SKINBAKE_CAPPED
// base + correction. The correction is shortened to at most cap * |base|.
vec3 skinbake_capped(vec3 base, vec3 correction, float cap)
{
    float allowed = cap * cap * dot(base, base);
    float square = dot(correction, correction);
    bool too_long = square > allowed && allowed > 0.0;
    return base + (too_long ? sqrt(allowed / square) : 1.0) * correction;
}
#endif

#ifndef SKINBAKE_DERIVATIVE_CAPPED
#define SKINBAKE_DERIVATIVE_CAPPED
// The derivative of p + delta along t, if the mix b changes at the rate db. delta = k h, and i is as in the caller.
vec3 skinbake_derivative(mat2x4 b, float k, vec3 p, vec3 i, vec3 delta, vec3 t, mat2x4 db, float cap)
{
    vec3 di = b[0].w * t + db[1].xyz + cross(b[0].xyz, t) + db[0].w * p + cross(db[0].xyz, p);
    vec3 dh = b[0].w * db[1].xyz + cross(b[0].xyz, di) + cross(db[0].xyz, i)
            + db[0].w * b[1].xyz - db[1].w * b[0].xyz - b[1].w * db[0].xyz - dot(b[0], db[0]) * delta;
    vec3 turn = cross(b[0].xyz, b[0].w * t + cross(b[0].xyz, t));
    return skinbake_capped(t + k * turn, k * (dh - turn), cap);
}
#endif

// The frame moves by the derivative of the motion p' = p + delta of the mix, delta = k h,
//     i = r x p + r0 p + d, h = r x i + r0 d - d0 r, k = 2 / (r0^2 + |r|^2), the mix b = (r0, r, d0, d).
// Q: the dual quaternions of slots 0 to 3.
skinbake_Vertex skinbake_dqs_exact(vec3 p, skinbake_Frame frame, mat2x4 Q[4], vec4 weights_0, vec3 alpha_0,
        vec3 beta_0)
{
    float s1 = skinbake_hemisphere(Q[1], Q[0]); // 1
    float s2 = skinbake_hemisphere(Q[2], Q[0]);
    float s3 = skinbake_hemisphere(Q[3], Q[0]);
    mat2x4 b = weights_0.x * Q[0]
              + (s1 * weights_0.y) * Q[1]
              + (s2 * weights_0.z) * Q[2]
              + (s3 * weights_0.w) * Q[3];
    float square = dot(b[0], b[0]);
    float k = square == 0.0 ? 2.0 : 2.0 / square; // 2
    vec3 i = b[0].w * p + b[1].xyz + cross(b[0].xyz, p); // 3
    vec3 delta = k * (b[0].w * b[1].xyz - b[1].w * b[0].xyz + cross(b[0].xyz, i));
    skinbake_Vertex v;
    v.position = p + delta;
    mat2x4 D1 = s1 * Q[1] - Q[0]; // 4
    mat2x4 D2 = s2 * Q[2] - Q[0];
    mat2x4 D3 = s3 * Q[3] - Q[0];
    mat2x4 db_t = alpha_0.x * D1 + alpha_0.y * D2 + alpha_0.z * D3; // 5
    mat2x4 db_b = beta_0.x * D1 + beta_0.y * D2 + beta_0.z * D3; // 6
    v.tangent = skinbake_derivative(b, k, p, i, delta, frame.tangent, db_t, morphSkinbakeStorage.z); // 7
    v.bitangent = skinbake_derivative(b, k, p, i, delta, frame.bitangent, db_b, morphSkinbakeStorage.z); // 8
    v.normal = frame.handedness * cross(v.tangent, v.bitangent); // 9
    vec3 carried = frame.normal + k * cross(b[0].xyz, b[0].w * frame.normal + cross(b[0].xyz,
            frame.normal)); // 10
    v.cotangent = frame.handedness * cross(v.bitangent, carried); // 11
    v.cobitangent = frame.handedness * cross(carried, v.tangent); // 12
    return v;
}

#ifndef SKINBAKE_VERTEX
#define SKINBAKE_VERTEX
// A skinned vertex. Its vectors have any length. tangent and bitangent are the images of t0 and b0.
struct skinbake_Vertex {
    vec3 position;
    vec3 normal;
    vec3 tangent;
    vec3 bitangent;
};

// The tangent frame at rest.
struct skinbake_Frame {
    vec3 normal;
    vec3 tangent;
    vec3 bitangent;
    float handedness; // n0 = handedness * cross(t0, b0) / |t0|^2
};
#endif

#ifndef SKINBAKE_FRAME_FROM_TANGENT
#define SKINBAKE_FRAME_FROM_TANGENT
// The frame of NORMAL, which must have length 1, and TANGENT.
skinbake_Frame skinbake_frame(vec3 n, vec4 tangent)
{
    return skinbake_Frame(n, tangent.xyz, cross(n, tangent.xyz) * tangent.w, tangent.w);
}
#endif

#ifndef SKINBAKE_FRAME_FROM_NORMAL
#define SKINBAKE_FRAME_FROM_NORMAL
// The frame that bake took from NORMAL alone. n must have length 1. Every product in a sum is exact, so a compiler
// that fuses multiply-adds gets the same bits. side is the last factor, because Mesa turns side * ((x * x) * a)
// into side * (x * (x * a)).
skinbake_Frame skinbake_frame(vec3 n)
{
    float side = n.z >= 0.0 ? 1.0 : -1.0; // 1 also at -0.0
    float a = -1.0 / (side + n.z);
    float b = (n.x * n.y) * a;
    vec3 t0 = vec3(1.0 + ((n.x * n.x) * a) * side, side * b, -side * n.x);
    vec3 b0 = vec3(b, side * (1.0 + ((n.y * n.y) * a) * side), -n.y);
    return skinbake_Frame(n, t0, b0, 1.0);
}
#endif

#ifndef SKINBAKE_MOVED_FRAME
#define SKINBAKE_MOVED_FRAME
// The frame under morph targets whose differential the file has: m and up are the weighted sums of _SKINBAKE_MORPH
// and _SKINBAKE_MORPH_UP of the targets. It is exact, and needs no NORMAL of the targets.
skinbake_Frame skinbake_moved_frame(skinbake_Frame rest, vec4 m, vec2 up)
{
    vec3 tangent = rest.tangent + rest.tangent * m.x + rest.bitangent * m.y + rest.normal * up.x;
    vec3 bitangent = rest.bitangent + rest.tangent * m.z + rest.bitangent * m.w + rest.normal * up.y;
    vec3 c = cross(tangent, bitangent) * rest.handedness;
    float square = dot(c, c);
    bool moves = square > 0.0 && (any(notEqual(m, vec4(0.0))) || any(notEqual(up, vec2(0.0))));
    vec3 normal = moves ? c * inversesqrt(square) : rest.normal;
    return skinbake_Frame(normal, tangent, bitangent, rest.handedness);
}
#endif

#ifndef SKINBAKE_MOVED_FRAME_BY_NORMAL
#define SKINBAKE_MOVED_FRAME_BY_NORMAL
// The frame under morph targets that have NORMAL and their differential: n is NORMAL plus the weighted sum of its
// targets, of any length, m the weighted sum of _SKINBAKE_MORPH of the targets.
skinbake_Frame skinbake_moved_frame_by_normal(skinbake_Frame rest, vec3 n, vec4 m)
{
    skinbake_Frame frame = skinbake_morphed_frame(rest, n);
    vec3 t = rest.tangent + rest.tangent * m.x + rest.bitangent * m.y;
    vec3 b = rest.bitangent + rest.tangent * m.z + rest.bitangent * m.w;
    float cosine = dot(rest.normal, frame.normal);
    // Then m tells too little, or of the other side of the surface.
    bool steep = abs(cosine) < 0.2 || cosine * ((1.0 + m.x) * (1.0 + m.w) - m.y * m.z) <= 0.0;
    float k = steep ? 0.0 : 1.0 / cosine;
    frame.tangent = steep ? frame.tangent : t - rest.normal * (dot(t, frame.normal) * k);
    frame.bitangent = steep ? frame.bitangent : b - rest.normal * (dot(b, frame.normal) * k);
    return frame;
}
#endif

#ifndef SKINBAKE_DECODED
#define SKINBAKE_DECODED
// alpha or beta of slots 1 to 3, from set 0. xyz are relative to the scale of the vertex. w is the square root of
// that scale, relative to the scale of the file.
vec3 skinbake_decoded(vec4 stored, float scale)
{
    return (scale * stored.w * stored.w) * stored.xyz;
}
#endif

#ifndef SKINBAKE_MORPHED
#define SKINBAKE_MORPHED
// The frame under morph targets, by the morphed normal n: NORMAL plus the weighted sum of its targets, of any
// length. The frame at rest turns by the smallest rotation that takes its normal to n. Do not use
// skinbake_frame(n): alpha and beta belong to the frame at rest.
skinbake_Frame skinbake_morphed_frame(skinbake_Frame rest, vec3 n)
{
    float square = dot(n, n);
    vec3 normal = square > 0.0 ? n * inversesqrt(square) : rest.normal;
    vec3 s = rest.normal + normal;
    vec3 d = normal - rest.normal;
    bool opposite = dot(s, s) < 1e-4; // then every half turn is the smallest: take the one about t0
    float k = opposite ? 0.0 : 2.0 / dot(s, s);
    vec3 tangent = rest.tangent - s * (k * dot(d, rest.tangent));
    vec3 bitangent = rest.bitangent - s * (k * dot(d, rest.bitangent));
    return skinbake_Frame(normal, tangent, opposite ? -bitangent : bitangent, rest.handedness);
}
#endif

#ifndef SKINBAKE_MOVED
#define SKINBAKE_MOVED
// M p: the position p moved by the joint matrix M alone.
vec3 skinbake_moved(mat4 M, vec3 p)
{
    return M[0].xyz * p.x + (M[1].xyz * p.y + (M[2].xyz * p.z + M[3].xyz));
}
#endif

#ifndef SKINBAKE_CAPPED
#define SKINBAKE_CAPPED
// base + correction. The correction is shortened to at most cap * |base|.
vec3 skinbake_capped(vec3 base, vec3 correction, float cap)
{
    float allowed = cap * cap * dot(base, base);
    float square = dot(correction, correction);
    bool too_long = square > allowed && allowed > 0.0;
    return base + (too_long ? sqrt(allowed / square) : 1.0) * correction;
}
#endif

// The frame moves by the derivative of the skinned position along t0 and b0.
// M: the joint matrices of slots 0 to 3.
skinbake_Vertex skinbake_lbs_accurate(vec3 p, skinbake_Frame frame, mat4 M[4], vec4 weights_0, vec3 alpha_0,
        vec3 beta_0)
{
    mat3 T = weights_0.x * mat3(M[0]) // 1
            + weights_0.y * mat3(M[1])
            + weights_0.z * mat3(M[2])
            + weights_0.w * mat3(M[3]);
    vec3 q0 = skinbake_moved(M[0], p); // 2
    vec3 q1 = skinbake_moved(M[1], p);
    vec3 q2 = skinbake_moved(M[2], p);
    vec3 q3 = skinbake_moved(M[3], p);
    vec3 d1 = q1 - q0; // 3
    vec3 d2 = q2 - q0;
    vec3 d3 = q3 - q0;
    skinbake_Vertex v;
    v.tangent = skinbake_capped(T * frame.tangent, alpha_0.x * d1 + alpha_0.y * d2 + alpha_0.z * d3,
            morphSkinbakeStorage.z); // 4
    v.bitangent = skinbake_capped(T * frame.bitangent, beta_0.x * d1 + beta_0.y * d2 + beta_0.z * d3,
            morphSkinbakeStorage.z); // 5
    v.normal = frame.handedness * cross(v.tangent, v.bitangent); // 6
    v.position = q0 + weights_0.y * d1 + weights_0.z * d2 + weights_0.w * d3; // 7
    return v;
}

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
    } else {
        v = skinbake_lbs_accurate(q, moved, M, skinWeight, alpha, beta);
        objectNormal = cofactors * v.normal;
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
