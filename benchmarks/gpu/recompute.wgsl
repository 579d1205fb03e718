// Normals recomputed from the posed triangles, with the authored normal carried along.
//
// The normal of the surface at a vertex is the mean of its triangles' unit normals, weighted by their angles
// there. It and the edge to the first neighbour make a frame. A quaternion that was found in the rest pose
// turns this frame into that of the authored normal.

// Angles times unit normals are summed as integers: 24 bits after the point hold every sum up to 128.
const FIXED_POINT = 16777216.0;
// The mark of the first neighbour of a fan.
const START = 0x80000000u;

fn rest_position(i: u32) -> vec3<f32> {
    return vec3<f32>(position[3u * i], position[3u * i + 1u], position[3u * i + 2u]);
}

fn skinned_position(i: u32, instance: u32) -> vec3<f32> {
    let slots = unpack4xU8(joints[i]) + instance * counts.joints;
    let w = weights[i];
    let p = vec4<f32>(rest_position(i), 1.0);
    return (w.x * (matrices[slots.x] * p) + w.y * (matrices[slots.y] * p)
          + w.z * (matrices[slots.z] * p) + w.w * (matrices[slots.w] * p)).xyz;
}

fn write_position(posed: u32, p: vec3<f32>) {
    posed_position[3u * posed] = p.x;
    posed_position[3u * posed + 1u] = p.y;
    posed_position[3u * posed + 2u] = p.z;
}

fn read_position(posed: u32) -> vec3<f32> {
    return vec3<f32>(posed_position[3u * posed], posed_position[3u * posed + 1u], posed_position[3u * posed + 2u]);
}

// A flat vector has no direction, and becomes zero.
fn unit(v: vec3<f32>) -> vec3<f32> {
    return v * inverseSqrt(max(dot(v, v), 1e-38));
}

fn angle_between(area: f32, along: f32) -> f32 {
    return select(0.0, atan2(area, along), area > 0.0);
}

// The frame of surface normal n and edge, turned by q: the posed normal and tangent of a vertex.
fn write_frame(posed: u32, sum: vec3<f32>, edge: vec3<f32>, q: vec4<f32>) {
    let n = unit(sum);
    let t = unit(edge - dot(edge, n) * n);
    let s = cross(n, t);
    let tangent = (1.0 - 2.0 * (q.y * q.y + q.z * q.z)) * t
                + 2.0 * (q.x * q.y + q.z * q.w) * s
                + 2.0 * (q.x * q.z - q.y * q.w) * n;
    let normal = 2.0 * (q.x * q.z + q.y * q.w) * t
               + 2.0 * (q.y * q.z - q.x * q.w) * s
               + (1.0 - 2.0 * (q.x * q.x + q.y * q.y)) * n;
    posed_frame[6u * posed] = normal.x;
    posed_frame[6u * posed + 1u] = normal.y;
    posed_frame[6u * posed + 2u] = normal.z;
    posed_frame[6u * posed + 3u] = tangent.x;
    posed_frame[6u * posed + 4u] = tangent.y;
    posed_frame[6u * posed + 5u] = tangent.z;
}

//: skin
fn run(i: u32, instance: u32) {
    write_position(instance * counts.vertices + i, skinned_position(i, instance));
}

//: skin_and_clear
fn run(i: u32, instance: u32) {
    let posed = instance * counts.vertices + i;
    write_position(posed, skinned_position(i, instance));
    sums[3u * posed] = 0;
    sums[3u * posed + 1u] = 0;
    sums[3u * posed + 2u] = 0;
}

//: scatter
fn add(posed: u32, v: vec3<f32>) {
    let fixed = vec3<i32>(round(FIXED_POINT * v));
    atomicAdd(&sums[3u * posed], fixed.x);
    atomicAdd(&sums[3u * posed + 1u], fixed.y);
    atomicAdd(&sums[3u * posed + 2u], fixed.z);
}

fn run(i: u32, instance: u32) {
    let base = instance * counts.vertices;
    let a = base + triangles[3u * i];
    let b = base + triangles[3u * i + 1u];
    let c = base + triangles[3u * i + 2u];
    let p = read_position(a);
    let e1 = read_position(b) - p;
    let e2 = read_position(c) - p;
    let doubled = cross(e1, e2);
    let area = length(doubled);
    let n = doubled / max(area, 1e-38);
    let at_a = angle_between(area, dot(e1, e2));
    let at_b = angle_between(area, dot(e1, e1 - e2));
    let at_c = select(0.0, 3.14159265 - at_a - at_b, area > 0.0);
    add(a, at_a * n);
    add(b, at_b * n);
    add(c, at_c * n);
}

//: resolve
fn run(i: u32, instance: u32) {
    let base = instance * counts.vertices;
    let place = places[i] + base;
    let sum = vec3<f32>(vec3<i32>(sums[3u * place.x], sums[3u * place.x + 1u], sums[3u * place.x + 2u]));
    let edge = read_position(place.y) - read_position(base + i);
    write_frame(base + i, sum, edge, turns[i]);
}

//: gather
fn run(i: u32, instance: u32) {
    let base = instance * counts.vertices;
    let p = read_position(base + i);
    let within = ranges[i];
    var sum = vec3<f32>(0.0);
    var first = vec3<f32>(0.0);
    var before = vec3<f32>(0.0);
    for (var at = within.x; at < within.y; at++) {
        let neighbour = ring[at];
        let edge = read_position(base + (neighbour & ~START)) - p;
        if (at == within.x) {
            first = edge;
        }
        if (neighbour < START) {
            let doubled = cross(before, edge);
            let area = length(doubled);
            sum += angle_between(area, dot(before, edge)) / max(area, 1e-38) * doubled;
        }
        before = edge;
    }
    write_frame(base + i, sum, first, turns[i]);
}
