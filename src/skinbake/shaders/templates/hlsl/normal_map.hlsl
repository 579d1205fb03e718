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

//% if frame == "tangent"
//%   set comment = "frame: as it was given to the lighting. Its tangent may have any length."
//% elif morphs == "none"
//%   set comment = "frame: as it was given to the lighting. tangent: TANGENT, which the texture follows."
//% else
//%   set comment = "frame: as it was given to the lighting; rest: the frame without morphs; tangent: TANGENT at rest."
//% endif
//% set guard = "SKINBAKE_NORMAL_MAP_" ~ (frame if morphs == "none" or frame == "tangent" else "MORPHED") | upper
#ifndef @{ guard }
#define @{ guard }
// Make it at the vertex. @{ comment }
// By a model matrix: transform v.normal, v.cotangent and v.cobitangent like normals, by its cofactors, before the call.
//% if frame == "tangent"
skinbake_NormalMap skinbake_normal_map(skinbake_Vertex v, skinbake_Frame frame)
{
    float3 cotangent = v.cotangent;
    float3 cobitangent = v.cobitangent;
    float k = length(frame.tangent) / length(v.normal);
//% else
//%   set at = "frame" if morphs == "none" else "rest"
skinbake_NormalMap skinbake_normal_map(skinbake_Vertex v, skinbake_Frame frame@{ ", skinbake_Frame rest" if morphs != "none" }, float4 tangent)
{
    // Cofactors are linear: those of t and b follow from those of t0, b0 and n0. t may lean from n0.
    float3 t = normalize(tangent.xyz);
    float3 b = tangent.w * normalize(cross(@{ at }.normal, t));
    float3 cotangent = dot(t, @{ at }.tangent) * v.cotangent + dot(t, @{ at }.bitangent) * v.cobitangent;
    float3 cobitangent = dot(b, @{ at }.tangent) * v.cotangent + dot(b, @{ at }.bitangent) * v.cobitangent;
//%   if morphs != "none"
    cotangent *= length(frame.tangent); // it has the scale of the joints that dual quaternions share
    cobitangent *= length(frame.tangent);
//%   endif
    cotangent += dot(t, @{ at }.normal) * v.normal;
    float k = 1.0 / length(v.normal);
//% endif
    skinbake_NormalMap map;
    map.normal = normalize(v.normal);
    map.cotangent = skinbake_with_length(cotangent, k);
    map.cobitangent = skinbake_with_length(cobitangent, k);
    return map;
}
#endif
