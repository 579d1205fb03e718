// Each vertex lies between linear blending, l, and dual quaternions, d: p' = l + b (d - l).
//% if lighting == "standard"
// b: the blend weight.
//% else
// blend: the blend weight b, and its derivatives along t0 and b0, by which d - l is a part of t' and b'.
//% endif
// M: the joint matrices of @{ slot_words }. Q: what is made of them.
//% set own = weight_params + (gradient_params if reads_gradients else [])
//% set given = own | map(attribute=1) | join(", ")
skinbake_Vertex skinbake_@{ stem }(float3 p, skinbake_Frame frame, float4x4 M[@{ influences }], @{ motion_type } Q[@{ influences }]@{ params(own) }, @{ "float b" if lighting == "standard" else "float3 blend" })
{
    skinbake_Vertex l = skinbake_lbs_@{ lighting }(p, frame, M, @{ given });
    skinbake_Vertex v = skinbake_@{ dual_stem }(p, frame, Q, @{ given });
//% if lighting == "standard"
    v.position = lerp(l.position, v.position, b);
    v.normal = lerp(normalize(l.normal), normalize(v.normal), b);
    v.tangent = lerp(l.tangent, v.tangent, b);
    v.bitangent = lerp(l.bitangent, v.bitangent, b);
//% else
    float3 apart = v.position - l.position;
    v.position = l.position + blend.x * apart;
    v.tangent = lerp(l.tangent, v.tangent, blend.x) + blend.y * apart;
    v.bitangent = lerp(l.bitangent, v.bitangent, blend.x) + blend.z * apart;
//%   if mirrored_joints
    // On the side that linear blending has, outside.
    float side = dot(cross(l.tangent, l.bitangent), l.normal) < 0.0 ? -1.0 : 1.0;
    v.normal = side * cross(v.tangent, v.bitangent);
//%   else
    v.normal = @{ handed("cross(v.tangent, v.bitangent)") };
//%   endif
//% endif
    return v;
}
