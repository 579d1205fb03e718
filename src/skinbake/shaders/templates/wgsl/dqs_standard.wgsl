// The frame moves by the normalised mix b, as if the weights were constant over the surface.
// Q: the dual quaternions of @{ slot_words }.
fn skinbake_dqs_standard(p: vec3<f32>, frame: skinbake_Frame, Q: array<mat2x4<f32>, @{ influences }>@{ params(weight_params) }) -> skinbake_Vertex {
//% set mixed = "mixed"
//% include "wgsl/mix.wgsl"
//% include "wgsl/unit.wgsl"
    let position = p + 2.0 * skinbake_half_displacement(b, p); // 3
    let normal = skinbake_rotated(b[0], frame.normal); // 4
    let tangent = skinbake_rotated(b[0], frame.tangent); // 5
    let bitangent = skinbake_rotated(b[0], frame.bitangent); // 6
    return skinbake_Vertex(position, normal, tangent, bitangent);
}
