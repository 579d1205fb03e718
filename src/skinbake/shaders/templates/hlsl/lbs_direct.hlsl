// The frame moves by the Jacobian J of the skinned position, the normal by its inverse transpose.
// M: the joint matrices of @{ slot_words }; a: their weight gradients, from skinbake_gradients().
skinbake_Vertex skinbake_lbs_direct(float3 p, skinbake_Frame frame, float4x4 M[@{ influences }]@{ params(weight_params) }, float3 a[@{ influences }])
{
//% for slot in slots
    @{ "float3x4 T =" if loop.first else "          +" } @{ slot.weight } * (float3x4)M[@{ slot.index }]@{ ";" if loop.last }@{ " // 1" if loop.first }
//% endfor
//% for slot in slots
    float3 q@{ slot.index } = skinbake_moved(M[@{ slot.index }], p);@{ " // 2" if loop.first }
//% endfor
    float3x3 J = (float3x3)T // 3
//% for slot in slots
        + skinbake_outer(q@{ slot.index }, a[@{ slot.index }])@{ ";" if loop.last }
//% endfor
    float3x3 C = float3x3(cross(J[1], J[2]), cross(J[2], J[0]), cross(J[0], J[1])); // 4: J^-T = C / det J
    float det = dot(J[0], C[0]);
    skinbake_Vertex v;
    v.position = mul(T, float4(p, 1.0)); // 5
    v.normal = mul(C, frame.normal) * (det == 0.0 ? 1.0 : 1.0 / det); // 6
    v.tangent = mul(J, frame.tangent); // 7
    v.bitangent = mul(J, frame.bitangent); // 8
    return v;
}
