#define_import_path bevy_pbr::mesh_functions

#import bevy_pbr::mesh_bindings::mesh

fn get_world_from_local(instance_index: u32) -> mat4x4<f32> {
    let rows = mesh[instance_index].world_from_local;
    return transpose(mat4x4<f32>(rows[0], rows[1], rows[2], vec4<f32>(0.0, 0.0, 0.0, 1.0)));
}

fn mesh_position_local_to_world(world_from_local: mat4x4<f32>, vertex_position: vec4<f32>) -> vec4<f32> {
    return world_from_local * vertex_position;
}

fn mesh_normal_local_to_world(vertex_normal: vec3<f32>, instance_index: u32) -> vec3<f32> {
    let a = mesh[instance_index].local_from_world_transpose_a;
    let b = mesh[instance_index].local_from_world_transpose_b;
    return normalize(mat3x3<f32>(a[0].xyz, vec3<f32>(a[0].w, a[1].xy), vec3<f32>(a[1].zw, b)) * vertex_normal);
}

fn mesh_tangent_local_to_world(
    world_from_local: mat4x4<f32>, vertex_tangent: vec4<f32>, instance_index: u32
) -> vec4<f32> {
    let direction = (world_from_local * vec4<f32>(vertex_tangent.xyz, 0.0)).xyz;
    return vec4<f32>(normalize(direction), vertex_tangent.w);
}

#ifdef VISIBILITY_RANGE_DITHER
fn get_visibility_range_dither_level(instance_index: u32, world_position: vec4<f32>) -> i32 {
    return i32(world_position.x);
}
#endif
