// The frame moves by the derivative of the quotient p' = g / b: b mixes the joints' turns, and g what M p is times them.
// Q: the scaled motions of @{ slot_words }.
skinbake_Vertex skinbake_dqs_scaled(vec3 p, skinbake_Frame frame, skinbake_ScaledMotion Q[@{ influences }]@{ params(weight_params + gradient_params) })
{
    vec4 pivot = Q[0].turn;
//% for slot in others
    if (dot(pivot, pivot) == 0.0) pivot = Q[@{ slot.index }].turn;
//% endfor
    if (dot(pivot, pivot) == 0.0) pivot.w = 1.0;
//% for slot in slots
    Q[@{ slot.index }] = skinbake_turning(Q[@{ slot.index }], pivot);
//% endfor
//% for slot in others
    float s@{ slot.index } = dot(Q[@{ slot.index }].turn, Q[0].turn) < 0.0 ? -1.0 : 1.0;@{ " // 1: q and -q are the same rotation" if loop.first }
//% endfor
//% for slot in slots
    @{ "vec4 b =" if loop.first else "       +" } @{ slot.weight if loop.first else "(s%d * %s)" | format(slot.index, slot.weight) } * Q[@{ slot.index }].turn@{ ";" if loop.last }
//% endfor
//% for slot in slots
    @{ "mat4 T =" if loop.first else "       +" } @{ slot.weight if loop.first else "(s%d * %s)" | format(slot.index, slot.weight) } * Q[@{ slot.index }].moved@{ ";" if loop.last }
//% endfor
    float square = dot(b, b);
    vec4 divisor = b / (square > 0.0 ? square : 1.0); // 2
//% for slot in slots
    vec4 g@{ slot.index } = Q[@{ slot.index }].moved * vec4(p, 1.0);@{ " // 3" if loop.first }
//% endfor
//% for slot in others
    vec4 m@{ slot.index } = s@{ slot.index } * g@{ slot.index } - g0;@{ " // 4" if loop.first }
    vec4 r@{ slot.index } = s@{ slot.index } * Q[@{ slot.index }].turn - Q[0].turn;
//% endfor
    vec4 g = g0@{ " + " ~ sum("weight", "m%d", others) if others }; // 5
    vec4 ratio = vec4(skinbake_over(g, divisor), dot(g, divisor));
    skinbake_Vertex v;
    v.position = ratio.xyz;
//% for member, slopes in (("tangent", "alpha"), ("bitangent", "beta"))
//%   set base = "T * vec4(frame." ~ member ~ ", 0.0)"
//%   if not others
    v.@{ member } = skinbake_over(@{ base }, divisor);@{ " // 6" if loop.first else " // 7" }
//%   elif cap is none
    v.@{ member } = skinbake_over(@{ base } + @{ sum(slopes, "m%d", others) } - skinbake_product(ratio, @{ sum(slopes, "r%d", others) }), divisor);@{ " // 6" if loop.first else " // 7" }
//%   else
    v.@{ member } = skinbake_capped(skinbake_over(@{ base }, divisor), skinbake_over(@{ sum(slopes, "m%d", others) } - skinbake_product(ratio, @{ sum(slopes, "r%d", others) }), divisor), @{ cap_text });@{ " // 6" if loop.first else " // 7" }
//%   endif
//% endfor
    v.normal = @{ handed("cross(v.tangent, v.bitangent)") }; // 8
//% if normal_map
    vec3 carried = skinbake_over(T * vec4(frame.normal, 0.0), divisor); // 9
    v.cotangent = @{ handed("cross(v.bitangent, carried)") }; // 10
    v.cobitangent = @{ handed("cross(carried, v.tangent)") }; // 11
//% endif
//% if mirrored_joints
    // A joint that mirrors turns t x b to the inside.
    vec3 x = skinbake_over(T[0], divisor);
    vec3 y = skinbake_over(T[1], divisor);
    float outside = dot(cross(x, y), skinbake_over(T[2], divisor)) < 0.0 ? -1.0 : 1.0;
    v.normal *= outside;
//%   if normal_map
    v.cotangent *= outside;
    v.cobitangent *= outside;
//%   endif
//% endif
    return v;
}
