// What a pixel needs for normal maps. Pass all three to it as they are. A direction keeps its length in w, relative to
// the normal's, because a pixel sees the direction between vertices at length 1.
struct skinbake_NormalMap {
    normal: vec3<f32>,
    cotangent: vec4<f32>,
    cobitangent: vec4<f32>,
}

// A vector at length 1. Zero stays zero: joints of scale 0 leave nothing else.
fn skinbake_direction(v: vec3<f32>) -> vec3<f32> {
    return select(v, normalize(v), dot(v, v) > 0.0);
}

// The mapped normal at a pixel, of any length: the texel, 2 * texture - 1, on the surface as it is now. At rest it is
// t, b and n, each of length 1, times the texel, as in three.js.
fn skinbake_mapped_normal(texel: vec3<f32>, normal: vec3<f32>, cotangent: vec4<f32>, cobitangent: vec4<f32>) -> vec3<f32> {
    return texel.x * cotangent.w * skinbake_direction(cotangent.xyz)
        + texel.y * cobitangent.w * skinbake_direction(cobitangent.xyz) + texel.z * skinbake_direction(normal);
}

//% if morphs in ("none", "tangent")
//%   set given = "as it was given to the lighting"
//% else
//%   set given = "the one without morph targets"
//% endif
// Make it at the vertex. @{ "frame" if frame == "tangent" else "rest" }: @{ given }. A scale of dual quaternions multiplies its tangents.
//% if frame == "normal"
// tangent: TANGENT at rest, which the texture follows.
//% endif
// By a model matrix: transform v.normal, v.cotangent and v.cobitangent like normals, by its cofactors, before the call.
//% if frame == "tangent"
fn skinbake_normal_map(v: skinbake_Vertex, frame: skinbake_Frame) -> skinbake_NormalMap {
    let cotangent = v.cotangent;
    let cobitangent = v.cobitangent;
    let length_at_rest = length(frame.tangent);
//% else
fn skinbake_normal_map(v: skinbake_Vertex, rest: skinbake_Frame, tangent: vec4<f32>) -> skinbake_NormalMap {
    // Cofactors are linear: those of t and b follow from those of t0, b0 and n0. t may lean from n0.
    let t = normalize(tangent.xyz);
    let b = tangent.w * normalize(cross(rest.normal, t));
    let cotangent = dot(t, rest.tangent) * v.cotangent + dot(t, rest.bitangent) * v.cobitangent
        + dot(t, rest.normal) * v.normal;
    let cobitangent = dot(b, rest.tangent) * v.cotangent + dot(b, rest.bitangent) * v.cobitangent;
    let length_at_rest = 1.0;
//% endif
    let size = length(v.normal);
    let k = select(0.0, length_at_rest / size, size > 0.0);
    return skinbake_NormalMap(
        skinbake_direction(v.normal),
        vec4<f32>(skinbake_direction(cotangent), k * length(cotangent)),
        vec4<f32>(skinbake_direction(cobitangent), k * length(cobitangent)),
    );
}
