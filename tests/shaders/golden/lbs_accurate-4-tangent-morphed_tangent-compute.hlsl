// Lighting for skinned meshes that skinbake has baked: linear blend skinning, accurate lighting,
// 4 influences a vertex, tangent frame, morph targets by tangent.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang hlsl --method lbs --lighting accurate --influences 4 --frame tangent --morphs tangent --stage compute
//
// Algorithm 3 of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned
// Models", Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. The numbers beside the lines
// come from its supplement.
// A compute pass in HLSL of shader model 5.
//
// Inputs of each vertex, in mesh space: the attributes as they are stored, before any joint matrix:
//     POSITION             float3  p, in the file's unit of length
//     NORMAL               float3  n0, of any length
//     TANGENT              float4  t0, and in w the handedness of the frame, 1 or -1
//     JOINTS_0             uint4   joints of slots 0 to 3
//     WEIGHTS_0            float4  w of slots 0 to 3; over all slots they sum to 1
//     _SKINBAKE_ALPHA_0    float3  alpha = grad w . t0 of slots 1 to 3, in 1 / unit of POSITION
//     _SKINBAKE_BETA_0     float3  beta = grad w . b0 of the same slots
// alpha and beta of slot 0 are not stored: they are minus the sums over the other slots.
//
// M[s] is the joint matrix of the joint in slot s: its global transform * its inverse bind matrix, glTF's sixteen
// floats in HLSL's default packing, column_major.
// Bindings:
//     0  skinbake_draw      uniform: the numbers of one primitive; vertices, offsets and strides are set for each
//     1  skinbake_geometry  the bytes of glTF's buffer, as they are
//     2  skinbake_joints    the motions of the joints in this pose
//     3  skinbake_posed     the results: position and normal of three floats, tangent of four
//     4  skinbake_targets   the morph targets of the primitive
// An attribute is given as two numbers, in bytes: where its first value begins, and how far on the next one begins.
// Floats are read, but for JOINTS_n and WEIGHTS_n, of which joint_size and weight_size are the bytes of a component:
// 1, 2 or 4; weights of 4 are floats. Expand other types, sparse accessors and compressed geometry beforehand.
// skinbake_posed has posed_stride bytes a vertex; 0xffffffff for a result leaves it out. Normal and tangent have
// length 1. tangent is the image of t0, and its w the handedness of the result.
// Dispatch vertices / 64 workgroups, rounded up.

#ifndef SKINBAKE_LBS_ACCURATE_4_TANGENT_MORPHED_TANGENT_COMPUTE_HLSL
#define SKINBAKE_LBS_ACCURATE_4_TANGENT_MORPHED_TANGENT_COMPUTE_HLSL

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

#ifndef SKINBAKE_MORPHED
#define SKINBAKE_MORPHED
// The frame under morph targets, by the morphed normal n: NORMAL plus the weighted sum of its targets, of any
// length. The frame at rest turns by the smallest rotation that takes its normal to n. Do not use
// skinbake_frame(n): alpha and beta belong to the frame at rest.
skinbake_Frame skinbake_morphed_frame(skinbake_Frame rest, float3 n)
{
    float square = dot(n, n);
    float3 normal = square > 0.0 ? n * rsqrt(square) : rest.normal;
    float3 s = rest.normal + normal;
    float3 d = normal - rest.normal;
    bool opposite = dot(s, s) < 1e-4; // then every half turn is the smallest: take the one about t0
    float k = opposite ? 0.0 : 2.0 / dot(s, s);
    float3 tangent = rest.tangent - s * (k * dot(d, rest.tangent));
    float3 bitangent = rest.bitangent - s * (k * dot(d, rest.bitangent));
    skinbake_Frame made = { normal, tangent, opposite ? -bitangent : bitangent, rest.handedness };
    return made;
}
#endif

#ifndef SKINBAKE_MORPHED_TANGENT
#define SKINBAKE_MORPHED_TANGENT
// The frame under morph targets that move TANGENT too. tangent is TANGENT.xyz plus the weighted sum of its targets.
// Do not normalise it. If the sum is 0, the frame follows the normal. If the targets of a primitive have no
// TANGENT, use skinbake_morphed_frame().
skinbake_Frame skinbake_morphed_tangent_frame(skinbake_Frame rest, float3 n, float3 tangent)
{
    skinbake_Frame frame = skinbake_morphed_frame(rest, n);
    float3 t = tangent - frame.normal * (dot(frame.normal, tangent) - dot(rest.normal, rest.tangent));
    bool cancelled = dot(t, t) < 1e-4 * dot(rest.tangent, rest.tangent);
    frame.tangent = cancelled ? frame.tangent : t;
    frame.bitangent = cancelled ? frame.bitangent : cross(frame.normal, t) * rest.handedness;
    return frame;
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
    v.normal = frame.handedness * cross(v.tangent, v.bitangent); // 6
    v.position = q0 + weights_0.y * d1 + weights_0.z * d2 + weights_0.w * d3; // 7
    return v;
}

cbuffer skinbake_Draw : register(b0) {
    uint skinbake_draw_vertices;
    uint skinbake_draw_targets;
    uint skinbake_draw_joint_size;
    uint skinbake_draw_weight_size;
    uint skinbake_draw_posed_stride;
    uint skinbake_draw_posed_position;
    uint skinbake_draw_posed_normal;
    uint skinbake_draw_posed_tangent;
    float skinbake_draw_scale;
    float skinbake_draw_joint_scale;
    uint2 skinbake_draw_position;
    uint2 skinbake_draw_normal;
    uint2 skinbake_draw_tangent;
    uint2 skinbake_draw_joints_0;
    uint2 skinbake_draw_weights_0;
    uint2 skinbake_draw_alpha_0;
    uint2 skinbake_draw_beta_0;
};
ByteAddressBuffer skinbake_geometry : register(t1);
StructuredBuffer<float4x4> skinbake_joints : register(t2);
RWByteAddressBuffer skinbake_posed : register(u3);

