// Lighting for skinned meshes that skinbake has baked: dual quaternion skinning, exact lighting,
// 1 influence a vertex, normal frame.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang wgsl --method dqs --lighting exact --influences 1 --frame normal
//
// Algorithm 6 of skinbake: the exact derivative of the dual-quaternion blend, after M. Tarini, D. Panozzo,
// O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned Models", Computer Graphics Forum 33(2),
// 2014, doi:10.1111/cgf.12330. The numbers beside the lines are those of `skinbake cost`.
// Dual quaternions: L. Kavan, S. Collins, J. Zara, C. O'Sullivan, "Skinning with Dual Quaternions", I3D 2007.
// Frame: T. Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.
// WGSL for WebGPU. Pure functions: no bindings and no module variables.
//
// It reads of each vertex (mesh space: as the attributes come, before any joint matrix):
//     POSITION             vec3<f32>  p, in the file's unit of length
//     NORMAL               vec3<f32>  n0, of length 1: normalize() it where it is stored as integers
//     JOINTS_0             vec4<u32>  joints of slot 0
//     WEIGHTS_0            vec4<f32>  w of slot 0; over all slots they sum to 1
//
// Q[s] is the dual quaternion of the joint in slot s, made of its joint matrix by skinbake_dual_quaternion().
// Use:
//     let frame = skinbake_frame(normal);
//     let v = skinbake_dqs_exact(position, frame, Q, weights_0);
//     // v.position; normalize(v.normal); normalize(v.tangent)

// A skinned vertex. None of its vectors is of unit length; tangent and bitangent are the images of t0 and b0.
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

// The frame that bake took from NORMAL alone; n must have length 1. Written so that a compiler which fuses
// multiply-adds gets the same bits: every product that meets a sum is exact. side stands last there: Mesa turns
// side * ((x * x) * a) into side * (x * (x * a)).
fn skinbake_frame(n: vec3<f32>) -> skinbake_Frame {
    let side = select(-1.0, 1.0, n.z >= 0.0); // 1 also at -0.0
    let a = -1.0 / (side + n.z);
    let b = (n.x * n.y) * a;
    let t0 = vec3<f32>(1.0 + ((n.x * n.x) * a) * side, side * b, -side * n.x);
    let b0 = vec3<f32>(b, side * (1.0 + ((n.y * n.y) * a) * side), -n.y);
    return skinbake_Frame(n, t0, b0, 1.0);
}

// The unit dual quaternion of a rigid joint matrix: [0] is its real part (x, y, z, w), w the scalar, [1] its
// dual part. For the host, or for a pass over the joints: once a joint and frame, not once a vertex.
// Dual quaternions carry no scale: where all joint matrices share a uniform scale s, divide their upper 3x3
// parts by s before, and skin s * p, s * t0, s * b0 in place of p, t0, b0.
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

// The frame moves by the derivative of the mix's motion itself: p' = p + delta, delta = k h,
//     i = r x p + r0 p + d, h = r x i + r0 d - d0 r, k = 2 / (r0^2 + |r|^2), the mix b = (r0, r, d0, d).
// Q: the dual quaternions of slot 0.
fn skinbake_dqs_exact(p: vec3<f32>, frame: skinbake_Frame, Q: array<mat2x4<f32>, 1>,
        weights_0: vec4<f32>) -> skinbake_Vertex {
    let b = weights_0.x * Q[0]; // 1
    let square = dot(b[0], b[0]);
    let k = select(2.0 / square, 2.0, square == 0.0); // 2
    let i = b[0].w * p + b[1].xyz + cross(b[0].xyz, p); // 3
    let delta = k * (b[0].w * b[1].xyz - b[1].w * b[0].xyz + cross(b[0].xyz, i));
    let position = p + delta;
    let tangent = frame.tangent + k * cross(b[0].xyz, b[0].w * frame.tangent + cross(b[0].xyz,
            frame.tangent)); // 7
    let bitangent = frame.bitangent + k * cross(b[0].xyz, b[0].w * frame.bitangent + cross(b[0].xyz,
            frame.bitangent)); // 8
    let normal = cross(tangent, bitangent); // 9
    return skinbake_Vertex(position, normal, tangent, bitangent);
}
