// Lighting for skinned meshes that skinbake has baked: linear blend skinning, accurate lighting,
// 8 influences a vertex, normal frame, snorm16.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang glsl --method lbs --lighting accurate --influences 8 --frame normal --encoding snorm16
//
// Algorithm 3 of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned
// Models", Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330: the numbers beside the lines are
// those of its supplement.
// Frame: T. Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.
// Compiles as GLSL ES 3.00, 3.30 and 4.50. Pure functions: no attributes, uniforms or globals.
//
// It reads of each vertex (mesh space: as the attributes come, before any joint matrix):
//     POSITION             vec3   p, in the file's unit of length
//     NORMAL               vec3   n0, of length 1: normalize() it where it is stored as integers
//     JOINTS_0             uvec4  joints of slots 0 to 3
//     WEIGHTS_0            vec4   w of slots 0 to 3; over all slots they sum to 1
//     JOINTS_1             uvec4  joints of slots 4 to 7
//     WEIGHTS_1            vec4   w of slots 4 to 7; over all slots they sum to 1
//     _SKINBAKE_ALPHA_0    vec4   alpha = grad w . t0 of slots 1 to 3, as snorm16x4
//     _SKINBAKE_BETA_0     vec4   beta = grad w . b0 of the same slots, likewise
//     _SKINBAKE_ALPHA_1    vec4   alpha = grad w . t0 of slots 4 to 7, as snorm16x4
//     _SKINBAKE_BETA_1     vec4   beta = grad w . b0 of the same slots, likewise
// The integers c come as max(c / 32767, -1). What skinbake_decoded() makes of them is in 1 / unit of POSITION;
// scale is the file's own, "scale" in extras.skinbake of its baked primitives; make it a constant or a uniform.
// Slot 0's alpha and beta are minus the sums of the others': they are not stored.
//
// M[s] is the joint matrix of the joint in slot s: its global transform * its inverse bind matrix.
// Use:
//     skinbake_Frame frame = skinbake_frame(normal);
//     vec3 alpha_0 = skinbake_decoded(stored_alpha_0, scale);
//     vec4 alpha_1 = skinbake_decoded_further(stored_alpha_1, stored_alpha_0, scale);
//     vec3 beta_0 = skinbake_decoded(stored_beta_0, scale);
//     vec4 beta_1 = skinbake_decoded_further(stored_beta_1, stored_beta_0, scale);
//     skinbake_Vertex v = skinbake_lbs_accurate(position, frame, M, weights_0, weights_1, alpha_0, alpha_1, beta_0, beta_1);
//     // v.position; normalize(v.normal); normalize(v.tangent)

#ifndef SKINBAKE_LBS_ACCURATE_8_NORMAL_SNORM16_GLSL
#define SKINBAKE_LBS_ACCURATE_8_NORMAL_SNORM16_GLSL

#ifndef SKINBAKE_VERTEX
#define SKINBAKE_VERTEX
// A skinned vertex. None of its vectors is of unit length; tangent and bitangent are the images of t0 and b0.
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
// The frame that bake took from NORMAL alone; n must have length 1. Written so that a compiler which fuses
// multiply-adds gets the same bits: every product that meets a sum is exact. side stands last there: Mesa turns
// side * ((x * x) * a) into side * (x * (x * a)).
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
// alpha or beta of slots 1 to 3 from its set 0: xyz relative to the vertex's scale, w the root of that scale
// relative to the file's.
vec3 skinbake_decoded(vec4 stored, float scale)
{
    return (scale * stored.w * stored.w) * stored.xyz;
}
#endif

#ifndef SKINBAKE_DECODED_FURTHER
#define SKINBAKE_DECODED_FURTHER
// alpha or beta of the four slots of a further set; first is set 0 of the same, whose w counts for all sets.
vec4 skinbake_decoded_further(vec4 stored, vec4 first, float scale)
{
    return (scale * first.w * first.w) * stored;
}
#endif

#ifndef SKINBAKE_MOVED
#define SKINBAKE_MOVED
// M p: where the joint matrix M alone takes the position p.
vec3 skinbake_moved(mat4 M, vec3 p)
{
    return M[0].xyz * p.x + (M[1].xyz * p.y + (M[2].xyz * p.z + M[3].xyz));
}
#endif

// The frame moves by the derivative of the skinned position along t0 and b0.
// M: the joint matrices of slots 0 to 7.
skinbake_Vertex skinbake_lbs_accurate(vec3 p, skinbake_Frame frame, mat4 M[8], vec4 weights_0,
        vec4 weights_1, vec3 alpha_0, vec4 alpha_1, vec3 beta_0, vec4 beta_1)
{
    mat3 T = weights_0.x * mat3(M[0]) // 1
            + weights_0.y * mat3(M[1])
            + weights_0.z * mat3(M[2])
            + weights_0.w * mat3(M[3])
            + weights_1.x * mat3(M[4])
            + weights_1.y * mat3(M[5])
            + weights_1.z * mat3(M[6])
            + weights_1.w * mat3(M[7]);
    vec3 q0 = skinbake_moved(M[0], p); // 2
    vec3 q1 = skinbake_moved(M[1], p);
    vec3 q2 = skinbake_moved(M[2], p);
    vec3 q3 = skinbake_moved(M[3], p);
    vec3 q4 = skinbake_moved(M[4], p);
    vec3 q5 = skinbake_moved(M[5], p);
    vec3 q6 = skinbake_moved(M[6], p);
    vec3 q7 = skinbake_moved(M[7], p);
    vec3 d1 = q1 - q0; // 3
    vec3 d2 = q2 - q0;
    vec3 d3 = q3 - q0;
    vec3 d4 = q4 - q0;
    vec3 d5 = q5 - q0;
    vec3 d6 = q6 - q0;
    vec3 d7 = q7 - q0;
    skinbake_Vertex v;
    v.tangent = T * frame.tangent + alpha_0.x * d1 + alpha_0.y * d2 + alpha_0.z * d3 + alpha_1.x * d4
            + alpha_1.y * d5 + alpha_1.z * d6 + alpha_1.w * d7; // 4
    v.bitangent = T * frame.bitangent + beta_0.x * d1 + beta_0.y * d2 + beta_0.z * d3 + beta_1.x * d4
            + beta_1.y * d5 + beta_1.z * d6 + beta_1.w * d7; // 5
    v.normal = cross(v.tangent, v.bitangent); // 6
    v.position = q0 + weights_0.y * d1 + weights_0.z * d2 + weights_0.w * d3 + weights_1.x * d4
            + weights_1.y * d5 + weights_1.z * d6 + weights_1.w * d7; // 7
    return v;
}

#endif
