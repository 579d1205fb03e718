// The frame moves by the blended matrix T, as if the weights were constant over the surface.
// M: the joint matrices of @{ slot_words }.
skinbake_Vertex skinbake_lbs_standard(float3 p, skinbake_Frame frame, float4x4 M[@{ influences }]@{ params(weight_params) })
{
//% for slot in slots
    @{ "float3x4 T =" if loop.first else "          +" } @{ slot.weight } * (float3x4)M[@{ slot.index }]@{ ";" if loop.last }@{ " // 1" if loop.first }
//% endfor
    float3x3 upper = (float3x3)T;
    skinbake_Vertex v;
    v.position = mul(T, float4(p, 1.0)); // 2
    v.normal = mul(upper, frame.normal); // 3
    v.tangent = mul(upper, frame.tangent); // 4
    v.bitangent = mul(upper, frame.bitangent); // 5
    return v;
}
