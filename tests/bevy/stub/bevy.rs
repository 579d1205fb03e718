//! What the Rust lines of the Bevy target name of Bevy 0.19: the same paths, names and signatures, and bodies
//! that do just enough for `check.rs` to see what `specialize` does to a pipeline.

pub mod log {
    #[macro_export]
    macro_rules! warn_ {
        ($($words:tt)*) => { eprintln!("WARN {}", format_args!($($words)*)) };
    }
    pub use crate::warn_ as warn;
}

pub mod app {
    pub struct App;
    pub struct Update;
    pub trait Plugins<M> {}
    pub trait Plugin {}
    pub struct PluginGroupBuilder;
    pub trait PluginGroup: Sized {
        fn set<T: Plugin>(self, _plugin: T) -> PluginGroupBuilder {
            PluginGroupBuilder
        }
    }
    pub struct DefaultPlugins;
    impl PluginGroup for DefaultPlugins {}
    impl Plugins<()> for PluginGroupBuilder {}
    impl<T: Plugin> Plugins<u8> for T {}

    impl App {
        pub fn new() -> App {
            App
        }
        pub fn add_plugins<M>(&mut self, _plugins: impl Plugins<M>) -> &mut Self {
            self
        }
        pub fn add_systems<M>(
            &mut self,
            _schedule: Update,
            _systems: impl crate::ecs::IntoScheduleConfigs<M>,
        ) -> &mut Self {
            self
        }
    }
}

pub mod asset {
    pub use bevy_derive::Asset;

    use std::marker::PhantomData;

    pub trait VisitAssetDependencies {}
    pub trait Asset:
        VisitAssetDependencies + crate::reflect::TypePath + Send + Sync + 'static
    {
    }

    #[derive(Clone, Debug)]
    pub struct Handle<A: Asset>(pub PhantomData<A>);
    pub struct AssetId<A: Asset>(pub PhantomData<A>);
    impl<A: Asset> From<&Handle<A>> for AssetId<A> {
        fn from(_: &Handle<A>) -> Self {
            AssetId(PhantomData)
        }
    }

    pub struct Assets<A: Asset>(pub Vec<A>);
    impl<A: Asset> Assets<A> {
        pub fn add(&mut self, asset: impl Into<A>) -> Handle<A> {
            self.0.push(asset.into());
            Handle(PhantomData)
        }
        pub fn get(&self, _id: impl Into<AssetId<A>>) -> Option<&A> {
            self.0.first()
        }
    }
}

pub mod ecs {
    use std::marker::PhantomData;
    use std::ops::{Deref, DerefMut};

    use crate::pbr::{Material, MeshMaterial3d};

    #[derive(Clone, Copy, Debug)]
    pub struct Entity;
    pub trait Component: Send + Sync + 'static {}
    pub trait Bundle {}
    impl<C: Component> Bundle for C {}
    pub struct With<C>(PhantomData<C>);

    pub trait SystemParam {}
    impl SystemParam for Commands<'_, '_> {}
    impl<D, F> SystemParam for Query<'_, '_, D, F> {}
    impl<R> SystemParam for Res<'_, R> {}
    impl<R> SystemParam for ResMut<'_, R> {}

    pub trait IntoScheduleConfigs<M> {}
    impl<S, A, B, C, D> IntoScheduleConfigs<fn(A, B, C, D)> for S
    where
        S: Fn(A, B, C, D),
        A: SystemParam,
        B: SystemParam,
        C: SystemParam,
        D: SystemParam,
    {
    }

    pub struct Commands<'w, 's>(PhantomData<(&'w (), &'s ())>);
    pub struct EntityCommands<'a>(PhantomData<&'a ()>);
    impl Commands<'_, '_> {
        pub fn entity(&mut self, _entity: Entity) -> EntityCommands<'_> {
            EntityCommands(PhantomData)
        }
    }
    impl EntityCommands<'_> {
        pub fn insert(&mut self, _bundle: impl Bundle) -> &mut Self {
            self
        }
        pub fn remove<B: Bundle>(&mut self) -> &mut Self {
            self
        }
    }

    pub struct Query<'w, 's, D, F = ()>(PhantomData<(&'w (), &'s (), D, F)>);
    impl<'a, 'q, M: Material, C: Component> IntoIterator
        for &'a Query<'_, '_, (Entity, &'q MeshMaterial3d<M>), With<C>>
    {
        type Item = (Entity, &'a MeshMaterial3d<M>);
        type IntoIter = std::vec::IntoIter<Self::Item>;
        fn into_iter(self) -> Self::IntoIter {
            Vec::new().into_iter()
        }
    }

    pub struct Res<'w, R>(&'w R);
    impl<R> Deref for Res<'_, R> {
        type Target = R;
        fn deref(&self) -> &R {
            self.0
        }
    }
    pub struct ResMut<'w, R>(&'w mut R);
    impl<R> Deref for ResMut<'_, R> {
        type Target = R;
        fn deref(&self) -> &R {
            self.0
        }
    }
    impl<R> DerefMut for ResMut<'_, R> {
        fn deref_mut(&mut self) -> &mut R {
            self.0
        }
    }
}

