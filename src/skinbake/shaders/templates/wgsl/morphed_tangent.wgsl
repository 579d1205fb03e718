// The frame under morph targets that move TANGENT too: tangent is TANGENT.xyz plus the weighted sum of its targets,
// and must not be normalised. Where they cancel it, the frame follows the normal; so should that of a primitive
// whose targets have no TANGENT, by skinbake_morphed_frame().
fn skinbake_morphed_tangent_frame(rest: skinbake_Frame, n: vec3<f32>, tangent: vec3<f32>) -> skinbake_Frame {
    var frame = skinbake_morphed_frame(rest, n);
    let t = tangent - frame.normal * (dot(frame.normal, tangent) - dot(rest.normal, rest.tangent));
    let cancelled = dot(t, t) < 1e-4 * dot(rest.tangent, rest.tangent);
    frame.tangent = select(t, frame.tangent, cancelled);
    frame.bitangent = select(cross(frame.normal, t) * rest.handedness, frame.bitangent, cancelled);
    return frame;
}
