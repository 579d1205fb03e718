//% set target, dialect, bevy, first, asset = "bevy", "WGSL", "0.19", 8, "skinbake.wgsl"
//% from "bevy/choices.txt" import text, vertex_format, stored, joints with context
//% include "bevy/rust.txt"
#import bevy_pbr::{
    forward_io::VertexOutput,
    mesh_bindings::mesh,
    mesh_functions,
    skinning,
    view_transformations::position_world_to_clip,
}
#ifdef MORPH_TARGETS
#import bevy_pbr::morph
#endif

@{ text.snippet }

// The vertex as Bevy's forward pass has it, and the baked attributes at locations that it leaves free.
struct Vertex {
    @builtin(instance_index) instance_index: u32,
#ifdef VERTEX_POSITIONS
    @location(0) position: vec3<f32>,
#endif
#ifdef VERTEX_NORMALS
    @location(1) normal: vec3<f32>,
#endif
#ifdef VERTEX_UVS_A
    @location(2) uv: vec2<f32>,
#endif
#ifdef VERTEX_UVS_B
    @location(3) uv_b: vec2<f32>,
#endif
#ifdef VERTEX_TANGENTS
    @location(4) tangent: vec4<f32>,
#endif
#ifdef VERTEX_COLORS
    @location(5) color: vec4<f32>,
#endif
#ifdef SKINNED
    @location(6) joint_indices: vec4<u32>,
    @location(7) joint_weights: vec4<f32>,
#endif
#ifdef SKINBAKE
    @location(8) skinbake_alpha: @{ stored },
    @location(9) skinbake_beta: @{ stored },
#endif
#ifdef MORPH_TARGETS
    @builtin(vertex_index) index: u32,
#endif
}

#ifdef MORPH_TARGETS
// The vertex with the weighted deltas of the morph targets added.
fn skinbake_morphed_vertex(rest: Vertex, instance_index: u32) -> Vertex {
    var morphed = rest;
    let index = rest.index - mesh[instance_index].first_vertex_index;
    let layers = morph::layer_count(instance_index);
    for (var layer = 0u; layer < layers; layer++) {
        let weight = morph::weight_at(layer, instance_index);
        if (weight == 0.0) {
            continue;
        }
#ifdef VERTEX_POSITIONS
        morphed.position += weight * morph::morph_position(index, layer, instance_index);
#endif
#ifdef VERTEX_NORMALS
        morphed.normal += weight * morph::morph_normal(index, layer, instance_index);
#endif
#ifdef VERTEX_TANGENTS
        morphed.tangent += vec4<f32>(weight * morph::morph_tangent(index, layer, instance_index), 0.0);
#endif
    }
    return morphed;
}
#endif

#ifdef SKINBAKE
// A joint matrix: in Bevy it leads from mesh space to the world.
fn skinbake_joint(joint: u32, instance_index: u32) -> mat4x4<f32> {
#ifdef SKINS_USE_UNIFORM_BUFFERS
    return skinning::joint_matrices.data[joint];
#else
    return skinning::joint_matrices[mesh[instance_index].current_skin_index + joint];
#endif
}

//% include "bevy/unit.wgsl"
// The frame before skinning.
fn skinbake_unskinned_frame(rest: Vertex, morphed: Vertex) -> skinbake_Frame {
//% if frame == "tangent"
    let frame = skinbake_frame(skinbake_unit(rest.normal), rest.tangent);
//% else
    let frame = skinbake_frame(skinbake_unit(rest.normal));
//% endif
#ifdef MORPH_TARGETS
//% if text.morphs == "tangent"
    return skinbake_morphed_tangent_frame(frame, morphed.normal, morphed.tangent.xyz);
//% else
    return skinbake_morphed_frame(frame, morphed.normal);
//% endif
#else
    return frame;
#endif
}

// The skinned vertex in the world.
fn skinbake_lit(vertex: Vertex, frame: skinbake_Frame, instance_index: u32) -> skinbake_Vertex {
    let M = array<mat4x4<f32>, @{ influences }>(
//% for component in joints
        skinbake_joint(vertex.joint_indices.@{ component }, instance_index)@{ "," if not loop.last }
//% endfor
    );
    let position = vertex.position;
    let weights_0 = vertex.joint_weights;
//% for kind in ["alpha", "beta"]
    let @{ kind }_0 = @{ "skinbake_decoded(vertex.skinbake_%s, %s)" | format(kind, scale) if decodes else "vertex.skinbake_" ~ kind };
//% endfor
    return skinbake_@{ stem }(@{ arguments | join(", ") });
}

#ifdef VERTEX_TANGENTS
//% include "bevy/world_tangent.wgsl"
#endif
#endif

@vertex
fn vertex(rest: Vertex) -> VertexOutput {
    var out: VertexOutput;
    let instance_index = rest.instance_index;
#ifdef MORPH_TARGETS
    let vertex = skinbake_morphed_vertex(rest, instance_index);
#else
    let vertex = rest;
#endif
    let node_world_from_local = mesh_functions::get_world_from_local(instance_index);
#ifdef SKINNED
    let world_from_local = skinning::skin_model(vertex.joint_indices, vertex.joint_weights, instance_index);
#else
    let world_from_local = node_world_from_local;
#endif
#ifdef SKINBAKE
    let frame = skinbake_unskinned_frame(rest, vertex);
    let lit = skinbake_lit(vertex, frame, instance_index);
#endif

#ifdef VERTEX_POSITIONS
    // Bevy's own functions compute it, so that it agrees with prepasses and shadows.
    out.world_position = mesh_functions::mesh_position_local_to_world(world_from_local, vec4<f32>(vertex.position, 1.0));
    out.position = position_world_to_clip(out.world_position.xyz);
#endif

#ifdef VERTEX_NORMALS
#ifdef SKINBAKE
    out.world_normal = normalize(lit.normal);
#else
#ifdef SKINNED
    out.world_normal = skinning::skin_normals(world_from_local, vertex.normal);
#else
    out.world_normal = mesh_functions::mesh_normal_local_to_world(vertex.normal, instance_index);
#endif
#endif
#endif

#ifdef VERTEX_TANGENTS
#ifdef SKINBAKE
    out.world_tangent = skinbake_world_tangent(vertex.tangent, frame, lit);
#else
    out.world_tangent = mesh_functions::mesh_tangent_local_to_world(world_from_local, vertex.tangent, instance_index);
#endif
#endif

#ifdef VERTEX_UVS_A
    out.uv = vertex.uv;
#endif
#ifdef VERTEX_UVS_B
    out.uv_b = vertex.uv_b;
#endif
#ifdef VERTEX_COLORS
    out.color = vertex.color;
#endif
#ifdef VERTEX_OUTPUT_INSTANCE_INDEX
    out.instance_index = instance_index;
#endif
#ifdef VISIBILITY_RANGE_DITHER
    out.visibility_range_dither = mesh_functions::get_visibility_range_dither_level(
        instance_index, node_world_from_local[3]);
#endif
    return out;
}
