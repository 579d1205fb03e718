#ifndef SKINBAKE_SCALED_MOTION
#define SKINBAKE_SCALED_MOTION
// The unit quaternion of the rotation R in the polar decomposition M = R S, or in that of -M where M mirrors, by Newton's
// iteration (Higham 1986). A joint that flattens does not mirror. One that leaves a line or a point has no
// rotation: zeros.
vec4 skinbake_turn(mat3 M)
{
    mat3 R = M * (1.0 / max(sqrt(dot(M[0], M[0]) + dot(M[1], M[1]) + dot(M[2], M[2])), 1e-30));
    mat3 C = mat3(cross(R[1], R[2]), cross(R[2], R[0]), cross(R[0], R[1]));
    float area = sqrt(dot(C[0], C[0]) + dot(C[1], C[1]) + dot(C[2], C[2]));
    if (area <= 1e-6) return vec4(0.0, 0.0, 0.0, 0.0);
    // The cofactors have the same rotation, and an extent where M has none.
    R = R * (dot(R[0], C[0]) < -1e-6 * area ? -1.0 : 1.0) + C * (1.0 / area);
    R = R * (1.0 / pow(dot(cross(R[0], R[1]), R[2]), 1.0 / 3.0));
    for (int i = 0; i < 12; i++) {
        // The volume is at least 1, so the squares sum to 3 where R is a rotation.
        bool is_near = dot(R[0], R[0]) + dot(R[1], R[1]) + dot(R[2], R[2]) < 3.00001;
        mat3 cofactors = mat3(cross(R[1], R[2]), cross(R[2], R[0]), cross(R[0], R[1]));
        R = 0.5 * (R + cofactors * (1.0 / dot(R[0], cofactors[0])));
        if (is_near) break;
    }
    return skinbake_dual_quaternion(mat4(vec4(R[0], 0.0), vec4(R[1], 0.0), vec4(R[2], 0.0), vec4(0.0, 0.0, 0.0, 1.0)))[0];
}

// The motion of a joint matrix. Compute it on the host, by joint_scaled_motions() of skinbake's Python package, or in a
// pass over the joints: once per joint and frame, not per vertex.
skinbake_ScaledMotion skinbake_scaled_motion(mat4 M)
{
    vec4 turn = skinbake_turn(mat3(M));
    skinbake_ScaledMotion Q;
    for (int i = 0; i < 4; i++)
        Q.moved[i] = vec4(M[i].xyz, 0.0);
    Q.turn = vec4(0.0, 0.0, 0.0, 0.0);
    if (dot(turn, turn) > 0.0)
        return skinbake_turning(Q, turn);
    return Q;
}
#endif
