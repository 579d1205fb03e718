#ifndef SKINBAKE_MORPHED_TANGENT
#define SKINBAKE_MORPHED_TANGENT
// The frame under morph targets that move TANGENT too. tangent is TANGENT.xyz plus the weighted sum of its targets.
// Do not normalise it. If the sum is 0, the frame follows the normal. If the targets of a primitive have no
// TANGENT, use skinbake_morphed_frame().
skinbake_Frame skinbake_morphed_tangent_frame(skinbake_Frame rest, float3 n, float3 tangent)
{
    skinbake_Frame frame = skinbake_morphed_frame(rest, n);
    float3 t = tangent - frame.normal * (dot(frame.normal, tangent) - dot(rest.normal, rest.tangent));
    bool cancelled = dot(t, t) < 1e-4 * dot(rest.tangent, rest.tangent);
    frame.tangent = cancelled ? frame.tangent : t;
    frame.bitangent = cancelled ? frame.bitangent : cross(frame.normal, t) * rest.handedness;
    return frame;
}
#endif
