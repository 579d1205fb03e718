// Lighting for skinned meshes that skinbake has baked: dual quaternion skinning, standard lighting,
// 4 influences a vertex, tangent frame.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang glsl --method dqs --lighting standard --influences 4 --frame tangent
//
// Algorithm 4 of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned
// Models", Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. The numbers beside the lines
// come from its supplement.
// Dual quaternions: L. Kavan, S. Collins, J. Zara, C. O'Sullivan, "Skinning with Dual Quaternions", I3D 2007.
// Compiles as GLSL ES 3.00, 3.30 and 4.50. Pure functions: no attributes, uniforms or globals.
//
// Inputs of each vertex, in mesh space: the attributes as they are stored, before any joint matrix:
//     POSITION             vec3   p, in the file's unit of length
//     NORMAL               vec3   n0, of length 1: normalize() it if it is stored as integers
//     TANGENT              vec4   t0, and in w the handedness of the frame, 1 or -1
//     JOINTS_0             uvec4  joints of slots 0 to 3
//     WEIGHTS_0            vec4   w of slots 0 to 3; over all slots they sum to 1
//
// Q[s] is the dual quaternion of the joint in slot s, made of its joint matrix by skinbake_dual_quaternion().
// Use:
//     skinbake_Frame frame = skinbake_frame(normal, tangent);
//     skinbake_Vertex v = skinbake_dqs_standard(position, frame, Q, weights_0);
//     // v.position; normalize(v.normal); normalize(v.tangent)

#ifndef SKINBAKE_DQS_STANDARD_4_TANGENT_GLSL
#define SKINBAKE_DQS_STANDARD_4_TANGENT_GLSL

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

#ifndef SKINBAKE_DUAL_QUATERNION
#define SKINBAKE_DUAL_QUATERNION
// The unit dual quaternion of a rigid joint matrix. [0] is its real part (x, y, z, w), w the scalar; [1] is its
// dual part. Compute it on the host or in a pass over the joints: once per joint and frame, not per vertex.
// Dual quaternions have no scale. If all joint matrices share a uniform scale s, divide their upper 3x3 parts by
// s first, and skin s * p, s * t0, s * b0 in place of p, t0, b0.
mat2x4 skinbake_dual_quaternion(mat4 M)
{
    vec3 d = vec3(M[0].x, M[1].y, M[2].z);
    vec4 squares = 1.0 + vec4( // 4 * (x, y, z, w)^2
        d.x - d.y - d.z, d.y - d.z - d.x, d.z - d.x - d.y, d.x + d.y + d.z);
    vec3 differences = vec3(M[1].z - M[2].y, M[2].x - M[0].z, M[0].y - M[1].x); // 4 w * (x, y, z)
    vec3 sums = vec3(M[1].z + M[2].y, M[2].x + M[0].z, M[0].y + M[1].x); // 4 * (yz, zx, xy)
    vec4 real = vec4(differences, squares.w);
    float largest = squares.w;
    if (squares.x > largest) {
        largest = squares.x;
        real = vec4(squares.x, sums.z, sums.y, differences.x);
    }
    if (squares.y > largest) {
        largest = squares.y;
        real = vec4(sums.z, squares.y, sums.x, differences.y);
    }
    if (squares.z > largest) {
        real = vec4(sums.y, sums.x, squares.z, differences.z);
    }
    real = normalize(real);
    vec3 t = M[3].xyz;
    return mat2x4(real, 0.5 * vec4(cross(t, real.xyz) + real.w * t, -dot(t, real.xyz)));
}
#endif

#ifndef SKINBAKE_HEMISPHERE
#define SKINBAKE_HEMISPHERE
// -1 if the real part of the joint points away from that of the pivot: q and -q are the same rotation.
float skinbake_hemisphere(mat2x4 joint, mat2x4 pivot)
{
    return dot(joint[0], pivot[0]) < 0.0 ? -1.0 : 1.0;
}
#endif

#ifndef SKINBAKE_ROTATION
#define SKINBAKE_ROTATION
// (Q(p) - p) / 2 of a unit dual quaternion Q.
vec3 skinbake_half_displacement(mat2x4 Q, vec3 p)
{
    vec3 i = Q[0].w * p + Q[1].xyz + cross(Q[0].xyz, p);
    return Q[0].w * Q[1].xyz - Q[1].w * Q[0].xyz + cross(Q[0].xyz, i);
}

// v rotated by a unit quaternion q.
vec3 skinbake_rotated(vec4 q, vec3 v)
{
    return v + 2.0 * cross(q.xyz, q.w * v + cross(q.xyz, v));
}
#endif

// The frame moves by the normalised mix b, as if the weights were constant over the surface.
// Q: the dual quaternions of slots 0 to 3.
skinbake_Vertex skinbake_dqs_standard(vec3 p, skinbake_Frame frame, mat2x4 Q[4], vec4 weights_0)
{
    float s1 = skinbake_hemisphere(Q[1], Q[0]); // 1
    float s2 = skinbake_hemisphere(Q[2], Q[0]);
    float s3 = skinbake_hemisphere(Q[3], Q[0]);
    mat2x4 b = weights_0.x * Q[0]
              + (s1 * weights_0.y) * Q[1]
              + (s2 * weights_0.z) * Q[2]
              + (s3 * weights_0.w) * Q[3];
    float square = dot(b[0], b[0]);
    b *= square > 0.0 ? inversesqrt(square) : 1.0; // 2
    skinbake_Vertex v;
    v.position = p + 2.0 * skinbake_half_displacement(b, p); // 3
    v.normal = skinbake_rotated(b[0], frame.normal); // 4
    v.tangent = skinbake_rotated(b[0], frame.tangent); // 5
    v.bitangent = skinbake_rotated(b[0], frame.bitangent); // 6
    return v;
}

#endif
