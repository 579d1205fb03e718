#define_import_path bevy_pbr::mesh_bindings

#import bevy_pbr::mesh_types::Mesh

@group(2) @binding(0) var<storage> mesh: array<Mesh>;
