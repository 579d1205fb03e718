// The frame moves by the derivative of the skinned position along t0 and b0.
// M: the joint matrices of @{ slot_words }.
fn skinbake_lbs_accurate(p: vec3<f32>, frame: skinbake_Frame, M: array<mat4x4<f32>, @{ influences }>@{ params(weight_params + gradient_params) }) -> skinbake_Vertex {
//% for slot in slots
    @{ "let T =" if loop.first else "      +" } @{ slot.weight } * skinbake_upper(M[@{ slot.index }])@{ ";" if loop.last }@{ " // 1" if loop.first }
//% endfor
//% for slot in slots
    let q@{ slot.index } = skinbake_moved(M[@{ slot.index }], p);@{ " // 2" if loop.first }
//% endfor
//% for slot in others
    let d@{ slot.index } = q@{ slot.index } - q0;@{ " // 3" if loop.first }
//% endfor
    let tangent = @{ corrected("T * frame.tangent", sum("alpha", "d%d", others)) }; // 4
    let bitangent = @{ corrected("T * frame.bitangent", sum("beta", "d%d", others)) }; // 5
//% if mirrored_joints
    let outside = select(1.0, -1.0, determinant(T) < 0.0); // a joint that mirrors turns t x b to the inside
    let normal = outside * @{ handed("cross(tangent, bitangent)") }; // 6
//% else
    let normal = @{ handed("cross(tangent, bitangent)") }; // 6
//% endif
    let position = q0@{ " + " ~ sum("weight", "d%d", others) if others }; // 7
//% if normal_map
    let carried = T * frame.normal; // 8
    let cotangent = @{ "outside * " if mirrored_joints }@{ handed("cross(bitangent, carried)") }; // 9
    let cobitangent = @{ "outside * " if mirrored_joints }@{ handed("cross(carried, tangent)") }; // 10
//% endif
    return skinbake_Vertex(position, normal, tangent, bitangent@{ ", cotangent, cobitangent" if normal_map });
}
