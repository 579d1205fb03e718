#ifndef SKINBAKE_NORMAL_MAP
#define SKINBAKE_NORMAL_MAP
// What a pixel needs for normal maps. Pass all three to it as they are. A direction keeps its length in w, relative to
// the normal's, because a pixel sees the direction between vertices at length 1.
struct skinbake_NormalMap {
    vec3 normal;
    vec4 cotangent;
    vec4 cobitangent;
};

// A vector at length 1. Zero stays zero: joints of scale 0 leave nothing else.
vec3 skinbake_direction(vec3 v)
{
    return dot(v, v) > 0.0 ? normalize(v) : v;
}

// The mapped normal at a pixel, of any length: the texel, 2 * texture - 1, on the surface as it is now. At rest it is
// t, b and n, each of length 1, times the texel, as in three.js.
vec3 skinbake_mapped_normal(vec3 texel, vec3 normal, vec4 cotangent, vec4 cobitangent)
{
    return texel.x * cotangent.w * skinbake_direction(cotangent.xyz)
        + texel.y * cobitangent.w * skinbake_direction(cobitangent.xyz) + texel.z * skinbake_direction(normal);
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
    vec3 cotangent = v.cotangent;
    vec3 cobitangent = v.cobitangent;
    float k = length(frame.tangent);
//% else
skinbake_NormalMap skinbake_normal_map(skinbake_Vertex v, skinbake_Frame rest, vec4 tangent)
{
    // Cofactors are linear: those of t and b follow from those of t0, b0 and n0. t may lean from n0.
    vec3 t = normalize(tangent.xyz);
    vec3 b = tangent.w * normalize(cross(rest.normal, t));
    vec3 cotangent = dot(t, rest.tangent) * v.cotangent + dot(t, rest.bitangent) * v.cobitangent
        + dot(t, rest.normal) * v.normal;
    vec3 cobitangent = dot(b, rest.tangent) * v.cotangent + dot(b, rest.bitangent) * v.cobitangent;
    float k = 1.0;
//% endif
    float size = length(v.normal);
    k = size > 0.0 ? k / size : 0.0;
    return skinbake_NormalMap(skinbake_direction(v.normal), vec4(skinbake_direction(cotangent), k * length(cotangent)),
        vec4(skinbake_direction(cobitangent), k * length(cobitangent)));
}
#endif
