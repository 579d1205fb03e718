#ifndef SKINBAKE_HEMISPHERE
#define SKINBAKE_HEMISPHERE
// -1 if the real part of the joint points away from that of the pivot: q and -q are the same rotation.
float skinbake_hemisphere(float2x4 joint, float2x4 pivot)
{
    return dot(joint[0], pivot[0]) < 0.0 ? -1.0 : 1.0;
}
#endif
