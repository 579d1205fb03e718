// Matrices of 4 × 4 numbers, column by column, and quaternions (x, y, z, w).

export const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

export function product(a, b) {
    const found = new Array(16);
    for (let column = 0; column < 16; column += 4) {
        for (let row = 0; row < 4; row++) {
            found[column + row] =
                a[row] * b[column] +
                a[4 + row] * b[column + 1] +
                a[8 + row] * b[column + 2] +
                a[12 + row] * b[column + 3];
        }
    }
    return found;
}

// The matrix of a translation, after a rotation, after a scale.
export function composed([tx, ty, tz], [x, y, z, w], [sx, sy, sz]) {
    return [
        (1 - 2 * (y * y + z * z)) * sx, 2 * (x * y + z * w) * sx, 2 * (x * z - y * w) * sx, 0,
        2 * (x * y - z * w) * sy, (1 - 2 * (x * x + z * z)) * sy, 2 * (y * z + x * w) * sy, 0,
        2 * (x * z + y * w) * sz, 2 * (y * z - x * w) * sz, (1 - 2 * (x * x + y * y)) * sz, 0,
        tx, ty, tz, 1,
    ];
}

// A point (x, y, z, 1) moved: four numbers.
export function movedBy(m, [x, y, z]) {
    return [0, 1, 2, 3].map((row) => m[row] * x + m[4 + row] * y + m[8 + row] * z + m[12 + row]);
}

// The columns of the upper 3 × 3 part.
export const columnsOf = (m) => [0, 4, 8].map((start) => [m[start], m[start + 1], m[start + 2]]);

// The determinant of the upper 3 × 3 part.
export function determinant(m) {
    const [a, b, c] = columnsOf(m);
    return dot(a, cross(b, c));
}

export function perspective(angle, aspect, near, far) {
    const f = 1 / Math.tan(angle / 2);
    const depth = 1 / (near - far);
    return [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (near + far) * depth, -1, 0, 0, 2 * near * far * depth, 0];
}

export function viewFrom(eye, [x, y, z]) {
    return [
        x[0], y[0], z[0], 0, x[1], y[1], z[1], 0, x[2], y[2], z[2], 0,
        -dot(x, eye), -dot(y, eye), -dot(z, eye), 1,
    ];
}

export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const plus = (a, b, factor = 1) => [a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]];
export const cross = (a, b) => [
    a[1] * b[2] - a[2] * b[1],
    a[2] * b[0] - a[0] * b[2],
    a[0] * b[1] - a[1] * b[0],
];

export function normalised(a) {
    const length = Math.hypot(...a) || 1;
    return a.map((value) => value / length);
}

// Spherical interpolation on the shorter way.
export function slerp(a, b, share) {
    let cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
    const sign = cosine < 0 ? -1 : 1;
    cosine *= sign;
    let [first, second] = [1 - share, share];
    if (cosine < 1 - 1e-9) {
        const angle = Math.acos(cosine);
        [first, second] = [Math.sin(first * angle) / Math.sin(angle), Math.sin(second * angle) / Math.sin(angle)];
    }
    return normalised(a.map((value, i) => first * value + sign * second * b[i]));
}

const FLATTENED = 1e-6; // as in skinbake's dual_quaternions.py

// The unit dual quaternion of a rigid matrix whose scale has been divided out: its real part, its dual part.
export function dualQuaternion(m, scale) {
    const at = (row, column) => m[4 * column + row] / scale;
    const [xx, yy, zz] = [at(0, 0), at(1, 1), at(2, 2)];
    // Four times the products of the components; the largest square has no cancellation (Shepperd 1978).
    const squares = [1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz, 1 + xx + yy + zz];
    const [xy, xz, yz] = [at(1, 0) + at(0, 1), at(0, 2) + at(2, 0), at(2, 1) + at(1, 2)];
    const [xw, yw, zw] = [at(2, 1) - at(1, 2), at(0, 2) - at(2, 0), at(1, 0) - at(0, 1)];
    const rows = [
        [squares[0], xy, xz, xw],
        [xy, squares[1], yz, yw],
        [xz, yz, squares[2], zw],
        [xw, yw, zw, squares[3]],
    ];
    const real = normalised(rows[squares.indexOf(Math.max(...squares))]);
    const t = [m[12], m[13], m[14]];
    const turned = cross(t, real);
    const dual = turned.map((value, i) => 0.5 * (value + real[3] * t[i]));
    return [...real, ...dual, -0.5 * dot(t, real)];
}

// The unit quaternion of the rotation R in the polar decomposition M = R S, or in that of -M where M mirrors, by Newton's
// iteration (Higham 1986). A joint that flattens does not mirror. One that leaves a line or a point has no
// rotation: zeros.
export function polarQuaternion(m) {
    const mixed = (a, x, b, y) => a.map((column, i) => column.map((value, row) => x * value + y * b[i][row]));
    const over = (columns, divisor) => mixed(columns, 1 / divisor, columns, 0);
    const cofactorsOf = ([a, b, c]) => [cross(b, c), cross(c, a), cross(a, b)];
    const lengthOf = (columns) => Math.hypot(...columns.flat());
    let turn = over(columnsOf(m), lengthOf(columnsOf(m)) || 1);
    let cofactors = cofactorsOf(turn);
    const area = lengthOf(cofactors);
    if (!(area > FLATTENED)) return [0, 0, 0, 0];
    // The cofactors have the same rotation, and an extent where M has none.
    turn = mixed(turn, dot(turn[0], cofactors[0]) < -FLATTENED * area ? -1 : 1, cofactors, 1 / area);
    turn = over(turn, Math.cbrt(dot(turn[0], cofactorsOf(turn)[0])));
    for (let step = 0; step < 12; step++) {
        cofactors = cofactorsOf(turn);
        turn = mixed(turn, 0.5, cofactors, 0.5 / dot(turn[0], cofactors[0]));
    }
    const [x, y, z] = turn;
    return dualQuaternion([...x, 0, ...y, 0, ...z, 0, 0, 0, 0, 1], 1).slice(0, 4);
}
