// M without its last row, which is (0, 0, 0, 1).
fn skinbake_rows(M: mat4x4<f32>) -> mat4x3<f32> {
    return mat4x3<f32>(M[0].xyz, M[1].xyz, M[2].xyz, M[3].xyz);
}
