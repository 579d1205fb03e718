const WGSL = {
    skinVS: {
        usual: [/fn\s+getSkinMatrix\s*\(/, 'fn skinbake_usualSkinMatrix('],
        text: /* wgsl */ `
uniform skinbakeConstants: vec4f;
uniform skinbakeStretch: mat3x3f;
var skinbakeData: texture_2d<uff>;

@{ wgsl | replace("fn skinbake_frame(n: vec3<f32>, tangent", "fn skinbake_tangent_frame(n: vec3<f32>, tangent") | replace("\\", "\\\\") | replace("`", "\\`") | replace("${", "\\${") }

fn skinbake_isBaked() -> bool {
    return uniform.skinbakeConstants.x > 1.5;
}

fn skinbake_hasDualQuaternions() -> bool {
    return uniform.skinbakeConstants.y > 0.5;
}

fn skinbake_datum(index: i32) -> vec4f {
    let texel = i32(pcVertexIndex) * i32(uniform.skinbakeConstants.x) + index;
    let width = i32(textureDimensions(skinbakeData).x);
    return textureLoad(skinbakeData, vec2i(texel % width, texel / width), 0);
}

fn skinbake_joint(index: f32) -> mat4x4f {
    let rows = getBoneMatrix(i32(textureDimensions(texture_poseMap).x), 3 * i32(index + 0.5));
    return transpose(mat4x4f(rows.v1, rows.v2, rows.v3, vec4f(0.0, 0.0, 0.0, 1.0)));
}

fn skinbake_joints() -> array<mat4x4f, 4> {
    return array<mat4x4f, 4>(
        skinbake_joint(vertex_boneIndices.x), skinbake_joint(vertex_boneIndices.y),
        skinbake_joint(vertex_boneIndices.z), skinbake_joint(vertex_boneIndices.w));
}

fn skinbake_weights() -> vec4f {
    let sum = dot(vertex_boneWeights, vec4f(1.0));
    return select(vec4f(1.0, 0.0, 0.0, 0.0), vertex_boneWeights / sum, sum > 0.0);
}

fn skinbake_linear(M: mat4x4f) -> mat3x3f {
    return mat3x3f(M[0].xyz, M[1].xyz, M[2].xyz);
}

fn skinbake_cofactors(M: mat3x3f) -> mat3x3f {
    return mat3x3f(cross(M[1], M[2]), cross(M[2], M[0]), cross(M[0], M[1]));
}

fn skinbake_inverse(M: mat3x3f) -> mat3x3f {
    return transpose(skinbake_cofactors(M)) * (1.0 / determinant(M));
}

fn skinbake_placed(M: mat3x3f, translation: vec3f) -> mat4x4f {
    return mat4x4f(vec4f(M[0], 0.0), vec4f(M[1], 0.0), vec4f(M[2], 0.0), vec4f(translation, 1.0));
}

// As in GLSL.
struct skinbake_Relation {
    stretch: mat3x3f,
    outer: mat3x3f,
    motions: array<mat2x4f, 4>,
}

fn skinbake_related(given: array<mat4x4f, 4>) -> skinbake_Relation {
    var M = given;
    var found: skinbake_Relation;
    found.stretch = uniform.skinbakeStretch;
    let unstretched = skinbake_inverse(found.stretch);
    found.outer = skinbake_linear(M[0]) * unstretched;
    let inner = skinbake_inverse(found.outer);
    for (var i = 0; i < 4; i++) {
        let linear = inner * skinbake_linear(M[i]) * unstretched;
        let translation = inner * (M[i][3].xyz - M[0][3].xyz);
        found.motions[i] = skinbake_dual_quaternion(skinbake_placed(linear, translation));
    }
    return found;
}

fn skinbake_side(M: array<mat4x4f, 4>) -> f32 {
    return select(1.0, -1.0, determinant(skinbake_linear(M[0])) < 0.0);
}

fn skinbake_turned(p: vec3f, rest: skinbake_Frame, M: array<mat4x4f, 4>, alpha: vec3f, beta: vec3f) -> skinbake_Vertex {
    let joints = skinbake_related(M);
    let tangent = joints.stretch * rest.tangent;
    let frame = skinbake_Frame(rest.normal, tangent, joints.stretch * rest.bitangent, rest.handedness);
    var v = skinbake_dqs_exact(joints.stretch * p, frame, joints.motions, skinbake_weights(), alpha, beta);
    v.position = joints.outer * v.position + M[0][3].xyz;
    v.tangent = joints.outer * v.tangent;
    v.bitangent = joints.outer * v.bitangent;
    v.normal = rest.handedness * skinbake_side(M) * cross(v.tangent, v.bitangent);
    return v;
}

fn getSkinMatrix(indices: vec4f, weights: vec4f) -> mat4x4f {
    if (!skinbake_isBaked() || !skinbake_hasDualQuaternions()) { return skinbake_usualSkinMatrix(indices, weights); }
    let M = skinbake_joints();
    let joints = skinbake_related(M);
    let frame = skinbake_Frame(vec3f(0.0), vec3f(1.0, 0.0, 0.0), vec3f(0.0, 1.0, 0.0), 1.0);
    let v = skinbake_dqs_exact(vec3f(0.0), frame, joints.motions, skinbake_weights(), vec3f(0.0), vec3f(0.0));
    let linear = joints.outer * mat3x3f(v.tangent, v.bitangent, v.normal) * joints.stretch;
    return skinbake_placed(linear, joints.outer * v.position + M[0][3].xyz);
}
`,
    },
    normalVS: {
        usual: [/fn\s+getNormal\s*\(/, 'fn skinbake_usualNormal('],
        text: /* wgsl */ `
#if defined(SKIN) && !defined(BATCH)
// The matrix whose columns are a * b.x, a * b.y, a * b.z.
fn skinbake_outer(a: vec3f, b: vec3f) -> mat3x3f {
    return mat3x3f(a * b.x, a * b.y, a * b.z);
}

fn skinbake_model() -> mat4x4f {
#ifdef MESH_INSTANCE_STORAGE
    return getStoredModelMatrix();
#else
    return uniform.matrix_model;
#endif
}

fn skinbake_normal() -> vec3f {
    let n0 = select(vec3f(0.0, 0.0, 1.0), normalize(vertex_normal), dot(vertex_normal, vertex_normal) > 0.0);
    var rest = skinbake_frame(n0);
    if (uniform.skinbakeConstants.x > 2.5) { rest = skinbake_tangent_frame(n0, skinbake_datum(2)); }
    var frame = rest;
    let local = getLocalNormal(vertex_normal);
    if (any(local != vertex_normal)) { frame = skinbake_morphed_frame(rest, local); }
    let M = skinbake_joints();
    let p = getLocalPosition(vertex_position.xyz);
    let alpha = skinbake_datum(0).xyz;
    let beta = skinbake_datum(1).xyz;
    var v: skinbake_Vertex;
    if (skinbake_hasDualQuaternions()) {
        v = skinbake_turned(p, frame, M, alpha, beta);
    } else {
//% if blended == "direct"
        v = skinbake_lbs_direct(p, frame, M, skinbake_weights(), skinbake_gradients(frame, alpha, beta));
//% else
        v = skinbake_lbs_accurate(p, frame, M, skinbake_weights(), alpha, beta);
        v.normal *= skinbake_side(M);
//% endif
    }
    let world = skinbake_linear(skinbake_model());
    let normal = normalize((skinbake_cofactors(world) * v.normal) * select(1.0, -1.0, determinant(world) < 0.0));
    dNormalMatrix = world * (skinbake_outer(v.tangent, rest.tangent / dot(rest.tangent, rest.tangent))
            + skinbake_outer(v.bitangent, rest.bitangent / dot(rest.bitangent, rest.bitangent)));
#ifndef TANGENTS
    dNormalMatrix = dNormalMatrix + skinbake_outer(normal, n0);
#endif
    return normal;
}
#endif

fn getNormal() -> vec3f {
#if defined(SKIN) && !defined(BATCH)
    if (skinbake_isBaked()) { return skinbake_normal(); }
#endif
    return skinbake_usualNormal();
}
`,
    },
};
