// Lighting for skinned meshes that skinbake has baked: linear blend skinning, accurate lighting,
// 4 influences a vertex, tangent frame, morph targets by tangent.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang glsl --method lbs --lighting accurate --influences 4 --frame tangent --morphs tangent --stage compute
//
// Algorithm 3 of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned
// Models", Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. The numbers beside the lines
// come from its supplement.
// A compute pass in GLSL 4.50, for Vulkan and OpenGL.
//
// Inputs of each vertex, in mesh space: the attributes as they are stored, before any joint matrix:
//     POSITION             vec3   p, in the file's unit of length
//     NORMAL               vec3   n0, of any length
//     TANGENT              vec4   t0, and in w the handedness of the frame, 1 or -1
//     JOINTS_0             uvec4  joints of slots 0 to 3
//     WEIGHTS_0            vec4   w of slots 0 to 3; over all slots they sum to 1
//     _SKINBAKE_ALPHA_0    vec3   alpha = grad w . t0 of slots 1 to 3, in 1 / unit of POSITION
//     _SKINBAKE_BETA_0     vec3   beta = grad w . b0 of the same slots
// alpha and beta of slot 0 are not stored: they are minus the sums over the other slots.
//
// M[s] is the joint matrix of the joint in slot s: its global transform * its inverse bind matrix, glTF's sixteen
// floats.
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

#version 450

#ifndef SKINBAKE_LBS_ACCURATE_4_TANGENT_MORPHED_TANGENT_COMPUTE_GLSL
#define SKINBAKE_LBS_ACCURATE_4_TANGENT_MORPHED_TANGENT_COMPUTE_GLSL

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

#ifndef SKINBAKE_FRAME_FROM_TANGENT
#define SKINBAKE_FRAME_FROM_TANGENT
// The frame of NORMAL, which must have length 1, and TANGENT.
skinbake_Frame skinbake_frame(vec3 n, vec4 tangent)
{
    return skinbake_Frame(n, tangent.xyz, cross(n, tangent.xyz) * tangent.w, tangent.w);
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

#ifndef SKINBAKE_MOVED
#define SKINBAKE_MOVED
// M p: the position p moved by the joint matrix M alone.
vec3 skinbake_moved(mat4 M, vec3 p)
{
    return M[0].xyz * p.x + (M[1].xyz * p.y + (M[2].xyz * p.z + M[3].xyz));
}
#endif

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
    v.position = q0 + weights_0.y * d1 + weights_0.z * d2 + weights_0.w * d3; // 7
    return v;
}

layout(local_size_x = 64) in;

layout(std140, binding = 0) uniform skinbake_Draw {
    uint vertices;
    uint targets;
    uint joint_size;
    uint weight_size;
    uint posed_stride;
    uint posed_position;
    uint posed_normal;
    uint posed_tangent;
    float scale;
    float joint_scale;
    uvec2 position;
    uvec2 normal;
    uvec2 tangent;
    uvec2 joints_0;
    uvec2 weights_0;
    uvec2 alpha_0;
    uvec2 beta_0;
} skinbake_draw;
layout(std430, binding = 1) readonly buffer skinbake_Geometry { uint skinbake_geometry[]; };
layout(std430, binding = 2) readonly buffer skinbake_Joints { mat4 skinbake_joints[]; };
layout(std430, binding = 3) buffer skinbake_Posed { float skinbake_posed[]; };

struct skinbake_Target {
    float weight;
    uint unused;
    uvec2 position; // 0xffffffff in x: the target does not move it
    uvec2 normal;
    uvec2 tangent;
    uvec2 morph;
    uvec2 morph_up;
};
layout(std430, binding = 4) readonly buffer skinbake_Targets { skinbake_Target skinbake_targets[]; };

uint skinbake_word(uvec2 place, uint vertex, uint number)
{
    return skinbake_geometry[(place.x + place.y * vertex) / 4u + number];
}

float skinbake_float(uvec2 place, uint vertex, uint number)
{
    return uintBitsToFloat(skinbake_word(place, vertex, number));
}

vec2 skinbake_vec2(uvec2 place, uint vertex)
{
    return vec2(skinbake_float(place, vertex, 0u), skinbake_float(place, vertex, 1u));
}

