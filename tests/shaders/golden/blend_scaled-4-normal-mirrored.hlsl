// Lighting for skinned meshes that skinbake has baked: blended skinning, accurate lighting,
// 4 influences a vertex, normal frame, joints that scale, mirrored joints.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang hlsl --method blend --lighting accurate --influences 4 --frame normal --scaled-joints --mirrored-joints
//
// Algorithm 6 of skinbake: the exact derivative of the dual-quaternion blend, after M. Tarini, D. Panozzo,
// O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned Models", Computer Graphics Forum 33(2),
// 2014, doi:10.1111/cgf.12330. The numbers beside the lines come from `skinbake cost`.
// Beside it, algorithm 3 of the paper, and the derivative of what lies between both.
// Dual quaternions: L. Kavan, S. Collins, J. Zara, C. O'Sullivan, "Skinning with Dual Quaternions", I3D 2007.
// Frame: T. Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.
// HLSL of shader model 5. Pure functions: no semantics, buffers or globals.
//
// Inputs of each vertex, in mesh space: the attributes as they are stored, before any joint matrix:
//     POSITION             float3  p, in the file's unit of length
//     NORMAL               float3  n0, of length 1: normalize() it if it is stored as integers
//     JOINTS_0             uint4   joints of slots 0 to 3
//     WEIGHTS_0            float4  w of slots 0 to 3; over all slots they sum to 1
//     _SKINBAKE_ALPHA_0    float3  alpha = grad w . t0 of slots 1 to 3, in 1 / unit of POSITION
//     _SKINBAKE_BETA_0     float3  beta = grad w . b0 of the same slots
// alpha and beta of slot 0 are not stored: they are minus the sums over the other slots.
//     b                    float   the blend weight: the attribute of bake --blend
//     _SKINBAKE_BLEND      float2  grad b . t0 and grad b . b0 of the blend weight b, in 1 / unit of POSITION
//
// M[s] is the joint matrix of the joint in slot s: its global transform * its inverse bind matrix. It acts on
// columns, mul(M[s], p), and its rows are M[s][0] to M[s][3]. glTF's sixteen floats of a matrix, and DirectXMath's
// XMFLOAT4X4, arrive like this in a cbuffer or StructuredBuffer with HLSL's default packing, column_major, without
// a transpose. With row_major packing (-Zpr) transpose them first.
// Q[s] is the scaled motion of the joint in slot s, made of its joint matrix by skinbake_scaled_motion().
// blend.x is the blend weight, 0 for linear blending to 1 for dual quaternions; blend.yz is _SKINBAKE_BLEND.
// Use:
//     skinbake_Frame frame = skinbake_frame(normal);
//     skinbake_Vertex v = skinbake_blend_scaled(position, frame, M, Q, weights_0, alpha_0, beta_0, blend);
//     // v.position; normalize(v.normal); normalize(v.tangent)

#ifndef SKINBAKE_BLEND_SCALED_4_NORMAL_MIRRORED_HLSL
#define SKINBAKE_BLEND_SCALED_4_NORMAL_MIRRORED_HLSL

#ifndef SKINBAKE_VERTEX
#define SKINBAKE_VERTEX
// A skinned vertex. Its vectors have any length. tangent and bitangent are the images of t0 and b0.
struct skinbake_Vertex {
    float3 position;
    float3 normal;
    float3 tangent;
    float3 bitangent;
};

// The tangent frame at rest.
struct skinbake_Frame {
    float3 normal;
    float3 tangent;
    float3 bitangent;
    float handedness; // n0 = handedness * cross(t0, b0) / |t0|^2
};
#endif

#ifndef SKINBAKE_FRAME_FROM_NORMAL
#define SKINBAKE_FRAME_FROM_NORMAL
// The frame that bake took from NORMAL alone. n must have length 1. Every product in a sum is exact, so a compiler
// that fuses multiply-adds gets the same bits. side is the last factor, because Mesa turns side * ((x * x) * a)
// into side * (x * (x * a)).
skinbake_Frame skinbake_frame(float3 n)
{
    float side = n.z >= 0.0 ? 1.0 : -1.0; // 1 also at -0.0
    float a = -1.0 / (side + n.z);
    float b = (n.x * n.y) * a;
    float3 t0 = float3(1.0 + ((n.x * n.x) * a) * side, side * b, -side * n.x);
    float3 b0 = float3(b, side * (1.0 + ((n.y * n.y) * a) * side), -n.y);
    skinbake_Frame made = { n, t0, b0, 1.0 };
    return made;
}
#endif

