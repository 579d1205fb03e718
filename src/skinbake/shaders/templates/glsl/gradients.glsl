// The weight gradients of all slots from alpha and beta: a[s] = alpha[s] t0 + beta[s] b0.
vec3[@{ influences }] skinbake_gradients(skinbake_Frame frame@{ params(gradient_params) })
{
    vec3 a[@{ influences }];
//% for slot in others
    a[@{ slot.index }] = @{ slot.alpha } * frame.tangent + @{ slot.beta } * frame.bitangent;
//% endfor
    a[0] = @{ "-(" ~ joined(" + ", "a[%d]", others) ~ ")" if others else "vec3(0.0)" };
    return a;
}
