layout(local_size_x = 64) in;

layout(std140, binding = 0) uniform skinbake_Draw {
//% for kind, name in draw_members
    @{ kind } @{ name };
//% endfor
} skinbake_draw;
layout(std430, binding = 1) readonly buffer skinbake_Geometry { uint skinbake_geometry[]; };
layout(std430, binding = 2) readonly buffer skinbake_Joints { @{ motion_type } skinbake_joints[]; };
layout(std430, binding = 3) buffer skinbake_Posed { float skinbake_posed[]; };

//% if morphs != "none"
struct skinbake_Target {
    float weight;
    uint unused;
    uvec2 position; // @{ absent } in x: the target does not move it
    uvec2 normal;
    uvec2 tangent;
    uvec2 morph;
    uvec2 morph_up;
};
layout(std430, binding = 4) readonly buffer skinbake_Targets { skinbake_Target skinbake_targets[]; };

//% endif
uint skinbake_word(uvec2 place, uint vertex, uint number)
{
    return skinbake_geometry[(place.x + place.y * vertex) / 4u + number];
}

float skinbake_float(uvec2 place, uint vertex, uint number)
{
    return uintBitsToFloat(skinbake_word(place, vertex, number));
}

vec2 skinbake_vec2(uvec2 place, uint vertex)
{
    return vec2(skinbake_float(place, vertex, 0u), skinbake_float(place, vertex, 1u));
}

vec3 skinbake_vec3(uvec2 place, uint vertex)
{
    return vec3(skinbake_vec2(place, vertex), skinbake_float(place, vertex, 2u));
}

vec4 skinbake_vec4(uvec2 place, uint vertex)
{
    return vec4(skinbake_vec3(place, vertex), skinbake_float(place, vertex, 3u));
}

// NORMAL at length 1. If it has no direction, bake takes (0, 0, 1).
vec3 skinbake_normal(uvec2 place, uint vertex)
{
    vec3 stored = skinbake_vec3(place, vertex);
    return dot(stored, stored) > 0.0 ? normalize(stored) : vec3(0.0, 0.0, 1.0);
}

// Four whole numbers of 1, 2 or 4 bytes, by the size of one.
uvec4 skinbake_integers(uvec2 place, uint vertex, uint size)
{
    uint first = skinbake_word(place, vertex, 0u);
    if (size == 1u) {
        return (uvec4(first) >> uvec4(0u, 8u, 16u, 24u)) & 0xffu;
    }
    uint second = skinbake_word(place, vertex, 1u);
    if (size == 4u) {
        return uvec4(first, second, skinbake_word(place, vertex, 2u), skinbake_word(place, vertex, 3u));
    }
    return uvec4(first & 0xffffu, first >> 16u, second & 0xffffu, second >> 16u);
}

vec4 skinbake_weights(uvec2 place, uint vertex)
{
    if (skinbake_draw.weight_size == 4u) {
        return skinbake_vec4(place, vertex);
    }
    vec4 integers = vec4(skinbake_integers(place, vertex, skinbake_draw.weight_size));
    return integers / (skinbake_draw.weight_size == 1u ? 255.0 : 65535.0);
}

//% if decodes
vec4 skinbake_stored(uvec2 place, uint vertex)
{
//%   if encoding == "packed8"
    return unpackSnorm4x8(skinbake_word(place, vertex, 0u));
//%   else
    return vec4(unpackSnorm2x16(skinbake_word(place, vertex, 0u)),
            unpackSnorm2x16(skinbake_word(place, vertex, 1u)));
//%   endif
}

//% endif
void skinbake_put(uint offset, uint vertex, vec4 value, uint count)
{
    if (offset == @{ absent }u) {
        return;
    }
    uint at = (offset + skinbake_draw.posed_stride * vertex) / 4u;
    for (uint number = 0u; number < count; number++) {
        skinbake_posed[at + number] = value[number];
    }
}

void main()
{
    uint vertex = gl_GlobalInvocationID.x;
    if (vertex >= skinbake_draw.vertices) {
        return;
    }
//% for column in compute_reads
    @{ types[column.type] } @{ column.name } = @{ column.call };
//% endfor
    if (!(@{ is_bound })) {
        weights_0 = vec4(1.0, 0.0, 0.0, 0.0); // bound to slot 0, as bake takes it
    }
//% if morphs != "none"
//%   for sum in morphed
    @{ types[sum.type] } @{ sum.variable } = @{ sum.start };
//%   endfor
    for (uint number = 0u; number < skinbake_draw.targets; number++) {
        skinbake_Target moved = skinbake_targets[number];
//%   for sum in morphed
        if (moved.@{ sum.name }.x != @{ absent }u) {
            @{ sum.variable } += moved.weight * skinbake_@{ sum.type }(moved.@{ sum.name }, vertex);
        }
//%   endfor
    }
//% endif
    @{ motion_type } @{ motion_name }[@{ influences }];
//% for joint in slot_joints
    @{ motion_name }[@{ loop.index0 }] = skinbake_joints[@{ joint }];
//% endfor
//% if morphs == "none"
    skinbake_Frame frame = skinbake_frame(@{ "normal, tangent" if frame == "tangent" else "normal" });
//% else
    skinbake_Frame rest = skinbake_frame(@{ "normal, tangent" if frame == "tangent" else "normal" });
    skinbake_Frame frame = @{ morph_call };
//% endif
//% if scales_joints
    @{ arguments_of_compute[0] } *= skinbake_draw.joint_scale;
    frame.tangent *= skinbake_draw.joint_scale;
    frame.bitangent *= skinbake_draw.joint_scale;
//% endif
//% if decodes
    float scale = @{ scale if scale else "skinbake_draw.scale" };
//% endif
//% for line in preparations
    @{ types[line.type] } @{ line.name } = @{ line.call };
//% endfor
    skinbake_Vertex v = skinbake_@{ stem }(@{ arguments_of_compute | join(", ") });
    float side = dot(cross(v.tangent, v.bitangent), v.normal) < 0.0 ? -1.0 : 1.0;
    skinbake_put(skinbake_draw.posed_position, vertex, vec4(v.position, 0.0), 3u);
    skinbake_put(skinbake_draw.posed_normal, vertex, vec4(normalize(v.normal), 0.0), 3u);
    skinbake_put(skinbake_draw.posed_tangent, vertex, vec4(normalize(v.tangent), side), 4u);
}
