struct skinbake_Draw {
//% for kind, name in draw_members
    @{ name }: @{ kind },
//% endfor
}
@group(0) @binding(0) var<uniform> skinbake_draw: skinbake_Draw;
@group(0) @binding(1) var<storage, read> skinbake_geometry: array<u32>;
@group(0) @binding(2) var<storage, read> skinbake_joints: array<@{ motion_type }>;
@group(0) @binding(3) var<storage, read_write> skinbake_posed: array<f32>;

//% if morphs != "none"
struct skinbake_Target {
    weight: f32,
    unused: u32,
    position: vec2<u32>, // @{ absent } in x: the target does not move it
    normal: vec2<u32>,
    tangent: vec2<u32>,
    morph: vec2<u32>,
    morph_up: vec2<u32>,
}
@group(0) @binding(4) var<storage, read> skinbake_targets: array<skinbake_Target>;

//% endif
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

//% if decodes
fn skinbake_stored(place: vec2<u32>, vertex: u32) -> vec4<f32> {
//%   if encoding == "packed8"
    return unpack4x8snorm(skinbake_word(place, vertex, 0u));
//%   else
    return vec4<f32>(unpack2x16snorm(skinbake_word(place, vertex, 0u)),
        unpack2x16snorm(skinbake_word(place, vertex, 1u)));
//%   endif
}

//% endif
fn skinbake_put(offset: u32, vertex: u32, value: vec4<f32>, count: u32) {
    if (offset == @{ absent }u) {
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
//% for column in compute_reads
    @{ "var" if column.name == "weights_0" or (scales_joints and column.name == "position") else "let" } @{ column.name } = @{ column.call };
//% endfor
    if (!(@{ is_bound })) {
        weights_0 = vec4<f32>(1.0, 0.0, 0.0, 0.0); // bound to slot 0, as bake takes it
    }
//% if morphs != "none"
//%   for sum in morphed
    var @{ sum.variable } = @{ sum.start };
//%   endfor
    for (var number = 0u; number < skinbake_draw.targets; number++) {
        let moved = skinbake_targets[number];
//%   for sum in morphed
        if (moved.@{ sum.name }.x != @{ absent }u) {
            @{ sum.variable } += moved.weight * skinbake_@{ sum.type }(moved.@{ sum.name }, vertex);
        }
//%   endfor
    }
//% endif
    let @{ motion_name } = array<@{ motion_type }, @{ influences }>(
//% for joint in slot_joints
        skinbake_joints[@{ joint }],
//% endfor
    );
//% if morphs == "none"
    @{ "var" if scales_joints else "let" } frame = skinbake_frame(@{ "normal, tangent" if frame == "tangent" else "normal" });
//% else
    let rest = skinbake_frame(@{ "normal, tangent" if frame == "tangent" else "normal" });
    @{ "var" if scales_joints else "let" } frame = @{ morph_call };
//% endif
//% if scales_joints
    @{ arguments_of_compute[0] } *= skinbake_draw.joint_scale;
    frame.tangent *= skinbake_draw.joint_scale;
    frame.bitangent *= skinbake_draw.joint_scale;
//% endif
//% if decodes
    let scale = @{ "f32(" ~ scale ~ ")" if scale else "skinbake_draw.scale" };
//% endif
//% for line in preparations
    let @{ line.name } = @{ line.call };
//% endfor
    let v = skinbake_@{ stem }(@{ arguments_of_compute | join(", ") });
    let side = select(1.0, -1.0, dot(cross(v.tangent, v.bitangent), v.normal) < 0.0);
    skinbake_put(skinbake_draw.posed_position, vertex, vec4<f32>(v.position, 0.0), 3u);
    skinbake_put(skinbake_draw.posed_normal, vertex, vec4<f32>(normalize(v.normal), 0.0), 3u);
    skinbake_put(skinbake_draw.posed_tangent, vertex, vec4<f32>(normalize(v.tangent), side), 4u);
}
