// The frame moves by the derivative of the motion p' = p + delta of the mix, delta = k h,
//     i = r x p + r0 p + d, h = r x i + r0 d - d0 r, k = 2 / (r0^2 + |r|^2), the mix b = (r0, r, d0, d).
// Q: the dual quaternions of @{ slot_words }.
fn skinbake_dqs_exact(p: vec3<f32>, frame: skinbake_Frame, Q: array<mat2x4<f32>, @{ influences }>@{ params(weight_params + gradient_params) }) -> skinbake_Vertex {
//% set mixed = "b"
//% include "wgsl/mix.wgsl"
    let square = dot(b[0], b[0]);
    let k = select(2.0 / square, 2.0, square == 0.0); // 2
    let i = b[0].w * p + b[1].xyz + cross(b[0].xyz, p); // 3
    let delta = k * (b[0].w * b[1].xyz - b[1].w * b[0].xyz + cross(b[0].xyz, i));
    let position = p + delta;
//% if others
//% for slot in others
    let D@{ slot.index } = s@{ slot.index } * Q[@{ slot.index }] - Q[0];@{ " // 4" if loop.first }
//% endfor
    let db_t = @{ sum("alpha", "D%d", others) }; // 5
    let db_b = @{ sum("beta", "D%d", others) }; // 6
    let tangent = skinbake_derivative(b, k, p, i, delta, frame.tangent, db_t@{ ", " ~ cap_text if cap is not none }); // 7
    let bitangent = skinbake_derivative(b, k, p, i, delta, frame.bitangent, db_b@{ ", " ~ cap_text if cap is not none }); // 8
//% else
    let tangent = frame.tangent + k * cross(b[0].xyz, b[0].w * frame.tangent + cross(b[0].xyz, frame.tangent)); // 7
    let bitangent = frame.bitangent + k * cross(b[0].xyz, b[0].w * frame.bitangent + cross(b[0].xyz, frame.bitangent)); // 8
//% endif
    let normal = @{ handed("cross(tangent, bitangent)") }; // 9
//% if normal_map
    let carried = frame.normal + k * cross(b[0].xyz, b[0].w * frame.normal + cross(b[0].xyz, frame.normal)); // 10
    let cotangent = @{ handed("cross(bitangent, carried)") }; // 11
    let cobitangent = @{ handed("cross(carried, tangent)") }; // 12
//% endif
    return skinbake_Vertex(position, normal, tangent, bitangent@{ ", cotangent, cobitangent" if normal_map });
}
