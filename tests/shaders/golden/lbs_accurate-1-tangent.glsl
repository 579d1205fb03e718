// Lighting for skinned meshes that skinbake has baked: linear blend skinning, accurate lighting,
// 1 influence a vertex, tangent frame.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang glsl --method lbs --lighting accurate --influences 1 --frame tangent
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
//     JOINTS_0             uvec4  joints of slot 0
//     WEIGHTS_0            vec4   w of slot 0; over all slots they sum to 1
//
// M[s] is the joint matrix of the joint in slot s: its global transform * its inverse bind matrix.
// Use:
//     skinbake_Frame frame = skinbake_frame(normal, tangent);
//     skinbake_Vertex v = skinbake_lbs_accurate(position, frame, M, weights_0);
//     // v.position; normalize(v.normal); normalize(v.tangent)

#ifndef SKINBAKE_LBS_ACCURATE_1_TANGENT_GLSL
#define SKINBAKE_LBS_ACCURATE_1_TANGENT_GLSL

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
// M: the joint matrices of slot 0.
skinbake_Vertex skinbake_lbs_accurate(vec3 p, skinbake_Frame frame, mat4 M[1], vec4 weights_0)
{
    mat3 T = weights_0.x * mat3(M[0]); // 1
    vec3 q0 = skinbake_moved(M[0], p); // 2
    skinbake_Vertex v;
    v.tangent = T * frame.tangent; // 4
    v.bitangent = T * frame.bitangent; // 5
    v.normal = frame.handedness * cross(v.tangent, v.bitangent); // 6
    v.position = q0; // 7
    return v;
}

#endif
