//% if method != "lbs"
//%   set _ = refuse("--target bevy: Bevy blends joint matrices; use --method lbs")
//% elif lighting == "approximated"
//%   set _ = refuse("--target bevy: approximated lighting is Bevy's own and needs no shader; use --lighting accurate or direct")
//% elif influences > 4
//%   set _ = refuse("--target bevy: Bevy reads four influences per vertex, not " ~ influences ~ "; bake with --limit-influences 4")
//% elif influences < 2
//%   set _ = refuse("--target bevy: one influence needs no shader, Bevy lights it correctly; use --influences 4")
//% elif assembles
//%   set _ = refuse("--target bevy: Bevy reads two sets of texture coordinates, but alpha and beta need " ~ pairs | length ~ "; bake with --layout attributes")
//% elif decodes and not scale
//%   set _ = refuse("--target bevy: " ~ encoding ~ " needs the scale of the baked file; give --for BAKED_FILE")
//% endif
//% set text = text_for(reads=["snorm16", "packed8"], morphs="tangent" if morphs == "tangent" else "normal")
//% set vertex_format = {"float32": "Float32x3", "snorm16": "Snorm16x4", "packed8": "Snorm8x4"}[encoding]
//% set stored = types.vec4 if decodes else types.vec3
//% set joints = ["x", "y", "z", "w"][:influences]
@{ text.header }
// For Bevy 0.19: the vertex stage of a material extension. Bevy's own modules compute everything except the
// normals and tangents of baked meshes. A mesh without a bake may have the same material. Bevy then lights it.
// Deferred rendering and the normal prepass (for screen-space effects) run Bevy's prepass shader, and see its
// normals.
//% if decodes
// The scale of alpha and beta is a constant here: a file with another scale needs a shader of its own.
//% endif
//
@{ text.inputs }
//
// Rust for the application, in the lines that begin with "//rs":
//     sed -n 's|^//rs ||p; s|^//rs$||p' skinbake.wgsl > src/skinbake.rs
//
//rs //! Corrected lighting for baked skinned meshes, for Bevy 0.19.
//rs //!
//rs //! ```ignore
//rs //! App::new()
//rs //!     .add_plugins(DefaultPlugins.set(skinbake::gltf_plugin()))
//rs //!     .add_plugins(MaterialPlugin::<skinbake::SkinbakeMaterial>::default())
//rs //!     .add_systems(Update, skinbake::extend_materials)
//rs //! ```
//rs
//rs use bevy::{
//rs     gltf::GltfPlugin,
//rs     mesh::{skinning::SkinnedMesh, MeshVertexAttribute, MeshVertexBufferLayoutRef},
//rs     pbr::{ExtendedMaterial, MaterialExtension, MaterialExtensionKey, MaterialExtensionPipeline},
//rs     prelude::*,
//rs     reflect::TypePath,
//rs     render::render_resource::{
//rs         AsBindGroup, RenderPipelineDescriptor, SpecializedMeshPipelineError, VertexFormat,
//rs     },
//rs     shader::ShaderRef,
//rs };
//rs
//rs /// The path of the WGSL file in the folder of assets.
//rs const SHADER: &str = "shaders/skinbake.wgsl";
//rs
//rs // The numbers are arbitrary: no other attribute may have them.
//rs pub const ALPHA: MeshVertexAttribute =
//rs     MeshVertexAttribute::new("SkinbakeAlpha", 0x736b_696e_0001, VertexFormat::@{ vertex_format });
//rs pub const BETA: MeshVertexAttribute =
//rs     MeshVertexAttribute::new("SkinbakeBeta", 0x736b_696e_0002, VertexFormat::@{ vertex_format });
//rs
//rs /// The glTF loader with the baked attributes. It knows them without their leading underscore. It ignores
//rs /// attributes that are stored in another format.
//% if frame == "normal"
//rs /// Leave its conversion of coordinates off: alpha and beta do not follow when it turns NORMAL.
//% endif
//rs pub fn gltf_plugin() -> GltfPlugin {
//rs     GltfPlugin::default()
//rs         .add_custom_vertex_attribute("@{ sets[0].alpha_name[1:] }", ALPHA)
//rs         .add_custom_vertex_attribute("@{ sets[0].beta_name[1:] }", BETA)
//rs }
//rs
//rs pub type SkinbakeMaterial = ExtendedMaterial<StandardMaterial, Skinbake>;
//rs
//rs #[derive(Asset, AsBindGroup, TypePath, Debug, Clone, Default)]
//rs pub struct Skinbake {}
//rs
//rs impl MaterialExtension for Skinbake {
//rs     fn vertex_shader() -> ShaderRef {
//rs         SHADER.into()
//rs     }
//rs
//rs     fn specialize(
//rs         _pipeline: &MaterialExtensionPipeline,
//rs         descriptor: &mut RenderPipelineDescriptor,
//rs         layout: &MeshVertexBufferLayoutRef,
//rs         _key: MaterialExtensionKey<Self>,
//rs     ) -> Result<(), SpecializedMeshPipelineError> {
//rs         let needed = [
//rs             ALPHA,
//rs             BETA,
//rs             Mesh::ATTRIBUTE_NORMAL,
//% if frame == "tangent"
//rs             Mesh::ATTRIBUTE_TANGENT,
//% endif
//rs             Mesh::ATTRIBUTE_JOINT_INDEX,
//rs             Mesh::ATTRIBUTE_JOINT_WEIGHT,
//rs         ];
//rs         if !needed.iter().all(|attribute| layout.0.contains(*attribute)) {
//rs             return Ok(()); // not baked: Bevy's own normals
//rs         }
//rs         // Bevy's attributes are in place, and all lie in one buffer. Shadows and prepasses come by here
//rs         // too: their locations 8 and 9 are free as well, and they read neither.
//rs         let baked = layout
//rs             .0
//rs             .get_layout(&[ALPHA.at_shader_location(8), BETA.at_shader_location(9)])?;
//rs         let vertex = &mut descriptor.vertex;
//rs         vertex.buffers[0].attributes.extend(baked.attributes);
//rs         vertex.shader_defs.push("SKINBAKE".into());
//rs         Ok(())
//rs     }
//rs }
//rs
//rs /// Give the skinned meshes of a loaded scene the extended material.
//rs pub fn extend_materials(
//rs     mut commands: Commands,
//rs     meshes: Query<(Entity, &MeshMaterial3d<StandardMaterial>), With<SkinnedMesh>>,
//rs     standard: Res<Assets<StandardMaterial>>,
//rs     mut extended: ResMut<Assets<SkinbakeMaterial>>,
//rs ) {
//rs     for (entity, material) in &meshes {
//rs         if let Some(base) = standard.get(&material.0) {
//rs             let handle = extended.add(ExtendedMaterial {
//rs                 base: base.clone(),
//rs                 extension: Skinbake::default(),
//rs             });
//rs             commands
//rs                 .entity(entity)
//rs                 .remove::<MeshMaterial3d<StandardMaterial>>()
//rs                 .insert(MeshMaterial3d(handle));
//rs         }
//rs     }
//rs }

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

// A normal of length 1. If NORMAL has no direction, bake takes (0, 0, 1).
fn skinbake_unit(normal: vec3<f32>) -> vec3<f32> {
    return select(vec3<f32>(0.0, 0.0, 1.0), normalize(normal), dot(normal, normal) > 0.0);
}

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
// The mesh's tangent in the world. It moves with t0 and b0, which span it.
fn skinbake_world_tangent(tangent: vec4<f32>, frame: skinbake_Frame, lit: skinbake_Vertex) -> vec4<f32> {
    let along = dot(tangent.xyz, frame.tangent) * lit.tangent + dot(tangent.xyz, frame.bitangent) * lit.bitangent;
//% if mirrored_joints or lighting == "direct"
    // A mirror turns the handedness round.
    let side = dot(cross(lit.tangent, lit.bitangent), lit.normal) * frame.handedness;
    return vec4<f32>(normalize(along), select(tangent.w, -tangent.w, side < 0.0));
//% else
    return vec4<f32>(normalize(along), tangent.w);
//% endif
}
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
