#ifndef SKINBAKE_SCALED_MOTION
#define SKINBAKE_SCALED_MOTION
// A joint that may scale, shear or mirror. Quaternions are (x, y, z, w), w the scalar. turn is the rotation of the joint
// matrix, and the columns of moved are those of the matrix times it.
struct skinbake_ScaledMotion {
    mat4 moved;
    vec4 turn;
};

// Compute it on the host or in a pass over the joints, by joint_scaled_motions() of skinbake's Python package or like
// this: M is the joint matrix, and turn is the unit quaternion of the rotation R in its polar decomposition M = R S, or
// in that of -M where M mirrors.
skinbake_ScaledMotion skinbake_scaled_motion(mat4 M, vec4 turn)
{
    skinbake_ScaledMotion Q;
    for (int i = 0; i < 4; i++)
        Q.moved[i] = vec4(turn.w * M[i].xyz + cross(M[i].xyz, turn.xyz), -dot(M[i].xyz, turn.xyz));
    Q.turn = turn;
    return Q;
}

// The vector of a over a quaternion, which is given as itself / its squared length.
vec3 skinbake_over(vec4 a, vec4 divisor)
{
    return divisor.w * a.xyz - a.w * divisor.xyz + cross(divisor.xyz, a.xyz);
}
#endif
