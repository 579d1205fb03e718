#ifndef SKINBAKE_ROTATION
#define SKINBAKE_ROTATION
// (Q(p) - p) / 2 of a unit dual quaternion Q.
vec3 skinbake_half_displacement(mat2x4 Q, vec3 p)
{
    vec3 i = Q[0].w * p + Q[1].xyz + cross(Q[0].xyz, p);
    return Q[0].w * Q[1].xyz - Q[1].w * Q[0].xyz + cross(Q[0].xyz, i);
}

// v rotated by a unit quaternion q.
vec3 skinbake_rotated(vec4 q, vec3 v)
{
    return v + 2.0 * cross(q.xyz, q.w * v + cross(q.xyz, v));
}
#endif
