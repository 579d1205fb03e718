// Lighting for skinned meshes that skinbake has baked: dual quaternion skinning, accurate lighting,
// 4 influences a vertex, normal frame.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang hlsl --method dqs --lighting accurate --influences 4 --frame normal
//
// Algorithm 5 of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned
// Models", Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. The numbers beside the lines
// come from its supplement.
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
//
// Q[s] is the dual quaternion of the joint in slot s, made of its joint matrix by skinbake_dual_quaternion(). Row 0
// is its real part, row 1 its dual part. If you store it, take two float4, or row_major float2x4: HLSL's default
// packing, column_major, has another order of the eight floats.
// Use:
//     skinbake_Frame frame = skinbake_frame(normal);
//     skinbake_Vertex v = skinbake_dqs_accurate(position, frame, Q, weights_0, alpha_0, beta_0);
//     // v.position; normalize(v.normal); normalize(v.tangent)

#ifndef SKINBAKE_DQS_ACCURATE_4_NORMAL_HLSL
#define SKINBAKE_DQS_ACCURATE_4_NORMAL_HLSL

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

#ifndef SKINBAKE_HEMISPHERE
#define SKINBAKE_HEMISPHERE
// -1 if the real part of the joint points away from that of the pivot: q and -q are the same rotation.
float skinbake_hemisphere(float2x4 joint, float2x4 pivot)
{
    return dot(joint[0], pivot[0]) < 0.0 ? -1.0 : 1.0;
}
#endif

#ifndef SKINBAKE_ROTATION
#define SKINBAKE_ROTATION
// (Q(p) - p) / 2 of a unit dual quaternion Q.
float3 skinbake_half_displacement(float2x4 Q, float3 p)
{
    float3 i = Q[0].w * p + Q[1].xyz + cross(Q[0].xyz, p);
    return Q[0].w * Q[1].xyz - Q[1].w * Q[0].xyz + cross(Q[0].xyz, i);
}

// v rotated by a unit quaternion q.
float3 skinbake_rotated(float4 q, float3 v)
{
    return v + 2.0 * cross(q.xyz, q.w * v + cross(q.xyz, v));
}
#endif

// The frame moves by the normalised mix b, corrected as if the mix blended positions. Algorithm 6 is exact.
// Q: the dual quaternions of slots 0 to 3.
skinbake_Vertex skinbake_dqs_accurate(float3 p, skinbake_Frame frame, float2x4 Q[4], float4 weights_0,
        float3 alpha_0, float3 beta_0)
{
    float s1 = skinbake_hemisphere(Q[1], Q[0]); // 1
    float s2 = skinbake_hemisphere(Q[2], Q[0]);
    float s3 = skinbake_hemisphere(Q[3], Q[0]);
    float2x4 b = weights_0.x * Q[0]
              + (s1 * weights_0.y) * Q[1]
              + (s2 * weights_0.z) * Q[2]
              + (s3 * weights_0.w) * Q[3];
    float square = dot(b[0], b[0]);
    b *= square > 0.0 ? rsqrt(square) : 1.0; // 2
    skinbake_Vertex v;
    v.position = p + 2.0 * skinbake_half_displacement(b, p); // 3
    float3 q0 = 2.0 * skinbake_half_displacement(Q[0], p); // 4: each joint's Q(p) - p
    float3 q1 = 2.0 * skinbake_half_displacement(Q[1], p);
    float3 q2 = 2.0 * skinbake_half_displacement(Q[2], p);
    float3 q3 = 2.0 * skinbake_half_displacement(Q[3], p);
    float3 d1 = q1 - q0; // 5
    float3 d2 = q2 - q0;
    float3 d3 = q3 - q0;
    v.tangent = skinbake_rotated(b[0], frame.tangent) + alpha_0.x * d1 + alpha_0.y * d2 + alpha_0.z * d3; // 6
    v.bitangent = skinbake_rotated(b[0], frame.bitangent) + beta_0.x * d1 + beta_0.y * d2
            + beta_0.z * d3; // 7
    v.normal = cross(v.tangent, v.bitangent); // 8
    return v;
}

#endif
