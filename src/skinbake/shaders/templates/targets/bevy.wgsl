//% if method == "dqs"
//%   set _ = refuse("method", "Bevy blends joint matrices; use --method lbs")
//% elif lighting == "standard"
//%   set _ = refuse("lighting", "standard lighting is Bevy's own; use --lighting accurate")
//% elif lighting == "direct"
//%   set _ = refuse("lighting", "use --lighting accurate")
//% elif influences > 4
//%   set _ = refuse("influences", "Bevy reads four influences per vertex, not " ~ influences ~ "; bake with --limit-influences 4")
//% elif influences < 4
//%   set _ = refuse("influences", "a shader of Bevy always reads four influences per vertex; use --influences 4")
//% elif moves_frame
//%   set _ = refuse("morphs", "Bevy has no place for the numbers of --morph-frames; use --morphs normal")
//% endif
//# Joint matrices lead to the world in Bevy: they mirror wherever an entity above them does.
//% set text = text_for(reads=["packed8"], morphs="normal", frame="tangent", encoding="packed8", layout="attributes", attributes=None, also=["frame_normal"], mirrored_joints=True)
// Accurate lighting in Bevy 0.19 for skinned meshes that skinbake has baked: the vertex stage of the forward pass and of
// the prepass, which shadows, screen-space effects and deferred rendering use.
//
// Written by skinbake @{ version }:
//     @{ command }
//
// One shader serves all characters: the crate skinbake-bevy, which embeds it, reads frame, encoding and scale from the
// file. Meshes without a bake, and shadows, are as Bevy's own shaders draw them.
//
// Algorithm 3 of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned
// Models", Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. The numbers beside the lines
// come from its supplement. Frame: T. Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.

#import bevy_pbr::{
    mesh_bindings::mesh,
    mesh_functions,
    skinning,
    view_transformations::position_world_to_clip,
}
#ifdef MORPH_TARGETS
#import bevy_pbr::morph
#endif
#ifdef PREPASS_PIPELINE
#import bevy_pbr::prepass_io::{Vertex, VertexOutput}
#else
#import bevy_pbr::forward_io::{Vertex, VertexOutput}
#endif

