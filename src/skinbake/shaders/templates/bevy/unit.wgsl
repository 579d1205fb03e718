// A normal of length 1. If NORMAL has no direction, bake takes (0, 0, 1).
fn skinbake_unit(normal: vec3<f32>) -> vec3<f32> {
    return select(vec3<f32>(0.0, 0.0, 1.0), normalize(normal), dot(normal, normal) > 0.0);
}

