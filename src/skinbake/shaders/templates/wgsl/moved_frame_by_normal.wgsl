// The frame under morph targets that have NORMAL and their differential: n is NORMAL plus the weighted sum of its
// targets, of any length, m the weighted sum of _SKINBAKE_MORPH of the targets.
fn skinbake_moved_frame_by_normal(rest: skinbake_Frame, n: vec3<f32>, m: vec4<f32>) -> skinbake_Frame {
    var frame = skinbake_morphed_frame(rest, n);
    let t = rest.tangent + rest.tangent * m.x + rest.bitangent * m.y;
    let b = rest.bitangent + rest.tangent * m.z + rest.bitangent * m.w;
    let cosine = dot(rest.normal, frame.normal);
    // Then m tells too little, or of the other side of the surface.
    let steep = abs(cosine) < 0.2 || cosine * ((1.0 + m.x) * (1.0 + m.w) - m.y * m.z) <= 0.0;
    let k = select(1.0 / cosine, 0.0, steep);
    frame.tangent = select(t - rest.normal * (dot(t, frame.normal) * k), frame.tangent, steep);
    frame.bitangent = select(b - rest.normal * (dot(b, frame.normal) * k), frame.bitangent, steep);
    return frame;
}
