// Shader text, written by skinbake 0.1.0:
//     skinbake shader --lang glsl --method lbs --lighting accurate --influences 4 --frame normal --target babylon
//
// Algorithm 3 of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned Models",
// Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. Frame: T. Duff et al., "Building an Orthonormal
// Basis, Revisited", JCGT 6(1), 2017. Dual quaternions: the exact derivative of their blend, for joints that may scale,
// which is skinbake's own.

export const METHOD = 'lbs';

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

#ifndef SKINBAKE_DECODED
#define SKINBAKE_DECODED
// alpha or beta of slots 1 to 3, from set 0. xyz are relative to the scale of the vertex. w is the square root of
// that scale, relative to the scale of the file.
vec3 skinbake_decoded(vec4 stored, float scale)
{
    return (scale * stored.w * stored.w) * stored.xyz;
}
#endif

#ifndef SKINBAKE_DECODED_FURTHER
#define SKINBAKE_DECODED_FURTHER
// alpha or beta of the four slots of a further set. first is set 0, whose w counts for all sets.
vec4 skinbake_decoded_further(vec4 stored, vec4 first, float scale)
{
    return (scale * first.w * first.w) * stored;
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

#ifndef SKINBAKE_MORPHED_TANGENT
#define SKINBAKE_MORPHED_TANGENT
// The frame under morph targets that move TANGENT too. tangent is TANGENT.xyz plus the weighted sum of its targets.
// Do not normalise it. If the sum is 0, the frame follows the normal. If the targets of a primitive have no
// TANGENT, use skinbake_morphed_frame().
skinbake_Frame skinbake_morphed_tangent_frame(skinbake_Frame rest, vec3 n, vec3 tangent)
{
    skinbake_Frame frame = skinbake_morphed_frame(rest, n);
    vec3 t = tangent - frame.normal * (dot(frame.normal, tangent) - dot(rest.normal, rest.tangent));
    bool cancelled = dot(t, t) < 1e-4 * dot(rest.tangent, rest.tangent);
    frame.tangent = cancelled ? frame.tangent : t;
    frame.bitangent = cancelled ? frame.bitangent : cross(frame.normal, t) * rest.handedness;
    return frame;
}
#endif

#if SKINBAKE_MORPHS > 0
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

#ifndef SKINBAKE_PRODUCT
#define SKINBAKE_PRODUCT
// The product of two quaternions.
vec4 skinbake_product(vec4 a, vec4 b)
{
    return vec4(a.w * b.xyz + b.w * a.xyz + cross(a.xyz, b.xyz), a.w * b.w - dot(a.xyz, b.xyz));
}
#endif

#ifndef SKINBAKE_SCALED_JOINT
#define SKINBAKE_SCALED_JOINT
// A joint that may scale, shear or mirror. Quaternions are (x, y, z, w), w the scalar. turn is the rotation of the joint
// matrix, and the columns of moved are those of the matrix times it.
struct skinbake_ScaledMotion {
    mat4 moved;
    vec4 turn;
};

// A motion that has a rotation. A joint that leaves a line or a point, as at scale 0, has none: its turn is 0, and moved has
// the columns of the matrix. It takes another's.
skinbake_ScaledMotion skinbake_turning(skinbake_ScaledMotion Q, vec4 turn)
{
    if (dot(Q.turn, Q.turn) > 0.0) return Q;
    for (int i = 0; i < 4; i++)
        Q.moved[i] = vec4(turn.w * Q.moved[i].xyz + cross(Q.moved[i].xyz, turn.xyz), -dot(Q.moved[i].xyz,
                turn.xyz));
    Q.turn = turn;
    return Q;
}

// The vector of a over a quaternion, which is given as itself / its squared length.
vec3 skinbake_over(vec4 a, vec4 divisor)
{
    return divisor.w * a.xyz - a.w * divisor.xyz + cross(divisor.xyz, a.xyz);
}
#endif

#ifndef SKINBAKE_SCALED_MOTION
#define SKINBAKE_SCALED_MOTION
// The unit quaternion of the rotation R in the polar decomposition M = R S, or in that of -M where M mirrors, by Newton's
// iteration (Higham 1986). A joint that flattens does not mirror. One that leaves a line or a point has no
// rotation: zeros.
vec4 skinbake_turn(mat3 M)
{
    mat3 R = M * (1.0 / max(sqrt(dot(M[0], M[0]) + dot(M[1], M[1]) + dot(M[2], M[2])), 1e-30));
    mat3 C = mat3(cross(R[1], R[2]), cross(R[2], R[0]), cross(R[0], R[1]));
    float area = sqrt(dot(C[0], C[0]) + dot(C[1], C[1]) + dot(C[2], C[2]));
    if (area <= 1e-6) return vec4(0.0, 0.0, 0.0, 0.0);
    // The cofactors have the same rotation, and an extent where M has none.
    R = R * (dot(R[0], C[0]) < -1e-6 * area ? -1.0 : 1.0) + C * (1.0 / area);
    R = R * (1.0 / pow(dot(cross(R[0], R[1]), R[2]), 1.0 / 3.0));
    for (int i = 0; i < 12; i++) {
        // The volume is at least 1, so the squares sum to 3 where R is a rotation.
        bool is_near = dot(R[0], R[0]) + dot(R[1], R[1]) + dot(R[2], R[2]) < 3.00001;
        mat3 cofactors = mat3(cross(R[1], R[2]), cross(R[2], R[0]), cross(R[0], R[1]));
        R = 0.5 * (R + cofactors * (1.0 / dot(R[0], cofactors[0])));
        if (is_near) break;
    }
    return skinbake_dual_quaternion(mat4(vec4(R[0], 0.0), vec4(R[1], 0.0), vec4(R[2], 0.0), vec4(0.0, 0.0,
            0.0, 1.0)))[0];
}

// The motion of a joint matrix. Compute it on the host, by joint_scaled_motions() of skinbake's Python package, or in a
// pass over the joints: once per joint and frame, not per vertex.
skinbake_ScaledMotion skinbake_scaled_motion(mat4 M)
{
    vec4 turn = skinbake_turn(mat3(M));
    skinbake_ScaledMotion Q;
    for (int i = 0; i < 4; i++)
        Q.moved[i] = vec4(M[i].xyz, 0.0);
    Q.turn = vec4(0.0, 0.0, 0.0, 0.0);
    if (dot(turn, turn) > 0.0)
        return skinbake_turning(Q, turn);
    return Q;
}
#endif

#if NUM_BONE_INFLUENCERS > 4
// The frame moves by the derivative of the quotient p' = g / b: b mixes the joints' turns, and g what M p is times them.
// Q: the scaled motions of slots 0 to 7.
skinbake_Vertex skinbake_dqs_scaled(vec3 p, skinbake_Frame frame, skinbake_ScaledMotion Q[8], vec4 weights_0,
        vec4 weights_1, vec3 alpha_0, vec4 alpha_1, vec3 beta_0, vec4 beta_1)
{
    vec4 pivot = Q[0].turn;
    if (dot(pivot, pivot) == 0.0) pivot = Q[1].turn;
    if (dot(pivot, pivot) == 0.0) pivot = Q[2].turn;
    if (dot(pivot, pivot) == 0.0) pivot = Q[3].turn;
    if (dot(pivot, pivot) == 0.0) pivot = Q[4].turn;
    if (dot(pivot, pivot) == 0.0) pivot = Q[5].turn;
    if (dot(pivot, pivot) == 0.0) pivot = Q[6].turn;
    if (dot(pivot, pivot) == 0.0) pivot = Q[7].turn;
    if (dot(pivot, pivot) == 0.0) pivot.w = 1.0;
    Q[0] = skinbake_turning(Q[0], pivot);
    Q[1] = skinbake_turning(Q[1], pivot);
    Q[2] = skinbake_turning(Q[2], pivot);
    Q[3] = skinbake_turning(Q[3], pivot);
    Q[4] = skinbake_turning(Q[4], pivot);
    Q[5] = skinbake_turning(Q[5], pivot);
    Q[6] = skinbake_turning(Q[6], pivot);
    Q[7] = skinbake_turning(Q[7], pivot);
    float s1 = dot(Q[1].turn, Q[0].turn) < 0.0 ? -1.0 : 1.0; // 1: q and -q are the same rotation
    float s2 = dot(Q[2].turn, Q[0].turn) < 0.0 ? -1.0 : 1.0;
    float s3 = dot(Q[3].turn, Q[0].turn) < 0.0 ? -1.0 : 1.0;
    float s4 = dot(Q[4].turn, Q[0].turn) < 0.0 ? -1.0 : 1.0;
    float s5 = dot(Q[5].turn, Q[0].turn) < 0.0 ? -1.0 : 1.0;
    float s6 = dot(Q[6].turn, Q[0].turn) < 0.0 ? -1.0 : 1.0;
    float s7 = dot(Q[7].turn, Q[0].turn) < 0.0 ? -1.0 : 1.0;
    vec4 b = weights_0.x * Q[0].turn
           + (s1 * weights_0.y) * Q[1].turn
           + (s2 * weights_0.z) * Q[2].turn
           + (s3 * weights_0.w) * Q[3].turn
           + (s4 * weights_1.x) * Q[4].turn
           + (s5 * weights_1.y) * Q[5].turn
           + (s6 * weights_1.z) * Q[6].turn
           + (s7 * weights_1.w) * Q[7].turn;
    mat4 T = weights_0.x * Q[0].moved
           + (s1 * weights_0.y) * Q[1].moved
           + (s2 * weights_0.z) * Q[2].moved
           + (s3 * weights_0.w) * Q[3].moved
           + (s4 * weights_1.x) * Q[4].moved
           + (s5 * weights_1.y) * Q[5].moved
           + (s6 * weights_1.z) * Q[6].moved
           + (s7 * weights_1.w) * Q[7].moved;
    float square = dot(b, b);
    vec4 divisor = b / (square > 0.0 ? square : 1.0); // 2
    vec4 g0 = Q[0].moved * vec4(p, 1.0); // 3
    vec4 g1 = Q[1].moved * vec4(p, 1.0);
    vec4 g2 = Q[2].moved * vec4(p, 1.0);
    vec4 g3 = Q[3].moved * vec4(p, 1.0);
    vec4 g4 = Q[4].moved * vec4(p, 1.0);
    vec4 g5 = Q[5].moved * vec4(p, 1.0);
    vec4 g6 = Q[6].moved * vec4(p, 1.0);
    vec4 g7 = Q[7].moved * vec4(p, 1.0);
    vec4 m1 = s1 * g1 - g0; // 4
    vec4 r1 = s1 * Q[1].turn - Q[0].turn;
    vec4 m2 = s2 * g2 - g0;
    vec4 r2 = s2 * Q[2].turn - Q[0].turn;
    vec4 m3 = s3 * g3 - g0;
    vec4 r3 = s3 * Q[3].turn - Q[0].turn;
    vec4 m4 = s4 * g4 - g0;
    vec4 r4 = s4 * Q[4].turn - Q[0].turn;
    vec4 m5 = s5 * g5 - g0;
    vec4 r5 = s5 * Q[5].turn - Q[0].turn;
    vec4 m6 = s6 * g6 - g0;
    vec4 r6 = s6 * Q[6].turn - Q[0].turn;
    vec4 m7 = s7 * g7 - g0;
    vec4 r7 = s7 * Q[7].turn - Q[0].turn;
    vec4 g = g0 + weights_0.y * m1 + weights_0.z * m2 + weights_0.w * m3 + weights_1.x * m4
            + weights_1.y * m5 + weights_1.z * m6 + weights_1.w * m7; // 5
    vec4 ratio = vec4(skinbake_over(g, divisor), dot(g, divisor));
    skinbake_Vertex v;
    v.position = ratio.xyz;
    v.tangent = skinbake_over(T * vec4(frame.tangent, 0.0) + alpha_0.x * m1 + alpha_0.y * m2
            + alpha_0.z * m3 + alpha_1.x * m4 + alpha_1.y * m5 + alpha_1.z * m6
            + alpha_1.w * m7 - skinbake_product(ratio, alpha_0.x * r1 + alpha_0.y * r2 + alpha_0.z * r3
            + alpha_1.x * r4 + alpha_1.y * r5 + alpha_1.z * r6 + alpha_1.w * r7), divisor); // 6
    v.bitangent = skinbake_over(T * vec4(frame.bitangent, 0.0) + beta_0.x * m1 + beta_0.y * m2
            + beta_0.z * m3 + beta_1.x * m4 + beta_1.y * m5 + beta_1.z * m6
            + beta_1.w * m7 - skinbake_product(ratio, beta_0.x * r1 + beta_0.y * r2 + beta_0.z * r3
            + beta_1.x * r4 + beta_1.y * r5 + beta_1.z * r6 + beta_1.w * r7), divisor); // 7
    v.normal = frame.handedness * cross(v.tangent, v.bitangent); // 8
    vec3 carried = skinbake_over(T * vec4(frame.normal, 0.0), divisor); // 9
    v.cotangent = frame.handedness * cross(v.bitangent, carried); // 10
    v.cobitangent = frame.handedness * cross(carried, v.tangent); // 11
    // A joint that mirrors turns t x b to the inside.
    vec3 x = skinbake_over(T[0], divisor);
    vec3 y = skinbake_over(T[1], divisor);
    float outside = dot(cross(x, y), skinbake_over(T[2], divisor)) < 0.0 ? -1.0 : 1.0;
    v.normal *= outside;
    v.cotangent *= outside;
    v.cobitangent *= outside;
    return v;
}
#else
// The frame moves by the derivative of the quotient p' = g / b: b mixes the joints' turns, and g what M p is times them.
// Q: the scaled motions of slots 0 to 3.
skinbake_Vertex skinbake_dqs_scaled(vec3 p, skinbake_Frame frame, skinbake_ScaledMotion Q[4], vec4 weights_0,
        vec3 alpha_0, vec3 beta_0)
{
    vec4 pivot = Q[0].turn;
    if (dot(pivot, pivot) == 0.0) pivot = Q[1].turn;
    if (dot(pivot, pivot) == 0.0) pivot = Q[2].turn;
    if (dot(pivot, pivot) == 0.0) pivot = Q[3].turn;
    if (dot(pivot, pivot) == 0.0) pivot.w = 1.0;
    Q[0] = skinbake_turning(Q[0], pivot);
    Q[1] = skinbake_turning(Q[1], pivot);
    Q[2] = skinbake_turning(Q[2], pivot);
    Q[3] = skinbake_turning(Q[3], pivot);
    float s1 = dot(Q[1].turn, Q[0].turn) < 0.0 ? -1.0 : 1.0; // 1: q and -q are the same rotation
    float s2 = dot(Q[2].turn, Q[0].turn) < 0.0 ? -1.0 : 1.0;
    float s3 = dot(Q[3].turn, Q[0].turn) < 0.0 ? -1.0 : 1.0;
    vec4 b = weights_0.x * Q[0].turn
           + (s1 * weights_0.y) * Q[1].turn
           + (s2 * weights_0.z) * Q[2].turn
           + (s3 * weights_0.w) * Q[3].turn;
    mat4 T = weights_0.x * Q[0].moved
           + (s1 * weights_0.y) * Q[1].moved
           + (s2 * weights_0.z) * Q[2].moved
           + (s3 * weights_0.w) * Q[3].moved;
    float square = dot(b, b);
    vec4 divisor = b / (square > 0.0 ? square : 1.0); // 2
    vec4 g0 = Q[0].moved * vec4(p, 1.0); // 3
    vec4 g1 = Q[1].moved * vec4(p, 1.0);
    vec4 g2 = Q[2].moved * vec4(p, 1.0);
    vec4 g3 = Q[3].moved * vec4(p, 1.0);
    vec4 m1 = s1 * g1 - g0; // 4
    vec4 r1 = s1 * Q[1].turn - Q[0].turn;
    vec4 m2 = s2 * g2 - g0;
    vec4 r2 = s2 * Q[2].turn - Q[0].turn;
    vec4 m3 = s3 * g3 - g0;
    vec4 r3 = s3 * Q[3].turn - Q[0].turn;
    vec4 g = g0 + weights_0.y * m1 + weights_0.z * m2 + weights_0.w * m3; // 5
    vec4 ratio = vec4(skinbake_over(g, divisor), dot(g, divisor));
    skinbake_Vertex v;
    v.position = ratio.xyz;
    v.tangent = skinbake_over(T * vec4(frame.tangent, 0.0) + alpha_0.x * m1 + alpha_0.y * m2
            + alpha_0.z * m3 - skinbake_product(ratio, alpha_0.x * r1 + alpha_0.y * r2 + alpha_0.z * r3),
            divisor); // 6
    v.bitangent = skinbake_over(T * vec4(frame.bitangent, 0.0) + beta_0.x * m1 + beta_0.y * m2
            + beta_0.z * m3 - skinbake_product(ratio, beta_0.x * r1 + beta_0.y * r2 + beta_0.z * r3),
            divisor); // 7
    v.normal = frame.handedness * cross(v.tangent, v.bitangent); // 8
    vec3 carried = skinbake_over(T * vec4(frame.normal, 0.0), divisor); // 9
    v.cotangent = frame.handedness * cross(v.bitangent, carried); // 10
    v.cobitangent = frame.handedness * cross(carried, v.tangent); // 11
    // A joint that mirrors turns t x b to the inside.
    vec3 x = skinbake_over(T[0], divisor);
    vec3 y = skinbake_over(T[1], divisor);
    float outside = dot(cross(x, y), skinbake_over(T[2], divisor)) < 0.0 ? -1.0 : 1.0;
    v.normal *= outside;
    v.cotangent *= outside;
    v.cobitangent *= outside;
    return v;
}
#endif
#endif

#if NUM_BONE_INFLUENCERS > 4
// The frame moves by the derivative of the skinned position along t0 and b0.
// M: the joint matrices of slots 0 to 7.
skinbake_Vertex skinbake_lbs_accurate(vec3 p, skinbake_Frame frame, mat4 M[8], vec4 weights_0,
        vec4 weights_1, vec3 alpha_0, vec4 alpha_1, vec3 beta_0, vec4 beta_1)
{
    mat3 T = weights_0.x * mat3(M[0]) // 1
            + weights_0.y * mat3(M[1])
            + weights_0.z * mat3(M[2])
            + weights_0.w * mat3(M[3])
            + weights_1.x * mat3(M[4])
            + weights_1.y * mat3(M[5])
            + weights_1.z * mat3(M[6])
            + weights_1.w * mat3(M[7]);
    vec3 q0 = skinbake_moved(M[0], p); // 2
    vec3 q1 = skinbake_moved(M[1], p);
    vec3 q2 = skinbake_moved(M[2], p);
    vec3 q3 = skinbake_moved(M[3], p);
    vec3 q4 = skinbake_moved(M[4], p);
    vec3 q5 = skinbake_moved(M[5], p);
    vec3 q6 = skinbake_moved(M[6], p);
    vec3 q7 = skinbake_moved(M[7], p);
    vec3 d1 = q1 - q0; // 3
    vec3 d2 = q2 - q0;
    vec3 d3 = q3 - q0;
    vec3 d4 = q4 - q0;
    vec3 d5 = q5 - q0;
    vec3 d6 = q6 - q0;
    vec3 d7 = q7 - q0;
    skinbake_Vertex v;
    v.tangent = T * frame.tangent + alpha_0.x * d1 + alpha_0.y * d2 + alpha_0.z * d3 + alpha_1.x * d4
            + alpha_1.y * d5 + alpha_1.z * d6 + alpha_1.w * d7; // 4
    v.bitangent = T * frame.bitangent + beta_0.x * d1 + beta_0.y * d2 + beta_0.z * d3 + beta_1.x * d4
            + beta_1.y * d5 + beta_1.z * d6 + beta_1.w * d7; // 5
    v.normal = frame.handedness * cross(v.tangent, v.bitangent); // 6
    vec3 carried = T * frame.normal; // 8
    v.cotangent = frame.handedness * cross(v.bitangent, carried); // 9
    v.cobitangent = frame.handedness * cross(carried, v.tangent); // 10
    float outside = determinant(T) < 0.0 ? -1.0 : 1.0; // a joint that mirrors turns t x b to the inside
    v.normal *= outside;
    v.cotangent *= outside;
    v.cobitangent *= outside;
    v.position = q0 + weights_0.y * d1 + weights_0.z * d2 + weights_0.w * d3 + weights_1.x * d4
            + weights_1.y * d5 + weights_1.z * d6 + weights_1.w * d7; // 7
    return v;
}
#else
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
    v.tangent = T * frame.tangent + alpha_0.x * d1 + alpha_0.y * d2 + alpha_0.z * d3; // 4
    v.bitangent = T * frame.bitangent + beta_0.x * d1 + beta_0.y * d2 + beta_0.z * d3; // 5
    v.normal = frame.handedness * cross(v.tangent, v.bitangent); // 6
    vec3 carried = T * frame.normal; // 8
    v.cotangent = frame.handedness * cross(v.bitangent, carried); // 9
    v.cobitangent = frame.handedness * cross(carried, v.tangent); // 10
    float outside = determinant(T) < 0.0 ? -1.0 : 1.0; // a joint that mirrors turns t x b to the inside
    v.normal *= outside;
    v.cotangent *= outside;
    v.cobitangent *= outside;
    v.position = q0 + weights_0.y * d1 + weights_0.z * d2 + weights_0.w * d3; // 7
    return v;
}
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
    M[0] = skinbake_joint(matricesIndices.x);
    M[1] = skinbake_joint(matricesIndices.y);
    M[2] = skinbake_joint(matricesIndices.z);
    M[3] = skinbake_joint(matricesIndices.w);