#ifndef SKINBAKE_MOVED
#define SKINBAKE_MOVED
// M p: the position p moved by the joint matrix M alone.
float3 skinbake_moved(float4x4 M, float3 p)
{
    return mul((float3x4)M, float4(p, 1.0));
}
#endif

#ifndef SKINBAKE_LBS_ACCURATE_4_NORMAL_MIRRORED_HLSL
#define SKINBAKE_LBS_ACCURATE_4_NORMAL_MIRRORED_HLSL
// The frame moves by the derivative of the skinned position along t0 and b0.
// M: the joint matrices of slots 0 to 3.
skinbake_Vertex skinbake_lbs_accurate(float3 p, skinbake_Frame frame, float4x4 M[4], float4 weights_0,
        float3 alpha_0, float3 beta_0)
{
    float3x3 T = weights_0.x * (float3x3)M[0] // 1
            + weights_0.y * (float3x3)M[1]
            + weights_0.z * (float3x3)M[2]
            + weights_0.w * (float3x3)M[3];
    float3 q0 = skinbake_moved(M[0], p); // 2
    float3 q1 = skinbake_moved(M[1], p);
    float3 q2 = skinbake_moved(M[2], p);
    float3 q3 = skinbake_moved(M[3], p);
    float3 d1 = q1 - q0; // 3
    float3 d2 = q2 - q0;
    float3 d3 = q3 - q0;
    skinbake_Vertex v;
    v.tangent = mul(T, frame.tangent) + alpha_0.x * d1 + alpha_0.y * d2 + alpha_0.z * d3; // 4
    v.bitangent = mul(T, frame.bitangent) + beta_0.x * d1 + beta_0.y * d2 + beta_0.z * d3; // 5
    v.normal = cross(v.tangent, v.bitangent); // 6
    float outside = determinant(T) < 0.0 ? -1.0 : 1.0; // a joint that mirrors turns t x b to the inside
    v.normal *= outside;
    v.position = q0 + weights_0.y * d1 + weights_0.z * d2 + weights_0.w * d3; // 7
    return v;
}
#endif

#ifndef SKINBAKE_DUAL_QUATERNION
#define SKINBAKE_DUAL_QUATERNION
// The unit dual quaternion of a rigid joint matrix. Row [0] is its real part (x, y, z, w), w the scalar; row [1] is
// its dual part. Compute it on the host or in a pass over the joints: once per joint and frame, not per vertex.
// Dual quaternions have no scale. If all joint matrices share a uniform scale s, divide their upper 3x3 parts by
// s first, and skin s * p, s * t0, s * b0 in place of p, t0, b0.
float2x4 skinbake_dual_quaternion(float4x4 M)
{
    float3 d = float3(M[0].x, M[1].y, M[2].z);
    float4 squares = 1.0 + float4( // 4 * (x, y, z, w)^2
        d.x - d.y - d.z, d.y - d.z - d.x, d.z - d.x - d.y, d.x + d.y + d.z);
    float3 differences = float3(M[2].y - M[1].z, M[0].z - M[2].x, M[1].x - M[0].y); // 4 w * (x, y, z)
    float3 sums = float3(M[2].y + M[1].z, M[0].z + M[2].x, M[1].x + M[0].y); // 4 * (yz, zx, xy)
    float4 real = float4(differences, squares.w);
    float largest = squares.w;
    if (squares.x > largest) {
        largest = squares.x;
        real = float4(squares.x, sums.z, sums.y, differences.x);
    }
    if (squares.y > largest) {
        largest = squares.y;
        real = float4(sums.z, squares.y, sums.x, differences.y);
    }
    if (squares.z > largest) {
        real = float4(sums.y, sums.x, squares.z, differences.z);
    }
    real = normalize(real);
    float3 t = float3(M[0].w, M[1].w, M[2].w);
    return float2x4(real, 0.5 * float4(cross(t, real.xyz) + real.w * t, -dot(t, real.xyz)));
}
#endif

