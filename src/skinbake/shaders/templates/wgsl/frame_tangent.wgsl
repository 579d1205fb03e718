// The frame of NORMAL, which must have length 1, and TANGENT.
fn skinbake_frame(n: vec3<f32>, tangent: vec4<f32>) -> skinbake_Frame {
    return skinbake_Frame(n, tangent.xyz, cross(n, tangent.xyz) * tangent.w, tangent.w);
}
