// Lighting for skinned meshes that skinbake has baked: linear blend skinning, accurate lighting,
// 4 influences a vertex, tangent frame, morph targets by tangent.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang wgsl --method lbs --lighting accurate --influences 4 --frame tangent --morphs tangent --stage compute
//
// Algorithm 3 of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned
// Models", Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. The numbers beside the lines
// come from its supplement.
// A compute pass in WGSL for WebGPU. All bindings are in group 0.
//
// Inputs of each vertex, in mesh space: the attributes as they are stored, before any joint matrix:
//     POSITION             vec3<f32>  p, in the file's unit of length
//     NORMAL               vec3<f32>  n0, of any length
//     TANGENT              vec4<f32>  t0, and in w the handedness of the frame, 1 or -1
//     JOINTS_0             vec4<u32>  joints of slots 0 to 3
//     WEIGHTS_0            vec4<f32>  w of slots 0 to 3; over all slots they sum to 1
//     _SKINBAKE_ALPHA_0    vec3<f32>  alpha = grad w . t0 of slots 1 to 3, in 1 / unit of POSITION
//     _SKINBAKE_BETA_0     vec3<f32>  beta = grad w . b0 of the same slots
// alpha and beta of slot 0 are not stored: they are minus the sums over the other slots.
//
// M[s] is the joint matrix of the joint in slot s: its global transform * its inverse bind matrix, glTF's sixteen
// floats.
// Bindings:
//     0  skinbake_draw      uniform: the numbers of one primitive; vertices, offsets and strides are set for each
//     1  skinbake_geometry  the bytes of glTF's buffer, as they are
//     2  skinbake_joints    the motions of the joints in this pose
//     3  skinbake_posed     the results: position and normal of three floats, tangent of four
//     4  skinbake_targets   the morph targets of the primitive
// An attribute is given as two numbers, in bytes: where its first value begins, and how far on the next one begins.
// Floats are read, but for JOINTS_n and WEIGHTS_n, of which joint_size and weight_size are the bytes of a component:
// 1, 2 or 4; weights of 4 are floats. Expand other types, sparse accessors and compressed geometry beforehand.
// skinbake_posed has posed_stride bytes a vertex; 0xffffffff for a result leaves it out. Normal and tangent have
// length 1. tangent is the image of t0, and its w the handedness of the result.
// Dispatch vertices / 64 workgroups, rounded up.

// A skinned vertex. Its vectors have any length. tangent and bitangent are the images of t0 and b0.
struct skinbake_Vertex {
    position: vec3<f32>,
    normal: vec3<f32>,
    tangent: vec3<f32>,
    bitangent: vec3<f32>,
}

// The tangent frame at rest.
struct skinbake_Frame {
    normal: vec3<f32>,
    tangent: vec3<f32>,
    bitangent: vec3<f32>,
    handedness: f32, // n0 = handedness * cross(t0, b0) / |t0|^2
}

// The frame of NORMAL, which must have length 1, and TANGENT.
fn skinbake_frame(n: vec3<f32>, tangent: vec4<f32>) -> skinbake_Frame {
    return skinbake_Frame(n, tangent.xyz, cross(n, tangent.xyz) * tangent.w, tangent.w);
}

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

// The upper 3x3 part of M.
fn skinbake_upper(M: mat4x4<f32>) -> mat3x3<f32> {
    return mat3x3<f32>(M[0].xyz, M[1].xyz, M[2].xyz);
}

// M p: the position p moved by the joint matrix M alone.
fn skinbake_moved(M: mat4x4<f32>, p: vec3<f32>) -> vec3<f32> {
    return M[0].xyz * p.x + (M[1].xyz * p.y + (M[2].xyz * p.z + M[3].xyz));
}

