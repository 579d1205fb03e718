// Lighting for skinned meshes that skinbake has baked: linear blend skinning, accurate lighting,
// 12 influences a vertex, tangent frame.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang glsl --method lbs --lighting accurate --influences 12 --frame tangent
//
// Algorithm 3 of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned
// Models", Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330: the numbers beside the lines are
// those of its supplement.
// Compiles as GLSL ES 3.00, 3.30 and 4.50. Pure functions: no attributes, uniforms or globals.
//
// It reads of each vertex (mesh space: as the attributes come, before any joint matrix):
//     POSITION             vec3   p, in the file's unit of length
//     NORMAL               vec3   n0, of length 1: normalize() it where it is stored as integers
//     TANGENT              vec4   t0, and in w the handedness of the frame, 1 or -1
//     JOINTS_0             uvec4  joints of slots 0 to 3
//     WEIGHTS_0            vec4   w of slots 0 to 3; over all slots they sum to 1
//     JOINTS_1             uvec4  joints of slots 4 to 7
//     WEIGHTS_1            vec4   w of slots 4 to 7; over all slots they sum to 1
//     JOINTS_2             uvec4  joints of slots 8 to 11
//     WEIGHTS_2            vec4   w of slots 8 to 11; over all slots they sum to 1
//     _SKINBAKE_ALPHA_0    vec3   alpha = grad w . t0 of slots 1 to 3, in 1 / unit of POSITION
//     _SKINBAKE_BETA_0     vec3   beta = grad w . b0 of the same slots
//     _SKINBAKE_ALPHA_1    vec4   alpha = grad w . t0 of slots 4 to 7, in 1 / unit of POSITION
//     _SKINBAKE_BETA_1     vec4   beta = grad w . b0 of the same slots
//     _SKINBAKE_ALPHA_2    vec4   alpha = grad w . t0 of slots 8 to 11, in 1 / unit of POSITION
//     _SKINBAKE_BETA_2     vec4   beta = grad w . b0 of the same slots
// Slot 0's alpha and beta are minus the sums of the others': they are not stored.
//
// M[s] is the joint matrix of the joint in slot s: its global transform * its inverse bind matrix.
// Use:
//     skinbake_Frame frame = skinbake_frame(normal, tangent);
//     skinbake_Vertex v = skinbake_lbs_accurate(position, frame, M, weights_0, weights_1, weights_2, alpha_0, alpha_1, alpha_2, beta_0, beta_1, beta_2);
//     // v.position; normalize(v.normal); normalize(v.tangent)

#ifndef SKINBAKE_LBS_ACCURATE_12_TANGENT_GLSL
#define SKINBAKE_LBS_ACCURATE_12_TANGENT_GLSL

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

#ifndef SKINBAKE_FRAME_FROM_TANGENT
#define SKINBAKE_FRAME_FROM_TANGENT
// The frame of NORMAL, which must have length 1, and TANGENT.
skinbake_Frame skinbake_frame(vec3 n, vec4 tangent)
{
    return skinbake_Frame(n, tangent.xyz, cross(n, tangent.xyz) * tangent.w, tangent.w);
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
// M: the joint matrices of slots 0 to 11.
skinbake_Vertex skinbake_lbs_accurate(vec3 p, skinbake_Frame frame, mat4 M[12], vec4 weights_0,
        vec4 weights_1, vec4 weights_2, vec3 alpha_0, vec4 alpha_1, vec4 alpha_2, vec3 beta_0, vec4 beta_1,
        vec4 beta_2)
{
    mat3 T = weights_0.x * mat3(M[0]) // 1
            + weights_0.y * mat3(M[1])
            + weights_0.z * mat3(M[2])
            + weights_0.w * mat3(M[3])
            + weights_1.x * mat3(M[4])
            + weights_1.y * mat3(M[5])
            + weights_1.z * mat3(M[6])
            + weights_1.w * mat3(M[7])
            + weights_2.x * mat3(M[8])
            + weights_2.y * mat3(M[9])
            + weights_2.z * mat3(M[10])
            + weights_2.w * mat3(M[11]);
    vec3 q0 = skinbake_moved(M[0], p); // 2
    vec3 q1 = skinbake_moved(M[1], p);
    vec3 q2 = skinbake_moved(M[2], p);
    vec3 q3 = skinbake_moved(M[3], p);
    vec3 q4 = skinbake_moved(M[4], p);
    vec3 q5 = skinbake_moved(M[5], p);
    vec3 q6 = skinbake_moved(M[6], p);
    vec3 q7 = skinbake_moved(M[7], p);
    vec3 q8 = skinbake_moved(M[8], p);
    vec3 q9 = skinbake_moved(M[9], p);
    vec3 q10 = skinbake_moved(M[10], p);
    vec3 q11 = skinbake_moved(M[11], p);
    vec3 d1 = q1 - q0; // 3
    vec3 d2 = q2 - q0;
    vec3 d3 = q3 - q0;
    vec3 d4 = q4 - q0;
    vec3 d5 = q5 - q0;
    vec3 d6 = q6 - q0;
    vec3 d7 = q7 - q0;
    vec3 d8 = q8 - q0;
    vec3 d9 = q9 - q0;
    vec3 d10 = q10 - q0;
    vec3 d11 = q11 - q0;
    skinbake_Vertex v;
    v.tangent = T * frame.tangent + alpha_0.x * d1 + alpha_0.y * d2 + alpha_0.z * d3 + alpha_1.x * d4
            + alpha_1.y * d5 + alpha_1.z * d6 + alpha_1.w * d7 + alpha_2.x * d8 + alpha_2.y * d9
            + alpha_2.z * d10 + alpha_2.w * d11; // 4
    v.bitangent = T * frame.bitangent + beta_0.x * d1 + beta_0.y * d2 + beta_0.z * d3 + beta_1.x * d4
            + beta_1.y * d5 + beta_1.z * d6 + beta_1.w * d7 + beta_2.x * d8 + beta_2.y * d9
            + beta_2.z * d10 + beta_2.w * d11; // 5
    v.normal = frame.handedness * cross(v.tangent, v.bitangent); // 6
    v.position = q0 + weights_0.y * d1 + weights_0.z * d2 + weights_0.w * d3 + weights_1.x * d4
            + weights_1.y * d5 + weights_1.z * d6 + weights_1.w * d7 + weights_2.x * d8 + weights_2.y * d9
            + weights_2.z * d10 + weights_2.w * d11; // 7
    return v;
}

#endif
