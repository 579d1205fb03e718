#ifndef SKINBAKE_SCALED_JOINT
#define SKINBAKE_SCALED_JOINT
// A joint that may scale, shear or mirror. Quaternions are (x, y, z, w), w the scalar. turn is the rotation of the joint
// matrix, and the columns of moved are those of the matrix times it.
struct skinbake_ScaledMotion {
    mat4 moved;
    vec4 turn;
};

// The vector of a over a quaternion, which is given as itself / its squared length.
vec3 skinbake_over(vec4 a, vec4 divisor)
{
    return divisor.w * a.xyz - a.w * divisor.xyz + cross(divisor.xyz, a.xyz);
}
#endif
