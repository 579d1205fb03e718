// A joint that may scale, shear or mirror. Quaternions are (x, y, z, w), w the scalar. turn is the rotation of the joint
// matrix, and the columns of moved are those of the matrix times it.
struct skinbake_ScaledMotion {
    moved: mat4x4<f32>,
    turn: vec4<f32>,
}

// Compute it on the host or in a pass over the joints, by joint_scaled_motions() of skinbake's Python package or like
// this: M is the joint matrix, and turn is the unit quaternion of the rotation R in its polar decomposition M = R S, or
// in that of -M where M mirrors.
fn skinbake_scaled_motion(M: mat4x4<f32>, turn: vec4<f32>) -> skinbake_ScaledMotion {
    return skinbake_ScaledMotion(
        mat4x4<f32>(
            skinbake_product(vec4<f32>(M[0].xyz, 0.0), turn),
            skinbake_product(vec4<f32>(M[1].xyz, 0.0), turn),
            skinbake_product(vec4<f32>(M[2].xyz, 0.0), turn),
            skinbake_product(vec4<f32>(M[3].xyz, 0.0), turn)),
        turn);
}

// The vector of a over a quaternion, which is given as itself / its squared length.
fn skinbake_over(a: vec4<f32>, divisor: vec4<f32>) -> vec3<f32> {
    return divisor.w * a.xyz - a.w * divisor.xyz + cross(divisor.xyz, a.xyz);
}
