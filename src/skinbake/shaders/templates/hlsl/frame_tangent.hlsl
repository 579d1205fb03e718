#ifndef SKINBAKE_FRAME_FROM_TANGENT
#define SKINBAKE_FRAME_FROM_TANGENT
// The frame of NORMAL, which must have length 1, and TANGENT.
skinbake_Frame skinbake_frame(float3 n, float4 tangent)
{
    skinbake_Frame frame;
    frame.normal = n;
    frame.tangent = tangent.xyz;
    frame.bitangent = cross(n, tangent.xyz) * tangent.w;
    frame.handedness = tangent.w;
    return frame;
}
#endif
