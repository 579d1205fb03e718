// alpha or beta of the four slots of a further set. first is set 0, whose w counts for all sets.
fn skinbake_decoded_further(stored: vec4<f32>, first: vec4<f32>, scale: f32) -> vec4<f32> {
    return (scale * first.w * first.w) * stored;
}
