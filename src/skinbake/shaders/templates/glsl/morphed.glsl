#ifndef SKINBAKE_MORPHED
#define SKINBAKE_MORPHED
// The frame under morph targets, by the morphed normal n: NORMAL plus the weighted sum of its targets, of any
// length. The frame at rest turns by the smallest rotation that takes its normal to n. Do not use
// skinbake_frame(n): alpha and beta belong to the frame at rest.
skinbake_Frame skinbake_morphed_frame(skinbake_Frame rest, vec3 n)
{
    float square = dot(n, n);
    vec3 normal = square > 0.0 ? n * inversesqrt(square) : rest.normal;
    vec3 s = rest.normal + normal;
    vec3 d = normal - rest.normal;
    bool opposite = dot(s, s) < 1e-4; // then every half turn is the smallest: take the one about t0
    float k = opposite ? 0.0 : 2.0 / dot(s, s);
    vec3 tangent = rest.tangent - s * (k * dot(d, rest.tangent));
    vec3 bitangent = rest.bitangent - s * (k * dot(d, rest.bitangent));
    return skinbake_Frame(normal, tangent, opposite ? -bitangent : bitangent, rest.handedness);
}
#endif
