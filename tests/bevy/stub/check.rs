//! Runs what the Rust lines of the Bevy target do to a pipeline, against the stand-in `bevy.rs`.

mod skinbake;

use bevy::{
    mesh::{MeshVertexAttribute, MeshVertexBufferLayout, MeshVertexBufferLayoutRef, VertexBufferLayout},
    pbr::{MaterialExtension, MaterialExtensionKey, MaterialExtensionPipeline},
    prelude::*,
    render::render_resource::{RenderPipelineDescriptor, VertexState},
    shader::{ShaderDefVal, ShaderRef},
};

type Places = [(MeshVertexAttribute, u32); 5];

// Locations as in Bevy's forward pass, and in its prepass, which draws shadows too.
const FORWARD: Places = [
    (Mesh::ATTRIBUTE_POSITION, 0),
    (Mesh::ATTRIBUTE_NORMAL, 1),
    (Mesh::ATTRIBUTE_TANGENT, 4),
    (Mesh::ATTRIBUTE_JOINT_WEIGHT, 7),
    (Mesh::ATTRIBUTE_JOINT_INDEX, 6),
];
const PREPASS: Places = [
    (Mesh::ATTRIBUTE_POSITION, 0),
    (Mesh::ATTRIBUTE_NORMAL, 3),
    (Mesh::ATTRIBUTE_TANGENT, 4),
    (Mesh::ATTRIBUTE_JOINT_WEIGHT, 6),
    (Mesh::ATTRIBUTE_JOINT_INDEX, 5),
];

/// The last location in both passes. Texture coordinates and colours have the others.
const LAST: u32 = 7;

/// The layout of a mesh with Bevy's attributes and others, and the pipeline that Bevy has begun for it.
fn mesh(
    own: &Places,
    more: &[MeshVertexAttribute],
) -> (MeshVertexBufferLayoutRef, RenderPipelineDescriptor) {
    let mut attributes: Vec<_> = own.iter().map(|(attribute, _)| *attribute).collect();
    attributes.extend(more);
    let layout = MeshVertexBufferLayout { attributes };
    let places: Vec<_> = own.iter().map(|(a, location)| a.at_shader_location(*location)).collect();
    let buffer = layout.get_layout(&places).unwrap();
    let vertex = VertexState { shader_defs: vec!["SKINNED".into()], buffers: vec![buffer] };
    (MeshVertexBufferLayoutRef(layout.into()), RenderPipelineDescriptor { vertex })
}

fn specialized(more: &[MeshVertexAttribute]) -> (RenderPipelineDescriptor, RenderPipelineDescriptor) {
    specialized_with(&FORWARD, more, &[])
}

fn specialized_with(
    own: &Places,
    more: &[MeshVertexAttribute],
    defs: &[&str],
) -> (RenderPipelineDescriptor, RenderPipelineDescriptor) {
    let (layout, mut before) = mesh(own, more);
    before.vertex.shader_defs.extend(defs.iter().map(|name| ShaderDefVal::from(*name)));
    let mut after = before.clone();
    let key = MaterialExtensionKey { bind_group_data: () };
    skinbake::Skinbake::specialize(&MaterialExtensionPipeline, &mut after, &layout, key).unwrap();
    (before, after)
}

fn main() {
    let (before, after) = specialized(&[skinbake::ALPHA, skinbake::BETA]);
    let old: &VertexBufferLayout = &before.vertex.buffers[0];
    let new: &VertexBufferLayout = &after.vertex.buffers[0];
    assert_eq!(after.vertex.buffers.len(), 1);
    assert_eq!(new.array_stride, old.array_stride);
    assert_eq!(new.attributes[..5], old.attributes[..]);
    let added = &new.attributes[5..];
    assert_eq!(added.len(), 2);
    let baked = ShaderDefVal::Bool("SKINBAKE".into(), true);
    assert_eq!(after.vertex.shader_defs, ["SKINNED".into(), baked]);

    for partly in [&[][..], &[skinbake::ALPHA], &[skinbake::BETA]] {
        let (before, after) = specialized(partly);
        assert_eq!(before, after);
    }

    let (_, in_prepass) = specialized_with(&PREPASS, &[skinbake::ALPHA, skinbake::BETA], &[]);
    assert_eq!(in_prepass.vertex.buffers[0].attributes[5..], *added);
    assert!(added.iter().all(|place| place.shader_location > LAST));

    let baked = [skinbake::ALPHA, skinbake::BETA];
    let (before, after) = specialized_with(&FORWARD, &baked, &["VERTEX_NORMALS_COMPRESSED"]);
    println!("with compressed normals: {}", if before == after { "Bevy's own" } else { "baked" });
    let ShaderRef::Path(path) = skinbake::Skinbake::vertex_shader() else { panic!("no path") };
    println!("{path}");
    // The loader takes what has this format in the file, and the pipeline reads it as that.
    for ((name, attribute), place) in skinbake::gltf_plugin().custom_vertex_attributes.iter().zip(added) {
        assert_eq!(attribute.format, place.format);
        println!("{name} {} {:?} {} {}", attribute.name, place.format, place.offset, place.shader_location);
    }
    example();
}
