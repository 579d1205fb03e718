//! Accurate lighting for the skinned meshes of glTF files that skinbake has baked.
//!
//! ```no_run
//! # use bevy::prelude::*;
//! App::new()
//!     .add_plugins(DefaultPlugins)
//!     .add_plugins(skinbake_bevy::SkinbakePlugin);
//! ```
//!
//! Add the plugin after Bevy's own. Each mesh of a baked file that stays standard is named in the log, and its component
//! [`SkinbakeMesh`] says why.

mod loading;
mod material;

pub use loading::{ALPHA, BETA};
pub use material::{SkinbakeExtension, SkinbakeMaterial};

use bevy::{
    asset::embedded_asset,
    gltf::{GltfPlugin, extensions::GltfExtensionHandlers},
    pbr::{MaterialPlugin, StandardMaterial},
    prelude::*,
    tasks::block_on,
};
use material::{Extended, extend, follow, report};

/// Reads the bakes of glTF files, and lights their meshes by them. Add it after Bevy's own plugins.
pub struct SkinbakePlugin;

impl Plugin for SkinbakePlugin {
    fn build(&self, app: &mut App) {
        embedded_asset!(app, "skinbake.wgsl");
        let turns_meshes = app
            .get_added_plugins::<GltfPlugin>()
            .first()
            .is_some_and(|plugin| plugin.convert_coordinates.rotate_meshes);
        let reader = loading::Reader::new(turns_meshes);
        let handlers = app.world().get_resource::<GltfExtensionHandlers>();
        let handlers = handlers.expect("SkinbakePlugin comes after Bevy's GltfPlugin").0.clone();
        block_on(async { handlers.write().await.push(Box::new(reader)) });
        app.register_type::<SkinbakeMesh>()
            .init_resource::<Extended>()
            .add_plugins(MaterialPlugin::<SkinbakeMaterial>::default())
            .add_systems(PostUpdate, (extend, follow, report).chain());
    }
}

/// How a mesh of a file with a bake is lit: the report of this crate. Every primitive of a skinned mesh has one.
#[derive(Component, Reflect, Clone, Debug, Default)]
#[reflect(Component)]
pub struct SkinbakeMesh {
    /// Why the mesh has Bevy's own lighting; `None` if it has the accurate one.
    pub standard: Option<String>,
    /// What the shader takes of the bake.
    pub bake: SkinbakeExtension,
    /// The material of the file. The mesh draws with an extension of it, which follows its changes.
    pub source: Handle<StandardMaterial>,
}
