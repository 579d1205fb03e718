#ifndef SKINBAKE_MORPHED
#define SKINBAKE_MORPHED
// The frame under morph targets, by the morphed normal n: NORMAL plus the weighted sum of its targets, of any
// length. The frame at rest turns by the smallest rotation that takes its normal to n. Do not use
// skinbake_frame(n): alpha and beta belong to the frame at rest.
skinbake_Frame skinbake_morphed_frame(skinbake_Frame rest, float3 n)
{
    float square = dot(n, n);
    float3 normal = square > 0.0 ? n * rsqrt(square) : rest.normal;
    float3 s = rest.normal + normal;
    float3 d = normal - rest.normal;
    bool opposite = dot(s, s) < 1e-4; // then every half turn is the smallest; take the one about t0
    float k = opposite ? 0.0 : 2.0 / dot(s, s);
    float3 tangent = rest.tangent - s * (k * dot(d, rest.tangent));
    float3 bitangent = rest.bitangent - s * (k * dot(d, rest.bitangent));
    skinbake_Frame frame;
    frame.normal = normal;
    frame.tangent = tangent;
    frame.bitangent = opposite ? -bitangent : bitangent;
    frame.handedness = rest.handedness;
    return frame;
}
#endif
