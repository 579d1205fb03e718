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
