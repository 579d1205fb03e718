// Lighting for skinned meshes that skinbake has baked: linear blend skinning, direct lighting,
// 4 influences a vertex, tangent frame.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang hlsl --method lbs --lighting direct --influences 4 --frame tangent
//
// Algorithm 2 of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned
// Models", Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. The numbers beside the lines
// come from its supplement.
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
// M[s] is the joint matrix of the joint in slot s: its global transform * its inverse bind matrix. It acts on
// columns, mul(M[s], p), and its rows are M[s][0] to M[s][3]. glTF's sixteen floats of a matrix, and DirectXMath's
// XMFLOAT4X4, arrive like this in a cbuffer or StructuredBuffer with HLSL's default packing, column_major, without
// a transpose. With row_major packing (-Zpr) transpose them first.
// Use:
//     skinbake_Frame frame = skinbake_frame(normal, tangent);
//     float3 a[4];
//     skinbake_gradients(frame, alpha_0, beta_0, a);
//     skinbake_Vertex v = skinbake_lbs_direct(position, frame, M, weights_0, a);
//     // v.position; normalize(v.normal); normalize(v.tangent)

#ifndef SKINBAKE_LBS_DIRECT_4_TANGENT_HLSL
#define SKINBAKE_LBS_DIRECT_4_TANGENT_HLSL

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

#ifndef SKINBAKE_MOVED
#define SKINBAKE_MOVED
// M p: the position p moved by the joint matrix M alone.
float3 skinbake_moved(float4x4 M, float3 p)
{
    return mul((float3x4)M, float4(p, 1.0));
}
#endif

// The weight gradients of all slots from alpha and beta: a[s] = alpha[s] t0 + beta[s] b0.
void skinbake_gradients(skinbake_Frame frame, float3 alpha_0, float3 beta_0, out float3 a[4])
{
    a[1] = alpha_0.x * frame.tangent + beta_0.x * frame.bitangent;
    a[2] = alpha_0.y * frame.tangent + beta_0.y * frame.bitangent;
    a[3] = alpha_0.z * frame.tangent + beta_0.z * frame.bitangent;
    a[0] = -(a[1] + a[2] + a[3]);
}

#ifndef SKINBAKE_OUTER
#define SKINBAKE_OUTER
// The matrix q a^T: its rows are multiples of a.
float3x3 skinbake_outer(float3 q, float3 a)
{
    return float3x3(q.x * a, q.y * a, q.z * a);
}
#endif

// The frame moves by the Jacobian J of the skinned position, the normal by its inverse transpose.
// M: the joint matrices of slots 0 to 3; a: their weight gradients, as skinbake_gradients() gives them.
skinbake_Vertex skinbake_lbs_direct(float3 p, skinbake_Frame frame, float4x4 M[4], float4 weights_0,
        float3 a[4])
{
    float3x4 T = weights_0.x * (float3x4)M[0] // 1
              + weights_0.y * (float3x4)M[1]
              + weights_0.z * (float3x4)M[2]
              + weights_0.w * (float3x4)M[3];
    float3 q0 = skinbake_moved(M[0], p); // 2
    float3 q1 = skinbake_moved(M[1], p);
    float3 q2 = skinbake_moved(M[2], p);
    float3 q3 = skinbake_moved(M[3], p);
    float3x3 J = (float3x3)T // 3
        + skinbake_outer(q0, a[0])
        + skinbake_outer(q1, a[1])
        + skinbake_outer(q2, a[2])
        + skinbake_outer(q3, a[3]);
    float3x3 C = float3x3(cross(J[1], J[2]), cross(J[2], J[0]), cross(J[0], J[1])); // 4: J^-T = C / det J
    float det = dot(J[0], C[0]);
    skinbake_Vertex v;
    v.position = mul(T, float4(p, 1.0)); // 5
    v.normal = (mul(C, frame.normal)) * (det == 0.0 ? 1.0 : 1.0 / det); // 6
    v.tangent = mul(J, frame.tangent); // 7
    v.bitangent = mul(J, frame.bitangent); // 8
    return v;
}

#endif
