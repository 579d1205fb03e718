#define_import_path bevy_pbr::morph

#import bevy_pbr::mesh_bindings::mesh

#ifdef MORPH_TARGETS

struct MorphAttributes {
    position: vec3<f32>,
    normal: vec3<f32>,
    tangent: vec3<f32>,
}

struct MorphDescriptor {
    weight_count: u32,
    vertex_count: u32,
}

@group(2) @binding(2) var<storage> morph_weights: array<f32>;
@group(2) @binding(3) var<storage> morph_targets: array<MorphAttributes>;
@group(2) @binding(8) var<storage> morph_descriptors: array<MorphDescriptor>;

fn layer_count(instance_index: u32) -> u32 {
    return morph_descriptors[mesh[instance_index].morph_descriptor_index].weight_count;
}

fn weight_at(weight_index: u32, instance_index: u32) -> f32 {
    return morph_weights[weight_index];
}

fn delta(vertex_index: u32, weight_index: u32, instance_index: u32) -> MorphAttributes {
    let vertices = morph_descriptors[mesh[instance_index].morph_descriptor_index].vertex_count;
    return morph_targets[weight_index * vertices + vertex_index];
}

fn morph_position(vertex_index: u32, weight_index: u32, instance_index: u32) -> vec3<f32> {
    return delta(vertex_index, weight_index, instance_index).position;
}

fn morph_normal(vertex_index: u32, weight_index: u32, instance_index: u32) -> vec3<f32> {
    return delta(vertex_index, weight_index, instance_index).normal;
}

fn morph_tangent(vertex_index: u32, weight_index: u32, instance_index: u32) -> vec3<f32> {
    return delta(vertex_index, weight_index, instance_index).tangent;
}

#endif
