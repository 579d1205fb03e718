// base + correction. The correction is shortened to at most cap * |base|.
fn skinbake_capped(base: vec3<f32>, correction: vec3<f32>, cap: f32) -> vec3<f32> {
    let allowed = cap * cap * dot(base, base);
    let square = dot(correction, correction);
    let too_long = square > allowed && allowed > 0.0;
    return base + select(1.0, sqrt(allowed / square), too_long) * correction;
}
