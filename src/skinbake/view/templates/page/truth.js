// The true normals of a deformed mesh by its triangles, as skinbake verify measures them (docs/lighting.md).
//
// The normal of a vertex is the mean of its triangles' normals, weighted by their angles (Thürmer and Wüthrich
// 1998). The authored normal leans from it. It is carried by the cofactor of the map that two tangents show, which
// are measured on the triangles with the weights of Max 1999. Nothing here reads α or β, or runs on the GPU.

import { cross, determinant, normalised } from './matrices.js';

const CREASE = (15 * Math.PI) / 180;
const DEGENERATE = 1e-10;
const FLAT = 1e10;
const FLAT_FRAME = 1e-6; // The sine between two tangents below which they span no plane.
const CANCELLED = 1e-9; // Radians. Triangles that sum to less cancel out: each is there twice, once for each side.
const SHRUNK = 1e-12; // The largest entry of a joint's linear part up to which what it leaves of a surface is rounding.
const HIDDEN = 1e-6; // The weight of all other joints up to which a vertex is hidden: adopted ones have less.
const CROWDED = 4096; // As in bake: of more different normals at one place, only equal ones are one.
const TINY_WEIGHT = 1.5 * 2 ** -30; // The weight of an adopted joint does not tell copies of a vertex apart.

// One surface: the primitives that one skin draws. Primitives with morph targets are a surface of their own.
export class Surface {
    constructor(primitives) {
        this.primitives = primitives;
        let count = 0;
        this.starts = primitives.map((primitive) => (count += primitive.count) - primitive.count);
        this.count = count;
        this.rest = new Float64Array(joined(primitives, 'positions'));
        this.normals = new Float64Array(joined(primitives, 'normals'));
        this.triangles = soundTriangles(this.rest, offsetTriangles(primitives, this.starts));
        this.classes = weldClasses(primitives, this.starts, this.rest, this.normals);
        this.areas = restAreas(this.rest, this.triangles, count);
        this.dominant = dominantJoints(primitives, this.starts, count);
        this.listCorners();
        this.measureTangents();
        this.sums = new Float64Array(3 * this.classCount);
        this.edges = new Float64Array(2 * this.triangles.length);
        this.found = new Float32Array(4 * count);
        this.carried = new Float64Array(3 * count);
        this.carry(this.rest, this.normals);
    }

    // The corners of each class of vertices that are one point of the surface.
    listCorners() {
        const { triangles, classes } = this;
        this.classCount = classes.reduce((most, one) => Math.max(most, one), -1) + 1;
        const ends = new Int32Array(this.classCount + 1);
        for (const vertex of triangles) ends[classes[vertex] + 1]++;
        for (let i = 0; i < this.classCount; i++) ends[i + 1] += ends[i];
        const next = ends.slice();
        this.corners = new Int32Array(triangles.length);
        triangles.forEach((vertex, corner) => (this.corners[next[classes[vertex]]++] = corner));
        this.ends = ends;
    }

    // The derivatives along two tangents of each vertex, as factors of the two edges of each triangle around it.
    measureTangents() {
        const { normals, triangles, classes, ends, corners, count } = this;
        const { weights, along } = measuredTriangles(this.rest, triangles);
        const totals = new Float64Array(this.classCount);
        triangles.forEach((vertex, corner) => (totals[classes[vertex]] += weights[corner]));
        const starts = new Int32Array(count + 1);
        for (let vertex = 0; vertex < count; vertex++) {
            const own = classes[vertex];
            starts[vertex + 1] = starts[vertex] + ends[own + 1] - ends[own];
        }
        const factors = new Float64Array(4 * starts[count]);
        for (let vertex = 0; vertex < count; vertex++) {
            const tangents = perpendicular(normals, 3 * vertex);
            const own = classes[vertex];
            for (let i = ends[own], at = 4 * starts[vertex]; i < ends[own + 1]; i++) {
                const corner = corners[i];
                const share = weights[corner] / totals[own];
                const from = 2 * (corner - (corner % 3));
                for (const [x, y, z] of tangents) {
                    factors[at++] = share * (along[from] * x + along[from + 1] * y + along[from + 2] * z);
                    factors[at++] = share * (along[from + 3] * x + along[from + 4] * y + along[from + 5] * z);
                }
            }
        }
        Object.assign(this, { factors, factorStarts: starts });
    }

