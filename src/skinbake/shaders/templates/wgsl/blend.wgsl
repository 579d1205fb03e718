// Each vertex lies between linear blending, l, and dual quaternions, d: p' = l + b (d - l).
//% if lighting == "standard"
// b: the blend weight.
//% else
// blend: the blend weight b, and its derivatives along t0 and b0, by which d - l is a part of t' and b'.
//% endif
// M: the joint matrices of @{ slot_words }. Q: what is made of them.
//% set own = weight_params + (gradient_params if reads_gradients else [])
//% set given = own | map(attribute=1) | join(", ")
fn skinbake_@{ stem }(p: vec3<f32>, frame: skinbake_Frame, M: array<mat4x4<f32>, @{ influences }>, Q: array<@{ motion_type }, @{ influences }>@{ params(own) }, @{ "b: f32" if lighting == "standard" else "blend: vec3<f32>" }) -> skinbake_Vertex {
    let l = skinbake_lbs_@{ lighting }(p, frame, M, @{ given });
    let d = skinbake_@{ dual_stem }(p, frame, Q, @{ given });
//% if lighting == "standard"
    let position = mix(l.position, d.position, b);
    let normal = mix(normalize(l.normal), normalize(d.normal), b);
    let tangent = mix(l.tangent, d.tangent, b);
    let bitangent = mix(l.bitangent, d.bitangent, b);
//% else
    let apart = d.position - l.position;
    let position = l.position + blend.x * apart;
    let tangent = mix(l.tangent, d.tangent, blend.x) + blend.y * apart;
    let bitangent = mix(l.bitangent, d.bitangent, blend.x) + blend.z * apart;
//%   if mirrored_joints
    // On the side that linear blending has, outside.
    let side = select(1.0, -1.0, dot(cross(l.tangent, l.bitangent), l.normal) < 0.0);
    let normal = side * cross(tangent, bitangent);
//%   else
    let normal = @{ handed("cross(tangent, bitangent)") };
//%   endif
//% endif
    return skinbake_Vertex(position, normal, tangent, bitangent);
}
