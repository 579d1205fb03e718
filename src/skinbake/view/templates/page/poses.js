// Poses of a model: joint matrices and morph weights, from a clip at a time, or turned at random.

import { columnsOf, composed, determinant, dot, dualQuaternion, polarQuaternion, product, slerp } from './matrices.js';

const RIGID = 1e-3; // As skinbake has it: a larger deviation of a joint matrix is not a rotation.
const RANDOM = -1; // A number that no animation of the file has.
const RANDOM_POSES = 8;
const RANDOM_ANGLE = Math.PI / 6;
const UNTURNED = [0, 0, 0, 1];

// What a clip does at a time, in seconds. Returns joint matrices by skin, node matrices, and morph weights.
export function poseAt(model, clip, time) {
    const moved = model.nodes.map(({ translation, rotation, scale, weights }) => ({ translation, rotation, scale, weights }));
    const touched = new Set();
    for (const channel of clip.channels) {
        const [values, node] = [sampled(channel, time), moved[channel.node]];
        if (channel.weight === undefined) node[channel.path] = values;
        else node.weights = Object.assign([...node.weights], { [channel.weight]: values[0] });
        if (!['weights', 'turn'].includes(channel.path)) touched.add(channel.node);
    }
    const matrices = new Array(model.nodes.length);
    const placed = (number) => {
        if (matrices[number]) return matrices[number];
        const { matrix, parent } = model.nodes[number];
        const { translation, rotation, scale, turn } = moved[number];
        const own = matrix && !touched.has(number) ? matrix : composed(translation, rotation, scale);
        const local = turn ? product(own, composed([0, 0, 0], turn, [1, 1, 1])) : own;
        return (matrices[number] = parent < 0 ? local : product(placed(parent), local));
    };
    moved.forEach((_, number) => placed(number));
    const skins = model.skins.map(({ joints, inverseBind }) => joints.map((joint, i) => product(matrices[joint], inverseBind[i])));
    return { nodes: matrices, skins, weights: moved.map(({ weights }) => weights) };
}

function sampled({ times, values, method, size, path }, time) {
    const at = (key, part = 0) => {
        const start = method === 'CUBICSPLINE' ? (3 * key + 1 + part) * size : key * size;
        return Array.from(values.subarray(start, start + size));
    };
    const last = times.length - 1;
    if (!(time > times[0])) return at(0);
    if (time >= times[last]) return at(last);
    let [low, high] = [0, last];
    while (high - low > 1) {
        const middle = (low + high) >> 1;
        if (times[middle] <= time) low = middle;
        else high = middle;
    }
    const step = times[high] - times[low];
    const share = step > 0 ? (time - times[low]) / step : 0;
    if (method === 'STEP') return at(low);
    if (method === 'CUBICSPLINE') return spline(at(low), at(low, 1), at(high), at(high, -1), share, step, path);
    const [a, b] = [at(low), at(high)];
    return ['rotation', 'turn'].includes(path) ? slerp(a, b, share) : a.map((value, i) => value + share * (b[i] - value));
}

function spline(a, out, b, into, s, step, path) {
    const [s2, s3] = [s * s, s * s * s];
    const found = a.map(
        (value, i) =>
            (2 * s3 - 3 * s2 + 1) * value +
            step * (s3 - 2 * s2 + s) * out[i] +
            (3 * s2 - 2 * s3) * b[i] +
            step * (s3 - s2) * into[i]
    );
    if (path !== 'rotation') return found;
    const length = Math.hypot(...found) || 1;
    return found.map((value) => value / length);
}

// A clip in which all joints turn from one random pose to the next, the first and the last being at rest.
// Its path is `turn`: a rotation after the transform of the node. `random_clip` in animation.py has the same numbers.
export function randomClip(model, seed = 1) {
    const random = numbers(seed);
    const joints = [...new Set(model.skins.flatMap((skin) => skin.joints))];
    const times = Float32Array.from({ length: RANDOM_POSES + 2 }, (_, i) => i);
    const channels = joints.map((node) => {
        const keys = [UNTURNED, ...Array.from({ length: RANDOM_POSES }, () => randomRotation(random)), UNTURNED];
        return { node, path: 'turn', times, values: Float32Array.from(keys.flat()), method: 'LINEAR', size: 4 };
    });
    return { number: RANDOM, name: 'Random poses', channels, start: 0, end: RANDOM_POSES + 1 };
}

function randomRotation(random) {
    const z = 2 * random() - 1;
    const around = 2 * Math.PI * random();
    const half = (RANDOM_ANGLE * random()) / 2;
    const flat = Math.sqrt(1 - z * z) * Math.sin(half);
    return [flat * Math.cos(around), flat * Math.sin(around), z * Math.sin(half), Math.cos(half)];
}

// Numbers from 0 to 1 that are the same for the same seed (mulberry32).
function numbers(seed) {
    let state = seed;
    return () => {
        state = (state + 0x6d2b79f5) | 0;
        let t = Math.imul(state ^ (state >>> 15), 1 | state);
        t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
        return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
    };
}

// Joint matrices as one scale for all and a dual quaternion for each. Where they are not rigid, the rotation of each.
export function motionsOf(matrices, used) {
    const scales = used
        .map((joint) => Math.cbrt(determinant(matrices[joint])))
        .filter((scale) => scale > 0)
        .sort((a, b) => a - b);
    const scale = scales[(scales.length - 1) >> 1] ?? 1;
    const isUsed = new Set(used);
    if (!used.every((joint) => isRigid(matrices[joint], scale))) {
        return { scale: 1, turns: matrices.map((matrix, i) => (isUsed.has(i) ? polarQuaternion(matrix) : [0, 0, 0, 1])) };
    }
    const unmoved = [0, 0, 0, 1, 0, 0, 0, 0];
    return { scale, quaternions: matrices.map((matrix, i) => (isUsed.has(i) ? dualQuaternion(matrix, scale) : unmoved)) };
}

function isRigid(m, scale) {
    const columns = columnsOf(m);
    const isRight = (a, i) => columns.every((b, j) => Math.abs(dot(a, b) / (scale * scale) - Number(i === j)) <= RIGID);
    return determinant(m) > 0 && columns.every(isRight);
}
