// The frame moves by the Jacobian J of the skinned position, the normal by its inverse transpose.
// M: the joint matrices of @{ slot_words }; a: their weight gradients, as skinbake_gradients() gives them.
skinbake_Vertex skinbake_lbs_direct(vec3 p, skinbake_Frame frame, mat4 M[@{ influences }]@{ params(weight_params) }, vec3 a[@{ influences }])
{
//% for slot in slots
    @{ "mat4x3 T =" if loop.first else "          +" } @{ slot.weight } * mat4x3(M[@{ slot.index }])@{ ";" if loop.last }@{ " // 1" if loop.first }
//% endfor
//% for slot in slots
    vec3 q@{ slot.index } = skinbake_moved(M[@{ slot.index }], p);@{ " // 2" if loop.first }
//% endfor
    mat3 J = mat3(T) // 3
//% for slot in slots
        + outerProduct(q@{ slot.index }, a[@{ slot.index }])@{ ";" if loop.last }
//% endfor
    mat3 C = mat3(cross(J[1], J[2]), cross(J[2], J[0]), cross(J[0], J[1])); // 4: J^-T = C / det J
    float det = dot(J[0], C[0]);
    skinbake_Vertex v;
    v.position = T * vec4(p, 1.0); // 5
    v.normal = (C * frame.normal) * (det == 0.0 ? 1.0 : 1.0 / det); // 6
    v.tangent = J * frame.tangent; // 7
    v.bitangent = J * frame.bitangent; // 8
    return v;
}
