#ifndef SKINBAKE_SCALED_JOINT
#define SKINBAKE_SCALED_JOINT
// A joint that may scale, shear or mirror. Quaternions are (x, y, z, w), w the scalar. turn is the rotation of the joint
// matrix, and the rows of moved are the matrix's columns times it. Store five float4: default packing has another order.
struct skinbake_ScaledMotion {
    float4x4 moved;
    float4 turn;
};

// The vector of a over a quaternion, which is given as itself / its squared length.
float3 skinbake_over(float4 a, float4 divisor)
{
    return divisor.w * a.xyz - a.w * divisor.xyz + cross(divisor.xyz, a.xyz);
}
#endif