    // Keep the coordinates of the normals in the frames before skinning: at rest, or under morph targets.
    // A vertex whose triangles cancel out has none.
    carry(positions, normals) {
        this.measure(positions);
        const { carried, count, sums } = this;
        for (let i = 0; i < sums.length; i += 3) {
            if (Math.hypot(sums[i], sums[i + 1], sums[i + 2]) < CANCELLED) sums.fill(0, i, i + 3);
        }
        const frame = new Float64Array(10);
        for (let vertex = 0; vertex < count; vertex++) {
            this.measureFrame(vertex, frame);
            const at = 3 * vertex;
            const length = Math.hypot(normals[at], normals[at + 1], normals[at + 2]);
            const [x, y, z] = [normals[at] / length, normals[at + 1] / length, normals[at + 2] / length];
            const [ax, ay, az, bx, by, bz, nx, ny, nz, area] = frame;
            const up = nx * x + ny * y + nz * z;
            const root = Math.sign(area) * Math.sqrt(Math.abs(area));
            carried[at] = (ax * x + ay * y + az * z - (ax * nx + ay * ny + az * nz) * up) / root;
            carried[at + 1] = (bx * x + by * y + bz * z - (bx * nx + by * ny + bz * nz) * up) / root;
            carried[at + 2] = Math.sign(area) * up;
        }
    }

    // Sum the triangles' normals by class, and keep their edges.
    measure(positions) {
        const { triangles, classes, sums, edges } = this;
        sums.fill(0);
        for (let t = 0; t < triangles.length; t += 3) {
            const [a, b, c] = [3 * triangles[t], 3 * triangles[t + 1], 3 * triangles[t + 2]];
            const ex = positions[b] - positions[a], ey = positions[b + 1] - positions[a + 1], ez = positions[b + 2] - positions[a + 2];
            const fx = positions[c] - positions[a], fy = positions[c + 1] - positions[a + 1], fz = positions[c + 2] - positions[a + 2];
            const at = 2 * t;
            edges[at] = ex; edges[at + 1] = ey; edges[at + 2] = ez;
            edges[at + 3] = fx; edges[at + 4] = fy; edges[at + 5] = fz;
            const nx = ey * fz - ez * fy, ny = ez * fx - ex * fz, nz = ex * fy - ey * fx;
            const area = Math.sqrt(nx * nx + ny * ny + nz * nz);
            const ee = ex * ex + ey * ey + ez * ez, ef = ex * fx + ey * fy + ez * fz, ff = fx * fx + fy * fy + fz * fz;
            if (!(Math.abs(ef / area) < FLAT && Math.abs((ee - ef) / area) < FLAT)) continue;
            for (let corner = 0; corner < 3; corner++) {
                const along = corner === 0 ? ef : corner === 1 ? ee - ef : ff - ef;
                const share = Math.atan2(area, along) / area;
                const place = 3 * classes[triangles[t + corner]];
                sums[place] += share * nx;
                sums[place + 1] += share * ny;
                sums[place + 2] += share * nz;
            }
        }
    }

