// Lighting for skinned meshes that skinbake has baked: dual quaternion skinning, standard lighting,
// 4 influences a vertex, tangent frame.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang wgsl --method dqs --lighting standard --influences 4 --frame tangent
//
// Algorithm 4 of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned
// Models", Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. The numbers beside the lines
// come from its supplement.
// Dual quaternions: L. Kavan, S. Collins, J. Zara, C. O'Sullivan, "Skinning with Dual Quaternions", I3D 2007.
// WGSL for WebGPU. Pure functions: no bindings and no module variables.
//
// Inputs of each vertex, in mesh space: the attributes as they are stored, before any joint matrix:
//     POSITION             vec3<f32>  p, in the file's unit of length
//     NORMAL               vec3<f32>  n0, of length 1: normalize() it if it is stored as integers
//     TANGENT              vec4<f32>  t0, and in w the handedness of the frame, 1 or -1
//     JOINTS_0             vec4<u32>  joints of slots 0 to 3
//     WEIGHTS_0            vec4<f32>  w of slots 0 to 3; over all slots they sum to 1
//
// Q[s] is the dual quaternion of the joint in slot s, made of its joint matrix by skinbake_dual_quaternion().
// Use:
//     let frame = skinbake_frame(normal, tangent);
//     let v = skinbake_dqs_standard(position, frame, Q, weights_0);
//     // v.position; normalize(v.normal); normalize(v.tangent)

// A skinned vertex. Its vectors have any length. tangent and bitangent are the images of t0 and b0.
struct skinbake_Vertex {
    position: vec3<f32>,
    normal: vec3<f32>,
    tangent: vec3<f32>,
    bitangent: vec3<f32>,
}

// The tangent frame at rest.
struct skinbake_Frame {
    normal: vec3<f32>,
    tangent: vec3<f32>,
    bitangent: vec3<f32>,
    handedness: f32, // n0 = handedness * cross(t0, b0) / |t0|^2
}

// The frame of NORMAL, which must have length 1, and TANGENT.
fn skinbake_frame(n: vec3<f32>, tangent: vec4<f32>) -> skinbake_Frame {
    return skinbake_Frame(n, tangent.xyz, cross(n, tangent.xyz) * tangent.w, tangent.w);
}

// The unit dual quaternion of a rigid joint matrix. [0] is its real part (x, y, z, w), w the scalar; [1] is its
// dual part. Compute it on the host or in a pass over the joints: once per joint and frame, not per vertex.
// Dual quaternions have no scale. If all joint matrices share a uniform scale s, divide their upper 3x3 parts by
// s first, and skin s * p, s * t0, s * b0 in place of p, t0, b0.
fn skinbake_dual_quaternion(M: mat4x4<f32>) -> mat2x4<f32> {
    let d = vec3<f32>(M[0].x, M[1].y, M[2].z);
    let squares = 1.0 + vec4<f32>( // 4 * (x, y, z, w)^2
        d.x - d.y - d.z, d.y - d.z - d.x, d.z - d.x - d.y, d.x + d.y + d.z);
    let differences = vec3<f32>(M[1].z - M[2].y, M[2].x - M[0].z, M[0].y - M[1].x); // 4 w * (x, y, z)
    let sums = vec3<f32>(M[1].z + M[2].y, M[2].x + M[0].z, M[0].y + M[1].x); // 4 * (yz, zx, xy)
    var real = vec4<f32>(differences, squares.w);
    var largest = squares.w;
    if (squares.x > largest) {
        largest = squares.x;
        real = vec4<f32>(squares.x, sums.z, sums.y, differences.x);
    }
    if (squares.y > largest) {
        largest = squares.y;
        real = vec4<f32>(sums.z, squares.y, sums.x, differences.y);
    }
    if (squares.z > largest) {
        real = vec4<f32>(sums.y, sums.x, squares.z, differences.z);
    }
    real = normalize(real);
    let t = M[3].xyz;
    return mat2x4<f32>(real, 0.5 * vec4<f32>(cross(t, real.xyz) + real.w * t, -dot(t, real.xyz)));
}

// -1 if the real part of the joint points away from that of the pivot: q and -q are the same rotation.
fn skinbake_hemisphere(joint: mat2x4<f32>, pivot: mat2x4<f32>) -> f32 {
    return select(1.0, -1.0, dot(joint[0], pivot[0]) < 0.0);
}

// (Q(p) - p) / 2 of a unit dual quaternion Q.
fn skinbake_half_displacement(Q: mat2x4<f32>, p: vec3<f32>) -> vec3<f32> {
    let i = Q[0].w * p + Q[1].xyz + cross(Q[0].xyz, p);
    return Q[0].w * Q[1].xyz - Q[1].w * Q[0].xyz + cross(Q[0].xyz, i);
}

// v rotated by a unit quaternion q.
fn skinbake_rotated(q: vec4<f32>, v: vec3<f32>) -> vec3<f32> {
    return v + 2.0 * cross(q.xyz, q.w * v + cross(q.xyz, v));
}

// The frame moves by the normalised mix b, as if the weights were constant over the surface.
// Q: the dual quaternions of slots 0 to 3.
fn skinbake_dqs_standard(p: vec3<f32>, frame: skinbake_Frame, Q: array<mat2x4<f32>, 4>,
        weights_0: vec4<f32>) -> skinbake_Vertex {
    let s1 = skinbake_hemisphere(Q[1], Q[0]); // 1
    let s2 = skinbake_hemisphere(Q[2], Q[0]);
    let s3 = skinbake_hemisphere(Q[3], Q[0]);
    let mixed = weights_0.x * Q[0]
          + (s1 * weights_0.y) * Q[1]
          + (s2 * weights_0.z) * Q[2]
          + (s3 * weights_0.w) * Q[3];
    let square = dot(mixed[0], mixed[0]);
    let b = select(1.0, inverseSqrt(square), square > 0.0) * mixed; // 2
    let position = p + 2.0 * skinbake_half_displacement(b, p); // 3
    let normal = skinbake_rotated(b[0], frame.normal); // 4
    let tangent = skinbake_rotated(b[0], frame.tangent); // 5
    let bitangent = skinbake_rotated(b[0], frame.bitangent); // 6
    return skinbake_Vertex(position, normal, tangent, bitangent);
}
