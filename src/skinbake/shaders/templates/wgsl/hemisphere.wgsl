// -1 if the real part of the joint points away from that of the pivot: q and -q are the same rotation.
fn skinbake_hemisphere(joint: mat2x4<f32>, pivot: mat2x4<f32>) -> f32 {
    return select(1.0, -1.0, dot(joint[0], pivot[0]) < 0.0);
}
