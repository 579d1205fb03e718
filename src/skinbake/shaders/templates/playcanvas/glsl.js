// The chunks, after PlayCanvas's own functions of the same names, which they rename and still call.
const GLSL = {
    skinVS: {
        usual: [/mat4\s+getSkinMatrix\s*\(/, 'mat4 skinbake_usualSkinMatrix('],
        text: /* glsl */ `
uniform vec4 skinbakeConstants; // texels of each vertex: 2 normal, 3 tangent frame; 1 for dual quaternions
uniform highp sampler2D skinbakeData; // alpha, beta, TANGENT
uniform mat3 skinbakeStretch; // by which joints differ from rigid ones, for dual quaternions

@{ glsl | replace("\\", "\\\\") | replace("`", "\\`") | replace("${", "\\${") }

bool skinbake_isBaked()
{
    return skinbakeConstants.x > 1.5;
}

bool skinbake_hasDualQuaternions()
{
    return skinbakeConstants.y > 0.5;
}

vec4 skinbake_datum(int index)
{
    int texel = gl_VertexID * int(skinbakeConstants.x) + index;
    int width = textureSize(skinbakeData, 0).x;
    return texelFetch(skinbakeData, ivec2(texel % width, texel / width), 0);
}

mat4 skinbake_joint(float index)
{
    vec4 x, y, z;
    getBoneMatrix(textureSize(texture_poseMap, 0).x, 3 * int(index + 0.5), x, y, z);
    return transpose(mat4(x, y, z, vec4(0.0, 0.0, 0.0, 1.0)));
}

mat4[4] skinbake_joints()
{
    return mat4[4](
        skinbake_joint(vertex_boneIndices.x), skinbake_joint(vertex_boneIndices.y),
        skinbake_joint(vertex_boneIndices.z), skinbake_joint(vertex_boneIndices.w));
}

// PlayCanvas divides positions by the sum of the weights.
vec4 skinbake_weights()
{
    float sum = dot(vertex_boneWeights, vec4(1.0));
    return sum > 0.0 ? vertex_boneWeights / sum : vec4(1.0, 0.0, 0.0, 0.0);
}

// Each joint is L Q X: Q is rigid, L and X are common to all joints. X is the uniform, up to a rotation and a scale.
// The joints relative to the first one, X M[0]^-1 M[i] X^-1, are rigid too. L is not needed.
struct skinbake_Relation
{
    mat3 stretch; // X
    mat3 outer; // M[0] X^-1, without its translation
    mat2x4 motions[4];
};

skinbake_Relation skinbake_related(mat4 M[4])
{
    skinbake_Relation found;
    found.stretch = skinbakeStretch;
    mat3 unstretched = inverse(found.stretch);
    found.outer = mat3(M[0]) * unstretched;
    mat3 inner = inverse(found.outer);
    for (int i = 0; i < 4; i++) {
        mat4 motion = mat4(inner * mat3(M[i]) * unstretched);
        motion[3].xyz = inner * (M[i][3].xyz - M[0][3].xyz);
        found.motions[i] = skinbake_dual_quaternion(motion);
    }
    return found;
}

// Joints undo a mirror of the mesh's node. Then they turn the cross product of tangent and bitangent round.
float skinbake_side(mat4 M[4])
{
    return determinant(mat3(M[0])) < 0.0 ? -1.0 : 1.0;
}

skinbake_Vertex skinbake_turned(vec3 p, skinbake_Frame frame, mat4 M[4], vec3 alpha, vec3 beta)
{
    skinbake_Relation joints = skinbake_related(M);
    frame.tangent = joints.stretch * frame.tangent;
    frame.bitangent = joints.stretch * frame.bitangent;
    skinbake_Vertex v = skinbake_dqs_exact(
        joints.stretch * p, frame, joints.motions, skinbake_weights(), alpha, beta);
    v.position = joints.outer * v.position + M[0][3].xyz;
    v.tangent = joints.outer * v.tangent;
    v.bitangent = joints.outer * v.bitangent;
    v.normal = frame.handedness * skinbake_side(M) * cross(v.tangent, v.bitangent);
    return v;
}

// Relative to the first joint, dual quaternions move a vertex rigidly.
mat4 getSkinMatrix(const in vec4 indices, const in vec4 weights)
{
    if (!skinbake_isBaked() || !skinbake_hasDualQuaternions()) return skinbake_usualSkinMatrix(indices, weights);
    mat4 M[4] = skinbake_joints();
    skinbake_Relation joints = skinbake_related(M);
    skinbake_Frame frame = skinbake_Frame(vec3(0.0), vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), 1.0);
    skinbake_Vertex v = skinbake_dqs_exact(
        vec3(0.0), frame, joints.motions, skinbake_weights(), vec3(0.0), vec3(0.0));
    mat4 found = mat4(joints.outer * mat3(v.tangent, v.bitangent, v.normal) * joints.stretch);
    found[3].xyz = joints.outer * v.position + M[0][3].xyz;
    return found;
}
`,
    },
    normalVS: {
        usual: [/vec3\s+getNormal\s*\(/, 'vec3 skinbake_usualNormal('],
        text: /* glsl */ `
#if defined(SKIN) && !defined(BATCH)
vec3 skinbake_normal()
{
    vec3 n0 = dot(vertex_normal, vertex_normal) > 0.0 ? normalize(vertex_normal) : vec3(0.0, 0.0, 1.0);
    skinbake_Frame rest = skinbake_frame(n0);
    if (skinbakeConstants.x > 2.5) rest = skinbake_frame(n0, skinbake_datum(2));
    skinbake_Frame frame = rest;
    vec3 local = getLocalNormal(vertex_normal); // morphed, or turned by a chunk normalCoreVS of the page
    if (local != vertex_normal) frame = skinbake_morphed_frame(rest, local);
    mat4 M[4] = skinbake_joints();
    vec3 p = getLocalPosition(vertex_position.xyz);
    vec3 alpha = skinbake_datum(0).xyz;
    vec3 beta = skinbake_datum(1).xyz;
    skinbake_Vertex v;
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
    mat3 world = mat3(matrix_model);
    mat3 cofactors = mat3(cross(world[1], world[2]), cross(world[2], world[0]), cross(world[0], world[1]));
    vec3 normal = normalize((cofactors * v.normal) * (determinant(world) < 0.0 ? -1.0 : 1.0));
    // PlayCanvas multiplies TANGENT by this matrix. TANGENT lies in the plane of the frame at rest.
    dNormalMatrix = world * (outerProduct(v.tangent, rest.tangent / dot(rest.tangent, rest.tangent))
            + outerProduct(v.bitangent, rest.bitangent / dot(rest.bitangent, rest.bitangent)));
#ifndef TANGENTS
    dNormalMatrix += outerProduct(normal, n0);
#endif
    return normal;
}
#endif

vec3 getNormal()
{
#if defined(SKIN) && !defined(BATCH)
    if (skinbake_isBaked()) return skinbake_normal();
#endif
    return skinbake_usualNormal();
}
`,
    },
};
