#define_import_path bevy_pbr::mesh_types

// The members that a vertex stage may read; the real struct has more, in another order.
struct Mesh {
    world_from_local: mat3x4<f32>,
    local_from_world_transpose_a: mat2x4<f32>,
    local_from_world_transpose_b: f32,
    flags: u32,
    first_vertex_index: u32,
    current_skin_index: u32,
    morph_descriptor_index: u32,
}

#ifdef SKINNED
struct SkinnedMesh {
    data: array<mat4x4<f32>, 256u>,
}
#endif

const MESH_FLAGS_SIGN_DETERMINANT_MODEL_3X3_BIT: u32 = 0x80000000u;
