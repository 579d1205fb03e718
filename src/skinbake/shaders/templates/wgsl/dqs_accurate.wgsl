// The frame moves by the normalised mix b, corrected as if the mix blended positions. Algorithm 6 is exact.
// Q: the dual quaternions of @{ slot_words }.
fn skinbake_dqs_accurate(p: vec3<f32>, frame: skinbake_Frame, Q: array<mat2x4<f32>, @{ influences }>@{ params(weight_params + gradient_params) }) -> skinbake_Vertex {
//% set mixed = "mixed"
//% include "wgsl/mix.wgsl"
//% include "wgsl/unit.wgsl"
    let position = p + 2.0 * skinbake_half_displacement(b, p); // 3
//% for slot in (slots if others else [])
    let q@{ slot.index } = 2.0 * skinbake_half_displacement(Q[@{ slot.index }], p);@{ " // 4: each joint's Q(p) - p" if loop.first }
//% endfor
//% for slot in others
    let d@{ slot.index } = q@{ slot.index } - q0;@{ " // 5" if loop.first }
//% endfor
    let tangent = @{ corrected("skinbake_rotated(b[0], frame.tangent)", sum("alpha", "d%d", others)) }; // 6
    let bitangent = @{ corrected("skinbake_rotated(b[0], frame.bitangent)", sum("beta", "d%d", others)) }; // 7
    let normal = @{ handed("cross(tangent, bitangent)") }; // 8
//% if normal_map
    let carried = skinbake_rotated(b[0], frame.normal); // 9
    let cotangent = @{ handed("cross(bitangent, carried)") }; // 10
    let cobitangent = @{ handed("cross(carried, tangent)") }; // 11
//% endif
    return skinbake_Vertex(position, normal, tangent, bitangent@{ ", cotangent, cobitangent" if normal_map });
}