#if NUM_BONE_INFLUENCERS > 4
    M[4] = skinbake_joint(matricesIndicesExtra.x);
    M[5] = skinbake_joint(matricesIndicesExtra.y);
    M[6] = skinbake_joint(matricesIndicesExtra.z);
    M[7] = skinbake_joint(matricesIndicesExtra.w);
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
    return skinbake_lbs_accurate(p, frame, M, weights_0, weights_1, alpha_0, alpha_1, beta_0, beta_1);
#else
    return skinbake_lbs_accurate(p, frame, M, weights_0, alpha_0, beta_0);
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

// A skinned vertex. Its vectors have any length. tangent and bitangent are the images of t0 and b0.
struct skinbake_Vertex {
    position: vec3<f32>,
    normal: vec3<f32>,
    tangent: vec3<f32>,
    bitangent: vec3<f32>,
    cotangent: vec3<f32>, // for normal maps: the cofactors of (t', b', T n0), of which normal is the third
    cobitangent: vec3<f32>,
}

// The tangent frame at rest.
struct skinbake_Frame {
    normal: vec3<f32>,
    tangent: vec3<f32>,
    bitangent: vec3<f32>,
    handedness: f32, // n0 = handedness * cross(t0, b0) / |t0|^2
}

// alpha or beta of slots 1 to 3, from set 0. xyz are relative to the scale of the vertex. w is the square root of
// that scale, relative to the scale of the file.
fn skinbake_decoded(stored: vec4<f32>, scale: f32) -> vec3<f32> {
    return (scale * stored.w * stored.w) * stored.xyz;
}

