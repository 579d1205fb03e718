// Shader text, written by skinbake 0.1.0:
//     skinbake shader --lang glsl --method lbs --lighting accurate --influences 4 --frame normal --target playcanvas
//
// Linear blending: algorithm 3 of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient
// Lighting for Skinned Models", Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. Dual quaternions:
// algorithm 6 of skinbake, the exact derivative of their blend. Frame: T. Duff et al., "Building an Orthonormal
// Basis, Revisited", JCGT 6(1), 2017.

export const METHOD = 'lbs';

// The chunks, after PlayCanvas's own functions of the same names, which they rename and still call.
export const GLSL = {
    skinVS: /* glsl */ `
uniform vec4 skinbakeConstants; // texels of each vertex: 2 normal, 3 tangent frame; 1 for dual quaternions
uniform highp sampler2D skinbakeData; // alpha, beta, TANGENT
uniform mat3 skinbakeStretch; // by which joints differ from rigid ones, for dual quaternions

#ifndef SKINBAKE_VERTEX
#define SKINBAKE_VERTEX
// A skinned vertex. Its vectors have any length. tangent and bitangent are the images of t0 and b0.
struct skinbake_Vertex {
    vec3 position;
    vec3 normal;
    vec3 tangent;
    vec3 bitangent;
    vec3 cotangent; // for normal maps: the cofactors of (t', b', T n0), of which normal is the third
    vec3 cobitangent;
};

// The tangent frame at rest.
struct skinbake_Frame {
    vec3 normal;
    vec3 tangent;
    vec3 bitangent;
    float handedness; // n0 = handedness * cross(t0, b0) / |t0|^2
};
#endif

#ifndef SKINBAKE_FRAME_FROM_TANGENT
#define SKINBAKE_FRAME_FROM_TANGENT
// The frame of NORMAL, which must have length 1, and TANGENT.
skinbake_Frame skinbake_frame(vec3 n, vec4 tangent)
{
    return skinbake_Frame(n, tangent.xyz, cross(n, tangent.xyz) * tangent.w, tangent.w);
}
#endif

#ifndef SKINBAKE_FRAME_FROM_NORMAL
#define SKINBAKE_FRAME_FROM_NORMAL
// The frame that bake took from NORMAL alone. n must have length 1. Every product in a sum is exact, so a compiler
// that fuses multiply-adds gets the same bits. side is the last factor, because Mesa turns side * ((x * x) * a)
// into side * (x * (x * a)).
skinbake_Frame skinbake_frame(vec3 n)
{
    float side = n.z >= 0.0 ? 1.0 : -1.0; // 1 also at -0.0
    float a = -1.0 / (side + n.z);
    float b = (n.x * n.y) * a;
    vec3 t0 = vec3(1.0 + ((n.x * n.x) * a) * side, side * b, -side * n.x);
    vec3 b0 = vec3(b, side * (1.0 + ((n.y * n.y) * a) * side), -n.y);
    return skinbake_Frame(n, t0, b0, 1.0);
}
#endif

#ifndef SKINBAKE_MORPHED
#define SKINBAKE_MORPHED
// The frame under morph targets, by the morphed normal n: NORMAL plus the weighted sum of its targets, of any
// length. The frame at rest turns by the smallest rotation that takes its normal to n. Do not use
// skinbake_frame(n): alpha and beta belong to the frame at rest.
skinbake_Frame skinbake_morphed_frame(skinbake_Frame rest, vec3 n)
{
    float square = dot(n, n);
    vec3 normal = square > 0.0 ? n * inversesqrt(square) : rest.normal;
    vec3 s = rest.normal + normal;
    vec3 d = normal - rest.normal;
    bool opposite = dot(s, s) < 1e-4; // then every half turn is the smallest: take the one about t0
    float k = opposite ? 0.0 : 2.0 / dot(s, s);
    vec3 tangent = rest.tangent - s * (k * dot(d, rest.tangent));
    vec3 bitangent = rest.bitangent - s * (k * dot(d, rest.bitangent));
    return skinbake_Frame(normal, tangent, opposite ? -bitangent : bitangent, rest.handedness);
}
#endif

#ifndef SKINBAKE_MOVED
#define SKINBAKE_MOVED
// M p: the position p moved by the joint matrix M alone.
vec3 skinbake_moved(mat4 M, vec3 p)
{
    return M[0].xyz * p.x + (M[1].xyz * p.y + (M[2].xyz * p.z + M[3].xyz));
}
#endif

// The frame moves by the derivative of the skinned position along t0 and b0.
// M: the joint matrices of slots 0 to 3.
skinbake_Vertex skinbake_lbs_accurate(vec3 p, skinbake_Frame frame, mat4 M[4], vec4 weights_0, vec3 alpha_0,
        vec3 beta_0)
{
    mat3 T = weights_0.x * mat3(M[0]) // 1
            + weights_0.y * mat3(M[1])
            + weights_0.z * mat3(M[2])
            + weights_0.w * mat3(M[3]);
    vec3 q0 = skinbake_moved(M[0], p); // 2
    vec3 q1 = skinbake_moved(M[1], p);
    vec3 q2 = skinbake_moved(M[2], p);
    vec3 q3 = skinbake_moved(M[3], p);
    vec3 d1 = q1 - q0; // 3
    vec3 d2 = q2 - q0;
    vec3 d3 = q3 - q0;
    skinbake_Vertex v;
    v.tangent = T * frame.tangent + alpha_0.x * d1 + alpha_0.y * d2 + alpha_0.z * d3; // 4
    v.bitangent = T * frame.bitangent + beta_0.x * d1 + beta_0.y * d2 + beta_0.z * d3; // 5
    v.normal = frame.handedness * cross(v.tangent, v.bitangent); // 6
    vec3 carried = T * frame.normal; // 8
    v.cotangent = frame.handedness * cross(v.bitangent, carried); // 9
    v.cobitangent = frame.handedness * cross(carried, v.tangent); // 10
    v.position = q0 + weights_0.y * d1 + weights_0.z * d2 + weights_0.w * d3; // 7
    return v;
}

#ifndef SKINBAKE_DUAL_QUATERNION
#define SKINBAKE_DUAL_QUATERNION
// The unit dual quaternion of a rigid joint matrix. [0] is its real part (x, y, z, w), w the scalar; [1] is its
// dual part. Compute it on the host or in a pass over the joints: once per joint and frame, not per vertex.
// Dual quaternions have no scale. If all joint matrices share a uniform scale s, divide their upper 3x3 parts by
// s first, and skin s * p, s * t0, s * b0 in place of p, t0, b0.
mat2x4 skinbake_dual_quaternion(mat4 M)
{
    vec3 d = vec3(M[0].x, M[1].y, M[2].z);
    vec4 squares = 1.0 + vec4( // 4 * (x, y, z, w)^2
        d.x - d.y - d.z, d.y - d.z - d.x, d.z - d.x - d.y, d.x + d.y + d.z);
    vec3 differences = vec3(M[1].z - M[2].y, M[2].x - M[0].z, M[0].y - M[1].x); // 4 w * (x, y, z)
    vec3 sums = vec3(M[1].z + M[2].y, M[2].x + M[0].z, M[0].y + M[1].x); // 4 * (yz, zx, xy)
    vec4 real = vec4(differences, squares.w);
    float largest = squares.w;
    if (squares.x > largest) {
        largest = squares.x;
        real = vec4(squares.x, sums.z, sums.y, differences.x);
    }
    if (squares.y > largest) {
        largest = squares.y;
        real = vec4(sums.z, squares.y, sums.x, differences.y);
    }
    if (squares.z > largest) {
        real = vec4(sums.y, sums.x, squares.z, differences.z);
    }
    real = normalize(real);
    vec3 t = M[3].xyz;
    return mat2x4(real, 0.5 * vec4(cross(t, real.xyz) + real.w * t, -dot(t, real.xyz)));
}
#endif

#ifndef SKINBAKE_HEMISPHERE
#define SKINBAKE_HEMISPHERE
// -1 if the real part of the joint points away from that of the pivot: q and -q are the same rotation.
float skinbake_hemisphere(mat2x4 joint, mat2x4 pivot)
{
    return dot(joint[0], pivot[0]) < 0.0 ? -1.0 : 1.0;
}
#endif

#ifndef SKINBAKE_DERIVATIVE
#define SKINBAKE_DERIVATIVE
// The derivative of p + delta along t, if the mix b changes at the rate db. delta = k h, and i is as in the caller.
vec3 skinbake_derivative(mat2x4 b, float k, vec3 p, vec3 i, vec3 delta, vec3 t, mat2x4 db)
{
    vec3 di = b[0].w * t + db[1].xyz + cross(b[0].xyz, t) + db[0].w * p + cross(db[0].xyz, p);
    vec3 dh = b[0].w * db[1].xyz + cross(b[0].xyz, di) + cross(db[0].xyz, i)
            + db[0].w * b[1].xyz - db[1].w * b[0].xyz - b[1].w * db[0].xyz - dot(b[0], db[0]) * delta;
    return t + k * dh;
}
#endif

// The frame moves by the derivative of the motion p' = p + delta of the mix, delta = k h,
//     i = r x p + r0 p + d, h = r x i + r0 d - d0 r, k = 2 / (r0^2 + |r|^2), the mix b = (r0, r, d0, d).
// Q: the dual quaternions of slots 0 to 3.
skinbake_Vertex skinbake_dqs_exact(vec3 p, skinbake_Frame frame, mat2x4 Q[4], vec4 weights_0, vec3 alpha_0,
        vec3 beta_0)
{
    float s1 = skinbake_hemisphere(Q[1], Q[0]); // 1
    float s2 = skinbake_hemisphere(Q[2], Q[0]);
    float s3 = skinbake_hemisphere(Q[3], Q[0]);
    mat2x4 b = weights_0.x * Q[0]
              + (s1 * weights_0.y) * Q[1]
              + (s2 * weights_0.z) * Q[2]
              + (s3 * weights_0.w) * Q[3];
    float square = dot(b[0], b[0]);
    float k = square == 0.0 ? 2.0 : 2.0 / square; // 2
    vec3 i = b[0].w * p + b[1].xyz + cross(b[0].xyz, p); // 3
    vec3 delta = k * (b[0].w * b[1].xyz - b[1].w * b[0].xyz + cross(b[0].xyz, i));
    skinbake_Vertex v;
    v.position = p + delta;
    mat2x4 D1 = s1 * Q[1] - Q[0]; // 4
    mat2x4 D2 = s2 * Q[2] - Q[0];
    mat2x4 D3 = s3 * Q[3] - Q[0];
    mat2x4 db_t = alpha_0.x * D1 + alpha_0.y * D2 + alpha_0.z * D3; // 5
    mat2x4 db_b = beta_0.x * D1 + beta_0.y * D2 + beta_0.z * D3; // 6
    v.tangent = skinbake_derivative(b, k, p, i, delta, frame.tangent, db_t); // 7
    v.bitangent = skinbake_derivative(b, k, p, i, delta, frame.bitangent, db_b); // 8
    v.normal = frame.handedness * cross(v.tangent, v.bitangent); // 9
    vec3 carried = frame.normal + k * cross(b[0].xyz, b[0].w * frame.normal + cross(b[0].xyz,
            frame.normal)); // 10
    v.cotangent = frame.handedness * cross(v.bitangent, carried); // 11
    v.cobitangent = frame.handedness * cross(carried, v.tangent); // 12
    return v;
}

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
    frame.normal = joints.stretch * frame.normal; // moves what is displaced along it
    skinbake_Vertex v = skinbake_dqs_exact(
        joints.stretch * p, frame, joints.motions, skinbake_weights(), alpha, beta);
    v.position = joints.outer * v.position + M[0][3].xyz;
    v.tangent = joints.outer * v.tangent;
    v.bitangent = joints.outer * v.bitangent;
    v.normal = frame.handedness * skinbake_side(M) * cross(v.tangent, v.bitangent);
    mat3 outer = joints.outer;
    mat3 cofactors = mat3(cross(outer[1], outer[2]), cross(outer[2], outer[0]), cross(outer[0], outer[1]));
    v.cotangent = skinbake_side(M) * (cofactors * v.cotangent);
    v.cobitangent = skinbake_side(M) * (cofactors * v.cobitangent);
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
    normalVS: /* glsl */ `
#ifdef TANGENTS
varying vec2 vSkinbakeLengths;
#endif
#if defined(SKIN) && !defined(BATCH)
// For normal maps.
skinbake_Vertex skinbakeLit;
skinbake_Frame skinbakeRest;
float skinbakeUnit; // the length of t0
mat3 skinbakeCofactors;

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
        v = skinbake_lbs_accurate(p, frame, M, skinbake_weights(), alpha, beta);
        v.normal *= skinbake_side(M);
        v.cotangent *= skinbake_side(M);
        v.cobitangent *= skinbake_side(M);
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
    skinbakeLit = v;
    skinbakeRest = rest;
    skinbakeUnit = length(frame.tangent);
    skinbakeCofactors = cofactors * (determinant(world) < 0.0 ? -1.0 : 1.0);
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
    // A normal map is a relief over the surface: its slopes are carried by cofactors, as the normal is. Directions have
    // length 1, and their lengths over that of the normal vary beside them.
    litUserMainEndVS: /* glsl */ `
#ifdef TANGENTS
vSkinbakeLengths = vec2(1.0);
#if defined(SKIN) && !defined(BATCH)
if (skinbake_isBaked()) {
    vec3 cotangent = skinbakeUnit * skinbakeLit.cotangent;
    vec3 cobitangent = skinbakeUnit * skinbakeLit.cobitangent;
    if (skinbakeConstants.x < 2.5) {
        // Cofactors are linear: those of t and b follow from those of t0, b0 and n0. t may lean from n0.
        vec3 t = normalize(vertex_tangent.xyz);
        vec3 b = vertex_tangent.w * normalize(cross(skinbakeRest.normal, t));
        vec3 c = cotangent;
        cotangent = dot(t, skinbakeRest.tangent) * c + dot(t, skinbakeRest.bitangent) * cobitangent
            + dot(t, skinbakeRest.normal) * skinbakeLit.normal;
        cobitangent = dot(b, skinbakeRest.tangent) * c + dot(b, skinbakeRest.bitangent) * cobitangent;
    }
    vTangentW = skinbakeCofactors * cotangent;
    vBinormalW = skinbakeCofactors * cobitangent;
    vSkinbakeLengths = vec2(length(vTangentW), length(vBinormalW)) / length(skinbakeCofactors * skinbakeLit.normal);
    vTangentW = normalize(vTangentW);
    vBinormalW = normalize(vBinormalW);
}
#endif
#endif
`,
    TBNPS: /* glsl */ `
#ifdef TBN_TANGENTS
varying vec2 vSkinbakeLengths;
#endif

void getTBN(vec3 tangent, vec3 binormal, vec3 normal)
{
    skinbake_usualTBN(tangent, binormal, normal);
#ifdef TBN_TANGENTS
#ifdef LIT_GGX_SPECULAR
    // Anisotropy follows the image of TANGENT itself.
    float side = dot(cross(dTBN[0], dTBN[1]), dTBN[2]) < 0.0 ? -1.0 : 1.0;
    dTBN[0] = side * normalize(cross(dTBN[1], dTBN[2]));
    dTBN[1] = side * cross(dTBN[2], dTBN[0]);
#else
    dTBN[0] *= vSkinbakeLengths.x;
    dTBN[1] *= vSkinbakeLengths.y;
#endif
#endif
}
`,
};

