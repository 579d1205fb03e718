// Shader text, written by skinbake 0.1.0:
//     skinbake shader --lang glsl --method lbs --lighting accurate --influences 4 --frame normal --target galacean
//
// Algorithm 3 of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned Models",
// Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. Frame: T. Duff et al., "Building an Orthonormal
// Basis, Revisited", JCGT 6(1), 2017. Dual quaternions: the exact derivative of their blend, for joints that may scale,
// which is skinbake's own.

export const METHOD = 'lbs';

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

#ifdef RENDERER_SKINBAKE_DUAL
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
    M[0] = skinbake_joint(JOINTS_0.x);
    M[1] = skinbake_joint(JOINTS_0.y);
    M[2] = skinbake_joint(JOINTS_0.z);
    M[3] = skinbake_joint(JOINTS_0.w);
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
    return skinbake_lbs_accurate(p, frame, M, weights_0, alpha_0, beta_0);
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
