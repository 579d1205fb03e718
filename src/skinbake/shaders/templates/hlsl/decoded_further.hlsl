#ifndef SKINBAKE_DECODED_FURTHER
#define SKINBAKE_DECODED_FURTHER
// alpha or beta of the four slots of a further set. first is set 0, whose w counts for all sets.
float4 skinbake_decoded_further(float4 stored, float4 first, float scale)
{
    return (scale * first.w * first.w) * stored;
}
#endif
