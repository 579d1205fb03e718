// The frame moves by the normalised mix b, as if the weights were constant over the surface.
// Q: the dual quaternions of @{ slot_words }.
skinbake_Vertex skinbake_dqs_standard(float3 p, skinbake_Frame frame, float2x4 Q[@{ influences }]@{ params(weight_params) })
{
//% include "hlsl/mix.hlsl"
//% include "hlsl/unit.hlsl"
    skinbake_Vertex v;
    v.position = p + 2.0 * skinbake_half_displacement(b, p); // 3
    v.normal = skinbake_rotated(b[0], frame.normal); // 4
    v.tangent = skinbake_rotated(b[0], frame.tangent); // 5
    v.bitangent = skinbake_rotated(b[0], frame.bitangent); // 6
    return v;
}
