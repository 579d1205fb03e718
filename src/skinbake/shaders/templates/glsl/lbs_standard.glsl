// The frame moves by the blended matrix T, as if the weights were constant over the surface.
// M: the joint matrices of @{ slot_words }.
skinbake_Vertex skinbake_lbs_standard(vec3 p, skinbake_Frame frame, mat4 M[@{ influences }]@{ params(weight_params) })
{
//% for slot in slots
    @{ "mat4x3 T =" if loop.first else "          +" } @{ slot.weight } * mat4x3(M[@{ slot.index }])@{ ";" if loop.last }@{ " // 1" if loop.first }
//% endfor
    skinbake_Vertex v;
    v.position = T * vec4(p, 1.0); // 2
    v.normal = mat3(T) * frame.normal; // 3
    v.tangent = mat3(T) * frame.tangent; // 4
    v.bitangent = mat3(T) * frame.bitangent; // 5
    return v;
}
