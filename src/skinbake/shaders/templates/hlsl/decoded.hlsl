#ifndef SKINBAKE_DECODED
#define SKINBAKE_DECODED
// alpha or beta of slots 1 to 3, from set 0. xyz are relative to the scale of the vertex. w is the square root of
// that scale, relative to the scale of the file.
float3 skinbake_decoded(float4 stored, float scale)
{
    return (scale * stored.w * stored.w) * stored.xyz;
}
#endif
