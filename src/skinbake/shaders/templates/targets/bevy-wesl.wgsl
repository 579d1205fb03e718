//% set target, dialect, bevy, first, asset = "bevy-wesl", "WESL", "0.20", 14, "skinbake.wesl"
//% from "bevy/choices.txt" import text, vertex_format, stored, joints with context
//% include "bevy/rust.txt"
import bevy_pbr::render::{
    forward_io::{Vertex, UncompressedVertex, VertexOutput, decompress_vertex},
    mesh_bindings::mesh,
    mesh_functions,
    skinning,
    view_transformations::position_world_to_clip,
};
@if(MORPH_TARGETS)
import bevy_pbr::render::morph;

@{ text.snippet }

// The vertex with the weighted deltas of the morph targets added.
@if(MORPH_TARGETS)
fn skinbake_morphed_vertex(rest: UncompressedVertex, instance_index: u32) -> UncompressedVertex {
    var morphed = rest;
    let index = rest.index - mesh[instance_index].first_vertex_index;
    let descriptor = mesh[instance_index].morph_descriptor_index;
    let layers = morph::layer_count(descriptor);
    for (var layer = 0u; layer < layers; layer++) {
        let weight = morph::weight_at(layer, descriptor);
        if (weight == 0.0) {
            continue;
        }
        @if(VERTEX_POSITIONS)
        morphed.position += weight * morph::morph_position(index, layer, descriptor);
        @if(VERTEX_NORMALS)
        morphed.normal += weight * morph::morph_normal(index, layer, descriptor);
        @if(VERTEX_TANGENTS)
        morphed.tangent += vec4<f32>(weight * morph::morph_tangent(index, layer, descriptor), 0.0);
    }
    return morphed;
}

// A joint matrix: in Bevy it leads from mesh space to the world.
@if(SKINBAKE)
fn skinbake_joint(joint: u32, instance_index: u32) -> mat4x4<f32> {
    @if(SKINS_USE_UNIFORM_BUFFERS)
    return skinning::joint_matrices.data[joint];
    @else
    return skinning::joint_matrices[mesh[instance_index].current_skin_index + joint];
}

//% include "bevy/unit.wgsl"
// The frame before skinning.
@if(SKINBAKE)
fn skinbake_unskinned_frame(rest: UncompressedVertex, morphed: UncompressedVertex) -> skinbake_Frame {
//% if frame == "tangent"
    let frame = skinbake_frame(skinbake_unit(rest.normal), rest.tangent);
//% else
    let frame = skinbake_frame(skinbake_unit(rest.normal));
//% endif
    @if(MORPH_TARGETS)
//% if text.morphs == "tangent"
    return skinbake_morphed_tangent_frame(frame, morphed.normal, morphed.tangent.xyz);
//% else
    return skinbake_morphed_frame(frame, morphed.normal);
//% endif
    @else
    return frame;
}

// The skinned vertex in the world.
@if(SKINBAKE)
fn skinbake_lit(
    vertex: UncompressedVertex,
    frame: skinbake_Frame,
    stored_alpha: @{ stored },
    stored_beta: @{ stored },
    instance_index: u32,
) -> skinbake_Vertex {
    let M = array<mat4x4<f32>, @{ influences }>(
//% for component in joints
        skinbake_joint(vertex.joint_indices.@{ component }, instance_index)@{ "," if not loop.last }
//% endfor
    );
    let position = vertex.position;
    let weights_0 = vertex.joint_weights;
//% for kind in ["alpha", "beta"]
    let @{ kind }_0 = @{ "skinbake_decoded(stored_%s, %s)" | format(kind, scale) if decodes else "stored_" ~ kind };
//% endfor
    return skinbake_@{ stem }(@{ arguments | join(", ") });
}

//% include "bevy/world_tangent.wgsl"
@{ "" }
// Bevy's own vertex, and the baked attributes at locations that it leaves free.
@vertex
fn vertex(
    compressed: Vertex,
    @if(SKINBAKE) @location(@{ first }) skinbake_alpha: @{ stored },
    @if(SKINBAKE) @location(@{ first + 1 }) skinbake_beta: @{ stored },
) -> VertexOutput {
    var out: VertexOutput;
    let instance_index = compressed.instance_index;
    let rest = decompress_vertex(compressed, instance_index);
    @if(MORPH_TARGETS)
    let moved = skinbake_morphed_vertex(rest, instance_index);
    @else
    let moved = rest;
    let node_world_from_local = mesh_functions::get_world_from_local(instance_index);
    @if(SKINNED)
    let world_from_local = skinning::skin_model(moved.joint_indices, moved.joint_weights, instance_index);
    @else
    let world_from_local = node_world_from_local;
    @if(SKINBAKE)
    let frame = skinbake_unskinned_frame(rest, moved);
    @if(SKINBAKE)
    let lit = skinbake_lit(moved, frame, skinbake_alpha, skinbake_beta, instance_index);

    // Bevy's own functions compute positions, so that they agree with prepasses and shadows.
    @if(VERTEX_POSITIONS)
    out.world_position = mesh_functions::mesh_position_local_to_world(world_from_local, vec4<f32>(moved.position, 1.0));
    @if(VERTEX_POSITIONS)
    out.position = position_world_to_clip(out.world_position.xyz);

    @if(VERTEX_NORMALS && SKINBAKE)
    out.world_normal = normalize(lit.normal);
    @if(VERTEX_NORMALS && SKINNED && !SKINBAKE)
    out.world_normal = skinning::skin_normals(world_from_local, moved.normal);
    @if(VERTEX_NORMALS && !SKINNED)
    out.world_normal = mesh_functions::mesh_normal_local_to_world(moved.normal, instance_index);

    @if(VERTEX_TANGENTS && SKINBAKE)
    out.world_tangent = skinbake_world_tangent(moved.tangent, frame, lit);
    @if(VERTEX_TANGENTS && !SKINBAKE)
    out.world_tangent = mesh_functions::mesh_tangent_local_to_world(world_from_local, moved.tangent, instance_index);

    @if(VERTEX_UVS_A)
    out.uv = moved.uv;
    @if(VERTEX_UVS_B)
    out.uv_b = moved.uv_b;
    @if(VERTEX_COLORS)
    out.color = moved.color;
    @if(VERTEX_OUTPUT_INSTANCE_INDEX)
    out.instance_index = instance_index;
    @if(VISIBILITY_RANGE_DITHER)
    out.visibility_range_dither = mesh_functions::get_visibility_range_dither_level(
        instance_index, node_world_from_local[3]);
    return out;
}
