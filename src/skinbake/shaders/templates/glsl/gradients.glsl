// The weight gradients of all slots from alpha and beta: a[s] = alpha[s] t0 + beta[s] b0@{ ", over |t0|^2" if morphs == "tangent" else ", along the dual of a moved frame" if moves_frame }.
vec3[@{ influences }] skinbake_gradients(skinbake_Frame frame@{ params(gradient_params) })
{
    vec3 a[@{ influences }];
//% if morphs == "tangent" and others
    float k = 1.0 / dot(frame.tangent, frame.tangent); // a morphed tangent has any length
//% endif
//% if moves_frame and others
    vec3 c = cross(frame.tangent, frame.bitangent); // a moved frame has any angle and lengths
    vec3 along_t = cross(frame.bitangent, c) / dot(c, c);
    vec3 along_b = cross(c, frame.tangent) / dot(c, c);
//% endif
//% for slot in others
    a[@{ slot.index }] = @{ dual(slot.alpha ~ " * frame.tangent + " ~ slot.beta ~ " * frame.bitangent") };
//% endfor
    a[0] = @{ "-(" ~ joined(" + ", "a[%d]", others) ~ ")" if others else "vec3(0.0)" };
    return a;
}
