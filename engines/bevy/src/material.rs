//! The extended material, and the systems that give it to baked meshes.

use bevy::{
    asset::{AssetEvent, AssetId},
    log::{info, warn},
    mesh::MeshVertexBufferLayoutRef,
    pbr::{ExtendedMaterial, MaterialExtension, MaterialExtensionKey, MaterialExtensionPipeline},
    platform::collections::{HashMap, HashSet},
    prelude::*,
    render::render_resource::{AsBindGroup, RenderPipelineDescriptor, SpecializedMeshPipelineError},
    shader::ShaderRef,
};

use crate::{ALPHA, BETA, SkinbakeMesh, loading::NOT_BAKED};

const SHADER: &str = "embedded://skinbake_bevy/skinbake.wgsl";

/// The locations of α and β. Bevy's passes leave them free.
const LOCATIONS: [u32; 2] = [8, 9];

/// A `StandardMaterial` for baked meshes.
pub type SkinbakeMaterial = ExtendedMaterial<StandardMaterial, SkinbakeExtension>;

/// What the shader takes of a bake, one for all meshes of a file that share a material.
#[derive(Asset, AsBindGroup, Reflect, Clone, Copy, Debug, Default, PartialEq)]
pub struct SkinbakeExtension {
    /// The scale of the encoding, 1 for floats.
    #[uniform(100)]
    pub scale: f32,
    /// 1 if the frame of α and β is that of TANGENT, 0 if that of NORMAL alone.
    #[uniform(100)]
    pub has_tangent_frame: u32,
    /// WebGL 2 takes multiples of 16 bytes.
    #[uniform(100)]
    pub padding: Vec2,
}

impl MaterialExtension for SkinbakeExtension {
    fn vertex_shader() -> ShaderRef {
        SHADER.into()
    }

    fn prepass_vertex_shader() -> ShaderRef {
        SHADER.into()
    }

    fn deferred_vertex_shader() -> ShaderRef {
        SHADER.into()
    }

    fn specialize(
        _pipeline: &MaterialExtensionPipeline,
        descriptor: &mut RenderPipelineDescriptor,
        layout: &MeshVertexBufferLayoutRef,
        _key: MaterialExtensionKey<Self>,
    ) -> Result<(), SpecializedMeshPipelineError> {
        let vertex = &mut descriptor.vertex;
        // Shadows and depth have no normals, so nothing is to correct.
        let has = |name: &str| vertex.shader_defs.contains(&name.into());
        if has("SKINNED") && has("VERTEX_NORMALS") && layout.0.contains(ALPHA) && layout.0.contains(BETA) {
            let places = [ALPHA.at_shader_location(LOCATIONS[0]), BETA.at_shader_location(LOCATIONS[1])];
            vertex.buffers[0].attributes.extend(layout.0.get_layout(&places)?.attributes);
            vertex.shader_defs.push("SKINBAKE".into());
        }
        Ok(())
    }
}

/// The extension of each source material: one for all meshes and instances with the same bake.
#[derive(Resource, Default)]
pub struct Extended(HashMap<AssetId<StandardMaterial>, Vec<(SkinbakeExtension, Handle<SkinbakeMaterial>)>>);

/// Give baked meshes the extension of their material.
pub fn extend(
    mut commands: Commands,
    mut drawn: Query<(Entity, &mut SkinbakeMesh, &MeshMaterial3d<StandardMaterial>, &Mesh3d)>,
    layouts: Res<Assets<Mesh>>,
    sources: Res<Assets<StandardMaterial>>,
    mut extended: ResMut<Assets<SkinbakeMaterial>>,
    mut made: ResMut<Extended>,
) {
    for (entity, mut mesh, source, shape) in &mut drawn {
        if mesh.standard.is_some() {
            continue;
        }
        let (Some(base), Some(layout)) = (sources.get(&source.0), layouts.get(&shape.0)) else {
            continue;
        };
        // What only the render world has cannot be asked.
        let has = |kind| layout.try_contains_attribute(kind).unwrap_or(true);
        if !(has(ALPHA) && has(BETA)) {
            mesh.standard = Some("its mesh has lost alpha and beta since it was loaded".into());
            continue;
        }
        let known = made.0.entry(source.0.id()).or_default();
        let found = known.iter().find(|(bake, _)| *bake == mesh.bake).map(|(_, handle)| handle.clone());
        let handle = found.unwrap_or_else(|| {
            let handle = extended.add(ExtendedMaterial { base: base.clone(), extension: mesh.bake });
            known.push((mesh.bake, handle.clone()));
            handle
        });
        mesh.source = source.0.clone();
        commands.entity(entity).remove::<MeshMaterial3d<StandardMaterial>>().insert(MeshMaterial3d(handle));
    }
}

/// Carry changes of source materials over to their extensions.
pub fn follow(
    mut events: MessageReader<AssetEvent<StandardMaterial>>,
    sources: Res<Assets<StandardMaterial>>,
    mut extended: ResMut<Assets<SkinbakeMaterial>>,
    mut made: ResMut<Extended>,
) {
    for event in events.read() {
        match event {
            AssetEvent::Modified { id } => {
                for (_, handle) in made.0.get(id).into_iter().flatten() {
                    if let (Some(source), Some(mut material)) = (sources.get(*id), extended.get_mut(handle)) {
                        material.base = source.clone();
                    }
                }
            }
            AssetEvent::Removed { id } => {
                made.0.remove(id);
            }
            _ => {}
        }
    }
}

/// Log each mesh that stays standard, once for all of its instances.
pub fn report(
    meshes: Query<(NameOrEntity, &SkinbakeMesh, &Mesh3d), Changed<SkinbakeMesh>>,
    mut told: Local<HashSet<AssetId<Mesh>>>,
) {
    for (name, mesh, shape) in &meshes {
        let Some(reason) = &mesh.standard else { continue };
        if told.insert(shape.0.id()) {
            if reason == NOT_BAKED {
                info!("skinbake: {name} stays standard: {reason}");
            } else {
                warn!("skinbake: {name} stays standard: {reason}");
            }
        }
    }
}