#ifndef SKINBAKE_PRODUCT
#define SKINBAKE_PRODUCT
// The product of two quaternions.
float4 skinbake_product(float4 a, float4 b)
{
    return float4(a.w * b.xyz + b.w * a.xyz + cross(a.xyz, b.xyz), a.w * b.w - dot(a.xyz, b.xyz));
}
#endif

#ifndef SKINBAKE_SCALED_JOINT
#define SKINBAKE_SCALED_JOINT
// A joint that may scale, shear or mirror. Quaternions are (x, y, z, w), w the scalar. turn is the rotation of the joint
// matrix, and the rows of moved are the matrix's columns times it. Store five float4: default packing has another order.
struct skinbake_ScaledMotion {
    float4x4 moved;
    float4 turn;
};

// A motion that has a rotation. A joint that leaves a line or a point, as at scale 0, has none: its turn is 0, and moved has
// the columns of the matrix. It takes another's.
skinbake_ScaledMotion skinbake_turning(skinbake_ScaledMotion Q, float4 turn)
{
    if (dot(Q.turn, Q.turn) > 0.0) return Q;
    for (int i = 0; i < 4; i++)
        Q.moved[i] = float4(turn.w * Q.moved[i].xyz + cross(Q.moved[i].xyz, turn.xyz), -dot(Q.moved[i].xyz,
                turn.xyz));
    Q.turn = turn;
    return Q;
}

// The vector of a over a quaternion, which is given as itself / its squared length.
float3 skinbake_over(float4 a, float4 divisor)
{
    return divisor.w * a.xyz - a.w * divisor.xyz + cross(divisor.xyz, a.xyz);
}
#endif

#ifndef SKINBAKE_SCALED_MOTION
#define SKINBAKE_SCALED_MOTION
// The unit quaternion of the rotation R in the polar decomposition M = R S, or in that of -M where M mirrors, by Newton's
// iteration (Higham 1986). A joint that flattens does not mirror. One that leaves a line or a point has no
// rotation: zeros.
float4 skinbake_turn(float3x3 M)
{
    float3x3 R = M * (1.0 / max(sqrt(dot(M[0], M[0]) + dot(M[1], M[1]) + dot(M[2], M[2])), 1e-30));
    float3x3 C = float3x3(cross(R[1], R[2]), cross(R[2], R[0]), cross(R[0], R[1]));
    float area = sqrt(dot(C[0], C[0]) + dot(C[1], C[1]) + dot(C[2], C[2]));
    if (area <= 1e-6)
        return float4(0.0, 0.0, 0.0, 0.0);
    // The cofactors have the same rotation, and an extent where M has none.
    R = R * (dot(R[0], C[0]) < -1e-6 * area ? -1.0 : 1.0) + C * (1.0 / area);
    R = R * (1.0 / pow(dot(cross(R[0], R[1]), R[2]), 1.0 / 3.0));
    for (int i = 0; i < 12; i++) {
        // The volume is at least 1, so the squares sum to 3 where R is a rotation.
        bool is_near = dot(R[0], R[0]) + dot(R[1], R[1]) + dot(R[2], R[2]) < 3.00001;
        float3x3 cofactors = float3x3(cross(R[1], R[2]), cross(R[2], R[0]), cross(R[0], R[1]));
        R = 0.5 * (R + cofactors * (1.0 / dot(R[0], cofactors[0])));
        if (is_near) break;
    }
    return skinbake_dual_quaternion(float4x4(float4(R[0], 0.0), float4(R[1], 0.0), float4(R[2], 0.0),
            float4(0.0, 0.0, 0.0, 1.0)))[0];
}

// The motion of a joint matrix. Compute it on the host, by joint_scaled_motions() of skinbake's Python package, or in a
// pass over the joints: once per joint and frame, not per vertex.
skinbake_ScaledMotion skinbake_scaled_motion(float4x4 M)
{
    float4 turn = skinbake_turn((float3x3)M);
    skinbake_ScaledMotion Q;
    float4x4 columns = transpose(M);
    for (int i = 0; i < 4; i++)
        Q.moved[i] = float4(columns[i].xyz, 0.0);
    Q.turn = float4(0.0, 0.0, 0.0, 0.0);
    if (dot(turn, turn) > 0.0)
        return skinbake_turning(Q, turn);
    return Q;
}
#endif

