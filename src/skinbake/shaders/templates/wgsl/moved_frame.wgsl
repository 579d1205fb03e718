// The frame under morph targets whose differential the file has: m and up are the weighted sums of _SKINBAKE_MORPH
// and _SKINBAKE_MORPH_UP of the targets. It is exact, and needs no NORMAL of the targets.
fn skinbake_moved_frame(rest: skinbake_Frame, m: vec4<f32>, up: vec2<f32>) -> skinbake_Frame {
    let tangent = rest.tangent + rest.tangent * m.x + rest.bitangent * m.y + rest.normal * up.x;
    let bitangent = rest.bitangent + rest.tangent * m.z + rest.bitangent * m.w + rest.normal * up.y;
    let c = cross(tangent, bitangent) * rest.handedness;
    let square = dot(c, c);
    let moves = square > 0.0 && (any(m != vec4<f32>(0.0)) || any(up != vec2<f32>(0.0)));
    let normal = select(rest.normal, c * inverseSqrt(square), moves);
    return skinbake_Frame(normal, tangent, bitangent, rest.handedness);
}
