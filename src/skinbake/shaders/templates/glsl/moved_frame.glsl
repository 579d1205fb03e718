#ifndef SKINBAKE_MOVED_FRAME
#define SKINBAKE_MOVED_FRAME
// The frame under morph targets whose differential the file has: m and up are the weighted sums of _SKINBAKE_MORPH
// and _SKINBAKE_MORPH_UP of the targets. It is exact, and needs no NORMAL of the targets.
skinbake_Frame skinbake_moved_frame(skinbake_Frame rest, vec4 m, vec2 up)
{
    vec3 tangent = rest.tangent + rest.tangent * m.x + rest.bitangent * m.y + rest.normal * up.x;
    vec3 bitangent = rest.bitangent + rest.tangent * m.z + rest.bitangent * m.w + rest.normal * up.y;
    vec3 c = cross(tangent, bitangent) * rest.handedness;
    float square = dot(c, c);
    bool moves = square > 0.0 && (any(notEqual(m, vec4(0.0))) || any(notEqual(up, vec2(0.0))));
    vec3 normal = moves ? c * inversesqrt(square) : rest.normal;
    return skinbake_Frame(normal, tangent, bitangent, rest.handedness);
}
#endif
