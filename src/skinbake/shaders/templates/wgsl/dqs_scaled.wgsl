// The frame moves by the derivative of the quotient p' = g / b: b mixes the joints' turns, and g what M p is times them.
// given: the scaled motions of @{ slot_words }.
fn skinbake_dqs_scaled(p: vec3<f32>, frame: skinbake_Frame, given: array<skinbake_ScaledMotion, @{ influences }>@{ params(weight_params + gradient_params) }) -> skinbake_Vertex {
    var Q = given;
    var pivot = Q[0].turn;
//% for slot in others
    if (dot(pivot, pivot) == 0.0) { pivot = Q[@{ slot.index }].turn; }
//% endfor
    if (dot(pivot, pivot) == 0.0) { pivot.w = 1.0; }
//% for slot in slots
    Q[@{ slot.index }] = skinbake_turning(Q[@{ slot.index }], pivot);
//% endfor
//% for slot in others
    let s@{ slot.index } = select(1.0, -1.0, dot(Q[@{ slot.index }].turn, Q[0].turn) < 0.0);@{ " // 1: q and -q are the same rotation" if loop.first }
//% endfor
//% for slot in slots
    @{ "let b =" if loop.first else "      +" } @{ slot.weight if loop.first else "(s%d * %s)" | format(slot.index, slot.weight) } * Q[@{ slot.index }].turn@{ ";" if loop.last }
//% endfor
//% for slot in slots
    @{ "let T =" if loop.first else "      +" } @{ slot.weight if loop.first else "(s%d * %s)" | format(slot.index, slot.weight) } * Q[@{ slot.index }].moved@{ ";" if loop.last }
//% endfor
    let square = dot(b, b);
    let divisor = b / select(1.0, square, square > 0.0); // 2
//% for slot in slots
    let g@{ slot.index } = Q[@{ slot.index }].moved * vec4<f32>(p, 1.0);@{ " // 3" if loop.first }
//% endfor
//% for slot in others
    let m@{ slot.index } = s@{ slot.index } * g@{ slot.index } - g0;@{ " // 4" if loop.first }
    let r@{ slot.index } = s@{ slot.index } * Q[@{ slot.index }].turn - Q[0].turn;
//% endfor
    let g = g0@{ " + " ~ sum("weight", "m%d", others) if others }; // 5
    let ratio = vec4<f32>(skinbake_over(g, divisor), dot(g, divisor));
//% for member, slopes in (("tangent", "alpha"), ("bitangent", "beta"))
//%   set base = "T * vec4<f32>(frame." ~ member ~ ", 0.0)"
//%   if not others
    let @{ member } = skinbake_over(@{ base }, divisor);@{ " // 6" if loop.first else " // 7" }
//%   elif cap is none
    let @{ member } = skinbake_over(@{ base } + @{ sum(slopes, "m%d", others) } - skinbake_product(ratio, @{ sum(slopes, "r%d", others) }), divisor);@{ " // 6" if loop.first else " // 7" }
//%   else
    let @{ member } = skinbake_capped(skinbake_over(@{ base }, divisor), skinbake_over(@{ sum(slopes, "m%d", others) } - skinbake_product(ratio, @{ sum(slopes, "r%d", others) }), divisor), @{ cap_text });@{ " // 6" if loop.first else " // 7" }
//%   endif
//% endfor
//% if mirrored_joints
    // A joint that mirrors turns t x b to the inside.
    let x = skinbake_over(T[0], divisor);
    let y = skinbake_over(T[1], divisor);
    let outside = select(1.0, -1.0, dot(cross(x, y), skinbake_over(T[2], divisor)) < 0.0);
//% endif
    let normal = @{ "outside * " if mirrored_joints }@{ handed("cross(tangent, bitangent)") }; // 8
//% if normal_map
    let carried = skinbake_over(T * vec4<f32>(frame.normal, 0.0), divisor); // 9
    let cotangent = @{ "outside * " if mirrored_joints }@{ handed("cross(bitangent, carried)") }; // 10
    let cobitangent = @{ "outside * " if mirrored_joints }@{ handed("cross(carried, tangent)") }; // 11
//% endif
    return skinbake_Vertex(ratio.xyz, normal, tangent, bitangent@{ ", cotangent, cobitangent" if normal_map });
}
