// M p: the position p moved by the joint matrix M alone.
fn skinbake_moved(M: mat4x4<f32>, p: vec3<f32>) -> vec3<f32> {
    return M[0].xyz * p.x + (M[1].xyz * p.y + (M[2].xyz * p.z + M[3].xyz));
}