// alpha or beta of the four slots of a further set. first is set 0, whose w counts for all sets.
fn skinbake_decoded_further(stored: vec4<f32>, first: vec4<f32>, scale: f32) -> vec4<f32> {
    return (scale * first.w * first.w) * stored;
}

// The frame under morph targets, by the morphed normal n: NORMAL plus the weighted sum of its targets, of any
// length. The frame at rest turns by the smallest rotation that takes its normal to n. Do not use
// skinbake_frame(n): alpha and beta belong to the frame at rest.
fn skinbake_morphed_frame(rest: skinbake_Frame, n: vec3<f32>) -> skinbake_Frame {
    let square = dot(n, n);
    let normal = select(rest.normal, n * inverseSqrt(square), square > 0.0);
    let s = rest.normal + normal;
    let d = normal - rest.normal;
    let opposite = dot(s, s) < 1e-4; // then every half turn is the smallest: take the one about t0
    let k = select(2.0 / dot(s, s), 0.0, opposite);
    let tangent = rest.tangent - s * (k * dot(d, rest.tangent));
    let bitangent = rest.bitangent - s * (k * dot(d, rest.bitangent));
    return skinbake_Frame(normal, tangent, select(bitangent, -bitangent, opposite), rest.handedness);
}

// The upper 3x3 part of M.
fn skinbake_upper(M: mat4x4<f32>) -> mat3x3<f32> {
    return mat3x3<f32>(M[0].xyz, M[1].xyz, M[2].xyz);
}