#ifdef SKINBAKE
struct skinbake_Bake {
    // The scale of the encoding, 1.0 for floats.
    scale: f32,
    // 1: t0 and b0 come from TANGENT, 0: from NORMAL alone.
    has_tangent_frame: u32,
    // WebGL 2 takes multiples of 16 bytes.
    padding: vec2<f32>,
}
@group(#{MATERIAL_BIND_GROUP}) @binding(100) var<uniform> skinbake_bake: skinbake_Bake;

//% for name, part in text.parts.items()
@{ part | replace("fn skinbake_frame(n: vec3<f32>)", "fn skinbake_normal_frame(n: vec3<f32>)") }

//% endfor
// A joint matrix: in Bevy it leads from mesh space to the world.
fn skinbake_joint(joint: u32, instance_index: u32) -> mat4x4<f32> {
#ifdef SKINS_USE_UNIFORM_BUFFERS
    return skinning::joint_matrices.data[joint];
#else
    return skinning::joint_matrices[mesh[instance_index].current_skin_index + joint];
#endif
}

// The frame before skinning. If NORMAL has no direction, bake takes (0, 0, 1).
fn skinbake_unskinned_frame(rest: Vertex, morphed: Vertex) -> skinbake_Frame {
    let normal = select(vec3<f32>(0.0, 0.0, 1.0), normalize(rest.normal), dot(rest.normal, rest.normal) > 0.0);
    var frame = skinbake_normal_frame(normal);
#ifdef VERTEX_TANGENTS
    if (skinbake_bake.has_tangent_frame != 0u) {
        frame = skinbake_frame(normal, rest.tangent);
    }
#endif
#ifdef MORPH_TARGETS
    frame = skinbake_morphed_frame(frame, morphed.normal);
#endif
    return frame;
}

// The skinned vertex in the world. alpha and beta have w = 1 if they are floats.
fn skinbake_lit(
    vertex: Vertex,
    frame: skinbake_Frame,
    alpha: vec4<f32>,
    beta: vec4<f32>,
    instance_index: u32,
) -> skinbake_Vertex {
    let M = array<mat4x4<f32>, 4>(
        skinbake_joint(vertex.joint_indices.x, instance_index),
        skinbake_joint(vertex.joint_indices.y, instance_index),
        skinbake_joint(vertex.joint_indices.z, instance_index),
        skinbake_joint(vertex.joint_indices.w, instance_index),
    );
    let along_tangent = skinbake_decoded(alpha, skinbake_bake.scale);
    let along_bitangent = skinbake_decoded(beta, skinbake_bake.scale);
    return skinbake_lbs_accurate(vertex.position, frame, M, vertex.joint_weights, along_tangent, along_bitangent);
}

#ifdef VERTEX_TANGENTS
// The mesh's tangent in the world. It moves with t0 and b0, which span it.
fn skinbake_world_tangent(tangent: vec4<f32>, frame: skinbake_Frame, lit: skinbake_Vertex) -> vec4<f32> {
    let along = dot(tangent.xyz, frame.tangent) * lit.tangent + dot(tangent.xyz, frame.bitangent) * lit.bitangent;
    // A mirror turns the handedness round.
    let side = dot(cross(lit.tangent, lit.bitangent), lit.normal) * frame.handedness;
    return vec4<f32>(normalize(along), select(tangent.w, -tangent.w, side < 0.0));
}
#endif
#endif

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
        morphed.position += weight * morph::morph_position(index, layer, instance_index);
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

#ifdef MOTION_VECTOR_PREPASS
// Where the vertex was in the last frame.
fn skinbake_previous_position(rest: Vertex, instance_index: u32) -> vec4<f32> {
    var position = rest.position;
#ifdef MORPH_TARGETS
#ifdef HAS_PREVIOUS_MORPH
    let index = rest.index - mesh[instance_index].first_vertex_index;
    let layers = morph::layer_count(instance_index);
    for (var layer = 0u; layer < layers; layer++) {
        let weight = morph::prev_weight_at(layer, instance_index);
        if (weight != 0.0) {
            position += weight * morph::morph_position(index, layer, instance_index);
        }
    }
#endif
#endif
    var world_from_local = mesh_functions::get_previous_world_from_local(instance_index);
#ifdef SKINNED
#ifdef HAS_PREVIOUS_SKIN
    world_from_local = skinning::skin_prev_model(rest.joint_indices, rest.joint_weights, instance_index);
#endif
#endif
    return mesh_functions::mesh_position_local_to_world(world_from_local, vec4<f32>(position, 1.0));
}
#endif

// Bevy's own vertex, and the baked attributes at locations that its passes leave free.
@vertex
fn vertex(
    rest: Vertex,
#ifdef SKINBAKE
    @location(8) alpha: vec4<f32>,
    @location(9) beta: vec4<f32>,
#endif
) -> VertexOutput {
    var out: VertexOutput;
    let instance_index = rest.instance_index;
#ifdef MORPH_TARGETS
    let moved = skinbake_morphed_vertex(rest, instance_index);
#else
    let moved = rest;
#endif
    let node_world_from_local = mesh_functions::get_world_from_local(instance_index);
#ifdef SKINNED
    let world_from_local = skinning::skin_model(moved.joint_indices, moved.joint_weights, instance_index);
#else
    let world_from_local = node_world_from_local;
#endif

    // Bevy's own functions compute positions, so that all passes agree.
    out.world_position = mesh_functions::mesh_position_local_to_world(world_from_local, vec4<f32>(moved.position, 1.0));
    out.position = position_world_to_clip(out.world_position.xyz);
#ifdef UNCLIPPED_DEPTH_ORTHO_EMULATION
    out.unclipped_depth = out.position.z;
    out.position.z = min(out.position.z, 1.0);
#endif
#ifdef MOTION_VECTOR_PREPASS
    out.previous_world_position = skinbake_previous_position(rest, instance_index);
#endif

#ifdef SKINBAKE
    let frame = skinbake_unskinned_frame(rest, moved);
    let lit = skinbake_lit(moved, frame, alpha, beta, instance_index);
    out.world_normal = normalize(lit.normal);
#ifdef VERTEX_TANGENTS
    out.world_tangent = skinbake_world_tangent(moved.tangent, frame, lit);
#endif
#else
#ifdef VERTEX_NORMALS
#ifdef SKINNED
    out.world_normal = skinning::skin_normals(world_from_local, moved.normal);
#else
    out.world_normal = mesh_functions::mesh_normal_local_to_world(moved.normal, instance_index);
#endif
#endif
#ifdef VERTEX_TANGENTS
    out.world_tangent = mesh_functions::mesh_tangent_local_to_world(world_from_local, moved.tangent, instance_index);
#endif
#endif

#ifdef VERTEX_UVS_A
    out.uv = moved.uv;
#endif
#ifdef VERTEX_UVS_B
    out.uv_b = moved.uv_b;
#endif
#ifdef VERTEX_COLORS
    out.color = moved.color;
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