    // Put two tangents a and b of a vertex, the triangles' normal n, and the signed area of a and b at right angles
    // to n into frame; the area is not a number where there is none.
    measureFrame(vertex, frame) {
        const { sums, edges, factors, factorStarts: starts, classes, ends, corners } = this;
        const own = classes[vertex];
        let nx = sums[3 * own], ny = sums[3 * own + 1], nz = sums[3 * own + 2];
        const length = Math.sqrt(nx * nx + ny * ny + nz * nz);
        nx /= length; ny /= length; nz /= length;
        let ax = 0, ay = 0, az = 0, bx = 0, by = 0, bz = 0;
        for (let i = ends[own], at = 4 * starts[vertex]; i < ends[own + 1]; i++, at += 4) {
            const edge = 2 * (corners[i] - (corners[i] % 3));
            const ex = edges[edge], ey = edges[edge + 1], ez = edges[edge + 2];
            const fx = edges[edge + 3], fy = edges[edge + 4], fz = edges[edge + 5];
            const ae = factors[at], af = factors[at + 1], be = factors[at + 2], bf = factors[at + 3];
            ax += ae * ex + af * fx; ay += ae * ey + af * fy; az += ae * ez + af * fz;
            bx += be * ex + bf * fx; by += be * ey + bf * fy; bz += be * ez + bf * fz;
        }
        frame[0] = ax; frame[1] = ay; frame[2] = az;
        frame[3] = bx; frame[4] = by; frame[5] = bz;
        frame[6] = nx; frame[7] = ny; frame[8] = nz;
        const area = (ay * bz - az * by) * nx + (az * bx - ax * bz) * ny + (ax * by - ay * bx) * nz;
        const size = (ax * ax + ay * ay + az * az) * (bx * bx + by * by + bz * bz);
        frame[9] = area * area > FLAT_FRAME * FLAT_FRAME * size ? area : NaN;
    }

    // True unit normals (x, y, z, 1) of all vertices; 0 where there is none.
    trueNormals(positions, matrices) {
        this.measure(positions);
        const { carried, found, count, dominant } = this;
        const mirrors = matrices.map((matrix) => determinant(matrix) < 0);
        const isMirrored = mirrors.some(Boolean);
        const points = matrices.map((m) => [0, 1, 2, 4, 5, 6, 8, 9, 10].every((i) => Math.abs(m[i]) <= SHRUNK));
        const hidden = points.some(Boolean) ? hiddenVertices(this.primitives, this.starts, count, points) : null;
        const frame = new Float64Array(10);
        for (let vertex = 0; vertex < count; vertex++) {
            this.measureFrame(vertex, frame);
            const ax = frame[0], ay = frame[1], az = frame[2], bx = frame[3], by = frame[4], bz = frame[5];
            const nx = frame[6], ny = frame[7], nz = frame[8], area = frame[9];
            // b × n and n × a over the root of the area, as the columns of a cofactor. Folds and mirrors turn n.
            const root = 1 / Math.sqrt(Math.abs(area));
            const a = root * carried[3 * vertex], b = root * carried[3 * vertex + 1];
            const side = isMirrored && mirrors[dominant[vertex]] ? -1 : 1;
            const up = side * Math.sign(area) * carried[3 * vertex + 2];
            const x = a * (by * nz - bz * ny) + b * (ny * az - nz * ay) + up * nx;
            const y = a * (bz * nx - bx * nz) + b * (nz * ax - nx * az) + up * ny;
            const z = a * (bx * ny - by * nx) + b * (nx * ay - ny * ax) + up * nz;
            const length = Math.sqrt(x * x + y * y + z * z);
            const at = 4 * vertex;
            found[at] = x / length;
            found[at + 1] = y / length;
            found[at + 2] = z / length;
            found[at + 3] = 1;
            if (hidden?.[vertex] || !Number.isFinite(found[at])) found.fill(0, at, at + 4);
        }
        return found;
    }
}

// The positions of a primitive, or of every so many of its vertices from the first one on, moved by linear blending or
// by dual quaternions; written from a place on.
export function skinned(primitive, positions, matrices, motions, found, { start = 0, first = 0, step = 1 } = {}) {
    const { joints, weights, slots, count } = primitive;
    for (let vertex = first, at = 3 * start; vertex < count; vertex += step, at += 3) {
        const x = positions[3 * vertex], y = positions[3 * vertex + 1], z = positions[3 * vertex + 2];
        if (motions?.turns) byTurns(primitive, vertex, x, y, z, matrices, motions.turns, found, at);
        else if (motions) byQuaternions(primitive, vertex, x, y, z, motions, found, at);
        else {
            let px = 0, py = 0, pz = 0, sum = 0;
            for (let i = slots * vertex; i < slots * (vertex + 1); i++) {
                const w = weights[i];
                if (w === 0) continue;
                const m = matrices[joints[i]];
                px += w * (m[0] * x + m[4] * y + m[8] * z + m[12]);
                py += w * (m[1] * x + m[5] * y + m[9] * z + m[13]);
                pz += w * (m[2] * x + m[6] * y + m[10] * z + m[14]);
                sum += w;
            }
            // The sum of float32 weights is nearly 1, and a model may be far from the origin.
            found[at] = px / sum; found[at + 1] = py / sum; found[at + 2] = pz / sum;
        }
    }
}

