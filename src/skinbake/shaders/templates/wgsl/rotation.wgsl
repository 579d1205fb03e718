// (Q(p) - p) / 2 of a unit dual quaternion Q.
fn skinbake_half_displacement(Q: mat2x4<f32>, p: vec3<f32>) -> vec3<f32> {
    let i = Q[0].w * p + Q[1].xyz + cross(Q[0].xyz, p);
    return Q[0].w * Q[1].xyz - Q[1].w * Q[0].xyz + cross(Q[0].xyz, i);
}

// v rotated by a unit quaternion q.
fn skinbake_rotated(q: vec4<f32>, v: vec3<f32>) -> vec3<f32> {
    return v + 2.0 * cross(q.xyz, q.w * v + cross(q.xyz, v));
}
