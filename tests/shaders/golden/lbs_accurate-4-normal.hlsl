// Lighting for skinned meshes that skinbake has baked: linear blend skinning, accurate lighting,
// 4 influences a vertex, normal frame.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang hlsl --method lbs --lighting accurate --influences 4 --frame normal
//
// Algorithm 3 of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned
// Models", Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. The numbers beside the lines
// come from its supplement.
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
// M[s] is the joint matrix of the joint in slot s: its global transform * its inverse bind matrix. It acts on
// columns, mul(M[s], p), and its rows are M[s][0] to M[s][3]. glTF's sixteen floats of a matrix, and DirectXMath's
// XMFLOAT4X4, arrive like this in a cbuffer or StructuredBuffer with HLSL's default packing, column_major, without
// a transpose. With row_major packing (-Zpr) transpose them first.
// Use:
//     skinbake_Frame frame = skinbake_frame(normal);
//     skinbake_Vertex v = skinbake_lbs_accurate(position, frame, M, weights_0, alpha_0, beta_0);
//     // v.position; normalize(v.normal); normalize(v.tangent)

#ifndef SKINBAKE_LBS_ACCURATE_4_NORMAL_HLSL
#define SKINBAKE_LBS_ACCURATE_4_NORMAL_HLSL

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
    v.position = q0 + weights_0.y * d1 + weights_0.z * d2 + weights_0.w * d3; // 7
    return v;
}

#endif