// M p: the position p moved by the joint matrix M alone.
fn skinbake_moved(M: mat4x4<f32>, p: vec3<f32>) -> vec3<f32> {
    return M[0].xyz * p.x + (M[1].xyz * p.y + (M[2].xyz * p.z + M[3].xyz));
}

// The frame under morph targets that move TANGENT too. tangent is TANGENT.xyz plus the weighted sum of its targets.
// Do not normalise it. If the sum is 0, the frame follows the normal. If the targets of a primitive have no
// TANGENT, use skinbake_morphed_frame().
fn skinbake_morphed_tangent_frame(rest: skinbake_Frame, n: vec3<f32>, tangent: vec3<f32>) -> skinbake_Frame {
    var frame = skinbake_morphed_frame(rest, n);
    let t = tangent - frame.normal * (dot(frame.normal, tangent) - dot(rest.normal, rest.tangent));
    let cancelled = dot(t, t) < 1e-4 * dot(rest.tangent, rest.tangent);
    frame.tangent = select(t, frame.tangent, cancelled);
    frame.bitangent = select(cross(frame.normal, t) * rest.handedness, frame.bitangent, cancelled);
    return frame;
}

#if SKINBAKE_MORPHS > 0
// The frame under morph targets whose differential the file has: m and up are the weighted sums of _SKINBAKE_MORPH
// and _SKINBAKE_MORPH_UP of the targets. It is exact, and needs no NORMAL of the targets.
fn skinbake_moved_frame(rest: skinbake_Frame, m: vec4<f32>, up: vec2<f32>) -> skinbake_Frame {
    let tangent = rest.tangent + rest.tangent * m.x + rest.bitangent * m.y + rest.normal * up.x;
    let bitangent = rest.bitangent + rest.tangent * m.z + rest.bitangent * m.w + rest.normal * up.y;
    let c = cross(tangent, bitangent) * rest.handedness;
    let square = dot(c, c);
    let moves = square > 0.0 && (any(m != vec4<f32>(0.0)) || any(up != vec2<f32>(0.0)));
    let normal = select(rest.normal, c * inverseSqrt(square), moves);
    return skinbake_Frame(normal, tangent, bitangent, rest.handedness);
}

