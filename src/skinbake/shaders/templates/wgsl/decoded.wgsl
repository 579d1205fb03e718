// alpha or beta of slots 1 to 3 from its set 0: xyz relative to the vertex's scale, w the root of that scale
// relative to the file's.
fn skinbake_decoded(stored: vec4<f32>, scale: f32) -> vec3<f32> {
    return (scale * stored.w * stored.w) * stored.xyz;
}
