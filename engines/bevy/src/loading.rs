//! What Bevy's glTF loader does not read of a bake: α and β of any name and encoding, and the metadata.

use std::sync::Arc;

use bevy::{
    asset::{LoadContext, RenderAssetUsages},
    ecs::world::EntityWorldMut,
    gltf::{
        GltfLoaderSettings,
        extensions::{ErasedGltfExtensionHandler, GltfExtensionHandler},
        gltf::{Gltf, Material, Mesh as GltfMesh, Primitive},
        vertex_attributes::convert_attribute,
    },
    math::DVec3,
    mesh::{Indices, MeshVertexAttribute, PrimitiveTopology, VertexFormat, morph::MorphAttributes},
    platform::collections::HashMap,
    prelude::*,
    tasks::ConditionalSendFuture,
};
use serde_json::Value;

use crate::{SkinbakeExtension, SkinbakeMesh};

/// α and β in a `Mesh`. Their format is that of the file, so compare by `id`. No other attribute may have these numbers.
pub const ALPHA: MeshVertexAttribute = attribute("SkinbakeAlpha", 0x736b_696e_0001, VertexFormat::Float32x3);
/// See [`ALPHA`].
pub const BETA: MeshVertexAttribute = attribute("SkinbakeBeta", 0x736b_696e_0002, VertexFormat::Float32x3);

const fn attribute(name: &'static str, id: u64, format: VertexFormat) -> MeshVertexAttribute {
    MeshVertexAttribute::new(name, id, format)
}

pub const NOT_BAKED: &str = "it is not baked";

const TRIANGLES: u32 = 4;
const TRIANGLE_STRIP: u32 = 5;

/// The attributes that hold α and β, without their leading underscore as Bevy names them, and what the shader takes.
struct Read {
    alpha: String,
    beta: String,
    format: VertexFormat,
    bake: SkinbakeExtension,
    /// What a bake notes of the mesh, by which one sees that a tool has changed it since.
    noted: Value,
}

/// Reads the bakes of one file.
#[derive(Clone)]
pub struct Reader {
    turns_meshes: bool,
    turns_meshes_by_default: bool,
    usages: RenderAssetUsages,
    /// The buffers of the file, as Bevy's reader of attributes takes them.
    buffers: Option<Arc<Vec<Vec<u8>>>>,
    /// Why primitives stay standard, by mesh and primitive; or their bake.
    found: HashMap<(usize, usize), Result<SkinbakeExtension, String>>,
}

impl Reader {
    pub fn new(turns_meshes: bool) -> Self {
        Self {
            turns_meshes,
            turns_meshes_by_default: turns_meshes,
            usages: RenderAssetUsages::default(),
            buffers: None,
            found: HashMap::default(),
        }
    }
}

impl GltfExtensionHandler for Reader {
    fn dyn_clone(&self) -> Box<dyn ErasedGltfExtensionHandler> {
        Box::new(self.clone())
    }

    fn on_root(&mut self, _context: &mut LoadContext<'_>, _gltf: &Gltf, settings: &GltfLoaderSettings) {
        self.turns_meshes =
            settings.convert_coordinates.map_or(self.turns_meshes_by_default, |convert| convert.rotate_meshes);
        self.usages = settings.load_meshes;
    }

    fn on_gltf_primitive(
        &mut self,
        _context: &mut LoadContext<'_>,
        _gltf: &Gltf,
        mesh: &GltfMesh,
        primitive: &Primitive,
        buffers: &[Vec<u8>],
        custom: &HashMap<Box<str>, MeshVertexAttribute>,
        on_skinned_nodes: bool,
        on_others: bool,
        made: &mut Option<Mesh>,
    ) -> impl ConditionalSendFuture<Output = ()> {
        let mut read = || -> Result<SkinbakeExtension, String> {
            let read = read(primitive)?;
            if !on_skinned_nodes || on_others {
                return Err("nodes without a skin draw it".into());
            }
            if self.turns_meshes {
                return Err("Bevy turns its mesh: leave rotate_meshes off".into());
            }
            if made.is_some() {
                return Err("another extension handler of glTF has made its mesh".into());
            }
            let buffers = self.buffers.get_or_insert_with(|| Arc::new(buffers.to_vec()));
            *made = Some(whole_mesh(mesh, primitive, &read, buffers, custom, self.usages)?);
            Ok(read.bake)
        };
        let found = read();
        self.found.insert((mesh.index(), primitive.index()), found);
        async {}
    }