// The frame under morph targets that have NORMAL and their differential: n is NORMAL plus the weighted sum of its
// targets, of any length, m the weighted sum of _SKINBAKE_MORPH of the targets.
fn skinbake_moved_frame_by_normal(rest: skinbake_Frame, n: vec3<f32>, m: vec4<f32>) -> skinbake_Frame {
    var frame = skinbake_morphed_frame(rest, n);
    let t = rest.tangent + rest.tangent * m.x + rest.bitangent * m.y;
    let b = rest.bitangent + rest.tangent * m.z + rest.bitangent * m.w;
    let cosine = dot(rest.normal, frame.normal);
    // Then m tells too little, or of the other side of the surface.
    let steep = abs(cosine) < 0.2 || cosine * ((1.0 + m.x) * (1.0 + m.w) - m.y * m.z) <= 0.0;
    let k = select(1.0 / cosine, 0.0, steep);
    frame.tangent = select(t - rest.normal * (dot(t, frame.normal) * k), frame.tangent, steep);
    frame.bitangent = select(b - rest.normal * (dot(b, frame.normal) * k), frame.bitangent, steep);
    return frame;
}

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
// The unit dual quaternion of a rigid joint matrix. [0] is its real part (x, y, z, w), w the scalar; [1] is its
// dual part. Compute it on the host or in a pass over the joints: once per joint and frame, not per vertex.
// Dual quaternions have no scale. If all joint matrices share a uniform scale s, divide their upper 3x3 parts by
// s first, and skin s * p, s * t0, s * b0 in place of p, t0, b0.
fn skinbake_dual_quaternion(M: mat4x4<f32>) -> mat2x4<f32> {
    let d = vec3<f32>(M[0].x, M[1].y, M[2].z);
    let squares = 1.0 + vec4<f32>( // 4 * (x, y, z, w)^2
        d.x - d.y - d.z, d.y - d.z - d.x, d.z - d.x - d.y, d.x + d.y + d.z);
    let differences = vec3<f32>(M[1].z - M[2].y, M[2].x - M[0].z, M[0].y - M[1].x); // 4 w * (x, y, z)
    let sums = vec3<f32>(M[1].z + M[2].y, M[2].x + M[0].z, M[0].y + M[1].x); // 4 * (yz, zx, xy)
    var real = vec4<f32>(differences, squares.w);
    var largest = squares.w;
    if (squares.x > largest) {
        largest = squares.x;
        real = vec4<f32>(squares.x, sums.z, sums.y, differences.x);
    }
    if (squares.y > largest) {
        largest = squares.y;
        real = vec4<f32>(sums.z, squares.y, sums.x, differences.y);
    }
    if (squares.z > largest) {
        real = vec4<f32>(sums.y, sums.x, squares.z, differences.z);
    }
    real = normalize(real);
    let t = M[3].xyz;
    return mat2x4<f32>(real, 0.5 * vec4<f32>(cross(t, real.xyz) + real.w * t, -dot(t, real.xyz)));
}

// The product of two quaternions.
fn skinbake_product(a: vec4<f32>, b: vec4<f32>) -> vec4<f32> {
    return vec4<f32>(a.w * b.xyz + b.w * a.xyz + cross(a.xyz, b.xyz), a.w * b.w - dot(a.xyz, b.xyz));
}

// A joint that may scale, shear or mirror. Quaternions are (x, y, z, w), w the scalar. turn is the rotation of the joint
// matrix, and the columns of moved are those of the matrix times it.
struct skinbake_ScaledMotion {
    moved: mat4x4<f32>,
    turn: vec4<f32>,
}

// A motion that has a rotation. A joint that leaves a line or a point, as at scale 0, has none: its turn is 0, and moved has
// the columns of the matrix. It takes another's.
fn skinbake_turning(given: skinbake_ScaledMotion, turn: vec4<f32>) -> skinbake_ScaledMotion {
    if (dot(given.turn, given.turn) > 0.0) { return given; }
    var Q = given;
    for (var i = 0; i < 4; i++) { Q.moved[i] = skinbake_product(Q.moved[i], turn); }
    Q.turn = turn;
    return Q;
}

// The vector of a over a quaternion, which is given as itself / its squared length.
fn skinbake_over(a: vec4<f32>, divisor: vec4<f32>) -> vec3<f32> {
    return divisor.w * a.xyz - a.w * divisor.xyz + cross(divisor.xyz, a.xyz);
}

// The unit quaternion of the rotation R in the polar decomposition M = R S, or in that of -M where M mirrors, by Newton's
// iteration (Higham 1986). A joint that flattens does not mirror. One that leaves a line or a point has no
// rotation: zeros.
fn skinbake_turn(M: mat4x4<f32>) -> vec4<f32> {
    var R = mat3x3<f32>(M[0].xyz, M[1].xyz, M[2].xyz);
    R = R * (1.0 / max(sqrt(dot(R[0], R[0]) + dot(R[1], R[1]) + dot(R[2], R[2])), 1e-30));
    let C = mat3x3<f32>(cross(R[1], R[2]), cross(R[2], R[0]), cross(R[0], R[1]));
    let area = sqrt(dot(C[0], C[0]) + dot(C[1], C[1]) + dot(C[2], C[2]));
    if (area <= 1e-6) { return vec4<f32>(); }
    // The cofactors have the same rotation, and an extent where M has none.
    R = R * select(1.0, -1.0, dot(R[0], C[0]) < -1e-6 * area) + C * (1.0 / area);
    R = R * (1.0 / pow(dot(cross(R[0], R[1]), R[2]), 1.0 / 3.0));
    for (var i = 0; i < 12; i++) {
        // The volume is at least 1, so the squares sum to 3 where R is a rotation.
        let is_near = dot(R[0], R[0]) + dot(R[1], R[1]) + dot(R[2], R[2]) < 3.00001;
        let cofactors = mat3x3<f32>(cross(R[1], R[2]), cross(R[2], R[0]), cross(R[0], R[1]));
        R = (R + cofactors * (1.0 / dot(R[0], cofactors[0]))) * 0.5;
        if (is_near) { break; }
    }
    return skinbake_dual_quaternion(mat4x4<f32>(
        vec4<f32>(R[0], 0.0), vec4<f32>(R[1], 0.0), vec4<f32>(R[2], 0.0), vec4<f32>(0.0, 0.0, 0.0, 1.0)))[0];
}

