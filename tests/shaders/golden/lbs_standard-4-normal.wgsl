// Lighting for skinned meshes that skinbake has baked: linear blend skinning, standard lighting,
// 4 influences a vertex, normal frame.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang wgsl --method lbs --lighting standard --influences 4 --frame normal
//
// Algorithm 1 of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned
// Models", Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. The numbers beside the lines
// come from its supplement.
// Frame: T. Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.
// WGSL for WebGPU. Pure functions: no bindings and no module variables.
//
// Inputs of each vertex, in mesh space: the attributes as they are stored, before any joint matrix:
//     POSITION             vec3<f32>  p, in the file's unit of length
//     NORMAL               vec3<f32>  n0, of length 1: normalize() it if it is stored as integers
//     JOINTS_0             vec4<u32>  joints of slots 0 to 3
//     WEIGHTS_0            vec4<f32>  w of slots 0 to 3; over all slots they sum to 1
//
// M[s] is the joint matrix of the joint in slot s: its global transform * its inverse bind matrix.
// Use:
//     let frame = skinbake_frame(normal);
//     let v = skinbake_lbs_standard(position, frame, M, weights_0);
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

// The frame that bake took from NORMAL alone. n must have length 1. Every product in a sum is exact, so a compiler
// that fuses multiply-adds gets the same bits. side is the last factor, because Mesa turns side * ((x * x) * a)
// into side * (x * (x * a)).
fn skinbake_frame(n: vec3<f32>) -> skinbake_Frame {
    let side = select(-1.0, 1.0, n.z >= 0.0); // 1 also at -0.0
    let a = -1.0 / (side + n.z);
    let b = (n.x * n.y) * a;
    let t0 = vec3<f32>(1.0 + ((n.x * n.x) * a) * side, side * b, -side * n.x);
    let b0 = vec3<f32>(b, side * (1.0 + ((n.y * n.y) * a) * side), -n.y);
    return skinbake_Frame(n, t0, b0, 1.0);
}

// M without its last row, which is (0, 0, 0, 1).
fn skinbake_rows(M: mat4x4<f32>) -> mat4x3<f32> {
    return mat4x3<f32>(M[0].xyz, M[1].xyz, M[2].xyz, M[3].xyz);
}

// The frame moves by the blended matrix T, as if the weights were constant over the surface.
// M: the joint matrices of slots 0 to 3.
fn skinbake_lbs_standard(p: vec3<f32>, frame: skinbake_Frame, M: array<mat4x4<f32>, 4>,
        weights_0: vec4<f32>) -> skinbake_Vertex {
    let T = weights_0.x * skinbake_rows(M[0]) // 1
          + weights_0.y * skinbake_rows(M[1])
          + weights_0.z * skinbake_rows(M[2])
          + weights_0.w * skinbake_rows(M[3]);
    let upper = mat3x3<f32>(T[0], T[1], T[2]);
    let position = T * vec4<f32>(p, 1.0); // 2
    let normal = upper * frame.normal; // 3
    let tangent = upper * frame.tangent; // 4
    let bitangent = upper * frame.bitangent; // 5
    return skinbake_Vertex(position, normal, tangent, bitangent);
}
