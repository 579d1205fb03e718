#ifndef SKINBAKE_SCALED_MOTION
#define SKINBAKE_SCALED_MOTION
// A joint that may scale, shear or mirror. Quaternions are (x, y, z, w), w the scalar. turn is the rotation of the joint
// matrix, and the rows of moved are the matrix's columns times it. Store five float4: default packing has another order.
struct skinbake_ScaledMotion {
    float4x4 moved;
    float4 turn;
};

// Compute it on the host or in a pass over the joints, by joint_scaled_motions() of skinbake's Python package or like
// this: M is the joint matrix, and turn is the unit quaternion of the rotation R in its polar decomposition M = R S, or
// in that of -M where M mirrors.
skinbake_ScaledMotion skinbake_scaled_motion(float4x4 M, float4 turn)
{
    skinbake_ScaledMotion Q;
    float4x4 columns = transpose(M);
    for (int i = 0; i < 4; i++)
        Q.moved[i] = float4(turn.w * columns[i].xyz + cross(columns[i].xyz, turn.xyz), -dot(columns[i].xyz, turn.xyz));
    Q.turn = turn;
    return Q;
}

// The vector of a over a quaternion, which is given as itself / its squared length.
float3 skinbake_over(float4 a, float4 divisor)
{
    return divisor.w * a.xyz - a.w * divisor.xyz + cross(divisor.xyz, a.xyz);
}
#endif
