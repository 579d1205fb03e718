// Lighting for skinned meshes that skinbake has baked: dual quaternion skinning, exact lighting,
// 4 influences a vertex, normal frame, joints that scale, mirrored joints.
//
// Written by skinbake 0.1.0:
//     skinbake shader --lang wgsl --method dqs --lighting exact --influences 4 --frame normal --scaled-joints --mirrored-joints
//
// Algorithm 6 of skinbake: the exact derivative of the dual-quaternion blend, after M. Tarini, D. Panozzo,
// O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned Models", Computer Graphics Forum 33(2),
// 2014, doi:10.1111/cgf.12330. The numbers beside the lines come from `skinbake cost`.
// Dual quaternions: L. Kavan, S. Collins, J. Zara, C. O'Sullivan, "Skinning with Dual Quaternions", I3D 2007.
// Frame: T. Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.
// WGSL for WebGPU. Pure functions: no bindings and no module variables.
//
// Inputs of each vertex, in mesh space: the attributes as they are stored, before any joint matrix:
//     POSITION             vec3<f32>  p, in the file's unit of length
//     NORMAL               vec3<f32>  n0, of length 1: normalize() it if it is stored as integers
//     JOINTS_0             vec4<u32>  joints of slots 0 to 3
//     WEIGHTS_0            vec4<f32>  w of slots 0 to 3; over all slots they sum to 1
//     _SKINBAKE_ALPHA_0    vec3<f32>  alpha = grad w . t0 of slots 1 to 3, in 1 / unit of POSITION
//     _SKINBAKE_BETA_0     vec3<f32>  beta = grad w . b0 of the same slots
// alpha and beta of slot 0 are not stored: they are minus the sums over the other slots.
//
// Q[s] is the scaled motion of the joint in slot s, made of its joint matrix by skinbake_scaled_motion().
// Use:
//     let frame = skinbake_frame(normal);
//     let v = skinbake_dqs_scaled(position, frame, Q, weights_0, alpha_0, beta_0);
//     // v.position; normalize(v.normal); normalize(v.tangent)

// A skinned vertex. Its vectors have any length. tangent and bitangent are the images of t0 and b0.
struct skinbake_Vertex {
    position: vec3<f32>,
    normal: vec3<f32>,
    tangent: vec3<f32>,
    bitangent: vec3<f32>,
}

