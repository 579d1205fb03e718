// The derivative of p + delta along t, if the mix b changes at the rate db. delta = k h, and i is as in the caller.
//% if cap is none
fn skinbake_derivative(b: mat2x4<f32>, k: f32, p: vec3<f32>, i: vec3<f32>, delta: vec3<f32>, t: vec3<f32>, db: mat2x4<f32>) -> vec3<f32> {
//% else
fn skinbake_derivative(b: mat2x4<f32>, k: f32, p: vec3<f32>, i: vec3<f32>, delta: vec3<f32>, t: vec3<f32>, db: mat2x4<f32>, cap: f32) -> vec3<f32> {
//% endif
    let di = b[0].w * t + db[1].xyz + cross(b[0].xyz, t) + db[0].w * p + cross(db[0].xyz, p);
    let dh = b[0].w * db[1].xyz + cross(b[0].xyz, di) + cross(db[0].xyz, i)
           + db[0].w * b[1].xyz - db[1].w * b[0].xyz - b[1].w * db[0].xyz - dot(b[0], db[0]) * delta;
//% if cap is none
    return t + k * dh;
//% else
    let turn = cross(b[0].xyz, b[0].w * t + cross(b[0].xyz, t));
    return skinbake_capped(t + k * turn, k * (dh - turn), cap);
//% endif
}