// Where joints scale: the quotient of Σ w (M p) r and Σ w r, both of one hemisphere.
function byTurns({ joints, weights, slots }, vertex, x, y, z, matrices, turns, found, at) {
    // A joint without a rotation takes that of the first slot that has one.
    const hasTurn = (joint) => turns[joint].some((value) => value !== 0);
    const pivot = turns[joints.subarray(slots * vertex, slots * (vertex + 1)).find(hasTurn)] ?? [0, 0, 0, 1];
    let gx = 0, gy = 0, gz = 0, g = 0, bx = 0, by = 0, bz = 0, b = 0;
    for (let i = slots * vertex; i < slots * (vertex + 1); i++) {
        const w = weights[i];
        if (w === 0) continue;
        const m = matrices[joints[i]];
        const [rx, ry, rz, r] = hasTurn(joints[i]) ? turns[joints[i]] : pivot;
        const side = rx * pivot[0] + ry * pivot[1] + rz * pivot[2] + r * pivot[3] < 0 ? -w : w;
        const px = m[0] * x + m[4] * y + m[8] * z + m[12];
        const py = m[1] * x + m[5] * y + m[9] * z + m[13];
        const pz = m[2] * x + m[6] * y + m[10] * z + m[14];
        gx += side * (r * px + py * rz - pz * ry);
        gy += side * (r * py + pz * rx - px * rz);
        gz += side * (r * pz + px * ry - py * rx);
        g -= side * (px * rx + py * ry + pz * rz);
        bx += side * rx; by += side * ry; bz += side * rz; b += side * r;
    }
    const square = bx * bx + by * by + bz * bz + b * b;
    found[at] = (b * gx - g * bx + by * gz - bz * gy) / square;
    found[at + 1] = (b * gy - g * by + bz * gx - bx * gz) / square;
    found[at + 2] = (b * gz - g * bz + bx * gy - by * gx) / square;
}

function byQuaternions({ joints, weights, slots }, vertex, x, y, z, { scale, quaternions }, found, at) {
    const pivot = quaternions[joints[slots * vertex]];
    const b = [0, 0, 0, 0, 0, 0, 0, 0];
    for (let i = slots * vertex; i < slots * (vertex + 1); i++) {
        const w = weights[i];
        if (w === 0) continue;
        const q = quaternions[joints[i]];
        const side = q[0] * pivot[0] + q[1] * pivot[1] + q[2] * pivot[2] + q[3] * pivot[3] < 0 ? -w : w;
        for (let k = 0; k < 8; k++) b[k] += side * q[k];
    }
    const [rx, ry, rz, r, dx, dy, dz, d] = b;
    const k = 2 / (rx * rx + ry * ry + rz * rz + r * r);
    x *= scale; y *= scale; z *= scale;
    const ix = r * x + dx + ry * z - rz * y, iy = r * y + dy + rz * x - rx * z, iz = r * z + dz + rx * y - ry * x;
    found[at] = x + k * (r * dx - d * rx + ry * iz - rz * iy);
    found[at + 1] = y + k * (r * dy - d * ry + rz * ix - rx * iz);
    found[at + 2] = z + k * (r * dz - d * rz + rx * iy - ry * ix);
}

// One array of all primitives.
export function joined(primitives, name) {
    const found = new Float32Array(primitives.reduce((sum, one) => sum + one[name].length, 0));
    let at = 0;
    for (const one of primitives) {
        found.set(one[name], at);
        at += one[name].length;
    }
    return found;
}

