// Lighting for skinned meshes that skinbake has baked: linear blend skinning, standard lighting,
// 4 influences a vertex, normal frame.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang hlsl --method lbs --lighting standard --influences 4 --frame normal
//
// Algorithm 1 of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned
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
//
// M[s] is the joint matrix of the joint in slot s: its global transform * its inverse bind matrix. It acts on
// columns, mul(M[s], p), and its rows are M[s][0] to M[s][3]. glTF's sixteen floats of a matrix, and DirectXMath's
// XMFLOAT4X4, arrive like this in a cbuffer or StructuredBuffer with HLSL's default packing, column_major, without
// a transpose. With row_major packing (-Zpr) transpose them first.
// Use:
//     skinbake_Frame frame = skinbake_frame(normal);
//     skinbake_Vertex v = skinbake_lbs_standard(position, frame, M, weights_0);
//     // v.position; normalize(v.normal); normalize(v.tangent)

#ifndef SKINBAKE_LBS_STANDARD_4_NORMAL_HLSL
#define SKINBAKE_LBS_STANDARD_4_NORMAL_HLSL

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

// The frame moves by the blended matrix T, as if the weights were constant over the surface.
// M: the joint matrices of slots 0 to 3.
skinbake_Vertex skinbake_lbs_standard(float3 p, skinbake_Frame frame, float4x4 M[4], float4 weights_0)
{
    float3x4 T = weights_0.x * (float3x4)M[0] // 1
              + weights_0.y * (float3x4)M[1]
              + weights_0.z * (float3x4)M[2]
              + weights_0.w * (float3x4)M[3];
    skinbake_Vertex v;
    v.position = mul(T, float4(p, 1.0)); // 2
    v.normal = mul((float3x3)T, frame.normal); // 3
    v.tangent = mul((float3x3)T, frame.tangent); // 4
    v.bitangent = mul((float3x3)T, frame.bitangent); // 5
    return v;
}

#endif
