// The frame moves by the blended matrix T, as if the weights were constant over the surface.
// M: the joint matrices of @{ slot_words }.
fn skinbake_lbs_standard(p: vec3<f32>, frame: skinbake_Frame, M: array<mat4x4<f32>, @{ influences }>@{ params(weight_params) }) -> skinbake_Vertex {
//% for slot in slots
    @{ "let T =" if loop.first else "      +" } @{ slot.weight } * skinbake_rows(M[@{ slot.index }])@{ ";" if loop.last }@{ " // 1" if loop.first }
//% endfor
    let upper = mat3x3<f32>(T[0], T[1], T[2]);
    let position = T * vec4<f32>(p, 1.0); // 2
    let normal = upper * frame.normal; // 3
    let tangent = upper * frame.tangent; // 4
    let bitangent = upper * frame.bitangent; // 5
    return skinbake_Vertex(position, normal, tangent, bitangent);
}
