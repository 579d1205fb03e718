struct Scene {
    projected: mat4x4<f32>,
    eye: vec4<f32>,
    light: vec4<f32>,
    base: vec4<f32>,
    mode: u32,
    legend: f32,
}
struct Varying {
    @builtin(position) position: vec4<f32>,
    @location(0) place: vec3<f32>,
    @location(1) normal: vec3<f32>,
    @location(2) error: vec2<f32>,
}
@group(0) @binding(0) var<storage, read> joints: array<mat4x4<f32>>;
@group(0) @binding(1) var<storage, read> rows: array<array<vec4<f32>, ROW>>;
@group(0) @binding(2) var<uniform> scene: Scene;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> Varying {
    let row = rows[index];
    let M = array<mat4x4<f32>, INFLUENCES>(MATRICES);
    let frame = skinbake_Frame(row[1].xyz, row[2].xyz, row[3].xyz, row[2].w);
    let v = skinbake_CALL;
    return Varying(scene.projected * vec4<f32>(v.position, 1.0), v.position, normalize(v.normal),
        vec2<f32>(row[0].w, row[1].w));
}

fn shaded(n: vec3<f32>, v: vec3<f32>) -> vec3<f32> {
    let light = scene.light.xyz;
    let h = normalize(light + v);
    let nl = max(dot(n, light), 0.0);
    let nh = max(dot(n, h), 0.0);
    let nv = max(dot(n, v), 1e-3);
    let roughness = 0.42;
    let a2 = roughness * roughness * roughness * roughness;
    let d = nh * nh * (a2 - 1.0) + 1.0;
    let k = (roughness + 1.0) * (roughness + 1.0) / 8.0;
    let shine = 0.04 + 0.96 * pow(1.0 - max(dot(v, h), 0.0), 5.0);
    let specular = shine * a2 / (d * d) / (4.0 * (nl * (1.0 - k) + k) * (nv * (1.0 - k) + k));
    let sky = mix(vec3<f32>(0.16, 0.15, 0.145), vec3<f32>(0.36, 0.39, 0.43), 0.5 + 0.5 * n.y);
    let rim = pow(1.0 - nv, 4.0) * 0.12;
    return scene.base.rgb * (sky + 1.7 * nl * vec3<f32>(1.0, 0.98, 0.94)) + nl * specular * 1.2 + rim * sky;
}

fn heat(share: f32) -> vec3<f32> {
    var stops = array<vec3<f32>, 5>(STOPS);
    let at = clamp(share, 0.0, 1.0) * 4.0;
    let low = min(u32(at), 3u);
    return mix(stops[low], stops[low + 1u], at - f32(low));
}

@fragment
fn fragment(in: Varying) -> @location(0) vec4<f32> {
    let n = normalize(in.normal);
    let v = normalize(scene.eye.xyz - in.place);
    let r = reflect(-v, n);
    let at = asin(clamp(r.y * 0.94 + r.x * 0.34, -1.0, 1.0)) * 4.5;
    let width = max(fwidth(at), 1e-4);
    var color = 0.5 + 0.5 * n;
    if (scene.mode == 0u) {
        let lit = shaded(n, v);
        color = pow(lit / (1.0 + 0.18 * lit), vec3<f32>(1.0 / 2.2));
    } else if (scene.mode == 1u) {
        let line = clamp(0.5 + (abs(fract(at) - 0.5) - 0.25) / width, 0.0, 1.0);
        let grey = mix(mix(0.10, 0.93, line), 0.52, smoothstep(0.5, 1.5, width));
        color = vec3<f32>(grey) * (0.86 + 0.14 * max(dot(n, v), 0.0));
    } else if (scene.mode == 2u) {
        color = select(vec3<f32>(0.545, 0.576, 0.627), heat(in.error.x / scene.legend), in.error.y > 0.99);
        color *= 0.80 + 0.20 * max(dot(n, v), 0.0);
    }
    return vec4<f32>(color, 1.0);
}
