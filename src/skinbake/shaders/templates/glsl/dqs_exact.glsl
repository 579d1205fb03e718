// The frame moves by the derivative of the motion p' = p + delta of the mix, delta = k h,
//     i = r x p + r0 p + d, h = r x i + r0 d - d0 r, k = 2 / (r0^2 + |r|^2), the mix b = (r0, r, d0, d).
// Q: the dual quaternions of @{ slot_words }.
skinbake_Vertex skinbake_dqs_exact(vec3 p, skinbake_Frame frame, mat2x4 Q[@{ influences }]@{ params(weight_params + gradient_params) })
{
//% include "glsl/mix.glsl"
    float square = dot(b[0], b[0]);
    float k = square == 0.0 ? 2.0 : 2.0 / square; // 2
    vec3 i = b[0].w * p + b[1].xyz + cross(b[0].xyz, p); // 3
    vec3 delta = k * (b[0].w * b[1].xyz - b[1].w * b[0].xyz + cross(b[0].xyz, i));
    skinbake_Vertex v;
    v.position = p + delta;
//% if others
//% for slot in others
    mat2x4 D@{ slot.index } = s@{ slot.index } * Q[@{ slot.index }] - Q[0];@{ " // 4" if loop.first }
//% endfor
    mat2x4 db_t = @{ sum("alpha", "D%d", others) }; // 5
    mat2x4 db_b = @{ sum("beta", "D%d", others) }; // 6
    v.tangent = skinbake_derivative(b, k, p, i, delta, frame.tangent, db_t@{ ", " ~ cap_text if cap is not none }); // 7
    v.bitangent = skinbake_derivative(b, k, p, i, delta, frame.bitangent, db_b@{ ", " ~ cap_text if cap is not none }); // 8
//% else
    v.tangent = frame.tangent + k * cross(b[0].xyz, b[0].w * frame.tangent + cross(b[0].xyz, frame.tangent)); // 7
    v.bitangent = frame.bitangent + k * cross(b[0].xyz, b[0].w * frame.bitangent + cross(b[0].xyz, frame.bitangent)); // 8
//% endif
    v.normal = @{ handed("cross(v.tangent, v.bitangent)") }; // 9
//% if normal_map
    vec3 carried = frame.normal + k * cross(b[0].xyz, b[0].w * frame.normal + cross(b[0].xyz, frame.normal)); // 10
    v.cotangent = @{ handed("cross(v.bitangent, carried)") }; // 11
    v.cobitangent = @{ handed("cross(carried, v.tangent)") }; // 12
//% endif
    return v;
}
