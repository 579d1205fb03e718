// The frame under morph targets, by the morphed normal n: NORMAL plus the weighted sum of its targets, of any
// length. The frame at rest turns by the smallest rotation that takes its normal to n. Do not use
// skinbake_frame(n): alpha and beta belong to the frame at rest.
fn skinbake_morphed_frame(rest: skinbake_Frame, n: vec3<f32>) -> skinbake_Frame {
    let square = dot(n, n);
    let normal = select(rest.normal, n * inverseSqrt(square), square > 0.0);
    let s = rest.normal + normal;
    let d = normal - rest.normal;
    let opposite = dot(s, s) < 1e-4; // then every half turn is the smallest: take the one about t0
    let k = select(2.0 / dot(s, s), 0.0, opposite);
    let tangent = rest.tangent - s * (k * dot(d, rest.tangent));
    let bitangent = rest.bitangent - s * (k * dot(d, rest.bitangent));
    return skinbake_Frame(normal, tangent, select(bitangent, -bitangent, opposite), rest.handedness);
}
