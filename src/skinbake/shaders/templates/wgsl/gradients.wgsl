// The weight gradients of all slots from alpha and beta: a[s] = alpha[s] t0 + beta[s] b0@{ ", over |t0|^2" if morphs == "tangent" else ", along the dual of a moved frame" if moves_frame }.
fn skinbake_gradients(frame: skinbake_Frame@{ params(gradient_params) }) -> array<vec3<f32>, @{ influences }> {
//% if morphs == "tangent" and others
    let k = 1.0 / dot(frame.tangent, frame.tangent); // a morphed tangent has any length
//% endif
//% if moves_frame and others
    let c = cross(frame.tangent, frame.bitangent); // a moved frame has any angle and lengths
    let along_t = cross(frame.bitangent, c) / dot(c, c);
    let along_b = cross(c, frame.tangent) / dot(c, c);
//% endif
//% for slot in others
    let a@{ slot.index } = @{ dual(slot.alpha ~ " * frame.tangent + " ~ slot.beta ~ " * frame.bitangent") };
//% endfor
    let a0 = @{ "-(" ~ joined(" + ", "a%d", others) ~ ")" if others else "vec3<f32>(0.0)" };
    return array<vec3<f32>, @{ influences }>(@{ joined(", ", "a%d", slots) });
}