// The tangent frame at rest.
struct skinbake_Frame {
    normal: vec3<f32>,
    tangent: vec3<f32>,
    bitangent: vec3<f32>,
    handedness: f32, // n0 = handedness * cross(t0, b0) / |t0|^2
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

// The product of two quaternions.
fn skinbake_product(a: vec4<f32>, b: vec4<f32>) -> vec4<f32> {
    return vec4<f32>(a.w * b.xyz + b.w * a.xyz + cross(a.xyz, b.xyz), a.w * b.w - dot(a.xyz, b.xyz));
}

// A joint that may scale, shear or mirror. Quaternions are (x, y, z, w), w the scalar. turn is the rotation of the joint
// matrix, and the columns of moved are those of the matrix times it.
struct skinbake_ScaledMotion {
    moved: mat4x4<f32>,
    turn: vec4<f32>,
}

// A motion that has a rotation. A joint that leaves a line or a point, as at scale 0, has none: its turn is 0, and moved has
// the columns of the matrix. It takes another's.
fn skinbake_turning(given: skinbake_ScaledMotion, turn: vec4<f32>) -> skinbake_ScaledMotion {
    if (dot(given.turn, given.turn) > 0.0) { return given; }
    var Q = given;
    for (var i = 0; i < 4; i++) { Q.moved[i] = skinbake_product(Q.moved[i], turn); }
    Q.turn = turn;
    return Q;
}

// The vector of a over a quaternion, which is given as itself / its squared length.
fn skinbake_over(a: vec4<f32>, divisor: vec4<f32>) -> vec3<f32> {
    return divisor.w * a.xyz - a.w * divisor.xyz + cross(divisor.xyz, a.xyz);
}

// The unit quaternion of the rotation R in the polar decomposition M = R S, or in that of -M where M mirrors, by Newton's
// iteration (Higham 1986). A joint that flattens does not mirror. One that leaves a line or a point has no
// rotation: zeros.
fn skinbake_turn(M: mat4x4<f32>) -> vec4<f32> {
    var R = mat3x3<f32>(M[0].xyz, M[1].xyz, M[2].xyz);
    R = R * (1.0 / max(sqrt(dot(R[0], R[0]) + dot(R[1], R[1]) + dot(R[2], R[2])), 1e-30));
    let C = mat3x3<f32>(cross(R[1], R[2]), cross(R[2], R[0]), cross(R[0], R[1]));
    let area = sqrt(dot(C[0], C[0]) + dot(C[1], C[1]) + dot(C[2], C[2]));
    if (area <= 1e-6) { return vec4<f32>(); }
    // The cofactors have the same rotation, and an extent where M has none.
    R = R * select(1.0, -1.0, dot(R[0], C[0]) < -1e-6 * area) + C * (1.0 / area);
    R = R * (1.0 / pow(dot(cross(R[0], R[1]), R[2]), 1.0 / 3.0));
    for (var i = 0; i < 12; i++) {
        // The volume is at least 1, so the squares sum to 3 where R is a rotation.
        let is_near = dot(R[0], R[0]) + dot(R[1], R[1]) + dot(R[2], R[2]) < 3.00001;
        let cofactors = mat3x3<f32>(cross(R[1], R[2]), cross(R[2], R[0]), cross(R[0], R[1]));
        R = (R + cofactors * (1.0 / dot(R[0], cofactors[0]))) * 0.5;
        if (is_near) { break; }
    }
    return skinbake_dual_quaternion(mat4x4<f32>(
        vec4<f32>(R[0], 0.0), vec4<f32>(R[1], 0.0), vec4<f32>(R[2], 0.0), vec4<f32>(0.0, 0.0, 0.0, 1.0)))[0];
}

// The motion of a joint matrix. Compute it on the host, by joint_scaled_motions() of skinbake's Python package, or in a
// pass over the joints: once per joint and frame, not per vertex.
fn skinbake_scaled_motion(M: mat4x4<f32>) -> skinbake_ScaledMotion {
    let turn = skinbake_turn(M);
    let still = mat4x4<f32>(vec4<f32>(M[0].xyz, 0.0), vec4<f32>(M[1].xyz, 0.0), vec4<f32>(M[2].xyz, 0.0),
            vec4<f32>(M[3].xyz, 0.0));
    let Q = skinbake_ScaledMotion(still, vec4<f32>());
    if (dot(turn, turn) > 0.0) { return skinbake_turning(Q, turn); }
    return Q;
}

// The frame moves by the derivative of the quotient p' = g / b: b mixes the joints' turns, and g what M p is times them.
// given: the scaled motions of slots 0 to 3.
fn skinbake_dqs_scaled(p: vec3<f32>, frame: skinbake_Frame, given: array<skinbake_ScaledMotion, 4>,
        weights_0: vec4<f32>, alpha_0: vec3<f32>, beta_0: vec3<f32>) -> skinbake_Vertex {
    var Q = given;
    var pivot = Q[0].turn;
    if (dot(pivot, pivot) == 0.0) { pivot = Q[1].turn; }
    if (dot(pivot, pivot) == 0.0) { pivot = Q[2].turn; }
    if (dot(pivot, pivot) == 0.0) { pivot = Q[3].turn; }
    if (dot(pivot, pivot) == 0.0) { pivot.w = 1.0; }
    Q[0] = skinbake_turning(Q[0], pivot);
    Q[1] = skinbake_turning(Q[1], pivot);
    Q[2] = skinbake_turning(Q[2], pivot);
    Q[3] = skinbake_turning(Q[3], pivot);
    let s1 = select(1.0, -1.0, dot(Q[1].turn, Q[0].turn) < 0.0); // 1: q and -q are the same rotation
    let s2 = select(1.0, -1.0, dot(Q[2].turn, Q[0].turn) < 0.0);
    let s3 = select(1.0, -1.0, dot(Q[3].turn, Q[0].turn) < 0.0);
    let b = weights_0.x * Q[0].turn
          + (s1 * weights_0.y) * Q[1].turn
          + (s2 * weights_0.z) * Q[2].turn
          + (s3 * weights_0.w) * Q[3].turn;
    let T = weights_0.x * Q[0].moved
          + (s1 * weights_0.y) * Q[1].moved
          + (s2 * weights_0.z) * Q[2].moved
          + (s3 * weights_0.w) * Q[3].moved;
    let square = dot(b, b);
    let divisor = b / select(1.0, square, square > 0.0); // 2
    let g0 = Q[0].moved * vec4<f32>(p, 1.0); // 3
    let g1 = Q[1].moved * vec4<f32>(p, 1.0);
    let g2 = Q[2].moved * vec4<f32>(p, 1.0);
    let g3 = Q[3].moved * vec4<f32>(p, 1.0);
    let m1 = s1 * g1 - g0; // 4
    let r1 = s1 * Q[1].turn - Q[0].turn;
    let m2 = s2 * g2 - g0;
    let r2 = s2 * Q[2].turn - Q[0].turn;
    let m3 = s3 * g3 - g0;
    let r3 = s3 * Q[3].turn - Q[0].turn;
    let g = g0 + weights_0.y * m1 + weights_0.z * m2 + weights_0.w * m3; // 5
    let ratio = vec4<f32>(skinbake_over(g, divisor), dot(g, divisor));
    let tangent = skinbake_over(T * vec4<f32>(frame.tangent, 0.0) + alpha_0.x * m1 + alpha_0.y * m2
            + alpha_0.z * m3 - skinbake_product(ratio, alpha_0.x * r1 + alpha_0.y * r2 + alpha_0.z * r3),
            divisor); // 6
    let bitangent = skinbake_over(T * vec4<f32>(frame.bitangent, 0.0) + beta_0.x * m1 + beta_0.y * m2
            + beta_0.z * m3 - skinbake_product(ratio, beta_0.x * r1 + beta_0.y * r2 + beta_0.z * r3),
            divisor); // 7
    // A joint that mirrors turns t x b to the inside.
    let x = skinbake_over(T[0], divisor);
    let y = skinbake_over(T[1], divisor);
    let outside = select(1.0, -1.0, dot(cross(x, y), skinbake_over(T[2], divisor)) < 0.0);
    let normal = outside * cross(tangent, bitangent); // 8
    return skinbake_Vertex(ratio.xyz, normal, tangent, bitangent);
}
