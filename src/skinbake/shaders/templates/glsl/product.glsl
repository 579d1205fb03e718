#ifndef SKINBAKE_PRODUCT
#define SKINBAKE_PRODUCT
// The product of two quaternions.
vec4 skinbake_product(vec4 a, vec4 b)
{
    return vec4(a.w * b.xyz + b.w * a.xyz + cross(a.xyz, b.xyz), a.w * b.w - dot(a.xyz, b.xyz));
}
#endif