pub mod gltf {
    use crate::mesh::MeshVertexAttribute;

    #[derive(Default)]
    pub struct GltfPlugin {
        pub custom_vertex_attributes: Vec<(Box<str>, MeshVertexAttribute)>,
    }
    impl GltfPlugin {
        pub fn add_custom_vertex_attribute(
            mut self,
            name: &str,
            attribute: MeshVertexAttribute,
        ) -> Self {
            self.custom_vertex_attributes.push((name.into(), attribute));
            self
        }
    }
    impl crate::app::Plugin for GltfPlugin {}
}

pub mod mesh {
    use std::sync::Arc;

    use crate::render::render_resource::VertexFormat;

    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct MeshVertexAttribute {
        pub name: &'static str,
        pub id: MeshVertexAttributeId,
        pub format: VertexFormat,
    }
    #[derive(Debug, Copy, Clone, PartialEq, Eq)]
    pub struct MeshVertexAttributeId(u64);
    impl From<MeshVertexAttribute> for MeshVertexAttributeId {
        fn from(value: MeshVertexAttribute) -> Self {
            value.id
        }
    }
    impl MeshVertexAttribute {
        pub const fn new(name: &'static str, id: u64, format: VertexFormat) -> Self {
            Self {
                name,
                id: MeshVertexAttributeId(id),
                format,
            }
        }
        pub const fn at_shader_location(&self, shader_location: u32) -> VertexAttributeDescriptor {
            VertexAttributeDescriptor {
                shader_location,
                id: self.id,
            }
        }
    }
    pub struct VertexAttributeDescriptor {
        pub shader_location: u32,
        pub id: MeshVertexAttributeId,
    }

    #[derive(Debug, Clone, PartialEq)]
    pub struct VertexAttribute {
        pub format: VertexFormat,
        pub offset: u64,
        pub shader_location: u32,
    }
    #[derive(Debug, Clone, PartialEq)]
    pub struct VertexBufferLayout {
        pub array_stride: u64,
        pub attributes: Vec<VertexAttribute>,
    }
    #[derive(Debug)]
    pub struct MissingVertexAttributeError;

    pub struct MeshVertexBufferLayoutRef(pub Arc<MeshVertexBufferLayout>);
    pub struct MeshVertexBufferLayout {
        pub attributes: Vec<MeshVertexAttribute>,
    }
    impl MeshVertexBufferLayout {
        pub fn contains(&self, attribute_id: impl Into<MeshVertexAttributeId>) -> bool {
            let wanted = attribute_id.into();
            self.attributes
                .iter()
                .any(|attribute| attribute.id == wanted)
        }
        pub fn get_layout(
            &self,
            attribute_descriptors: &[VertexAttributeDescriptor],
        ) -> Result<VertexBufferLayout, MissingVertexAttributeError> {
            let mut offset = 0;
            let mut places = Vec::new();
            for attribute in &self.attributes {
                places.push((attribute, offset));
                offset += attribute.format.size();
            }
            let mut attributes = Vec::new();
            for wanted in attribute_descriptors {
                let place = places.iter().find(|place| place.0.id == wanted.id);
                let (attribute, offset) = place.ok_or(MissingVertexAttributeError)?;
                attributes.push(VertexAttribute {
                    format: attribute.format,
                    offset: *offset,
                    shader_location: wanted.shader_location,
                });
            }
            Ok(VertexBufferLayout {
                array_stride: offset,
                attributes,
            })
        }
    }

    pub struct Mesh;
    impl Mesh {
        pub const ATTRIBUTE_POSITION: MeshVertexAttribute =
            MeshVertexAttribute::new("Vertex_Position", 0, VertexFormat::Float32x3);
        pub const ATTRIBUTE_NORMAL: MeshVertexAttribute =
            MeshVertexAttribute::new("Vertex_Normal", 1, VertexFormat::Float32x3);
        pub const ATTRIBUTE_TANGENT: MeshVertexAttribute =
            MeshVertexAttribute::new("Vertex_Tangent", 4, VertexFormat::Float32x4);
        pub const ATTRIBUTE_JOINT_WEIGHT: MeshVertexAttribute =
            MeshVertexAttribute::new("Vertex_JointWeight", 6, VertexFormat::Float32x4);
        pub const ATTRIBUTE_JOINT_INDEX: MeshVertexAttribute =
            MeshVertexAttribute::new("Vertex_JointIndex", 7, VertexFormat::Uint16x4);
    }

    pub mod skinning {
        pub struct SkinnedMesh;
        impl crate::ecs::Component for SkinnedMesh {}
    }
}

pub mod pbr {
    use std::marker::PhantomData;

    use crate::asset::{Asset, Handle, VisitAssetDependencies};
    use crate::mesh::MeshVertexBufferLayoutRef;
    use crate::reflect::TypePath;
    use crate::render::render_resource::{
        AsBindGroup, RenderPipelineDescriptor, SpecializedMeshPipelineError,
    };
    use crate::shader::ShaderRef;

