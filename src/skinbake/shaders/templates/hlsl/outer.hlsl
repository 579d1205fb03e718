#ifndef SKINBAKE_OUTER
#define SKINBAKE_OUTER
// The matrix q a^T: its rows are multiples of a.
float3x3 skinbake_outer(float3 q, float3 a)
{
    return float3x3(q.x * a, q.y * a, q.z * a);
}
#endif
