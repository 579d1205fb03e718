// The frame moves by the Jacobian J of the skinned position, the normal by its inverse transpose.
// M: the joint matrices of @{ slot_words }; a: their weight gradients, as skinbake_gradients() gives them.
fn skinbake_lbs_direct(p: vec3<f32>, frame: skinbake_Frame, M: array<mat4x4<f32>, @{ influences }>@{ params(weight_params) }, a: array<vec3<f32>, @{ influences }>) -> skinbake_Vertex {
//% for slot in slots
    @{ "let T =" if loop.first else "      +" } @{ slot.weight } * skinbake_rows(M[@{ slot.index }])@{ ";" if loop.last }@{ " // 1" if loop.first }
//% endfor
//% for slot in slots
    let q@{ slot.index } = skinbake_moved(M[@{ slot.index }], p);@{ " // 2" if loop.first }
//% endfor
//% for column in ["x", "y", "z"]
    let J@{ column } = T[@{ loop.index0 }] + @{ joined(" + ", "q%d * a[%d]." ~ column, slots) };@{ " // 3" if loop.first }
//% endfor
    let C = mat3x3<f32>(cross(Jy, Jz), cross(Jz, Jx), cross(Jx, Jy)); // 4: J^-T = C / det J
    let det = dot(Jx, C[0]);
    let J = mat3x3<f32>(Jx, Jy, Jz);
    let position = T * vec4<f32>(p, 1.0); // 5
    let normal = (C * frame.normal) * select(1.0 / det, 1.0, det == 0.0); // 6
    let tangent = J * frame.tangent; // 7
    let bitangent = J * frame.bitangent; // 8
    return skinbake_Vertex(position, normal, tangent, bitangent);
}
