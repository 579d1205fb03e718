cbuffer skinbake_Draw : register(b0) {
//% for kind, name in draw_members
    @{ kind } skinbake_draw_@{ name };
//% endfor
};
ByteAddressBuffer skinbake_geometry : register(t1);
StructuredBuffer<@{ "float4x4" if method == "lbs" else "float4" }> skinbake_joints : register(t2);
RWByteAddressBuffer skinbake_posed : register(u3);

//% if morphs != "none"
struct skinbake_Target {
    float weight;
    uint unused;
    uint2 position; // @{ absent } in x: the target does not move it
    uint2 normal;
    uint2 tangent;
    uint2 morph;
    uint2 morph_up;
};
StructuredBuffer<skinbake_Target> skinbake_targets : register(t4);

//% endif
uint skinbake_word(uint2 place, uint vertex, uint number)
{
    return skinbake_geometry.Load(place.x + place.y * vertex + 4u * number);
}

float skinbake_float(uint2 place, uint vertex, uint number)
{
    return asfloat(skinbake_word(place, vertex, number));
}

float2 skinbake_vec2(uint2 place, uint vertex)
{
    return float2(skinbake_float(place, vertex, 0u), skinbake_float(place, vertex, 1u));
}

float3 skinbake_vec3(uint2 place, uint vertex)
{
    return float3(skinbake_vec2(place, vertex), skinbake_float(place, vertex, 2u));
}

float4 skinbake_vec4(uint2 place, uint vertex)
{
    return float4(skinbake_vec3(place, vertex), skinbake_float(place, vertex, 3u));
}

// NORMAL at length 1. If it has no direction, bake takes (0, 0, 1).
float3 skinbake_normal(uint2 place, uint vertex)
{
    float3 stored = skinbake_vec3(place, vertex);
    return dot(stored, stored) > 0.0 ? normalize(stored) : float3(0.0, 0.0, 1.0);
}

// Four whole numbers of 1, 2 or 4 bytes, by the size of one.
uint4 skinbake_integers(uint2 place, uint vertex, uint size)
{
    uint first = skinbake_word(place, vertex, 0u);
    if (size == 1u) {
        return (first.xxxx >> uint4(0u, 8u, 16u, 24u)) & 0xffu;
    }
    uint second = skinbake_word(place, vertex, 1u);
    if (size == 4u) {
        return uint4(first, second, skinbake_word(place, vertex, 2u), skinbake_word(place, vertex, 3u));
    }
    return uint4(first & 0xffffu, first >> 16u, second & 0xffffu, second >> 16u);
}

float4 skinbake_weights(uint2 place, uint vertex)
{
    if (skinbake_draw_weight_size == 4u) {
        return skinbake_vec4(place, vertex);
    }
    float4 integers = float4(skinbake_integers(place, vertex, skinbake_draw_weight_size));
    return integers / (skinbake_draw_weight_size == 1u ? 255.0 : 65535.0);
}

//% if decodes
float4 skinbake_stored(uint2 place, uint vertex)
{
//%   if encoding == "packed8"
    int4 signs = int4(skinbake_integers(place, vertex, 1u) << 24u) >> 24u;
//%   else
    int4 signs = int4(skinbake_integers(place, vertex, 2u) << 16u) >> 16u;
//%   endif
    return max(float4(signs) / @{ limit }.0, -1.0);
}

//% endif
void skinbake_put(uint offset, uint vertex, float4 value, uint count)
{
    if (offset == @{ absent }u) {
        return;
    }
    for (uint number = 0u; number < count; number++) {
        skinbake_posed.Store(offset + skinbake_draw_posed_stride * vertex + 4u * number, asuint(value[number]));
    }
}

[numthreads(64, 1, 1)]
void main(uint3 id : SV_DispatchThreadID)
{
    uint vertex = id.x;
    if (vertex >= skinbake_draw_vertices) {
        return;
    }
//% for column in compute_reads
    @{ types[column.type] } @{ column.name } = @{ column.call | replace("skinbake_draw.", "skinbake_draw_") };
//% endfor
    if (!(@{ is_bound })) {
        weights_0 = float4(1.0, 0.0, 0.0, 0.0); // bound to slot 0, as bake takes it
    }
//% if morphs != "none"
//%   for sum in morphed
    @{ types[sum.type] } @{ sum.variable } = @{ sum.start };
//%   endfor
    for (uint number = 0u; number < skinbake_draw_targets; number++) {
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
//%   if method == "lbs"
    @{ motion_name }[@{ loop.index0 }] = skinbake_joints[@{ joint }];
//%   elif stem == "dqs_scaled"
    @{ motion_name }[@{ loop.index0 }].moved = float4x4(skinbake_joints[5 * @{ joint }], skinbake_joints[5 * @{ joint } + 1],
            skinbake_joints[5 * @{ joint } + 2], skinbake_joints[5 * @{ joint } + 3]);
    @{ motion_name }[@{ loop.index0 }].turn = skinbake_joints[5 * @{ joint } + 4];
//%   else
    @{ motion_name }[@{ loop.index0 }] = float2x4(skinbake_joints[2 * @{ joint }], skinbake_joints[2 * @{ joint } + 1]);
//%   endif
//% endfor
//% if morphs == "none"
    skinbake_Frame frame = skinbake_frame(@{ "normal, tangent" if frame == "tangent" else "normal" });
//% else
    skinbake_Frame rest = skinbake_frame(@{ "normal, tangent" if frame == "tangent" else "normal" });
    skinbake_Frame frame = @{ morph_call };
//% endif
//% if scales_joints
    @{ arguments_of_compute[0] } *= skinbake_draw_joint_scale;
    frame.tangent *= skinbake_draw_joint_scale;
    frame.bitangent *= skinbake_draw_joint_scale;
//% endif
//% if decodes
    float scale = @{ scale if scale else "skinbake_draw_scale" };
//% endif
//% for line in preparations
    @{ types[line.type] } @{ line.name } = @{ line.call };
//% endfor
//% if lighting == "direct"
    float3 a[@{ influences }];
    skinbake_gradients(@{ (["frame"] + gradient_params | map(attribute=1) | list + ["a"]) | join(", ") });
//% endif
    skinbake_Vertex v = skinbake_@{ stem }(@{ arguments_of_compute | join(", ") });
    float side = dot(cross(v.tangent, v.bitangent), v.normal) < 0.0 ? -1.0 : 1.0;
    skinbake_put(skinbake_draw_posed_position, vertex, float4(v.position, 0.0), 3u);
    skinbake_put(skinbake_draw_posed_normal, vertex, float4(normalize(v.normal), 0.0), 3u);
    skinbake_put(skinbake_draw_posed_tangent, vertex, float4(normalize(v.tangent), side), 4u);
}
