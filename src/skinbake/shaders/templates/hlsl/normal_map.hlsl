#ifndef SKINBAKE_NORMAL_MAP
#define SKINBAKE_NORMAL_MAP
// What a pixel needs for normal maps. Pass all three to it as they are. A direction keeps its length in w, relative to
// the normal's, because a pixel sees the direction between vertices at length 1.
struct skinbake_NormalMap {
    float3 normal;
    float4 cotangent;
    float4 cobitangent;
};

// A direction at length 1, and its length times k.
float4 skinbake_with_length(float3 direction, float k)
{
    float size = length(direction);
    return float4(size > 0.0 ? direction / size : direction, k * size);
}

// The mapped normal at a pixel, of any length: the texel, 2 * texture - 1, on the surface as it is now. At rest it is
// t, b and n, each of length 1, times the texel, as in three.js.
float3 skinbake_mapped_normal(float3 texel, float3 normal, float4 cotangent, float4 cobitangent)
{
    return texel.x * cotangent.w * normalize(cotangent.xyz) + texel.y * cobitangent.w * normalize(cobitangent.xyz)
        + texel.z * normalize(normal);
}
#endif

//% if morphs in ("none", "tangent")
//%   set given = "as it was given to the lighting"
//% else
//%   set given = "the one without morph targets"
//% endif
//% set guard = "SKINBAKE_NORMAL_MAP_" ~ frame | upper
#ifndef @{ guard }
#define @{ guard }
// Make it at the vertex. @{ "frame" if frame == "tangent" else "rest" }: @{ given }. A scale of dual quaternions multiplies its tangents.
//% if frame == "normal"
// tangent: TANGENT at rest, which the texture follows.
//% endif
// By a model matrix: transform v.normal, v.cotangent and v.cobitangent like normals, by its cofactors, before the call.
//% if frame == "tangent"
skinbake_NormalMap skinbake_normal_map(skinbake_Vertex v, skinbake_Frame frame)
{
    float3 cotangent = v.cotangent;
    float3 cobitangent = v.cobitangent;
    float k = length(frame.tangent) / length(v.normal);
//% else
skinbake_NormalMap skinbake_normal_map(skinbake_Vertex v, skinbake_Frame rest, float4 tangent)
{
    // Cofactors are linear: those of t and b follow from those of t0, b0 and n0. t may lean from n0.
    float3 t = normalize(tangent.xyz);
    float3 b = tangent.w * normalize(cross(rest.normal, t));
    float3 cotangent = dot(t, rest.tangent) * v.cotangent + dot(t, rest.bitangent) * v.cobitangent
        + dot(t, rest.normal) * v.normal;
    float3 cobitangent = dot(b, rest.tangent) * v.cotangent + dot(b, rest.bitangent) * v.cobitangent;
    float k = 1.0 / length(v.normal);
//% endif
    skinbake_NormalMap map;
    map.normal = normalize(v.normal);
    map.cotangent = skinbake_with_length(cotangent, k);
    map.cobitangent = skinbake_with_length(cobitangent, k);
    return map;
}
#endif