function offsetTriangles(primitives, starts) {
    return Int32Array.from(primitives.flatMap(({ triangles }, number) => Array.from(triangles, (vertex) => vertex + starts[number])));
}

// The triangles that are no line and no point.
function soundTriangles(positions, triangles) {
    let length = 0;
    for (let t = 0; t < triangles.length; t += 3) {
        const [a, b, c] = [3 * triangles[t], 3 * triangles[t + 1], 3 * triangles[t + 2]];
        const longest = Math.max(apart(positions, a, b), apart(positions, b, c), apart(positions, c, a));
        if (!(doubledArea(positions, a, b, c) > DEGENERATE * longest)) continue;
        triangles.copyWithin(length, t, t + 3);
        length += 3;
    }
    return triangles.subarray(0, length);
}

// The squared distance of two places.
function apart(positions, a, b) {
    const [x, y, z] = [positions[a] - positions[b], positions[a + 1] - positions[b + 1], positions[a + 2] - positions[b + 2]];
    return x * x + y * y + z * z;
}

function doubledArea(positions, a, b, c) {
    const ex = positions[b] - positions[a], ey = positions[b + 1] - positions[a + 1], ez = positions[b + 2] - positions[a + 2];
    const fx = positions[c] - positions[a], fy = positions[c + 1] - positions[a + 1], fz = positions[c + 2] - positions[a + 2];
    return Math.hypot(ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx);
}

// The weights of corners (Max 1999), and by triangle two vectors: what changes linearly over it changes along t
// by its difference on the first edge times the first vector's part along t, and likewise on the second.
function measuredTriangles(positions, triangles) {
    const weights = new Float64Array(triangles.length);
    const along = new Float64Array(2 * triangles.length);
    for (let t = 0; t < triangles.length; t += 3) {
        const [a, b, c] = [3 * triangles[t], 3 * triangles[t + 1], 3 * triangles[t + 2]];
        const ex = positions[b] - positions[a], ey = positions[b + 1] - positions[a + 1], ez = positions[b + 2] - positions[a + 2];
        const fx = positions[c] - positions[a], fy = positions[c + 1] - positions[a + 1], fz = positions[c + 2] - positions[a + 2];
        const nx = ey * fz - ez * fy, ny = ez * fx - ex * fz, nz = ex * fy - ey * fx;
        const size = nx * nx + ny * ny + nz * nz;
        const area = Math.sqrt(size);
        const [ab, ac, bc] = [ex * ex + ey * ey + ez * ez, fx * fx + fy * fy + fz * fz, apart(positions, b, c)];
        weights[t] = area / (ab * ac);
        weights[t + 1] = area / (ab * bc);
        weights[t + 2] = area / (ac * bc);
        const at = 2 * t;
        along[at] = (fy * nz - fz * ny) / size;
        along[at + 1] = (fz * nx - fx * nz) / size;
        along[at + 2] = (fx * ny - fy * nx) / size;
        along[at + 3] = (ny * ez - nz * ey) / size;
        along[at + 4] = (nz * ex - nx * ez) / size;
        along[at + 5] = (nx * ey - ny * ex) / size;
    }
    return { weights, along };
}

// Two unit vectors at right angles to a normal: its product with the axis that it is the farthest from, and the
// product of both.
function perpendicular(normals, at) {
    const [x, y, z] = [normals[at], normals[at + 1], normals[at + 2]];
    const [ax, ay, az] = [Math.abs(x), Math.abs(y), Math.abs(z)];
    const t = normalised(ax <= ay && ax <= az ? [0, -z, y] : ay <= az ? [z, 0, -x] : [-y, x, 0]);
    return [t, normalised(cross([x, y, z], t))];
}

function restAreas(positions, triangles, count) {
    const areas = new Float64Array(count);
    for (let t = 0; t < triangles.length; t += 3) {
        const corners = triangles.subarray(t, t + 3);
        const third = doubledArea(positions, ...corners.map((corner) => 3 * corner)) / 6;
        for (const corner of corners) areas[corner] += third;
    }
    return areas;
}

