// Lighting for skinned meshes that skinbake has baked: linear blend skinning, accurate lighting,
// 5 influences a vertex, tangent frame.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang glsl --method lbs --lighting accurate --influences 5 --frame tangent
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
//     JOINTS_1             uvec4  joints of slot 4
//     WEIGHTS_1            vec4   w of slot 4; over all slots they sum to 1
//     _SKINBAKE_ALPHA_0    vec3   alpha = grad w . t0 of slots 1 to 3, in 1 / unit of POSITION
//     _SKINBAKE_BETA_0     vec3   beta = grad w . b0 of the same slots
//     _SKINBAKE_ALPHA_1    vec4   alpha = grad w . t0 of slot 4, in 1 / unit of POSITION
//     _SKINBAKE_BETA_1     vec4   beta = grad w . b0 of the same slots
// Slot 0's alpha and beta are minus the sums of the others': they are not stored.
//
// M[s] is the joint matrix of the joint in slot s: its global transform * its inverse bind matrix.
// Use:
//     skinbake_Frame frame = skinbake_frame(normal, tangent);
//     skinbake_Vertex v = skinbake_lbs_accurate(position, frame, M, weights_0, weights_1, alpha_0, alpha_1, beta_0, beta_1);
//     // v.position; normalize(v.normal); normalize(v.tangent)

#ifndef SKINBAKE_LBS_ACCURATE_5_TANGENT_GLSL
#define SKINBAKE_LBS_ACCURATE_5_TANGENT_GLSL

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
// M: the joint matrices of slots 0 to 4.
skinbake_Vertex skinbake_lbs_accurate(vec3 p, skinbake_Frame frame, mat4 M[5], vec4 weights_0,
        vec4 weights_1, vec3 alpha_0, vec4 alpha_1, vec3 beta_0, vec4 beta_1)
{
    mat3 T = weights_0.x * mat3(M[0]) // 1
            + weights_0.y * mat3(M[1])
            + weights_0.z * mat3(M[2])
            + weights_0.w * mat3(M[3])
            + weights_1.x * mat3(M[4]);
    vec3 q0 = skinbake_moved(M[0], p); // 2
    vec3 q1 = skinbake_moved(M[1], p);
    vec3 q2 = skinbake_moved(M[2], p);
    vec3 q3 = skinbake_moved(M[3], p);
    vec3 q4 = skinbake_moved(M[4], p);
    vec3 d1 = q1 - q0; // 3
    vec3 d2 = q2 - q0;
    vec3 d3 = q3 - q0;
    vec3 d4 = q4 - q0;
    skinbake_Vertex v;
    v.tangent = T * frame.tangent + alpha_0.x * d1 + alpha_0.y * d2 + alpha_0.z * d3 + alpha_1.x * d4; // 4
    v.bitangent = T * frame.bitangent + beta_0.x * d1 + beta_0.y * d2 + beta_0.z * d3 + beta_1.x * d4; // 5
    v.normal = frame.handedness * cross(v.tangent, v.bitangent); // 6
    v.position = q0 + weights_0.y * d1 + weights_0.z * d2 + weights_0.w * d3 + weights_1.x * d4; // 7
    return v;
}

#endif