export const WGSL = {
    skinVS: /* wgsl */ `
uniform skinbakeConstants: vec4f;
uniform skinbakeStretch: mat3x3f;
var skinbakeData: texture_2d<uff>;

// A skinned vertex. Its vectors have any length. tangent and bitangent are the images of t0 and b0.
struct skinbake_Vertex {
    position: vec3<f32>,
    normal: vec3<f32>,
    tangent: vec3<f32>,
    bitangent: vec3<f32>,
    cotangent: vec3<f32>, // for normal maps: the cofactors of (t', b', T n0), of which normal is the third
    cobitangent: vec3<f32>,
}

// The tangent frame at rest.
struct skinbake_Frame {
    normal: vec3<f32>,
    tangent: vec3<f32>,
    bitangent: vec3<f32>,
    handedness: f32, // n0 = handedness * cross(t0, b0) / |t0|^2
}

// The frame of NORMAL, which must have length 1, and TANGENT.
fn skinbake_tangent_frame(n: vec3<f32>, tangent: vec4<f32>) -> skinbake_Frame {
    return skinbake_Frame(n, tangent.xyz, cross(n, tangent.xyz) * tangent.w, tangent.w);
}

// The frame that bake took from NORMAL alone. n must have length 1. Every product in a sum is exact, so a compiler
// that fuses multiply-adds gets the same bits. side is the last factor, because Mesa turns side * ((x * x) * a)
// into side * (x * (x * a)).
fn skinbake_frame(n: vec3<f32>) -> skinbake_Frame {
    let side = select(-1.0, 1.0, n.z >= 0.0); // 1 also at -0.0
    let a = -1.0 / (side + n.z);
    let b = (n.x * n.y) * a;
    let t0 = vec3<f32>(1.0 + ((n.x * n.x) * a) * side, side * b, -side * n.x);
    let b0 = vec3<f32>(b, side * (1.0 + ((n.y * n.y) * a) * side), -n.y);
    return skinbake_Frame(n, t0, b0, 1.0);
}

// The frame under morph targets, by the morphed normal n: NORMAL plus the weighted sum of its targets, of any
// length. The frame at rest turns by the smallest rotation that takes its normal to n. Do not use
// skinbake_frame(n): alpha and beta belong to the frame at rest.
fn skinbake_morphed_frame(rest: skinbake_Frame, n: vec3<f32>) -> skinbake_Frame {
    let square = dot(n, n);
    let normal = select(rest.normal, n * inverseSqrt(square), square > 0.0);
    let s = rest.normal + normal;
    let d = normal - rest.normal;
    let opposite = dot(s, s) < 1e-4; // then every half turn is the smallest: take the one about t0
    let k = select(2.0 / dot(s, s), 0.0, opposite);
    let tangent = rest.tangent - s * (k * dot(d, rest.tangent));
    let bitangent = rest.bitangent - s * (k * dot(d, rest.bitangent));
    return skinbake_Frame(normal, tangent, select(bitangent, -bitangent, opposite), rest.handedness);
}

// The upper 3x3 part of M.
fn skinbake_upper(M: mat4x4<f32>) -> mat3x3<f32> {
    return mat3x3<f32>(M[0].xyz, M[1].xyz, M[2].xyz);
}

// M p: the position p moved by the joint matrix M alone.
fn skinbake_moved(M: mat4x4<f32>, p: vec3<f32>) -> vec3<f32> {
    return M[0].xyz * p.x + (M[1].xyz * p.y + (M[2].xyz * p.z + M[3].xyz));
}

// The frame moves by the derivative of the skinned position along t0 and b0.
// M: the joint matrices of slots 0 to 3.
fn skinbake_lbs_accurate(p: vec3<f32>, frame: skinbake_Frame, M: array<mat4x4<f32>, 4>, weights_0: vec4<f32>,
        alpha_0: vec3<f32>, beta_0: vec3<f32>) -> skinbake_Vertex {
    let T = weights_0.x * skinbake_upper(M[0]) // 1
          + weights_0.y * skinbake_upper(M[1])
          + weights_0.z * skinbake_upper(M[2])
          + weights_0.w * skinbake_upper(M[3]);
    let q0 = skinbake_moved(M[0], p); // 2
    let q1 = skinbake_moved(M[1], p);
    let q2 = skinbake_moved(M[2], p);
    let q3 = skinbake_moved(M[3], p);
    let d1 = q1 - q0; // 3
    let d2 = q2 - q0;
    let d3 = q3 - q0;
    let tangent = T * frame.tangent + alpha_0.x * d1 + alpha_0.y * d2 + alpha_0.z * d3; // 4
    let bitangent = T * frame.bitangent + beta_0.x * d1 + beta_0.y * d2 + beta_0.z * d3; // 5
    let normal = frame.handedness * cross(tangent, bitangent); // 6
    let position = q0 + weights_0.y * d1 + weights_0.z * d2 + weights_0.w * d3; // 7
    let carried = T * frame.normal; // 8
    let cotangent = frame.handedness * cross(bitangent, carried); // 9
    let cobitangent = frame.handedness * cross(carried, tangent); // 10
    return skinbake_Vertex(position, normal, tangent, bitangent, cotangent, cobitangent);
}

// The unit dual quaternion of a rigid joint matrix. [0] is its real part (x, y, z, w), w the scalar; [1] is its
// dual part. Compute it on the host or in a pass over the joints: once per joint and frame, not per vertex.
// Dual quaternions have no scale. If all joint matrices share a uniform scale s, divide their upper 3x3 parts by
// s first, and skin s * p, s * t0, s * b0 in place of p, t0, b0.
fn skinbake_dual_quaternion(M: mat4x4<f32>) -> mat2x4<f32> {
    let d = vec3<f32>(M[0].x, M[1].y, M[2].z);
    let squares = 1.0 + vec4<f32>( // 4 * (x, y, z, w)^2
        d.x - d.y - d.z, d.y - d.z - d.x, d.z - d.x - d.y, d.x + d.y + d.z);
    let differences = vec3<f32>(M[1].z - M[2].y, M[2].x - M[0].z, M[0].y - M[1].x); // 4 w * (x, y, z)
    let sums = vec3<f32>(M[1].z + M[2].y, M[2].x + M[0].z, M[0].y + M[1].x); // 4 * (yz, zx, xy)
    var real = vec4<f32>(differences, squares.w);
    var largest = squares.w;
    if (squares.x > largest) {
        largest = squares.x;
        real = vec4<f32>(squares.x, sums.z, sums.y, differences.x);
    }
    if (squares.y > largest) {
        largest = squares.y;
        real = vec4<f32>(sums.z, squares.y, sums.x, differences.y);
    }
    if (squares.z > largest) {
        real = vec4<f32>(sums.y, sums.x, squares.z, differences.z);
    }
    real = normalize(real);
    let t = M[3].xyz;
    return mat2x4<f32>(real, 0.5 * vec4<f32>(cross(t, real.xyz) + real.w * t, -dot(t, real.xyz)));
}

// -1 if the real part of the joint points away from that of the pivot: q and -q are the same rotation.
fn skinbake_hemisphere(joint: mat2x4<f32>, pivot: mat2x4<f32>) -> f32 {
    return select(1.0, -1.0, dot(joint[0], pivot[0]) < 0.0);
}

// The derivative of p + delta along t, if the mix b changes at the rate db. delta = k h, and i is as in the caller.
fn skinbake_derivative(b: mat2x4<f32>, k: f32, p: vec3<f32>, i: vec3<f32>, delta: vec3<f32>, t: vec3<f32>,
        db: mat2x4<f32>) -> vec3<f32> {
    let di = b[0].w * t + db[1].xyz + cross(b[0].xyz, t) + db[0].w * p + cross(db[0].xyz, p);
    let dh = b[0].w * db[1].xyz + cross(b[0].xyz, di) + cross(db[0].xyz, i)
           + db[0].w * b[1].xyz - db[1].w * b[0].xyz - b[1].w * db[0].xyz - dot(b[0], db[0]) * delta;
    return t + k * dh;
}

// The frame moves by the derivative of the motion p' = p + delta of the mix, delta = k h,
//     i = r x p + r0 p + d, h = r x i + r0 d - d0 r, k = 2 / (r0^2 + |r|^2), the mix b = (r0, r, d0, d).
// Q: the dual quaternions of slots 0 to 3.
fn skinbake_dqs_exact(p: vec3<f32>, frame: skinbake_Frame, Q: array<mat2x4<f32>, 4>, weights_0: vec4<f32>,
        alpha_0: vec3<f32>, beta_0: vec3<f32>) -> skinbake_Vertex {
    let s1 = skinbake_hemisphere(Q[1], Q[0]); // 1
    let s2 = skinbake_hemisphere(Q[2], Q[0]);
    let s3 = skinbake_hemisphere(Q[3], Q[0]);
    let b = weights_0.x * Q[0]
          + (s1 * weights_0.y) * Q[1]
          + (s2 * weights_0.z) * Q[2]
          + (s3 * weights_0.w) * Q[3];
    let square = dot(b[0], b[0]);
    let k = select(2.0 / square, 2.0, square == 0.0); // 2
    let i = b[0].w * p + b[1].xyz + cross(b[0].xyz, p); // 3
    let delta = k * (b[0].w * b[1].xyz - b[1].w * b[0].xyz + cross(b[0].xyz, i));
    let position = p + delta;
    let D1 = s1 * Q[1] - Q[0]; // 4
    let D2 = s2 * Q[2] - Q[0];
    let D3 = s3 * Q[3] - Q[0];
    let db_t = alpha_0.x * D1 + alpha_0.y * D2 + alpha_0.z * D3; // 5
    let db_b = beta_0.x * D1 + beta_0.y * D2 + beta_0.z * D3; // 6
    let tangent = skinbake_derivative(b, k, p, i, delta, frame.tangent, db_t); // 7
    let bitangent = skinbake_derivative(b, k, p, i, delta, frame.bitangent, db_b); // 8
    let normal = frame.handedness * cross(tangent, bitangent); // 9
    let carried = frame.normal + k * cross(b[0].xyz, b[0].w * frame.normal + cross(b[0].xyz,
            frame.normal)); // 10
    let cotangent = frame.handedness * cross(bitangent, carried); // 11
    let cobitangent = frame.handedness * cross(carried, tangent); // 12
    return skinbake_Vertex(position, normal, tangent, bitangent, cotangent, cobitangent);
}

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

fn skinbake_turned(
    p: vec3f, rest: skinbake_Frame, M: array<mat4x4f, 4>, alpha: vec3f, beta: vec3f
) -> skinbake_Vertex {
    let joints = skinbake_related(M);
    let tangent = joints.stretch * rest.tangent;
    let frame = skinbake_Frame(
        joints.stretch * rest.normal, tangent, joints.stretch * rest.bitangent, rest.handedness);
    var v = skinbake_dqs_exact(joints.stretch * p, frame, joints.motions, skinbake_weights(), alpha, beta);
    v.position = joints.outer * v.position + M[0][3].xyz;
    v.tangent = joints.outer * v.tangent;
    v.bitangent = joints.outer * v.bitangent;
    v.normal = rest.handedness * skinbake_side(M) * cross(v.tangent, v.bitangent);
    v.cotangent = skinbake_side(M) * (skinbake_cofactors(joints.outer) * v.cotangent);
    v.cobitangent = skinbake_side(M) * (skinbake_cofactors(joints.outer) * v.cobitangent);
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
    normalVS: /* wgsl */ `
#ifdef TANGENTS
varying vSkinbakeLengths: vec2f;
#endif
#if defined(SKIN) && !defined(BATCH)
var<private> skinbakeLit: skinbake_Vertex;
var<private> skinbakeRest: skinbake_Frame;
var<private> skinbakeUnit: f32;
var<private> skinbakeCofactors: mat3x3f;

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
        v = skinbake_lbs_accurate(p, frame, M, skinbake_weights(), alpha, beta);
        v.normal *= skinbake_side(M);
        v.cotangent *= skinbake_side(M);
        v.cobitangent *= skinbake_side(M);
    }
    let world = skinbake_linear(skinbake_model());
    let normal = normalize((skinbake_cofactors(world) * v.normal) * select(1.0, -1.0, determinant(world) < 0.0));
    dNormalMatrix = world * (skinbake_outer(v.tangent, rest.tangent / dot(rest.tangent, rest.tangent))
            + skinbake_outer(v.bitangent, rest.bitangent / dot(rest.bitangent, rest.bitangent)));
