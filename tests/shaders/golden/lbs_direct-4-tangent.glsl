// Lighting for skinned meshes that skinbake has baked: linear blend skinning, direct lighting,
// 4 influences a vertex, tangent frame.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang glsl --method lbs --lighting direct --influences 4 --frame tangent
//
// Algorithm 2 of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned
// Models", Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. The numbers beside the lines
// come from its supplement.
// Compiles as GLSL ES 3.00, 3.30 and 4.50. Pure functions: no attributes, uniforms or globals.
//
// Inputs of each vertex, in mesh space: the attributes as they are stored, before any joint matrix:
//     POSITION             vec3   p, in the file's unit of length
//     NORMAL               vec3   n0, of length 1: normalize() it if it is stored as integers
//     TANGENT              vec4   t0, and in w the handedness of the frame, 1 or -1
//     JOINTS_0             uvec4  joints of slots 0 to 3
//     WEIGHTS_0            vec4   w of slots 0 to 3; over all slots they sum to 1
//     _SKINBAKE_ALPHA_0    vec3   alpha = grad w . t0 of slots 1 to 3, in 1 / unit of POSITION
//     _SKINBAKE_BETA_0     vec3   beta = grad w . b0 of the same slots
// alpha and beta of slot 0 are not stored: they are minus the sums over the other slots.
//
// M[s] is the joint matrix of the joint in slot s: its global transform * its inverse bind matrix.
// Use:
//     skinbake_Frame frame = skinbake_frame(normal, tangent);
//     skinbake_Vertex v = skinbake_lbs_direct(position, frame, M, weights_0, skinbake_gradients(frame, alpha_0, beta_0));
//     // v.position; normalize(v.normal); normalize(v.tangent)

#ifndef SKINBAKE_LBS_DIRECT_4_TANGENT_GLSL
#define SKINBAKE_LBS_DIRECT_4_TANGENT_GLSL

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

#ifndef SKINBAKE_MOVED
#define SKINBAKE_MOVED
// M p: the position p moved by the joint matrix M alone.
vec3 skinbake_moved(mat4 M, vec3 p)
{
    return M[0].xyz * p.x + (M[1].xyz * p.y + (M[2].xyz * p.z + M[3].xyz));
}
#endif

// The weight gradients of all slots from alpha and beta: a[s] = alpha[s] t0 + beta[s] b0.
vec3[4] skinbake_gradients(skinbake_Frame frame, vec3 alpha_0, vec3 beta_0)
{
    vec3 a[4];
    a[1] = alpha_0.x * frame.tangent + beta_0.x * frame.bitangent;
    a[2] = alpha_0.y * frame.tangent + beta_0.y * frame.bitangent;
    a[3] = alpha_0.z * frame.tangent + beta_0.z * frame.bitangent;
    a[0] = -(a[1] + a[2] + a[3]);
    return a;
}

// The frame moves by the Jacobian J of the skinned position, the normal by its inverse transpose.
// M: the joint matrices of slots 0 to 3; a: their weight gradients, as skinbake_gradients() gives them.
skinbake_Vertex skinbake_lbs_direct(vec3 p, skinbake_Frame frame, mat4 M[4], vec4 weights_0, vec3 a[4])
{
    mat4x3 T = weights_0.x * mat4x3(M[0]) // 1
              + weights_0.y * mat4x3(M[1])
              + weights_0.z * mat4x3(M[2])
              + weights_0.w * mat4x3(M[3]);
    vec3 q0 = skinbake_moved(M[0], p); // 2
    vec3 q1 = skinbake_moved(M[1], p);
    vec3 q2 = skinbake_moved(M[2], p);
    vec3 q3 = skinbake_moved(M[3], p);
    mat3 J = mat3(T) // 3
        + outerProduct(q0, a[0])
        + outerProduct(q1, a[1])
        + outerProduct(q2, a[2])
        + outerProduct(q3, a[3]);
    mat3 C = mat3(cross(J[1], J[2]), cross(J[2], J[0]), cross(J[0], J[1])); // 4: J^-T = C / det J
    float det = dot(J[0], C[0]);
    skinbake_Vertex v;
    v.position = T * vec4(p, 1.0); // 5
    v.normal = (C * frame.normal) * (det == 0.0 ? 1.0 : 1.0 / det); // 6
    v.tangent = J * frame.tangent; // 7
    v.bitangent = J * frame.bitangent; // 8
    return v;
}

#endif