    pub trait Material: Asset + AsBindGroup + Clone + Sized {}

    #[derive(Clone, Debug)]
    pub struct StandardMaterial;
    impl VisitAssetDependencies for StandardMaterial {}
    impl TypePath for StandardMaterial {}
    impl Asset for StandardMaterial {}
    impl AsBindGroup for StandardMaterial {
        type Data = ();
    }
    impl Material for StandardMaterial {}

    pub struct MeshMaterial3d<M: Material>(pub Handle<M>);
    impl<M: Material> crate::ecs::Component for MeshMaterial3d<M> {}

    pub struct MaterialExtensionPipeline;
    pub struct MaterialExtensionKey<E: MaterialExtension> {
        pub bind_group_data: E::Data,
    }
    pub trait MaterialExtension: Asset + AsBindGroup + Clone + Sized {
        fn vertex_shader() -> ShaderRef {
            ShaderRef::Default
        }
        #[allow(unused_variables)]
        fn specialize(
            pipeline: &MaterialExtensionPipeline,
            descriptor: &mut RenderPipelineDescriptor,
            layout: &MeshVertexBufferLayoutRef,
            key: MaterialExtensionKey<Self>,
        ) -> Result<(), SpecializedMeshPipelineError> {
            Ok(())
        }
    }

    #[derive(Clone, Debug)]
    pub struct ExtendedMaterial<B: Material, E: MaterialExtension> {
        pub base: B,
        pub extension: E,
    }
    impl<B: Material, E: MaterialExtension> VisitAssetDependencies for ExtendedMaterial<B, E> {}
    impl<B: Material, E: MaterialExtension> TypePath for ExtendedMaterial<B, E> {}
    impl<B: Material, E: MaterialExtension> Asset for ExtendedMaterial<B, E> {}
    impl<B: Material, E: MaterialExtension> AsBindGroup for ExtendedMaterial<B, E> {
        type Data = (B::Data, E::Data);
    }
    impl<B: Material, E: MaterialExtension> Material for ExtendedMaterial<B, E> {}

    pub struct MaterialPlugin<M: Material>(PhantomData<M>);
    impl<M: Material> Default for MaterialPlugin<M> {
        fn default() -> Self {
            Self(PhantomData)
        }
    }
    impl<M: Material> crate::app::Plugin for MaterialPlugin<M> {}
}

pub mod reflect {
    pub use bevy_derive::TypePath;

    pub trait TypePath: 'static {}
}

pub mod render {
    pub mod render_resource {
        pub use bevy_derive::AsBindGroup;

        use crate::mesh::{MissingVertexAttributeError, VertexBufferLayout};
        use crate::shader::ShaderDefVal;

        pub trait AsBindGroup {
            type Data;
        }

        #[derive(Debug, Clone, Copy, PartialEq)]
        pub enum VertexFormat {
            Float32x3,
            Float32x4,
            Uint16x4,
            Snorm8x4,
            Snorm16x4,
        }
        impl VertexFormat {
            pub fn size(&self) -> u64 {
                match self {
                    VertexFormat::Float32x3 => 12,
                    VertexFormat::Float32x4 => 16,
                    VertexFormat::Uint16x4 => 8,
                    VertexFormat::Snorm8x4 => 4,
                    VertexFormat::Snorm16x4 => 8,
                }
            }
        }

        #[derive(Debug, Clone, PartialEq)]
        pub struct VertexState {
            pub shader_defs: Vec<ShaderDefVal>,
            pub buffers: Vec<VertexBufferLayout>,
        }
        #[derive(Debug, Clone, PartialEq)]
        pub struct RenderPipelineDescriptor {
            pub vertex: VertexState,
        }

        #[derive(Debug)]
        pub enum SpecializedMeshPipelineError {
            MissingVertexAttribute(MissingVertexAttributeError),
        }
        impl From<MissingVertexAttributeError> for SpecializedMeshPipelineError {
            fn from(error: MissingVertexAttributeError) -> Self {
                Self::MissingVertexAttribute(error)
            }
        }
    }
}

pub mod shader {
    pub enum ShaderRef {
        Default,
        Path(String),
    }
    impl From<&'static str> for ShaderRef {
        fn from(path: &'static str) -> Self {
            Self::Path(path.into())
        }
    }

    #[derive(Debug, Clone, PartialEq)]
    pub enum ShaderDefVal {
        Bool(String, bool),
    }
    impl From<&str> for ShaderDefVal {
        fn from(key: &str) -> Self {
            Self::Bool(key.into(), true)
        }
    }
}

pub mod prelude {
    pub use crate::app::{App, DefaultPlugins, Plugin, PluginGroup, Update};
    pub use crate::asset::{Asset, Assets, Handle};
    pub use crate::ecs::{Commands, Component, Entity, Query, Res, ResMut, With};
    pub use crate::log::warn;
    pub use crate::mesh::Mesh;
    pub use crate::pbr::{Material, MaterialPlugin, MeshMaterial3d, StandardMaterial};
    pub use crate::reflect::TypePath;
}
