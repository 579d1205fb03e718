// The unit quaternion of the rotation R in the polar decomposition M = R S, or in that of -M where M mirrors, by Newton's
// iteration (Higham 1986). A joint that flattens does not mirror. One that leaves a line or a point has no
// rotation: zeros.
fn skinbake_turn(M: mat4x4<f32>) -> vec4<f32> {
    var R = mat3x3<f32>(M[0].xyz, M[1].xyz, M[2].xyz);
    R = R * (1.0 / max(sqrt(dot(R[0], R[0]) + dot(R[1], R[1]) + dot(R[2], R[2])), 1e-30));
    let C = mat3x3<f32>(cross(R[1], R[2]), cross(R[2], R[0]), cross(R[0], R[1]));
    let area = sqrt(dot(C[0], C[0]) + dot(C[1], C[1]) + dot(C[2], C[2]));
    if (area <= 1e-6) { return vec4<f32>(); }
    // The cofactors have the same rotation, and an extent where M has none.
    R = R * select(1.0, -1.0, dot(R[0], C[0]) < -1e-6 * area) + C * (1.0 / area);
    R = R * (1.0 / pow(dot(cross(R[0], R[1]), R[2]), 1.0 / 3.0));
    for (var i = 0; i < 12; i++) {
        // The volume is at least 1, so the squares sum to 3 where R is a rotation.
        let is_near = dot(R[0], R[0]) + dot(R[1], R[1]) + dot(R[2], R[2]) < 3.00001;
        let cofactors = mat3x3<f32>(cross(R[1], R[2]), cross(R[2], R[0]), cross(R[0], R[1]));
        R = (R + cofactors * (1.0 / dot(R[0], cofactors[0]))) * 0.5;
        if (is_near) { break; }
    }
    return skinbake_dual_quaternion(mat4x4<f32>(
        vec4<f32>(R[0], 0.0), vec4<f32>(R[1], 0.0), vec4<f32>(R[2], 0.0), vec4<f32>(0.0, 0.0, 0.0, 1.0)))[0];
}

// The motion of a joint matrix. Compute it on the host, by joint_scaled_motions() of skinbake's Python package, or in a
// pass over the joints: once per joint and frame, not per vertex.
fn skinbake_scaled_motion(M: mat4x4<f32>) -> skinbake_ScaledMotion {
    let turn = skinbake_turn(M);
    let still = mat4x4<f32>(vec4<f32>(M[0].xyz, 0.0), vec4<f32>(M[1].xyz, 0.0), vec4<f32>(M[2].xyz, 0.0), vec4<f32>(M[3].xyz, 0.0));
    let Q = skinbake_ScaledMotion(still, vec4<f32>());
    if (dot(turn, turn) > 0.0) { return skinbake_turning(Q, turn); }
    return Q;
}
