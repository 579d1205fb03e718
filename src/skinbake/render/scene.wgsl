struct Scene {
    projected: mat4x4<f32>,
    eye: vec4<f32>,
    light: vec4<f32>,
    base: vec4<f32>,
    emissive: vec4<f32>, // and the roughness
    mode: u32,
    flags: u32,
    legend: f32,
    normal_scale: f32,
    least: f32, // the least alpha that is drawn, and what it must be below
    below: f32,
}
struct Varying {
    @builtin(position) position: vec4<f32>,
    @location(0) place: vec3<f32>,
    @location(1) normal: vec3<f32>,
    @location(2) error: vec2<f32>,
    @location(3) cotangent: vec4<f32>, // for normal maps: a direction, and its length over that of the normal
    @location(4) cobitangent: vec4<f32>,
    @location(5) texcoords: vec4<f32>, // of the base colour's image, and of the normal map
    @location(6) glow_texcoord: vec2<f32>,
    @location(7) color: vec4<f32>,
}
const HAS_NORMAL_MAP = 1u;
const HAS_TANGENTS = 2u;
const IS_TURNED = 4u; // seen from behind
const IS_BLENDED = 8u;
const IS_UNLIT = 16u;
@group(0) @binding(0) var<storage, read> joints: array<mat4x4<f32>>;
@group(0) @binding(1) var<storage, read> rows: array<array<vec4<f32>, ROW>>;
@group(0) @binding(2) var<uniform> scene: Scene;
@group(0) @binding(3) var base_sampler: sampler;
@group(0) @binding(4) var normal_sampler: sampler;
@group(0) @binding(5) var emissive_sampler: sampler;
@group(0) @binding(6) var base_map: texture_2d<f32>;
@group(0) @binding(7) var normal_map: texture_2d<f32>;
@group(0) @binding(8) var emissive_map: texture_2d<f32>;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> Varying {
    let row = rows[index];
    let M = array<mat4x4<f32>, INFLUENCES>(MATRICES);
    let frame = skinbake_Frame(row[1].xyz, row[2].xyz, row[3].xyz, row[2].w);
    let v = skinbake_CALL;
    // In the coordinates of the frame without morph targets.
    let tangent = row[TANGENT];
    let rest = skinbake_Frame(vec3<f32>(0.0, 0.0, 1.0), ALONG, vec3<f32>(0.0, 1.0, 0.0), 1.0);
    return Varying(scene.projected * vec4<f32>(v.position, 1.0), v.position, normalize(v.normal),
        vec2<f32>(row[0].w, row[1].w), COTANGENT, COBITANGENT, row[4], row[5].xy, row[6]);
}

fn encoded(c: vec3<f32>) -> vec3<f32> {
    return mix(12.92 * c, 1.055 * pow(c, vec3<f32>(1.0 / 2.4)) - 0.055, step(vec3<f32>(0.0031308), c));
}

// The normal of a normal map, whose frame comes from the shader, or from what changes between pixels.
fn mapped(n: vec3<f32>, texel: vec3<f32>, in: Varying, px: vec3<f32>, py: vec3<f32>, ux: vec2<f32>, uy: vec2<f32>) -> vec3<f32> {
    let m = (texel * 2.0 - 1.0) * vec3<f32>(vec2<f32>(scene.normal_scale), 1.0);
    if ((scene.flags & HAS_TANGENTS) != 0u) {
        return normalize(in.cotangent.w * m.x * normalize(in.cotangent.xyz)
            + in.cobitangent.w * m.y * normalize(in.cobitangent.xyz) + m.z * n);
    }
    let a = cross(py, n);
    let c = cross(n, px);
    let t = a * ux.x + c * uy.x;
    let b = a * ux.y + c * uy.y;
    let size = inverseSqrt(max(max(dot(t, t), dot(b, b)), 1e-30));
    return normalize(t * (m.x * size) + b * (m.y * size) + n * m.z);
}

