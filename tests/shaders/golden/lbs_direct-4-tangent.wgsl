// Lighting for skinned meshes that skinbake has baked: linear blend skinning, direct lighting,
// 4 influences a vertex, tangent frame.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang wgsl --method lbs --lighting direct --influences 4 --frame tangent
//
// Algorithm 2 of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned
// Models", Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. The numbers beside the lines
// come from its supplement.
// WGSL for WebGPU. Pure functions: no bindings and no module variables.
//
// Inputs of each vertex, in mesh space: the attributes as they are stored, before any joint matrix:
//     POSITION             vec3<f32>  p, in the file's unit of length
//     NORMAL               vec3<f32>  n0, of length 1: normalize() it if it is stored as integers
//     TANGENT              vec4<f32>  t0, and in w the handedness of the frame, 1 or -1
//     JOINTS_0             vec4<u32>  joints of slots 0 to 3
//     WEIGHTS_0            vec4<f32>  w of slots 0 to 3; over all slots they sum to 1
//     _SKINBAKE_ALPHA_0    vec3<f32>  alpha = grad w . t0 of slots 1 to 3, in 1 / unit of POSITION
//     _SKINBAKE_BETA_0     vec3<f32>  beta = grad w . b0 of the same slots
// alpha and beta of slot 0 are not stored: they are minus the sums over the other slots.
//
// M[s] is the joint matrix of the joint in slot s: its global transform * its inverse bind matrix.
// Use:
//     let frame = skinbake_frame(normal, tangent);
//     let v = skinbake_lbs_direct(position, frame, M, weights_0, skinbake_gradients(frame, alpha_0, beta_0));
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

// M without its last row, which is (0, 0, 0, 1).
fn skinbake_rows(M: mat4x4<f32>) -> mat4x3<f32> {
    return mat4x3<f32>(M[0].xyz, M[1].xyz, M[2].xyz, M[3].xyz);
}

// M p: the position p moved by the joint matrix M alone.
fn skinbake_moved(M: mat4x4<f32>, p: vec3<f32>) -> vec3<f32> {
    return M[0].xyz * p.x + (M[1].xyz * p.y + (M[2].xyz * p.z + M[3].xyz));
}

// The weight gradients of all slots from alpha and beta: a[s] = alpha[s] t0 + beta[s] b0.
fn skinbake_gradients(frame: skinbake_Frame, alpha_0: vec3<f32>, beta_0: vec3<f32>) -> array<vec3<f32>, 4> {
    let a1 = alpha_0.x * frame.tangent + beta_0.x * frame.bitangent;
    let a2 = alpha_0.y * frame.tangent + beta_0.y * frame.bitangent;
    let a3 = alpha_0.z * frame.tangent + beta_0.z * frame.bitangent;
    let a0 = -(a1 + a2 + a3);
    return array<vec3<f32>, 4>(a0, a1, a2, a3);
}

// The frame moves by the Jacobian J of the skinned position, the normal by its inverse transpose.
// M: the joint matrices of slots 0 to 3; a: their weight gradients, as skinbake_gradients() gives them.
fn skinbake_lbs_direct(p: vec3<f32>, frame: skinbake_Frame, M: array<mat4x4<f32>, 4>, weights_0: vec4<f32>,
        a: array<vec3<f32>, 4>) -> skinbake_Vertex {
    let T = weights_0.x * skinbake_rows(M[0]) // 1
          + weights_0.y * skinbake_rows(M[1])
          + weights_0.z * skinbake_rows(M[2])
          + weights_0.w * skinbake_rows(M[3]);
    let q0 = skinbake_moved(M[0], p); // 2
    let q1 = skinbake_moved(M[1], p);
    let q2 = skinbake_moved(M[2], p);
    let q3 = skinbake_moved(M[3], p);
    let Jx = T[0] + q0 * a[0].x + q1 * a[1].x + q2 * a[2].x + q3 * a[3].x; // 3
    let Jy = T[1] + q0 * a[0].y + q1 * a[1].y + q2 * a[2].y + q3 * a[3].y;
    let Jz = T[2] + q0 * a[0].z + q1 * a[1].z + q2 * a[2].z + q3 * a[3].z;
    let C = mat3x3<f32>(cross(Jy, Jz), cross(Jz, Jx), cross(Jx, Jy)); // 4: J^-T = C / det J
    let det = dot(Jx, C[0]);
    let J = mat3x3<f32>(Jx, Jy, Jz);
    let position = T * vec4<f32>(p, 1.0); // 5
    let normal = (C * frame.normal) * select(1.0 / det, 1.0, det == 0.0); // 6
    let tangent = J * frame.tangent; // 7
    let bitangent = J * frame.bitangent; // 8
    return skinbake_Vertex(position, normal, tangent, bitangent);
}
