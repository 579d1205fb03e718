// Lighting for skinned meshes that skinbake has baked: blended skinning, accurate lighting,
// 4 influences a vertex, normal frame, joints that scale, mirrored joints.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang glsl --method blend --lighting accurate --influences 4 --frame normal --scaled-joints --mirrored-joints
//
// Algorithm 6 of skinbake: the exact derivative of the dual-quaternion blend, after M. Tarini, D. Panozzo,
// O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned Models", Computer Graphics Forum 33(2),
// 2014, doi:10.1111/cgf.12330. The numbers beside the lines come from `skinbake cost`.
// Beside it, algorithm 3 of the paper, and the derivative of what lies between both.
// Dual quaternions: L. Kavan, S. Collins, J. Zara, C. O'Sullivan, "Skinning with Dual Quaternions", I3D 2007.
// Frame: T. Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.
// Compiles as GLSL ES 3.00, 3.30 and 4.50. Pure functions: no attributes, uniforms or globals.
//
// Inputs of each vertex, in mesh space: the attributes as they are stored, before any joint matrix:
//     POSITION             vec3   p, in the file's unit of length
//     NORMAL               vec3   n0, of length 1: normalize() it if it is stored as integers
//     JOINTS_0             uvec4  joints of slots 0 to 3
//     WEIGHTS_0            vec4   w of slots 0 to 3; over all slots they sum to 1
//     _SKINBAKE_ALPHA_0    vec3   alpha = grad w . t0 of slots 1 to 3, in 1 / unit of POSITION
//     _SKINBAKE_BETA_0     vec3   beta = grad w . b0 of the same slots
// alpha and beta of slot 0 are not stored: they are minus the sums over the other slots.
//     b                    float  the blend weight: the attribute of bake --blend
//     _SKINBAKE_BLEND      vec2   grad b . t0 and grad b . b0 of the blend weight b, in 1 / unit of POSITION
//
// M[s] is the joint matrix of the joint in slot s: its global transform * its inverse bind matrix.
// Q[s] is the scaled motion of the joint in slot s, made of its joint matrix by skinbake_scaled_motion().
// blend.x is the blend weight, 0 for linear blending to 1 for dual quaternions; blend.yz is _SKINBAKE_BLEND.
// Use:
//     skinbake_Frame frame = skinbake_frame(normal);
//     skinbake_Vertex v = skinbake_blend_scaled(position, frame, M, Q, weights_0, alpha_0, beta_0, blend);
//     // v.position; normalize(v.normal); normalize(v.tangent)

#ifndef SKINBAKE_BLEND_SCALED_4_NORMAL_MIRRORED_GLSL
#define SKINBAKE_BLEND_SCALED_4_NORMAL_MIRRORED_GLSL

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

#ifndef SKINBAKE_MOVED
#define SKINBAKE_MOVED
// M p: the position p moved by the joint matrix M alone.
vec3 skinbake_moved(mat4 M, vec3 p)
{
    return M[0].xyz * p.x + (M[1].xyz * p.y + (M[2].xyz * p.z + M[3].xyz));
}
#endif

#ifndef SKINBAKE_LBS_ACCURATE_4_NORMAL_MIRRORED_GLSL
#define SKINBAKE_LBS_ACCURATE_4_NORMAL_MIRRORED_GLSL
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
    v.normal = cross(v.tangent, v.bitangent); // 6
    float outside = determinant(T) < 0.0 ? -1.0 : 1.0; // a joint that mirrors turns t x b to the inside
    v.normal *= outside;
    v.position = q0 + weights_0.y * d1 + weights_0.z * d2 + weights_0.w * d3; // 7
    return v;
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

#ifndef SKINBAKE_DQS_SCALED_4_NORMAL_MIRRORED_GLSL
#define SKINBAKE_DQS_SCALED_4_NORMAL_MIRRORED_GLSL
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
    v.normal = cross(v.tangent, v.bitangent); // 8
    // A joint that mirrors turns t x b to the inside.
    vec3 x = skinbake_over(T[0], divisor);
    vec3 y = skinbake_over(T[1], divisor);
    float outside = dot(cross(x, y), skinbake_over(T[2], divisor)) < 0.0 ? -1.0 : 1.0;
    v.normal *= outside;
    return v;
}
#endif

// Each vertex lies between linear blending, l, and dual quaternions, d: p' = l + b (d - l).
// blend: the blend weight b, and its derivatives along t0 and b0, by which d - l is a part of t' and b'.
// M: the joint matrices of slots 0 to 3. Q: what is made of them.
skinbake_Vertex skinbake_blend_scaled(vec3 p, skinbake_Frame frame, mat4 M[4], skinbake_ScaledMotion Q[4],
        vec4 weights_0, vec3 alpha_0, vec3 beta_0, vec3 blend)
{
    skinbake_Vertex l = skinbake_lbs_accurate(p, frame, M, weights_0, alpha_0, beta_0);
    skinbake_Vertex v = skinbake_dqs_scaled(p, frame, Q, weights_0, alpha_0, beta_0);
    vec3 apart = v.position - l.position;
    v.position = l.position + blend.x * apart;
    v.tangent = mix(l.tangent, v.tangent, blend.x) + blend.y * apart;
    v.bitangent = mix(l.bitangent, v.bitangent, blend.x) + blend.z * apart;
    // On the side that linear blending has, outside.
    float side = dot(cross(l.tangent, l.bitangent), l.normal) < 0.0 ? -1.0 : 1.0;
    v.normal = side * cross(v.tangent, v.bitangent);
    return v;
}

#endif
