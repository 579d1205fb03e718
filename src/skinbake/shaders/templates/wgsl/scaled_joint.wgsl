// A joint that may scale, shear or mirror. Quaternions are (x, y, z, w), w the scalar. turn is the rotation of the joint
// matrix, and the columns of moved are those of the matrix times it.
struct skinbake_ScaledMotion {
    moved: mat4x4<f32>,
    turn: vec4<f32>,
}

// The vector of a over a quaternion, which is given as itself / its squared length.
fn skinbake_over(a: vec4<f32>, divisor: vec4<f32>) -> vec3<f32> {
    return divisor.w * a.xyz - a.w * divisor.xyz + cross(divisor.xyz, a.xyz);
}