struct skinbake_Target {
    float weight;
    uint unused;
    uint2 position; // 0xffffffff in x: the target does not move it
    uint2 normal;
    uint2 tangent;
    uint2 morph;
    uint2 morph_up;
};
StructuredBuffer<skinbake_Target> skinbake_targets : register(t4);

uint skinbake_word(uint2 place, uint vertex, uint number)
{
    return skinbake_geometry.Load(place.x + place.y * vertex + 4u * number);
}

float skinbake_float(uint2 place, uint vertex, uint number)
{
    return asfloat(skinbake_word(place, vertex, number));
}

float2 skinbake_vec2(uint2 place, uint vertex)
{
    return float2(skinbake_float(place, vertex, 0u), skinbake_float(place, vertex, 1u));
}

float3 skinbake_vec3(uint2 place, uint vertex)
{
    return float3(skinbake_vec2(place, vertex), skinbake_float(place, vertex, 2u));
}

float4 skinbake_vec4(uint2 place, uint vertex)
{
    return float4(skinbake_vec3(place, vertex), skinbake_float(place, vertex, 3u));
}

// NORMAL at length 1. If it has no direction, bake takes (0, 0, 1).
float3 skinbake_normal(uint2 place, uint vertex)
{
    float3 stored = skinbake_vec3(place, vertex);
    return dot(stored, stored) > 0.0 ? normalize(stored) : float3(0.0, 0.0, 1.0);
}

// Four whole numbers of 1, 2 or 4 bytes, by the size of one.
uint4 skinbake_integers(uint2 place, uint vertex, uint size)
{
    uint first = skinbake_word(place, vertex, 0u);
    if (size == 1u) {
        return (first.xxxx >> uint4(0u, 8u, 16u, 24u)) & 0xffu;
    }
    uint second = skinbake_word(place, vertex, 1u);
    if (size == 4u) {
        return uint4(first, second, skinbake_word(place, vertex, 2u), skinbake_word(place, vertex, 3u));
    }
    return uint4(first & 0xffffu, first >> 16u, second & 0xffffu, second >> 16u);
}

float4 skinbake_weights(uint2 place, uint vertex)
{
    if (skinbake_draw_weight_size == 4u) {
        return skinbake_vec4(place, vertex);
    }
    float4 integers = float4(skinbake_integers(place, vertex, skinbake_draw_weight_size));
    return integers / (skinbake_draw_weight_size == 1u ? 255.0 : 65535.0);
}

void skinbake_put(uint offset, uint vertex, float4 value, uint count)
{
    if (offset == 0xffffffffu) {
        return;
    }
    for (uint number = 0u; number < count; number++) {
        skinbake_posed.Store(offset + skinbake_draw_posed_stride * vertex + 4u * number,
                asuint(value[number]));
    }
}

[numthreads(64, 1, 1)]
void main(uint3 id : SV_DispatchThreadID)
{
    uint vertex = id.x;
    if (vertex >= skinbake_draw_vertices) {
        return;
    }
    float3 position = skinbake_vec3(skinbake_draw_position, vertex);
    float3 normal = skinbake_normal(skinbake_draw_normal, vertex);
    float4 tangent = skinbake_vec4(skinbake_draw_tangent, vertex);
    uint4 joints_0 = skinbake_integers(skinbake_draw_joints_0, vertex, skinbake_draw_joint_size);
    float4 weights_0 = skinbake_weights(skinbake_draw_weights_0, vertex);
    float3 alpha_0 = skinbake_vec3(skinbake_draw_alpha_0, vertex);
    float3 beta_0 = skinbake_vec3(skinbake_draw_beta_0, vertex);
    if (!(any(weights_0 > 0.0))) {
        weights_0 = float4(1.0, 0.0, 0.0, 0.0); // bound to slot 0, as bake takes it
    }
    float3 morphed_position = position;
    float3 morphed_normal = normal;
    float3 morphed_tangent = tangent.xyz;
    for (uint number = 0u; number < skinbake_draw_targets; number++) {
        skinbake_Target moved = skinbake_targets[number];
        if (moved.position.x != 0xffffffffu) {
            morphed_position += moved.weight * skinbake_vec3(moved.position, vertex);
        }
        if (moved.normal.x != 0xffffffffu) {
            morphed_normal += moved.weight * skinbake_vec3(moved.normal, vertex);
        }
        if (moved.tangent.x != 0xffffffffu) {
            morphed_tangent += moved.weight * skinbake_vec3(moved.tangent, vertex);
        }
    }
    float4x4 M[4];
    M[0] = skinbake_joints[joints_0.x];
    M[1] = skinbake_joints[joints_0.y];
    M[2] = skinbake_joints[joints_0.z];
    M[3] = skinbake_joints[joints_0.w];
    skinbake_Frame rest = skinbake_frame(normal, tangent);
    skinbake_Frame frame = skinbake_morphed_tangent_frame(rest, morphed_normal, morphed_tangent);
    skinbake_Vertex v = skinbake_lbs_accurate(morphed_position, frame, M, weights_0, alpha_0, beta_0);
    float side = dot(cross(v.tangent, v.bitangent), v.normal) < 0.0 ? -1.0 : 1.0;
    skinbake_put(skinbake_draw_posed_position, vertex, float4(v.position, 0.0), 3u);
    skinbake_put(skinbake_draw_posed_normal, vertex, float4(normalize(v.normal), 0.0), 3u);
    skinbake_put(skinbake_draw_posed_tangent, vertex, float4(normalize(v.tangent), side), 4u);
}

#endif