// The frame moves by the derivative of the skinned position along t0 and b0.
// M: the joint matrices of slots 0 to 3.
fn skinbake_lbs_accurate(p: vec3<f32>, frame: skinbake_Frame, M: array<mat4x4<f32>, 4>, weights_0: vec4<f32>,
        alpha_0: vec3<f32>, beta_0: vec3<f32>) -> skinbake_Vertex {
    let T = weights_0.x * skinbake_upper(M[0]) // 1
          + weights_0.y * skinbake_upper(M[1])
          + weights_0.z * skinbake_upper(M[2])
          + weights_0.w * skinbake_upper(M[3]);
    let q0 = skinbake_moved(M[0], p); // 2
    let q1 = skinbake_moved(M[1], p);
    let q2 = skinbake_moved(M[2], p);
    let q3 = skinbake_moved(M[3], p);
    let d1 = q1 - q0; // 3
    let d2 = q2 - q0;
    let d3 = q3 - q0;
    let tangent = T * frame.tangent + alpha_0.x * d1 + alpha_0.y * d2 + alpha_0.z * d3; // 4
    let bitangent = T * frame.bitangent + beta_0.x * d1 + beta_0.y * d2 + beta_0.z * d3; // 5
    let normal = frame.handedness * cross(tangent, bitangent); // 6
    let position = q0 + weights_0.y * d1 + weights_0.z * d2 + weights_0.w * d3; // 7
    return skinbake_Vertex(position, normal, tangent, bitangent);
}

struct skinbake_Draw {
    vertices: u32,
    targets: u32,
    joint_size: u32,
    weight_size: u32,
    posed_stride: u32,
    posed_position: u32,
    posed_normal: u32,
    posed_tangent: u32,
    scale: f32,
    joint_scale: f32,
    position: vec2<u32>,
    normal: vec2<u32>,
    tangent: vec2<u32>,
    joints_0: vec2<u32>,
    weights_0: vec2<u32>,
    alpha_0: vec2<u32>,
    beta_0: vec2<u32>,
}
@group(0) @binding(0) var<uniform> skinbake_draw: skinbake_Draw;
@group(0) @binding(1) var<storage, read> skinbake_geometry: array<u32>;
@group(0) @binding(2) var<storage, read> skinbake_joints: array<mat4x4<f32>>;
@group(0) @binding(3) var<storage, read_write> skinbake_posed: array<f32>;

struct skinbake_Target {
    weight: f32,
    unused: u32,
    position: vec2<u32>, // 0xffffffff in x: the target does not move it
    normal: vec2<u32>,
    tangent: vec2<u32>,
    morph: vec2<u32>,
    morph_up: vec2<u32>,
}
@group(0) @binding(4) var<storage, read> skinbake_targets: array<skinbake_Target>;

fn skinbake_word(place: vec2<u32>, vertex: u32, number: u32) -> u32 {
    return skinbake_geometry[(place.x + place.y * vertex) / 4u + number];
}

fn skinbake_float(place: vec2<u32>, vertex: u32, number: u32) -> f32 {
    return bitcast<f32>(skinbake_word(place, vertex, number));
}

fn skinbake_vec2(place: vec2<u32>, vertex: u32) -> vec2<f32> {
    return vec2<f32>(skinbake_float(place, vertex, 0u), skinbake_float(place, vertex, 1u));
}

fn skinbake_vec3(place: vec2<u32>, vertex: u32) -> vec3<f32> {
    return vec3<f32>(skinbake_vec2(place, vertex), skinbake_float(place, vertex, 2u));
}

fn skinbake_vec4(place: vec2<u32>, vertex: u32) -> vec4<f32> {
    return vec4<f32>(skinbake_vec3(place, vertex), skinbake_float(place, vertex, 3u));
}

// NORMAL at length 1. If it has no direction, bake takes (0, 0, 1).
fn skinbake_normal(place: vec2<u32>, vertex: u32) -> vec3<f32> {
    let stored = skinbake_vec3(place, vertex);
    return select(vec3<f32>(0.0, 0.0, 1.0), normalize(stored), dot(stored, stored) > 0.0);
}