fn shaded(n: vec3<f32>, v: vec3<f32>, base: vec3<f32>) -> vec3<f32> {
    let light = scene.light.xyz;
    let h = normalize(light + v);
    let nl = max(dot(n, light), 0.0);
    let nh = max(dot(n, h), 0.0);
    let nv = max(dot(n, v), 1e-3);
    let roughness = scene.emissive.w;
    let a2 = roughness * roughness * roughness * roughness;
    let d = nh * nh * (a2 - 1.0) + 1.0;
    let k = (roughness + 1.0) * (roughness + 1.0) / 8.0;
    let shine = 0.04 + 0.96 * pow(1.0 - max(dot(v, h), 0.0), 5.0);
    let specular = shine * a2 / (d * d) / (4.0 * (nl * (1.0 - k) + k) * (nv * (1.0 - k) + k));
    let sky = mix(vec3<f32>(0.16, 0.15, 0.145), vec3<f32>(0.36, 0.39, 0.43), 0.5 + 0.5 * n.y);
    let rim = pow(1.0 - nv, 4.0) * 0.12;
    return base * (sky + 1.1 * nl * vec3<f32>(1.0, 0.98, 0.94)) + nl * specular * 1.2 + rim * sky;
}

fn heat(share: f32) -> vec3<f32> {
    var stops = array<vec3<f32>, 5>(STOPS);
    let at = clamp(share, 0.0, 1.0) * 4.0;
    let low = min(u32(at), 3u);
    return mix(stops[low], stops[low + 1u], at - f32(low));
}

@fragment
fn fragment(in: Varying, @builtin(front_facing) is_front: bool) -> @location(0) vec4<f32> {
    // Derivatives and samples stand before every branch, as WGSL wants. y goes down here, and up in glTF's frame.
    let texel = textureSample(base_map, base_sampler, in.texcoords.xy);
    let slope = textureSample(normal_map, normal_sampler, in.texcoords.zw).rgb;
    let glow = textureSample(emissive_map, emissive_sampler, in.glow_texcoord).rgb;
    let px = dpdx(in.place);
    let py = -dpdy(in.place);
    let ux = dpdx(in.texcoords.zw);
    let uy = -dpdy(in.texcoords.zw);
    var n = normalize(in.normal);
    if ((scene.flags & IS_TURNED) != 0u && !is_front) {
        n = -n;
    }
    let v = normalize(scene.eye.xyz - in.place);
    let r = reflect(-v, n);
    let at = asin(clamp(r.y * 0.94 + r.x * 0.34, -1.0, 1.0)) * 4.5;
    let width = max(fwidth(at), 1e-4);
    let base = scene.base * in.color * texel;
    if (base.a < scene.least || base.a >= scene.below) {
        discard;
    }
    var color = 0.5 + 0.5 * n;
    var alpha = 1.0;
    if (scene.mode == 0u) {
        if ((scene.flags & HAS_NORMAL_MAP) != 0u) {
            n = mapped(n, slope, in, px, py, ux, uy);
        }
        let lit = shaded(n, v, base.rgb) + scene.emissive.rgb * glow;
        color = encoded(select(lit / (1.0 + 0.18 * lit), base.rgb, (scene.flags & IS_UNLIT) != 0u));
        if ((scene.flags & IS_BLENDED) != 0u) {
            alpha = base.a;
        }
    } else if (scene.mode == 1u) {
        let line = clamp(0.5 + (abs(fract(at) - 0.5) - 0.25) / width, 0.0, 1.0);
        let grey = mix(mix(0.10, 0.93, line), 0.52, smoothstep(0.5, 1.5, width));
        color = vec3<f32>(grey) * (0.86 + 0.14 * max(dot(n, v), 0.0));
    } else if (scene.mode == 2u) {
        color = select(vec3<f32>(0.545, 0.576, 0.627), heat(in.error.x / scene.legend), in.error.y > 0.99);
        color *= 0.80 + 0.20 * max(dot(n, v), 0.0);
    }
    return vec4<f32>(color * alpha, alpha);
}
