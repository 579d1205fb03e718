// Lighting for skinned meshes that skinbake has baked: dual quaternion skinning, exact lighting,
// 8 influences a vertex, normal frame, corrections of at most 0.9 times a tangent.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang glsl --method dqs --lighting exact --influences 8 --frame normal --cap 0.9
//
// Algorithm 6 of skinbake: the exact derivative of the dual-quaternion blend, after M. Tarini, D. Panozzo,
// O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned Models", Computer Graphics Forum 33(2),
// 2014, doi:10.1111/cgf.12330. The numbers beside the lines are those of `skinbake cost`.
// Dual quaternions: L. Kavan, S. Collins, J. Zara, C. O'Sullivan, "Skinning with Dual Quaternions", I3D 2007.
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
//     _SKINBAKE_ALPHA_0    vec3   alpha = grad w . t0 of slots 1 to 3, in 1 / unit of POSITION
//     _SKINBAKE_BETA_0     vec3   beta = grad w . b0 of the same slots
//     _SKINBAKE_ALPHA_1    vec4   alpha = grad w . t0 of slots 4 to 7, in 1 / unit of POSITION
//     _SKINBAKE_BETA_1     vec4   beta = grad w . b0 of the same slots
// Slot 0's alpha and beta are minus the sums of the others': they are not stored.
//
// Q[s] is the dual quaternion of the joint in slot s, made of its joint matrix by skinbake_dual_quaternion().
// Use:
//     skinbake_Frame frame = skinbake_frame(normal);
//     skinbake_Vertex v = skinbake_dqs_exact(position, frame, Q, weights_0, weights_1, alpha_0, alpha_1, beta_0, beta_1);
//     // v.position; normalize(v.normal); normalize(v.tangent)

#ifndef SKINBAKE_DQS_EXACT_8_NORMAL_CAPPED_GLSL
#define SKINBAKE_DQS_EXACT_8_NORMAL_CAPPED_GLSL

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

#ifndef SKINBAKE_DUAL_QUATERNION
#define SKINBAKE_DUAL_QUATERNION
// The unit dual quaternion of a rigid joint matrix: [0] is its real part (x, y, z, w), w the scalar, [1] its
// dual part. For the host, or for a pass over the joints: once a joint and frame, not once a vertex.
// Dual quaternions carry no scale: where all joint matrices share a uniform scale s, divide their upper 3x3
// parts by s before, and skin s * p, s * t0, s * b0 in place of p, t0, b0.
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
// -1 where the joint's real part points away from the pivot's: q and -q are the same rotation.
float skinbake_hemisphere(mat2x4 joint, mat2x4 pivot)
{
    return dot(joint[0], pivot[0]) < 0.0 ? -1.0 : 1.0;
}
#endif

#ifndef SKINBAKE_CAPPED
#define SKINBAKE_CAPPED
// base + correction, the correction shortened to at most cap * |base|.
vec3 skinbake_capped(vec3 base, vec3 correction, float cap)
{
    float allowed = cap * cap * dot(base, base);
    float square = dot(correction, correction);
    bool too_long = square > allowed && allowed > 0.0;
    return base + (too_long ? sqrt(allowed / square) : 1.0) * correction;
}
#endif

#ifndef SKINBAKE_DERIVATIVE_CAPPED
#define SKINBAKE_DERIVATIVE_CAPPED
// The derivative of p + delta along t, where the mix b changes at the rate db; delta = k h, i as in the caller.
vec3 skinbake_derivative(mat2x4 b, float k, vec3 p, vec3 i, vec3 delta, vec3 t, mat2x4 db, float cap)
{
    vec3 di = b[0].w * t + db[1].xyz + cross(b[0].xyz, t) + db[0].w * p + cross(db[0].xyz, p);
    vec3 dh = b[0].w * db[1].xyz + cross(b[0].xyz, di) + cross(db[0].xyz, i)
            + db[0].w * b[1].xyz - db[1].w * b[0].xyz - b[1].w * db[0].xyz - dot(b[0], db[0]) * delta;
    vec3 turn = cross(b[0].xyz, b[0].w * t + cross(b[0].xyz, t));
    return skinbake_capped(t + k * turn, k * (dh - turn), cap);
}
#endif

// The frame moves by the derivative of the mix's motion itself: p' = p + delta, delta = k h,
//     i = r x p + r0 p + d, h = r x i + r0 d - d0 r, k = 2 / (r0^2 + |r|^2), the mix b = (r0, r, d0, d).
// Q: the dual quaternions of slots 0 to 7.
skinbake_Vertex skinbake_dqs_exact(vec3 p, skinbake_Frame frame, mat2x4 Q[8], vec4 weights_0, vec4 weights_1,
        vec3 alpha_0, vec4 alpha_1, vec3 beta_0, vec4 beta_1)
{
    float s1 = skinbake_hemisphere(Q[1], Q[0]); // 1
    float s2 = skinbake_hemisphere(Q[2], Q[0]);
    float s3 = skinbake_hemisphere(Q[3], Q[0]);
    float s4 = skinbake_hemisphere(Q[4], Q[0]);
    float s5 = skinbake_hemisphere(Q[5], Q[0]);
    float s6 = skinbake_hemisphere(Q[6], Q[0]);
    float s7 = skinbake_hemisphere(Q[7], Q[0]);
    mat2x4 b = weights_0.x * Q[0]
              + (s1 * weights_0.y) * Q[1]
              + (s2 * weights_0.z) * Q[2]
              + (s3 * weights_0.w) * Q[3]
              + (s4 * weights_1.x) * Q[4]
              + (s5 * weights_1.y) * Q[5]
              + (s6 * weights_1.z) * Q[6]
              + (s7 * weights_1.w) * Q[7];
    float square = dot(b[0], b[0]);
    float k = square == 0.0 ? 2.0 : 2.0 / square; // 2
    vec3 i = b[0].w * p + b[1].xyz + cross(b[0].xyz, p); // 3
    vec3 delta = k * (b[0].w * b[1].xyz - b[1].w * b[0].xyz + cross(b[0].xyz, i));
    skinbake_Vertex v;
    v.position = p + delta;
    mat2x4 D1 = s1 * Q[1] - Q[0]; // 4
    mat2x4 D2 = s2 * Q[2] - Q[0];
    mat2x4 D3 = s3 * Q[3] - Q[0];
    mat2x4 D4 = s4 * Q[4] - Q[0];
    mat2x4 D5 = s5 * Q[5] - Q[0];
    mat2x4 D6 = s6 * Q[6] - Q[0];
    mat2x4 D7 = s7 * Q[7] - Q[0];
    mat2x4 db_t = alpha_0.x * D1 + alpha_0.y * D2 + alpha_0.z * D3 + alpha_1.x * D4 + alpha_1.y * D5
            + alpha_1.z * D6 + alpha_1.w * D7; // 5
    mat2x4 db_b = beta_0.x * D1 + beta_0.y * D2 + beta_0.z * D3 + beta_1.x * D4 + beta_1.y * D5
            + beta_1.z * D6 + beta_1.w * D7; // 6
    v.tangent = skinbake_derivative(b, k, p, i, delta, frame.tangent, db_t, 0.9); // 7
    v.bitangent = skinbake_derivative(b, k, p, i, delta, frame.bitangent, db_b, 0.9); // 8
    v.normal = cross(v.tangent, v.bitangent); // 9
    return v;
}

#endif