// The joint of the largest weight of each vertex.
function dominantJoints(primitives, starts, count) {
    const dominant = new Uint16Array(count);
    primitives.forEach(({ joints, weights, slots, count: own }, number) => {
        for (let vertex = 0; vertex < own; vertex++) {
            let most = slots * vertex;
            for (let i = most + 1; i < slots * (vertex + 1); i++) if (weights[i] > weights[most]) most = i;
            dominant[starts[number] + vertex] = joints[most];
        }
    });
    return dominant;
}

// Tell which vertices have no joint but those that leave a point.
function hiddenVertices(primitives, starts, count, points) {
    const hidden = new Uint8Array(count);
    primitives.forEach(({ joints, weights, slots, count: own }, number) => {
        for (let vertex = 0; vertex < own; vertex++) {
            let left = 0;
            for (let i = slots * vertex; i < slots * (vertex + 1); i++) if (!points[joints[i]]) left += weights[i];
            hidden[starts[number] + vertex] = left <= HIDDEN;
        }
    });
    return hidden;
}

// Number the vertices that are one point: equal places and influences, normals joined by a chain of small angles.
function weldClasses(primitives, starts, positions, normals) {
    const count = positions.length / 3;
    const parents = new Int32Array(count).map((_, i) => i);
    const root = (vertex) => {
        while (parents[vertex] !== vertex) vertex = parents[vertex] = parents[parents[vertex]];
        return vertex;
    };
    for (const group of samePlaces(positions)) {
        // Equal copies are one at once, so that few are left to compare by angle.
        const known = new Map();
        for (const vertex of group) {
            const number = starts.findLastIndex((start) => start <= vertex);
            const influences = influencesOf(primitives[number], vertex - starts[number]);
            const normal = normals.subarray(3 * vertex, 3 * vertex + 3).join();
            const key = `${influences} ${normal}`;
            if (known.has(key)) parents[root(vertex)] = root(known.get(key).vertex);
            else known.set(key, { vertex, influences });
        }
        const different = [...known.values()];
        if (different.length > CROWDED) continue;
        different.forEach((first, i) => {
            for (const other of different.slice(0, i)) {
                const isOne = first.influences === other.influences && isClose(normals, 3 * first.vertex, 3 * other.vertex);
                if (isOne) parents[root(first.vertex)] = root(other.vertex);
            }
        });
    }
    const numbers = new Map();
    return Int32Array.from({ length: count }, (_, vertex) => {
        const own = root(vertex);
        if (!numbers.has(own)) numbers.set(own, numbers.size);
        return numbers.get(own);
    });
}

function influencesOf({ joints, weights, slots }, vertex) {
    const sums = new Map();
    for (let i = slots * vertex; i < slots * (vertex + 1); i++) {
        if (weights[i] >= TINY_WEIGHT) sums.set(joints[i], (sums.get(joints[i]) ?? 0) + weights[i]);
    }
    return [...sums].sort((a, b) => a[0] - b[0]).map(([joint, weight]) => `${joint}:${Math.fround(weight)}`).join();
}

function isClose(normals, a, b) {
    let apart = 0;
    for (let axis = 0; axis < 3; axis++) apart += (normals[a + axis] - normals[b + axis]) ** 2;
    return Math.sqrt(apart) <= 2 * Math.sin(CREASE / 2) + 1e-12;
}

// The vertices at each place that has more than one: neighbours once they are in order.
function samePlaces(positions) {
    const compare = (a, b) =>
        positions[3 * a] - positions[3 * b] || positions[3 * a + 1] - positions[3 * b + 1] || positions[3 * a + 2] - positions[3 * b + 2];
    const order = Uint32Array.from({ length: positions.length / 3 }, (_, vertex) => vertex).sort(compare);
    const groups = [];
    order.forEach((vertex, i) => (i && compare(order[i - 1], vertex) === 0 ? groups.at(-1).push(vertex) : groups.push([vertex])));
    return groups.filter(({ length }) => length > 1);
}
