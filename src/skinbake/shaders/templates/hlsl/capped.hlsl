#ifndef SKINBAKE_CAPPED
#define SKINBAKE_CAPPED
// base + correction. The correction is shortened to at most cap * |base|.
float3 skinbake_capped(float3 base, float3 correction, float cap)
{
    float allowed = cap * cap * dot(base, base);
    float square = dot(correction, correction);
    bool too_long = square > allowed && allowed > 0.0;
    return base + (too_long ? sqrt(allowed / square) : 1.0) * correction;
}
#endif
