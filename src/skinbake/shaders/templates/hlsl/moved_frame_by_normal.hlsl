#ifndef SKINBAKE_MOVED_FRAME_BY_NORMAL
#define SKINBAKE_MOVED_FRAME_BY_NORMAL
// The frame under morph targets that have NORMAL and their differential: n is NORMAL plus the weighted sum of its
// targets, of any length, m the weighted sum of _SKINBAKE_MORPH of the targets.
skinbake_Frame skinbake_moved_frame_by_normal(skinbake_Frame rest, float3 n, float4 m)
{
    skinbake_Frame frame = skinbake_morphed_frame(rest, n);
    float3 t = rest.tangent + rest.tangent * m.x + rest.bitangent * m.y;
    float3 b = rest.bitangent + rest.tangent * m.z + rest.bitangent * m.w;
    float cosine = dot(rest.normal, frame.normal);
    // Then m tells too little, or of the other side of the surface.
    bool steep = abs(cosine) < 0.2 || cosine * ((1.0 + m.x) * (1.0 + m.w) - m.y * m.z) <= 0.0;
    float k = steep ? 0.0 : 1.0 / cosine;
    frame.tangent = steep ? frame.tangent : t - rest.normal * (dot(t, frame.normal) * k);
    frame.bitangent = steep ? frame.bitangent : b - rest.normal * (dot(b, frame.normal) * k);
    return frame;
}
#endif