#ifndef SKINBAKE_DQS_SCALED_4_NORMAL_MIRRORED_HLSL
#define SKINBAKE_DQS_SCALED_4_NORMAL_MIRRORED_HLSL
// The frame moves by the derivative of the quotient p' = g / b: b mixes the joints' turns, and g what M p is times them.
// Q: the scaled motions of slots 0 to 3.
skinbake_Vertex skinbake_dqs_scaled(float3 p, skinbake_Frame frame, skinbake_ScaledMotion Q[4],
        float4 weights_0, float3 alpha_0, float3 beta_0)
{
    float4 pivot = Q[0].turn;
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
    float4 b = weights_0.x * Q[0].turn
           + (s1 * weights_0.y) * Q[1].turn
           + (s2 * weights_0.z) * Q[2].turn
           + (s3 * weights_0.w) * Q[3].turn;
    float4x4 T = weights_0.x * Q[0].moved
           + (s1 * weights_0.y) * Q[1].moved
           + (s2 * weights_0.z) * Q[2].moved
           + (s3 * weights_0.w) * Q[3].moved;
    float square = dot(b, b);
    float4 divisor = b / (square > 0.0 ? square : 1.0); // 2
    float4 g0 = mul(float4(p, 1.0), Q[0].moved); // 3
    float4 g1 = mul(float4(p, 1.0), Q[1].moved);
    float4 g2 = mul(float4(p, 1.0), Q[2].moved);
    float4 g3 = mul(float4(p, 1.0), Q[3].moved);
    float4 m1 = s1 * g1 - g0; // 4
    float4 r1 = s1 * Q[1].turn - Q[0].turn;
    float4 m2 = s2 * g2 - g0;
    float4 r2 = s2 * Q[2].turn - Q[0].turn;
    float4 m3 = s3 * g3 - g0;
    float4 r3 = s3 * Q[3].turn - Q[0].turn;
    float4 g = g0 + weights_0.y * m1 + weights_0.z * m2 + weights_0.w * m3; // 5
    float4 ratio = float4(skinbake_over(g, divisor), dot(g, divisor));
    skinbake_Vertex v;
    v.position = ratio.xyz;
    v.tangent = skinbake_over(mul(float4(frame.tangent, 0.0), T) + alpha_0.x * m1 + alpha_0.y * m2
            + alpha_0.z * m3 - skinbake_product(ratio, alpha_0.x * r1 + alpha_0.y * r2 + alpha_0.z * r3),
            divisor); // 6
    v.bitangent = skinbake_over(mul(float4(frame.bitangent, 0.0), T) + beta_0.x * m1 + beta_0.y * m2
            + beta_0.z * m3 - skinbake_product(ratio, beta_0.x * r1 + beta_0.y * r2 + beta_0.z * r3),
            divisor); // 7
    v.normal = cross(v.tangent, v.bitangent); // 8
    // A joint that mirrors turns t x b to the inside.
    float3 x = skinbake_over(T[0], divisor);
    float3 y = skinbake_over(T[1], divisor);
    float outside = dot(cross(x, y), skinbake_over(T[2], divisor)) < 0.0 ? -1.0 : 1.0;
    v.normal *= outside;
    return v;
}
#endif

// Each vertex lies between linear blending, l, and dual quaternions, d: p' = l + b (d - l).
// blend: the blend weight b, and its derivatives along t0 and b0, by which d - l is a part of t' and b'.
// M: the joint matrices of slots 0 to 3. Q: what is made of them.
skinbake_Vertex skinbake_blend_scaled(float3 p, skinbake_Frame frame, float4x4 M[4],
        skinbake_ScaledMotion Q[4], float4 weights_0, float3 alpha_0, float3 beta_0, float3 blend)
{
    skinbake_Vertex l = skinbake_lbs_accurate(p, frame, M, weights_0, alpha_0, beta_0);
    skinbake_Vertex v = skinbake_dqs_scaled(p, frame, Q, weights_0, alpha_0, beta_0);
    float3 apart = v.position - l.position;
    v.position = l.position + blend.x * apart;
    v.tangent = lerp(l.tangent, v.tangent, blend.x) + blend.y * apart;
    v.bitangent = lerp(l.bitangent, v.bitangent, blend.x) + blend.z * apart;
    // On the side that linear blending has, outside.
    float side = dot(cross(l.tangent, l.bitangent), l.normal) < 0.0 ? -1.0 : 1.0;
    v.normal = side * cross(v.tangent, v.bitangent);
    return v;
}

#endif
