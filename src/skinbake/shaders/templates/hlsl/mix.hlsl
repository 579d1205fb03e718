//% for slot in others
    float s@{ slot.index } = skinbake_hemisphere(Q[@{ slot.index }], Q[0]);@{ " // 1" if loop.first }
//% endfor
//% for slot in slots
    @{ "float2x4 b =" if loop.first else "          +" } @{ "%s" | format(slot.weight) if loop.first else "(s%d * %s)" | format(slot.index, slot.weight) } * Q[@{ slot.index }]@{ ";" if loop.last }@{ " // 1" if loop.first and loop.last }
//% endfor
