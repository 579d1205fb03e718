// The upper 3x3 part of M.
fn skinbake_upper(M: mat4x4<f32>) -> mat3x3<f32> {
    return mat3x3<f32>(M[0].xyz, M[1].xyz, M[2].xyz);
}
