#ifndef SKINBAKE_MOVED
#define SKINBAKE_MOVED
// M p: the position p moved by the joint matrix M alone.
float3 skinbake_moved(float4x4 M, float3 p)
{
    return mul((float3x4)M, float4(p, 1.0));
}
#endif