// The motion of a joint matrix. Compute it on the host, by joint_scaled_motions() of skinbake's Python package, or in a
// pass over the joints: once per joint and frame, not per vertex.
fn skinbake_scaled_motion(M: mat4x4<f32>) -> skinbake_ScaledMotion {
    let turn = skinbake_turn(M);
    let still = mat4x4<f32>(vec4<f32>(M[0].xyz, 0.0), vec4<f32>(M[1].xyz, 0.0), vec4<f32>(M[2].xyz, 0.0),
            vec4<f32>(M[3].xyz, 0.0));
    let Q = skinbake_ScaledMotion(still, vec4<f32>());
    if (dot(turn, turn) > 0.0) { return skinbake_turning(Q, turn); }
    return Q;
}

#if NUM_BONE_INFLUENCERS > 4
// The frame moves by the derivative of the quotient p' = g / b: b mixes the joints' turns, and g what M p is times them.
// given: the scaled motions of slots 0 to 7.
fn skinbake_dqs_scaled(p: vec3<f32>, frame: skinbake_Frame, given: array<skinbake_ScaledMotion, 8>,
        weights_0: vec4<f32>, weights_1: vec4<f32>, alpha_0: vec3<f32>, alpha_1: vec4<f32>,
        beta_0: vec3<f32>, beta_1: vec4<f32>) -> skinbake_Vertex {
    var Q = given;
    var pivot = Q[0].turn;
    if (dot(pivot, pivot) == 0.0) { pivot = Q[1].turn; }
    if (dot(pivot, pivot) == 0.0) { pivot = Q[2].turn; }
    if (dot(pivot, pivot) == 0.0) { pivot = Q[3].turn; }
    if (dot(pivot, pivot) == 0.0) { pivot = Q[4].turn; }
    if (dot(pivot, pivot) == 0.0) { pivot = Q[5].turn; }
    if (dot(pivot, pivot) == 0.0) { pivot = Q[6].turn; }
    if (dot(pivot, pivot) == 0.0) { pivot = Q[7].turn; }
    if (dot(pivot, pivot) == 0.0) { pivot.w = 1.0; }
    Q[0] = skinbake_turning(Q[0], pivot);
    Q[1] = skinbake_turning(Q[1], pivot);
    Q[2] = skinbake_turning(Q[2], pivot);
    Q[3] = skinbake_turning(Q[3], pivot);
    Q[4] = skinbake_turning(Q[4], pivot);
    Q[5] = skinbake_turning(Q[5], pivot);
    Q[6] = skinbake_turning(Q[6], pivot);
    Q[7] = skinbake_turning(Q[7], pivot);
    let s1 = select(1.0, -1.0, dot(Q[1].turn, Q[0].turn) < 0.0); // 1: q and -q are the same rotation
    let s2 = select(1.0, -1.0, dot(Q[2].turn, Q[0].turn) < 0.0);
    let s3 = select(1.0, -1.0, dot(Q[3].turn, Q[0].turn) < 0.0);
    let s4 = select(1.0, -1.0, dot(Q[4].turn, Q[0].turn) < 0.0);
    let s5 = select(1.0, -1.0, dot(Q[5].turn, Q[0].turn) < 0.0);
    let s6 = select(1.0, -1.0, dot(Q[6].turn, Q[0].turn) < 0.0);
    let s7 = select(1.0, -1.0, dot(Q[7].turn, Q[0].turn) < 0.0);
    let b = weights_0.x * Q[0].turn
          + (s1 * weights_0.y) * Q[1].turn
          + (s2 * weights_0.z) * Q[2].turn
          + (s3 * weights_0.w) * Q[3].turn
          + (s4 * weights_1.x) * Q[4].turn
          + (s5 * weights_1.y) * Q[5].turn
          + (s6 * weights_1.z) * Q[6].turn
          + (s7 * weights_1.w) * Q[7].turn;
    let T = weights_0.x * Q[0].moved
          + (s1 * weights_0.y) * Q[1].moved
          + (s2 * weights_0.z) * Q[2].moved
          + (s3 * weights_0.w) * Q[3].moved
          + (s4 * weights_1.x) * Q[4].moved
          + (s5 * weights_1.y) * Q[5].moved
          + (s6 * weights_1.z) * Q[6].moved
          + (s7 * weights_1.w) * Q[7].moved;
    let square = dot(b, b);
    let divisor = b / select(1.0, square, square > 0.0); // 2
    let g0 = Q[0].moved * vec4<f32>(p, 1.0); // 3
    let g1 = Q[1].moved * vec4<f32>(p, 1.0);
    let g2 = Q[2].moved * vec4<f32>(p, 1.0);
    let g3 = Q[3].moved * vec4<f32>(p, 1.0);
    let g4 = Q[4].moved * vec4<f32>(p, 1.0);
    let g5 = Q[5].moved * vec4<f32>(p, 1.0);
    let g6 = Q[6].moved * vec4<f32>(p, 1.0);
    let g7 = Q[7].moved * vec4<f32>(p, 1.0);
    let m1 = s1 * g1 - g0; // 4
    let r1 = s1 * Q[1].turn - Q[0].turn;
    let m2 = s2 * g2 - g0;
    let r2 = s2 * Q[2].turn - Q[0].turn;
    let m3 = s3 * g3 - g0;
    let r3 = s3 * Q[3].turn - Q[0].turn;
    let m4 = s4 * g4 - g0;
    let r4 = s4 * Q[4].turn - Q[0].turn;
    let m5 = s5 * g5 - g0;
    let r5 = s5 * Q[5].turn - Q[0].turn;
    let m6 = s6 * g6 - g0;
    let r6 = s6 * Q[6].turn - Q[0].turn;
    let m7 = s7 * g7 - g0;
    let r7 = s7 * Q[7].turn - Q[0].turn;
    let g = g0 + weights_0.y * m1 + weights_0.z * m2 + weights_0.w * m3 + weights_1.x * m4
            + weights_1.y * m5 + weights_1.z * m6 + weights_1.w * m7; // 5
    let ratio = vec4<f32>(skinbake_over(g, divisor), dot(g, divisor));
    let tangent = skinbake_over(T * vec4<f32>(frame.tangent, 0.0) + alpha_0.x * m1 + alpha_0.y * m2
            + alpha_0.z * m3 + alpha_1.x * m4 + alpha_1.y * m5 + alpha_1.z * m6
            + alpha_1.w * m7 - skinbake_product(ratio, alpha_0.x * r1 + alpha_0.y * r2 + alpha_0.z * r3
            + alpha_1.x * r4 + alpha_1.y * r5 + alpha_1.z * r6 + alpha_1.w * r7), divisor); // 6
    let bitangent = skinbake_over(T * vec4<f32>(frame.bitangent, 0.0) + beta_0.x * m1 + beta_0.y * m2
            + beta_0.z * m3 + beta_1.x * m4 + beta_1.y * m5 + beta_1.z * m6
            + beta_1.w * m7 - skinbake_product(ratio, beta_0.x * r1 + beta_0.y * r2 + beta_0.z * r3
            + beta_1.x * r4 + beta_1.y * r5 + beta_1.z * r6 + beta_1.w * r7), divisor); // 7
    // A joint that mirrors turns t x b to the inside.
    let x = skinbake_over(T[0], divisor);
    let y = skinbake_over(T[1], divisor);
    let outside = select(1.0, -1.0, dot(cross(x, y), skinbake_over(T[2], divisor)) < 0.0);
    let normal = outside * frame.handedness * cross(tangent, bitangent); // 8
    let carried = skinbake_over(T * vec4<f32>(frame.normal, 0.0), divisor); // 9
    let cotangent = outside * frame.handedness * cross(bitangent, carried); // 10
    let cobitangent = outside * frame.handedness * cross(carried, tangent); // 11
    return skinbake_Vertex(ratio.xyz, normal, tangent, bitangent, cotangent, cobitangent);
}
#else
// The frame moves by the derivative of the quotient p' = g / b: b mixes the joints' turns, and g what M p is times them.
// given: the scaled motions of slots 0 to 3.
fn skinbake_dqs_scaled(p: vec3<f32>, frame: skinbake_Frame, given: array<skinbake_ScaledMotion, 4>,
        weights_0: vec4<f32>, alpha_0: vec3<f32>, beta_0: vec3<f32>) -> skinbake_Vertex {
    var Q = given;
    var pivot = Q[0].turn;
    if (dot(pivot, pivot) == 0.0) { pivot = Q[1].turn; }
    if (dot(pivot, pivot) == 0.0) { pivot = Q[2].turn; }
    if (dot(pivot, pivot) == 0.0) { pivot = Q[3].turn; }
    if (dot(pivot, pivot) == 0.0) { pivot.w = 1.0; }
    Q[0] = skinbake_turning(Q[0], pivot);
    Q[1] = skinbake_turning(Q[1], pivot);
    Q[2] = skinbake_turning(Q[2], pivot);
    Q[3] = skinbake_turning(Q[3], pivot);
    let s1 = select(1.0, -1.0, dot(Q[1].turn, Q[0].turn) < 0.0); // 1: q and -q are the same rotation
    let s2 = select(1.0, -1.0, dot(Q[2].turn, Q[0].turn) < 0.0);
    let s3 = select(1.0, -1.0, dot(Q[3].turn, Q[0].turn) < 0.0);
    let b = weights_0.x * Q[0].turn
          + (s1 * weights_0.y) * Q[1].turn
          + (s2 * weights_0.z) * Q[2].turn
          + (s3 * weights_0.w) * Q[3].turn;
    let T = weights_0.x * Q[0].moved
          + (s1 * weights_0.y) * Q[1].moved
          + (s2 * weights_0.z) * Q[2].moved
          + (s3 * weights_0.w) * Q[3].moved;
    let square = dot(b, b);
    let divisor = b / select(1.0, square, square > 0.0); // 2
    let g0 = Q[0].moved * vec4<f32>(p, 1.0); // 3
    let g1 = Q[1].moved * vec4<f32>(p, 1.0);
    let g2 = Q[2].moved * vec4<f32>(p, 1.0);
    let g3 = Q[3].moved * vec4<f32>(p, 1.0);
    let m1 = s1 * g1 - g0; // 4
    let r1 = s1 * Q[1].turn - Q[0].turn;
    let m2 = s2 * g2 - g0;
    let r2 = s2 * Q[2].turn - Q[0].turn;
    let m3 = s3 * g3 - g0;
    let r3 = s3 * Q[3].turn - Q[0].turn;
    let g = g0 + weights_0.y * m1 + weights_0.z * m2 + weights_0.w * m3; // 5
    let ratio = vec4<f32>(skinbake_over(g, divisor), dot(g, divisor));
    let tangent = skinbake_over(T * vec4<f32>(frame.tangent, 0.0) + alpha_0.x * m1 + alpha_0.y * m2
            + alpha_0.z * m3 - skinbake_product(ratio, alpha_0.x * r1 + alpha_0.y * r2 + alpha_0.z * r3),
            divisor); // 6
    let bitangent = skinbake_over(T * vec4<f32>(frame.bitangent, 0.0) + beta_0.x * m1 + beta_0.y * m2
            + beta_0.z * m3 - skinbake_product(ratio, beta_0.x * r1 + beta_0.y * r2 + beta_0.z * r3),
            divisor); // 7
    // A joint that mirrors turns t x b to the inside.
    let x = skinbake_over(T[0], divisor);
    let y = skinbake_over(T[1], divisor);
    let outside = select(1.0, -1.0, dot(cross(x, y), skinbake_over(T[2], divisor)) < 0.0);
    let normal = outside * frame.handedness * cross(tangent, bitangent); // 8
    let carried = skinbake_over(T * vec4<f32>(frame.normal, 0.0), divisor); // 9
    let cotangent = outside * frame.handedness * cross(bitangent, carried); // 10
    let cobitangent = outside * frame.handedness * cross(carried, tangent); // 11
    return skinbake_Vertex(ratio.xyz, normal, tangent, bitangent, cotangent, cobitangent);
}
#endif
#endif

