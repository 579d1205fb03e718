#ifndef SKINBAKE_DECODED
#define SKINBAKE_DECODED
// alpha or beta of slots 1 to 3 from its set 0: xyz relative to the vertex's scale, w the root of that scale
// relative to the file's.
vec3 skinbake_decoded(vec4 stored, float scale)
{
    return (scale * stored.w * stored.w) * stored.xyz;
}
#endif