vec3 skinbake_vec3(uvec2 place, uint vertex)
{
    return vec3(skinbake_vec2(place, vertex), skinbake_float(place, vertex, 2u));
}

vec4 skinbake_vec4(uvec2 place, uint vertex)
{
    return vec4(skinbake_vec3(place, vertex), skinbake_float(place, vertex, 3u));
}

// NORMAL at length 1. If it has no direction, bake takes (0, 0, 1).
vec3 skinbake_normal(uvec2 place, uint vertex)
{
    vec3 stored = skinbake_vec3(place, vertex);
    return dot(stored, stored) > 0.0 ? normalize(stored) : vec3(0.0, 0.0, 1.0);
}

// Four whole numbers of 1, 2 or 4 bytes, by the size of one.
uvec4 skinbake_integers(uvec2 place, uint vertex, uint size)
{
    uint first = skinbake_word(place, vertex, 0u);
    if (size == 1u) {
        return (uvec4(first) >> uvec4(0u, 8u, 16u, 24u)) & 0xffu;
    }
    uint second = skinbake_word(place, vertex, 1u);
    if (size == 4u) {
        return uvec4(first, second, skinbake_word(place, vertex, 2u), skinbake_word(place, vertex, 3u));
    }
    return uvec4(first & 0xffffu, first >> 16u, second & 0xffffu, second >> 16u);
}

vec4 skinbake_weights(uvec2 place, uint vertex)
{
    if (skinbake_draw.weight_size == 4u) {
        return skinbake_vec4(place, vertex);
    }
    vec4 integers = vec4(skinbake_integers(place, vertex, skinbake_draw.weight_size));
    return integers / (skinbake_draw.weight_size == 1u ? 255.0 : 65535.0);
}

void skinbake_put(uint offset, uint vertex, vec4 value, uint count)
{
    if (offset == 0xffffffffu) {
        return;
    }
    uint at = (offset + skinbake_draw.posed_stride * vertex) / 4u;
    for (uint number = 0u; number < count; number++) {
        skinbake_posed[at + number] = value[number];
    }
}

void main()
{
    uint vertex = gl_GlobalInvocationID.x;
    if (vertex >= skinbake_draw.vertices) {
        return;
    }
    vec3 position = skinbake_vec3(skinbake_draw.position, vertex);
    vec3 normal = skinbake_normal(skinbake_draw.normal, vertex);
    vec4 tangent = skinbake_vec4(skinbake_draw.tangent, vertex);
    uvec4 joints_0 = skinbake_integers(skinbake_draw.joints_0, vertex, skinbake_draw.joint_size);
    vec4 weights_0 = skinbake_weights(skinbake_draw.weights_0, vertex);
    vec3 alpha_0 = skinbake_vec3(skinbake_draw.alpha_0, vertex);
    vec3 beta_0 = skinbake_vec3(skinbake_draw.beta_0, vertex);
    if (!(any(greaterThan(weights_0, vec4(0.0))))) {
        weights_0 = vec4(1.0, 0.0, 0.0, 0.0); // bound to slot 0, as bake takes it
    }
    vec3 morphed_position = position;
    vec3 morphed_normal = normal;
    vec3 morphed_tangent = tangent.xyz;
    for (uint number = 0u; number < skinbake_draw.targets; number++) {
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
    mat4 M[4];
    M[0] = skinbake_joints[joints_0.x];
    M[1] = skinbake_joints[joints_0.y];
    M[2] = skinbake_joints[joints_0.z];
    M[3] = skinbake_joints[joints_0.w];
    skinbake_Frame rest = skinbake_frame(normal, tangent);
    skinbake_Frame frame = skinbake_morphed_tangent_frame(rest, morphed_normal, morphed_tangent);
    skinbake_Vertex v = skinbake_lbs_accurate(morphed_position, frame, M, weights_0, alpha_0, beta_0);
    float side = dot(cross(v.tangent, v.bitangent), v.normal) < 0.0 ? -1.0 : 1.0;
    skinbake_put(skinbake_draw.posed_position, vertex, vec4(v.position, 0.0), 3u);
    skinbake_put(skinbake_draw.posed_normal, vertex, vec4(normalize(v.normal), 0.0), 3u);
    skinbake_put(skinbake_draw.posed_tangent, vertex, vec4(normalize(v.tangent), side), 4u);
}

#endif
