// The frame moves by the derivative of the skinned position along t0 and b0.
// M: the joint matrices of @{ slot_words }.
skinbake_Vertex skinbake_lbs_accurate(vec3 p, skinbake_Frame frame, mat4 M[@{ influences }]@{ params(weight_params + gradient_params) })
{
//% for slot in slots
    @{ "mat3 T =" if loop.first else "        +" } @{ slot.weight } * mat3(M[@{ slot.index }])@{ ";" if loop.last }@{ " // 1" if loop.first }
//% endfor
//% for slot in slots
    vec3 q@{ slot.index } = skinbake_moved(M[@{ slot.index }], p);@{ " // 2" if loop.first }
//% endfor
//% for slot in others
    vec3 d@{ slot.index } = q@{ slot.index } - q0;@{ " // 3" if loop.first }
//% endfor
    skinbake_Vertex v;
    v.tangent = @{ corrected("T * frame.tangent", sum("alpha", "d%d", others)) }; // 4
    v.bitangent = @{ corrected("T * frame.bitangent", sum("beta", "d%d", others)) }; // 5
    v.normal = @{ handed("cross(v.tangent, v.bitangent)") }; // 6
//% if normal_map
    vec3 carried = T * frame.normal; // 8
    v.cotangent = @{ handed("cross(v.bitangent, carried)") }; // 9
    v.cobitangent = @{ handed("cross(carried, v.tangent)") }; // 10
//% endif
//% if mirrored_joints
    float outside = determinant(T) < 0.0 ? -1.0 : 1.0; // a joint that mirrors turns t x b to the inside
    v.normal *= outside;
//%   if normal_map
    v.cotangent *= outside;
    v.cobitangent *= outside;
//%   endif
//% endif
    v.position = q0@{ " + " ~ sum("weight", "d%d", others) if others }; // 7
    return v;
}
