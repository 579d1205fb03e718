#ifndef SKINBAKE_ROTATION
#define SKINBAKE_ROTATION
// (Q(p) - p) / 2 of a unit dual quaternion Q.
float3 skinbake_half_displacement(float2x4 Q, float3 p)
{
    float3 i = Q[0].w * p + Q[1].xyz + cross(Q[0].xyz, p);
    return Q[0].w * Q[1].xyz - Q[1].w * Q[0].xyz + cross(Q[0].xyz, i);
}

// v rotated by a unit quaternion q.
float3 skinbake_rotated(float4 q, float3 v)
{
    return v + 2.0 * cross(q.xyz, q.w * v + cross(q.xyz, v));
}
#endif