    fn on_spawn_mesh_and_material(
        &mut self,
        _context: &mut LoadContext<'_>,
        primitive: &Primitive,
        mesh: &GltfMesh,
        _material: &Material,
        entity: &mut EntityWorldMut,
        _label: &str,
    ) {
        let is_skinned = primitive.attributes().any(|(semantic, _)| semantic.to_string() == "JOINTS_0");
        let Some(found) = self.found.get(&(mesh.index(), primitive.index())).filter(|_| is_skinned) else { return };
        entity.insert(SkinbakeMesh {
            standard: found.as_ref().err().cloned(),
            bake: found.as_ref().copied().unwrap_or_default(),
            source: Handle::default(),
        });
    }
}

/// Read the metadata of a primitive; Err: why it stays standard.
fn read(primitive: &Primitive) -> Result<Read, String> {
    // Where extras of the primitive were not an object, bake has put the metadata into those of alpha's accessor.
    let places = primitive.attributes().map(|(_, accessor)| accessor.extras().clone());
    let metadata = std::iter::once(primitive.extras().clone())
        .chain(places)
        .flatten()
        .filter_map(|extras| serde_json::from_str::<Value>(extras.get()).ok())
        .map(|extras| extras["skinbake"].clone())
        .find(|one| one["version"].is_i64());
    let find = |name: &str| primitive.attributes().any(|(semantic, _)| semantic.to_string() == name);
    let Some(metadata) = metadata else {
        let is_lost = find("_SKINBAKE_ALPHA_0");
        let lost = "it has lost the metadata of its bake: keep the extras of primitives, or bake last";
        return Err(if is_lost { lost } else { NOT_BAKED }.into());
    };
    if metadata["targets"].is_i64() {
        return Err("it has correctives, which Bevy plays without a shader".into());
    }
    if metadata["version"] != 1 {
        let version = &metadata["version"];
        return Err(format!("its bake has version {version}, and this crate reads version 1: update it"));
    }
    let influences = metadata["influences"].as_u64().unwrap_or(0);
    if influences > 4 || find("JOINTS_1") {
        return Err(format!(
            "it has {} influences for each vertex, and Bevy reads four: bake it again with --limit-influences 4",
            influences.max(8)
        ));
    }
    let has_tangent_frame = match metadata["frame"].as_str() {
        Some("normal") => 0,
        Some("tangent") => 1,
        _ => {
            return Err(format!(
                "its frame is {}, and this crate knows normal and tangent: update it",
                metadata["frame"]
            ));
        }
    };
    if metadata["layout"] == "texcoord" {
        return Err("Bevy reads two sets of texture coordinates: bake it again with --layout attributes".into());
    }
    let format = match metadata["encoding"].as_str() {
        None => VertexFormat::Float32x3,
        Some("packed8") => VertexFormat::Snorm8x4,
        Some("snorm16") => VertexFormat::Snorm16x4,
        Some(other) => {
            return Err(format!("its encoding is {other}, and this crate knows packed8 and snorm16: update it"));
        }
    };
    let scale = if format == VertexFormat::Float32x3 { Some(1.0) } else { metadata["scale"].as_f64() };
    let damaged = "the metadata of its bake is damaged: bake it again";
    let [alpha, beta] = ["alpha", "beta"].map(|kind| metadata[kind][0].as_str().map(str::to_string));
    let (Some(scale), Some(alpha), Some(beta)) = (scale, alpha, beta) else { return Err(damaged.into()) };
    let needed = ["NORMAL", "TANGENT", alpha.as_str(), beta.as_str()];
    if let Some(lost) = needed.iter().find(|name| !find(name) && (**name != "TANGENT" || has_tangent_frame == 1)) {
        return Err(format!("it has lost the attribute {lost}, which its bake needs: bake last"));
    }
    let bare = |name: String| name.strip_prefix('_').map(str::to_string).ok_or(damaged.to_string());
    let bake = SkinbakeExtension { scale: scale as f32, has_tangent_frame, ..default() };
    Ok(Read { alpha: bare(alpha)?, beta: bare(beta)?, format, bake, noted: metadata["positions"].clone() })
}

/// Of the diagonal, as in skinbake.
const SAME_BOUNDS: f64 = 1e-3;

