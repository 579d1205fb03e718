// Lighting for skinned meshes that skinbake has baked: dual quaternion skinning, exact lighting,
// 4 influences a vertex, tangent frame.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang hlsl --method dqs --lighting exact --influences 4 --frame tangent
//
// Algorithm 6 of skinbake: the exact derivative of the dual-quaternion blend, after M. Tarini, D. Panozzo,
// O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned Models", Computer Graphics Forum 33(2),
// 2014, doi:10.1111/cgf.12330. The numbers beside the lines come from `skinbake cost`.
// Dual quaternions: L. Kavan, S. Collins, J. Zara, C. O'Sullivan, "Skinning with Dual Quaternions", I3D 2007.
// HLSL of shader model 5. Pure functions: no semantics, buffers or globals.
//
// Inputs of each vertex, in mesh space: the attributes as they are stored, before any joint matrix:
//     POSITION             float3  p, in the file's unit of length
//     NORMAL               float3  n0, of length 1: normalize() it if it is stored as integers
//     TANGENT              float4  t0, and in w the handedness of the frame, 1 or -1
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
//     skinbake_Frame frame = skinbake_frame(normal, tangent);
//     skinbake_Vertex v = skinbake_dqs_exact(position, frame, Q, weights_0, alpha_0, beta_0);
//     // v.position; normalize(v.normal); normalize(v.tangent)

#ifndef SKINBAKE_DQS_EXACT_4_TANGENT_HLSL
#define SKINBAKE_DQS_EXACT_4_TANGENT_HLSL

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

#ifndef SKINBAKE_FRAME_FROM_TANGENT
#define SKINBAKE_FRAME_FROM_TANGENT
// The frame of NORMAL, which must have length 1, and TANGENT.
skinbake_Frame skinbake_frame(float3 n, float4 tangent)
{
    skinbake_Frame made = { n, tangent.xyz, cross(n, tangent.xyz) * tangent.w, tangent.w };
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

#ifndef SKINBAKE_DERIVATIVE
#define SKINBAKE_DERIVATIVE
// The derivative of p + delta along t, if the mix b changes at the rate db. delta = k h, and i is as in the caller.
float3 skinbake_derivative(float2x4 b, float k, float3 p, float3 i, float3 delta, float3 t, float2x4 db)
{
    float3 di = b[0].w * t + db[1].xyz + cross(b[0].xyz, t) + db[0].w * p + cross(db[0].xyz, p);
    float3 dh = b[0].w * db[1].xyz + cross(b[0].xyz, di) + cross(db[0].xyz, i)
            + db[0].w * b[1].xyz - db[1].w * b[0].xyz - b[1].w * db[0].xyz - dot(b[0], db[0]) * delta;
    return t + k * dh;
}
#endif

// The frame moves by the derivative of the motion p' = p + delta of the mix, delta = k h,
//     i = r x p + r0 p + d, h = r x i + r0 d - d0 r, k = 2 / (r0^2 + |r|^2), the mix b = (r0, r, d0, d).
// Q: the dual quaternions of slots 0 to 3.
skinbake_Vertex skinbake_dqs_exact(float3 p, skinbake_Frame frame, float2x4 Q[4], float4 weights_0,
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
    float k = square == 0.0 ? 2.0 : 2.0 / square; // 2
    float3 i = b[0].w * p + b[1].xyz + cross(b[0].xyz, p); // 3
    float3 delta = k * (b[0].w * b[1].xyz - b[1].w * b[0].xyz + cross(b[0].xyz, i));
    skinbake_Vertex v;
    v.position = p + delta;
    float2x4 D1 = s1 * Q[1] - Q[0]; // 4
    float2x4 D2 = s2 * Q[2] - Q[0];
    float2x4 D3 = s3 * Q[3] - Q[0];
    float2x4 db_t = alpha_0.x * D1 + alpha_0.y * D2 + alpha_0.z * D3; // 5
    float2x4 db_b = beta_0.x * D1 + beta_0.y * D2 + beta_0.z * D3; // 6
    v.tangent = skinbake_derivative(b, k, p, i, delta, frame.tangent, db_t); // 7
    v.bitangent = skinbake_derivative(b, k, p, i, delta, frame.bitangent, db_b); // 8
    v.normal = frame.handedness * cross(v.tangent, v.bitangent); // 9
    return v;
}

#endif