// Four whole numbers of 1, 2 or 4 bytes, by the size of one.
fn skinbake_integers(place: vec2<u32>, vertex: u32, size: u32) -> vec4<u32> {
    let first = skinbake_word(place, vertex, 0u);
    if (size == 1u) {
        return (vec4<u32>(first) >> vec4<u32>(0u, 8u, 16u, 24u)) & vec4<u32>(0xffu);
    }
    let second = skinbake_word(place, vertex, 1u);
    if (size == 4u) {
        return vec4<u32>(first, second, skinbake_word(place, vertex, 2u), skinbake_word(place, vertex, 3u));
    }
    return vec4<u32>(first & 0xffffu, first >> 16u, second & 0xffffu, second >> 16u);
}

fn skinbake_weights(place: vec2<u32>, vertex: u32) -> vec4<f32> {
    if (skinbake_draw.weight_size == 4u) {
        return skinbake_vec4(place, vertex);
    }
    let integers = vec4<f32>(skinbake_integers(place, vertex, skinbake_draw.weight_size));
    return integers / select(65535.0, 255.0, skinbake_draw.weight_size == 1u);
}

fn skinbake_put(offset: u32, vertex: u32, value: vec4<f32>, count: u32) {
    if (offset == 0xffffffffu) {
        return;
    }
    let at = (offset + skinbake_draw.posed_stride * vertex) / 4u;
    for (var number = 0u; number < count; number++) {
        skinbake_posed[at + number] = value[number];
    }
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let vertex = id.x;
    if (vertex >= skinbake_draw.vertices) {
        return;
    }
    let position = skinbake_vec3(skinbake_draw.position, vertex);
    let normal = skinbake_normal(skinbake_draw.normal, vertex);
    let tangent = skinbake_vec4(skinbake_draw.tangent, vertex);
    let joints_0 = skinbake_integers(skinbake_draw.joints_0, vertex, skinbake_draw.joint_size);
    var weights_0 = skinbake_weights(skinbake_draw.weights_0, vertex);
    let alpha_0 = skinbake_vec3(skinbake_draw.alpha_0, vertex);
    let beta_0 = skinbake_vec3(skinbake_draw.beta_0, vertex);
    if (!(any(weights_0 > vec4<f32>(0.0)))) {
        weights_0 = vec4<f32>(1.0, 0.0, 0.0, 0.0); // bound to slot 0, as bake takes it
    }
    var morphed_position = position;
    var morphed_normal = normal;
    var morphed_tangent = tangent.xyz;
    for (var number = 0u; number < skinbake_draw.targets; number++) {
        let moved = skinbake_targets[number];
        if (moved.position.x != 0xffffffffu) {
            morphed_position += moved.weight * skinbake_vec3(moved.position, vertex);
        }
        if (moved.normal.x != 0xffffffffu) {
            morphed_normal += moved.weight * skinbake_vec3(moved.normal, vertex);
        }
        if (moved.tangent.x != 0xffffffffu) {
            morphed_tangent += moved.weight * skinbake_vec3(moved.tangent, vertex);
        }
    }
    let M = array<mat4x4<f32>, 4>(
        skinbake_joints[joints_0.x],
        skinbake_joints[joints_0.y],
        skinbake_joints[joints_0.z],
        skinbake_joints[joints_0.w],
    );
    let rest = skinbake_frame(normal, tangent);
    let frame = skinbake_morphed_tangent_frame(rest, morphed_normal, morphed_tangent);
    let v = skinbake_lbs_accurate(morphed_position, frame, M, weights_0, alpha_0, beta_0);
    let side = select(1.0, -1.0, dot(cross(v.tangent, v.bitangent), v.normal) < 0.0);
    skinbake_put(skinbake_draw.posed_position, vertex, vec4<f32>(v.position, 0.0), 3u);
    skinbake_put(skinbake_draw.posed_normal, vertex, vec4<f32>(normalize(v.normal), 0.0), 3u);
    skinbake_put(skinbake_draw.posed_tangent, vertex, vec4<f32>(normalize(v.tangent), side), 4u);
}