#ifndef TANGENTS
    dNormalMatrix = dNormalMatrix + skinbake_outer(normal, n0);
#endif
    skinbakeLit = v;
    skinbakeRest = rest;
    skinbakeUnit = length(frame.tangent);
    skinbakeCofactors = skinbake_cofactors(world) * select(1.0, -1.0, determinant(world) < 0.0);
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
    litUserMainEndVS: /* wgsl */ `
#ifdef TANGENTS
output.vSkinbakeLengths = vec2f(1.0);
#if defined(SKIN) && !defined(BATCH)
if (skinbake_isBaked()) {
    var cotangent = skinbakeUnit * skinbakeLit.cotangent;
    var cobitangent = skinbakeUnit * skinbakeLit.cobitangent;
    if (uniform.skinbakeConstants.x < 2.5) {
        let t = normalize(vertex_tangent.xyz);
        let b = vertex_tangent.w * normalize(cross(skinbakeRest.normal, t));
        let c = cotangent;
        cotangent = dot(t, skinbakeRest.tangent) * c + dot(t, skinbakeRest.bitangent) * cobitangent
            + dot(t, skinbakeRest.normal) * skinbakeLit.normal;
        cobitangent = dot(b, skinbakeRest.tangent) * c + dot(b, skinbakeRest.bitangent) * cobitangent;
    }
    cotangent = skinbakeCofactors * cotangent;
    cobitangent = skinbakeCofactors * cobitangent;
    output.vSkinbakeLengths =
        vec2f(length(cotangent), length(cobitangent)) / length(skinbakeCofactors * skinbakeLit.normal);
    output.vTangentW = normalize(cotangent);
    output.vBinormalW = normalize(cobitangent);
}
#endif
#endif
`,
    TBNPS: /* wgsl */ `
#ifdef TBN_TANGENTS
varying vSkinbakeLengths: vec2f;
#endif

fn getTBN(tangent: vec3f, binormal: vec3f, normal: vec3f) {
    skinbake_usualTBN(tangent, binormal, normal);
#ifdef TBN_TANGENTS
#ifdef LIT_GGX_SPECULAR
    let side = select(1.0, -1.0, dot(cross(dTBN[0], dTBN[1]), dTBN[2]) < 0.0);
    let t = side * normalize(cross(dTBN[1], dTBN[2]));
    dTBN = mat3x3f(t, side * cross(dTBN[2], t), dTBN[2]);
#else
    dTBN = mat3x3f(vSkinbakeLengths.x * dTBN[0], vSkinbakeLengths.y * dTBN[1], dTBN[2]);
#endif
#endif
}
`,
};