#if SKINBAKE > 2
// The frame of NORMAL, which must have length 1, and TANGENT.
fn skinbake_frame(n: vec3<f32>, tangent: vec4<f32>) -> skinbake_Frame {
    return skinbake_Frame(n, tangent.xyz, cross(n, tangent.xyz) * tangent.w, tangent.w);
}
#else
// The frame that bake took from NORMAL alone. n must have length 1. Every product in a sum is exact, so a compiler
// that fuses multiply-adds gets the same bits. side is the last factor, because Mesa turns side * ((x * x) * a)
// into side * (x * (x * a)).
fn skinbake_frame(n: vec3<f32>) -> skinbake_Frame {
    let side = select(-1.0, 1.0, n.z >= 0.0); // 1 also at -0.0
    let a = -1.0 / (side + n.z);
    let b = (n.x * n.y) * a;
    let t0 = vec3<f32>(1.0 + ((n.x * n.x) * a) * side, side * b, -side * n.x);
    let b0 = vec3<f32>(b, side * (1.0 + ((n.y * n.y) * a) * side), -n.y);
    return skinbake_Frame(n, t0, b0, 1.0);
}
#endif

#if NUM_BONE_INFLUENCERS > 4
// The frame moves by the derivative of the skinned position along t0 and b0.
// M: the joint matrices of slots 0 to 7.
fn skinbake_lbs_accurate(p: vec3<f32>, frame: skinbake_Frame, M: array<mat4x4<f32>, 8>, weights_0: vec4<f32>,
        weights_1: vec4<f32>, alpha_0: vec3<f32>, alpha_1: vec4<f32>, beta_0: vec3<f32>,
        beta_1: vec4<f32>) -> skinbake_Vertex {
    let T = weights_0.x * skinbake_upper(M[0]) // 1
          + weights_0.y * skinbake_upper(M[1])
          + weights_0.z * skinbake_upper(M[2])
          + weights_0.w * skinbake_upper(M[3])
          + weights_1.x * skinbake_upper(M[4])
          + weights_1.y * skinbake_upper(M[5])
          + weights_1.z * skinbake_upper(M[6])
          + weights_1.w * skinbake_upper(M[7]);
    let q0 = skinbake_moved(M[0], p); // 2
    let q1 = skinbake_moved(M[1], p);
    let q2 = skinbake_moved(M[2], p);
    let q3 = skinbake_moved(M[3], p);
    let q4 = skinbake_moved(M[4], p);
    let q5 = skinbake_moved(M[5], p);
    let q6 = skinbake_moved(M[6], p);
    let q7 = skinbake_moved(M[7], p);
    let d1 = q1 - q0; // 3
    let d2 = q2 - q0;
    let d3 = q3 - q0;
    let d4 = q4 - q0;
    let d5 = q5 - q0;
    let d6 = q6 - q0;
    let d7 = q7 - q0;
    let tangent = T * frame.tangent + alpha_0.x * d1 + alpha_0.y * d2 + alpha_0.z * d3 + alpha_1.x * d4
            + alpha_1.y * d5 + alpha_1.z * d6 + alpha_1.w * d7; // 4
    let bitangent = T * frame.bitangent + beta_0.x * d1 + beta_0.y * d2 + beta_0.z * d3 + beta_1.x * d4
            + beta_1.y * d5 + beta_1.z * d6 + beta_1.w * d7; // 5
    let outside = select(1.0, -1.0, determinant(T) < 0.0); // a joint that mirrors turns t x b to the inside
    let normal = outside * frame.handedness * cross(tangent, bitangent); // 6
    let position = q0 + weights_0.y * d1 + weights_0.z * d2 + weights_0.w * d3 + weights_1.x * d4
            + weights_1.y * d5 + weights_1.z * d6 + weights_1.w * d7; // 7
    let carried = T * frame.normal; // 8
    let cotangent = outside * frame.handedness * cross(bitangent, carried); // 9
    let cobitangent = outside * frame.handedness * cross(carried, tangent); // 10
    return skinbake_Vertex(position, normal, tangent, bitangent, cotangent, cobitangent);
}
#else
// The frame moves by the derivative of the skinned position along t0 and b0.
// M: the joint matrices of slots 0 to 3.
fn skinbake_lbs_accurate(p: vec3<f32>, frame: skinbake_Frame, M: array<mat4x4<f32>, 4>, weights_0: vec4<f32>,
        alpha_0: vec3<f32>, beta_0: vec3<f32>) -> skinbake_Vertex {
    let T = weights_0.x * skinbake_upper(M[0]) // 1
          + weights_0.y * skinbake_upper(M[1])
          + weights_0.z * skinbake_upper(M[2])
          + weights_0.w * skinbake_upper(M[3]);
    let q0 = skinbake_moved(M[0], p); // 2
    let q1 = skinbake_moved(M[1], p);
    let q2 = skinbake_moved(M[2], p);
    let q3 = skinbake_moved(M[3], p);
    let d1 = q1 - q0; // 3
    let d2 = q2 - q0;
    let d3 = q3 - q0;
    let tangent = T * frame.tangent + alpha_0.x * d1 + alpha_0.y * d2 + alpha_0.z * d3; // 4
    let bitangent = T * frame.bitangent + beta_0.x * d1 + beta_0.y * d2 + beta_0.z * d3; // 5
    let outside = select(1.0, -1.0, determinant(T) < 0.0); // a joint that mirrors turns t x b to the inside
    let normal = outside * frame.handedness * cross(tangent, bitangent); // 6
    let position = q0 + weights_0.y * d1 + weights_0.z * d2 + weights_0.w * d3; // 7
    let carried = T * frame.normal; // 8
    let cotangent = outside * frame.handedness * cross(bitangent, carried); // 9
    let cobitangent = outside * frame.handedness * cross(carried, tangent); // 10
    return skinbake_Vertex(position, normal, tangent, bitangent, cotangent, cobitangent);
}
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
    M[0] = skinbake_joint(vertexInputs.matricesIndices.x);
    M[1] = skinbake_joint(vertexInputs.matricesIndices.y);
    M[2] = skinbake_joint(vertexInputs.matricesIndices.z);
    M[3] = skinbake_joint(vertexInputs.matricesIndices.w);
#if NUM_BONE_INFLUENCERS > 4
    M[4] = skinbake_joint(vertexInputs.matricesIndicesExtra.x);
    M[5] = skinbake_joint(vertexInputs.matricesIndicesExtra.y);
    M[6] = skinbake_joint(vertexInputs.matricesIndicesExtra.z);
    M[7] = skinbake_joint(vertexInputs.matricesIndicesExtra.w);
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
    return skinbake_lbs_accurate(p, frame, M, weights_0, weights_1, alpha_0, alpha_1, beta_0, beta_1);
#else
    return skinbake_lbs_accurate(p, frame, M, weights_0, alpha_0, beta_0);
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
