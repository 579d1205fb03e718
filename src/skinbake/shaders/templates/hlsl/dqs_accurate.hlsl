// The frame moves by the normalised mix b, corrected as if the mix blended positions. Algorithm 6 is exact.
// Q: the dual quaternions of @{ slot_words }.
skinbake_Vertex skinbake_dqs_accurate(float3 p, skinbake_Frame frame, float2x4 Q[@{ influences }]@{ params(weight_params + gradient_params) })
{
//% include "hlsl/mix.hlsl"
//% include "hlsl/unit.hlsl"
    skinbake_Vertex v;
    v.position = p + 2.0 * skinbake_half_displacement(b, p); // 3
//% for slot in (slots if others else [])
    float3 q@{ slot.index } = 2.0 * skinbake_half_displacement(Q[@{ slot.index }], p);@{ " // 4: each joint's Q(p) - p" if loop.first }
//% endfor
//% for slot in others
    float3 d@{ slot.index } = q@{ slot.index } - q0;@{ " // 5" if loop.first }
//% endfor
    v.tangent = @{ corrected("skinbake_rotated(b[0], frame.tangent)", sum("alpha", "d%d", others)) }; // 6
    v.bitangent = @{ corrected("skinbake_rotated(b[0], frame.bitangent)", sum("beta", "d%d", others)) }; // 7
    v.normal = @{ handed("cross(v.tangent, v.bitangent)") }; // 8
//% if normal_map
    float3 carried = skinbake_rotated(b[0], frame.normal); // 9
    v.cotangent = @{ handed("cross(v.bitangent, carried)") }; // 10
    v.cobitangent = @{ handed("cross(carried, v.tangent)") }; // 11
//% endif
    return v;
}
