#define_import_path bevy_pbr::skinning

#import bevy_pbr::mesh_types::SkinnedMesh
#import bevy_pbr::mesh_bindings::mesh

#ifdef SKINNED

#ifdef SKINS_USE_UNIFORM_BUFFERS
@group(2) @binding(1) var<uniform> joint_matrices: SkinnedMesh;
#else
@group(2) @binding(1) var<storage> joint_matrices: array<mat4x4<f32>>;
#endif

fn skin_model(indexes: vec4<u32>, weights: vec4<f32>, instance_index: u32) -> mat4x4<f32> {
    var blended = mat4x4<f32>();
    for (var slot = 0u; slot < 4u; slot++) {
#ifdef SKINS_USE_UNIFORM_BUFFERS
        blended += weights[slot] * joint_matrices.data[indexes[slot]];
#else
        blended += weights[slot] * joint_matrices[mesh[instance_index].current_skin_index + indexes[slot]];
#endif
    }
    return blended;
}

fn skin_normals(world_from_local: mat4x4<f32>, normal: vec3<f32>) -> vec3<f32> {
    let x = world_from_local[0].xyz;
    let y = world_from_local[1].xyz;
    let z = world_from_local[2].xyz;
    let cofactors = mat3x3<f32>(cross(y, z), cross(z, x), cross(x, y));
    return normalize(sign(dot(x, cofactors[0])) * (cofactors * normal));
}

#endif
