// The frame under morph targets that move TANGENT too. tangent is TANGENT.xyz plus the weighted sum of its targets.
// Do not normalise it. If the sum is 0, the frame follows the normal. If the targets of a primitive have no
// TANGENT, use skinbake_morphed_frame().
fn skinbake_morphed_tangent_frame(rest: skinbake_Frame, n: vec3<f32>, tangent: vec3<f32>) -> skinbake_Frame {
    var frame = skinbake_morphed_frame(rest, n);
    let t = tangent - frame.normal * (dot(frame.normal, tangent) - dot(rest.normal, rest.tangent));
    let cancelled = dot(t, t) < 1e-4 * dot(rest.tangent, rest.tangent);
    frame.tangent = select(t, frame.tangent, cancelled);
    frame.bitangent = select(cross(frame.normal, t) * rest.handedness, frame.bitangent, cancelled);
    return frame;
}
