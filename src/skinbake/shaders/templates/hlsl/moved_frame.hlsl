#ifndef SKINBAKE_MOVED_FRAME
#define SKINBAKE_MOVED_FRAME
// The frame under morph targets whose differential the file has: m and up are the weighted sums of _SKINBAKE_MORPH
// and _SKINBAKE_MORPH_UP of the targets. It is exact, and needs no NORMAL of the targets.
skinbake_Frame skinbake_moved_frame(skinbake_Frame rest, float4 m, float2 up)
{
    float3 tangent = rest.tangent + rest.tangent * m.x + rest.bitangent * m.y + rest.normal * up.x;
    float3 bitangent = rest.bitangent + rest.tangent * m.z + rest.bitangent * m.w + rest.normal * up.y;
    float3 c = cross(tangent, bitangent) * rest.handedness;
    float square = dot(c, c);
    bool moves = square > 0.0 && (any(m != 0.0) || any(up != 0.0));
    float3 normal = moves ? c * rsqrt(square) : rest.normal;
    skinbake_Frame frame;
    frame.normal = normal;
    frame.tangent = tangent;
    frame.bitangent = bitangent;
    frame.handedness = rest.handedness;
    return frame;
}
#endif
