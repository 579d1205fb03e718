// The weight gradients of all slots from alpha and beta: a[s] = alpha[s] t0 + beta[s] b0@{ ", over |t0|^2" if morphs == "tangent" }.
void skinbake_gradients(skinbake_Frame frame@{ params(gradient_params) }, out float3 a[@{ influences }])
{
//% if morphs == "tangent" and others
    float k = 1.0 / dot(frame.tangent, frame.tangent); // a morphed tangent has any length
//% endif
//% for slot in others
    a[@{ slot.index }] = @{ dual(slot.alpha ~ " * frame.tangent + " ~ slot.beta ~ " * frame.bitangent") };
//% endfor
    a[0] = @{ "-(" ~ joined(" + ", "a[%d]", others) ~ ")" if others else "float3(0.0, 0.0, 0.0)" };
}
