// The mesh's tangent in the world. It moves with t0 and b0, which span it.
fn skinbake_world_tangent(tangent: vec4<f32>, frame: skinbake_Frame, lit: skinbake_Vertex) -> vec4<f32> {
    let along = dot(tangent.xyz, frame.tangent) * lit.tangent + dot(tangent.xyz, frame.bitangent) * lit.bitangent;
    // A mirror turns the handedness round.
    let side = dot(cross(lit.tangent, lit.bitangent), lit.normal) * frame.handedness;
    return vec4<f32>(normalize(along), select(tangent.w, -tangent.w, side < 0.0));
}
