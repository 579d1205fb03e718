// alpha or beta of slots 1 to 3, from set 0. xyz are relative to the scale of the vertex. w is the square root of
// that scale, relative to the scale of the file.
fn skinbake_decoded(stored: vec4<f32>, scale: f32) -> vec3<f32> {
    return (scale * stored.w * stored.w) * stored.xyz;
}