/// Return what a tool has changed since the bake, as far as the bake has noted it.
fn change(noted: &Value, primitive: &Primitive, buffers: &[Vec<u8>]) -> Option<&'static str> {
    let positions = primitive.attributes().find(|(semantic, _)| semantic.to_string() == "POSITION")?.1;
    noted.as_object()?;
    if noted["componentType"] != positions.data_type().as_gl_enum() {
        return Some("the type of its positions");
    }
    let corners = primitive.indices().map_or(positions.count(), |indices| indices.count());
    if noted["corners"].as_u64().is_some_and(|noted| noted != corners as u64) {
        return Some("its triangles");
    }
    let vector = |value: &Value| serde_json::from_value::<[f64; 3]>(value.clone()).ok().map(DVec3::from);
    let bounds = [&noted["min"], &noted["max"], &positions.min()?, &positions.max()?].map(vector);
    if let [Some(noted_min), Some(noted_max), Some(min), Some(max)] = bounds {
        let allowed = SAME_BOUNDS * noted_min.distance(noted_max);
        if (noted_min - min).abs().max_element() > allowed || (noted_max - max).abs().max_element() > allowed {
            return Some("the bounds of its positions");
        }
    }
    let reader = primitive.reader(|buffer| buffers.get(buffer.index()).map(Vec::as_slice));
    let joints = noted["joints"].as_u64()?;
    // FNV-1a of the joints of a vertex, slot by slot.
    let hash = |joints: [u16; 4]| {
        joints.iter().fold(0x811c_9dc5, |hash: u32, &joint| (hash ^ u32::from(joint)).wrapping_mul(0x0100_0193))
    };
    let hashes: Vec<u32> = reader.read_joints(0)?.into_u16().map(hash).collect();
    // In any order of vertices, merged or not, it is the same.
    let drawn = corners - corners % 3;
    let sum = |corners: &mut dyn Iterator<Item = usize>| {
        corners.take(drawn).fold(0_u32, |sum, vertex| sum.wrapping_add(*hashes.get(vertex).unwrap_or(&0)))
    };
    let found = match reader.read_indices() {
        Some(indices) => sum(&mut indices.into_u32().map(|index| index as usize)),
        None => sum(&mut (0..corners)),
    };
    (joints != u64::from(found)).then_some("the order of its joints")
}

/// Return the mesh of a primitive as Bevy's loader makes it, with α and β; Err: why it stays standard.
fn whole_mesh(
    mesh: &GltfMesh,
    primitive: &Primitive,
    read: &Read,
    buffers: &Vec<Vec<u8>>,
    custom: &HashMap<Box<str>, MeshVertexAttribute>,
    usages: RenderAssetUsages,
) -> Result<Mesh, String> {
    if let Some(change) = change(&read.noted, primitive, buffers) {
        return Err(format!("a tool has changed {change} since its bake: bake last"));
    }
    let mut known = custom.clone();
    for (name, kind) in [(&read.alpha, ALPHA), (&read.beta, BETA)] {
        known.insert(name.as_str().into(), MeshVertexAttribute { format: read.format, ..kind });
    }
    let topology = match primitive.mode().as_gl_enum() {
        TRIANGLES => PrimitiveTopology::TriangleList,
        TRIANGLE_STRIP => PrimitiveTopology::TriangleStrip,
        _ => return Err("it is not drawn in triangles".into()),
    };
    let mut whole = Mesh::new(topology, usages);
    for (semantic, accessor) in primitive.attributes() {
        match convert_attribute(semantic, accessor, buffers, &known, false) {
            Ok((kind, values)) => whole.insert_attribute(kind, values),
            Err(error) => warn!("{error}"), // as the loader does
        }
    }
    for kind in [ALPHA, BETA] {
        if !whole.contains_attribute(kind) {
            let name = kind.name;
            return Err(format!("its attribute {name} is not stored as its metadata say: bake last"));
        }
    }
    let count = whole.count_vertices();
    let reader = primitive.reader(|buffer| buffers.get(buffer.index()).map(Vec::as_slice));
    if let Some(indices) = reader.read_indices() {
        let indices = indices.into_u32();
        whole.insert_indices(if count <= usize::from(u16::MAX) {
            Indices::U16(indices.map(|index| index as u16).collect())
        } else {
            Indices::U32(indices.collect())
        });
    }
    let mut targets = Vec::new();
    for (positions, normals, tangents) in reader.read_morph_targets() {
        let mut one = vec![MorphAttributes::default(); count];
        for (target, position) in one.iter_mut().zip(positions.into_iter().flatten()) {
            target.position = position.into();
        }
        for (target, normal) in one.iter_mut().zip(normals.into_iter().flatten()) {
            target.normal = normal.into();
        }
        for (target, tangent) in one.iter_mut().zip(tangents.into_iter().flatten()) {
            target.tangent = tangent.into();
        }
        targets.extend(one);
    }
    if !targets.is_empty() {
        whole.set_morph_targets(targets);
        let extras = mesh.extras().as_ref().and_then(|extras| serde_json::from_str::<Value>(extras.get()).ok());
        let names = extras.as_ref().and_then(|extras| extras["targetNames"].as_array());
        let names: Option<Vec<String>> =
            names.map(|names| names.iter().filter_map(|one| Some(one.as_str()?.into())).collect());
        if let Some(names) = names {
            whole.set_morph_target_names(names);
        }
    }
    Ok(whole)
}
