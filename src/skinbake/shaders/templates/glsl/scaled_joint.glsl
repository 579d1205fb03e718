#ifndef SKINBAKE_SCALED_JOINT
#define SKINBAKE_SCALED_JOINT
// A joint that may scale, shear or mirror. Quaternions are (x, y, z, w), w the scalar. turn is the rotation of the joint
// matrix, and the columns of moved are those of the matrix times it.
struct skinbake_ScaledMotion {
    mat4 moved;
    vec4 turn;
};

// A motion that has a rotation. A joint that leaves a line or a point, as at scale 0, has none: its turn is 0, and moved has
// the columns of the matrix. It takes another's.
skinbake_ScaledMotion skinbake_turning(skinbake_ScaledMotion Q, vec4 turn)
{
    if (dot(Q.turn, Q.turn) > 0.0) return Q;
    for (int i = 0; i < 4; i++)
        Q.moved[i] = vec4(turn.w * Q.moved[i].xyz + cross(Q.moved[i].xyz, turn.xyz), -dot(Q.moved[i].xyz, turn.xyz));
    Q.turn = turn;
    return Q;
}

// The vector of a over a quaternion, which is given as itself / its squared length.
vec3 skinbake_over(vec4 a, vec4 divisor)
{
    return divisor.w * a.xyz - a.w * divisor.xyz + cross(divisor.xyz, a.xyz);
}
#endif
