// A model in a pose: its matrices, its morphed vertices, its true normals, and the errors of each lighting.

import { determinant, plus } from './matrices.js';
import { motionsOf, poseAt, randomClip } from './poses.js';
import { LIGHTINGS } from './renderer.js';
import { joined, skinned, Surface } from './truth.js';

const STILL = { name: 'Rest pose', start: 0, end: 0, channels: [] }; // Of a file in which nothing moves.
const BOUNDING = 20_000; // Vertices that place the camera.
const OF_MIDDLE = 1000; // Vertices that tell where a part is.

export class Scene {
    constructor(renderer) {
        this.renderer = renderer;
    }

    // Take a model. Returns a promise of its images.
    show(model) {
        const rest = poseAt(model, { channels: [] }, 0);
        const moving = movingNodes(model);
        const clips = model.clips.filter((clip) => clip.channels.some(({ node, path }) => path === 'weights' || moving.has(node)));
        const clip = clips[0] ?? (model.skins.length ? randomClip(model) : STILL);
        const middle = poseAt(model, clip, (clip.start + clip.end) / 2);
        const isMirrored = [rest, middle].some((pose) => pose.skins.flat().some((matrix) => determinant(matrix) < 0));
        const loading = this.renderer.setModel(model, isMirrored);
        Object.assign(this, { model, surfaces: undefined, known: new Map(), morphed: new Map(), played: new Map() });
        this.parts = this.renderer.parts;
        this.usedJoints = model.skins.map((_, skin) => usedJoints(this.parts.filter((part) => part.skin === skin)));
        this.clips = model.skins.length ? [...clips, randomClip(model)] : clips.length ? clips : [STILL];
        this.pose(clip, clip.start);
        return loading;
    }

    // Pose the model; truth is measured only when it is wanted.
    pose(clip, time) {
        const { model, renderer } = this;
        Object.assign(this, { clip, time, known: new Map() });
        this.posed = poseAt(model, clip, time);
        this.motions = this.posed.skins.map((matrices, skin) => motionsOf(matrices, this.usedJoints[skin]));
        renderer.setPose(this.posed, this.motions);
        for (const part of this.parts) this.morph(part);
    }

    morph(part) {
        const { targets, correctives } = part.primitive;
        if (!targets.length && !correctives.length) return;
        const weights = this.posed.weights[part.node];
        const key = weights.join();
        if (this.played.get(part) === key) return;
        this.played.set(part, key);
        const arrays = targets.length ? morphedArrays(part.primitive, weights) : null;
        if (arrays) this.morphed.set(part, arrays);
        const corrected = correctives.length ? correctedNormals(part.primitive, weights) : null;
        this.renderer.setMorphed(part, { ...arrays, corrected });
    }

    // Why a lighting cannot be shown; empty if it can.
    reasonWithout(lighting) {
        const lit = this.parts.filter((part) => part.skin !== undefined);
        const { gradients, stem, isCorrected } = LIGHTINGS[lighting];
        if (!lit.length) return lighting === 'standard' ? '' : 'nothing in it is skinned';
        if (isCorrected && !lit.some((part) => part.primitive.correctives.length)) return 'the file has none';
        if (gradients && !lit.some((part) => part.primitive.gradients[gradients])) return 'the page holds no such α and β of this file';
        if (stem !== 'lbs_standard' && !lit.some((part) => part.primitive.metadata)) return 'it is not baked';
        return '';
    }

    // Parts of one surface: all that a skin draws, but those with morph targets by themselves.
    allSurfaces() {
        if (this.surfaces) return this.surfaces;
        const groups = new Map();
        this.parts.forEach((part, number) => {
            if (part.skin === undefined || !part.primitive.joints.length) return;
            const key = part.primitive.targets.length ? `${part.node}` : `skin ${part.skin}`;
            if (!groups.has(key)) groups.set(key, []);
            groups.get(key).push(part);
        });
        this.surfaces = [...groups.values()].map((parts) => ({ parts, surface: new Surface(parts.map((part) => part.primitive)) }));
        return this.surfaces;
    }

    // The true normals (x, y, z, 1) of each surface in this pose, under one method.
    truths(method) {
        if (!this.known.has(method)) this.known.set(method, this.allSurfaces().map((one) => this.truthOf(one, method)));
        return this.known.get(method);
    }

    truthOf({ parts, surface }, method) {
        const { skin } = parts[0];
        const motions = method === 'dqs' ? this.motions[skin] : null;
        if (parts.some((part) => this.morphed.has(part))) {
            // Coordinates at rest serve where only the surface tells the normals.
            const arrays = parts.map((part) => (part.primitive.isAuthored && this.morphed.get(part)) || part.primitive);
            surface.carry(joined(arrays, 'positions'), joined(arrays, 'normals'));
        }
        surface.moved ??= new Float64Array(3 * surface.count);
        parts.forEach((part, i) => {
            const { positions } = this.morphed.get(part) ?? part.primitive;
            skinned(part.primitive, positions, this.posed.skins[skin], motions, surface.moved, surface.starts[i]);
        });
        return surface.trueNormals(surface.moved, this.posed.skins[skin]).slice();
    }

    // Upload the true normals under a method.
    uploadTruth(method) {
        const truths = this.truths(method);
        this.allSurfaces().forEach(({ parts, surface }, number) => {
            parts.forEach((part, i) => {
                const start = 4 * surface.starts[i];
                this.renderer.setTruth(part, method, truths[number].subarray(start, start + 4 * part.primitive.count));
            });
        });
    }

    // The mean error of a lighting in this pose, in degrees, weighted by rest area.
    // The mean is null if no vertex has a true normal. isPartial: some vertex of a triangle has none.
    errors(lighting, truths = this.truths(LIGHTINGS[lighting].method)) {
        let [sum, total] = [0, 0];
        let isPartial = false;
        this.allSurfaces().forEach(({ parts, surface }, number) => {
            const truth = truths[number];
            parts.forEach((part, i) => {
                const { normals } = this.renderer.captured(part, lighting);
                for (let vertex = 0; vertex < part.primitive.count; vertex++) {
                    const at = surface.starts[i] + vertex;
                    const area = surface.areas[at];
                    if (!area) continue;
                    isPartial ||= !truth[4 * at + 3];
                    if (!truth[4 * at + 3]) continue;
                    const error = angle(normals, 3 * vertex, truth, 4 * at);
                    if (!(error >= 0)) continue;
                    sum += area * error;
                    total += area;
                }
            });
        });
        return { mean: total ? sum / total : null, isPartial };
    }

    // The positions of every so many vertices of a part in this pose, without the GPU.
    positions(part, step) {
        const { skin, node } = part;
        const primitive = thinned(part.primitive, this.morphed.get(part)?.positions ?? part.primitive.positions, step);
        const found = new Float64Array(3 * primitive.count);
        if (skin !== undefined && primitive.joints.length) skinned(primitive, primitive.positions, this.posed.skins[skin], null, found, 0);
        else moved(primitive.positions, this.posed.nodes[node], found);
        return found;
    }

    // Where a vertex of a skinned primitive is in this pose.
    positionOf({ mesh, primitive, skin, vertex }) {
        const wanted = this.model.primitives.get(`${mesh}/${primitive}/true`);
        const part = this.parts.find((one) => one.primitive === wanted && one.skin === skin);
        if (!part) return null;
        const cut = (row, size) => row.subarray(size * vertex, size * (vertex + 1));
        const [joints, weights] = [wanted.joints, wanted.weights].map((rows) => rows.map((row) => cut(row, 4)));
        const found = [0, 0, 0];
        skinned({ joints, weights, count: 1 }, cut((this.morphed.get(part) ?? wanted).positions, 3), this.posed.skins[skin], null, found, 0);
        return found;
    }

    // The depth of the middle of a part in this pose.
    depth(part, projected) {
        const found = this.positions(part, Math.ceil(part.primitive.count / OF_MIDDLE));
        const middle = [0, 1, 2].map((axis) => {
            const row = found.filter((_, i) => i % 3 === axis);
            return (Math.min(...row) + Math.max(...row)) / 2;
        });
        return projected[3] * middle[0] + projected[7] * middle[1] + projected[11] * middle[2] + projected[15];
    }

    // The box around some parts over some poses of their clip: its middle, half its diagonal, its lowest point.
    bounds(parts = this.parts, times = [0, 0.25, 0.5, 0.75, 1].map((share) => this.clip.start + share * (this.clip.end - this.clip.start))) {
        const { clip, time } = this;
        const low = [Infinity, Infinity, Infinity];
        const high = low.map((value) => -value);
        const step = Math.ceil(parts.reduce((sum, { primitive }) => sum + primitive.count, 0) / BOUNDING);
        for (const one of times) {
            this.pose(clip, one);
            for (const part of parts) {
                const positions = this.positions(part, step);
                for (let i = 0; i < positions.length; i++) {
                    const axis = i % 3;
                    if (positions[i] < low[axis]) low[axis] = positions[i];
                    if (positions[i] > high[axis]) high[axis] = positions[i];
                }
            }
        }
        this.pose(clip, time);
        const middle = plus(low, high).map((value) => value / 2);
        return { middle, radius: Math.hypot(...plus(high, low, -1)) / 2, low: low[1] };
    }
}

function thinned({ joints, weights, count }, positions, step) {
    if (step === 1) return { joints, weights, count, positions };
    const kept = Math.ceil(count / step);
    const every = (row, size) => {
        const found = new row.constructor(size * kept);
        for (let i = 0; i < kept; i++) for (let k = 0; k < size; k++) found[size * i + k] = row[size * step * i + k];
        return found;
    };
    const ofFour = (row) => every(row, 4);
    return { joints: joints.map(ofFour), weights: weights.map(ofFour), count: kept, positions: every(positions, 3) };
}

function moved(positions, m, found) {
    for (let i = 0; i < positions.length; i += 3) {
        const [x, y, z] = [positions[i], positions[i + 1], positions[i + 2]];
        for (let row = 0; row < 3; row++) found[i + row] = m[row] * x + m[4 + row] * y + m[8 + row] * z + m[12 + row];
    }
}

// The nodes that move joints: joints, and all above them.
function movingNodes({ skins, nodes }) {
    const found = new Set();
    for (let node of skins.flatMap((skin) => skin.joints)) {
        while (node >= 0 && !found.has(node)) {
            found.add(node);
            node = nodes[node].parent;
        }
    }
    return found;
}

function usedJoints(parts) {
    const used = new Set();
    for (const { primitive } of parts) {
        primitive.joints.forEach((set, number) => {
            for (let i = 0; i < set.length; i++) if (primitive.weights[number][i] > 0) used.add(set[i]);
        });
    }
    return [...used].sort((a, b) => a - b);
}

function angle(a, i, b, j) {
    const x = a[i + 1] * b[j + 2] - a[i + 2] * b[j + 1];
    const y = a[i + 2] * b[j] - a[i] * b[j + 2];
    const z = a[i] * b[j + 1] - a[i + 1] * b[j];
    const cosine = a[i] * b[j] + a[i + 1] * b[j + 1] + a[i + 2] * b[j + 2];
    return (Math.atan2(Math.sqrt(x * x + y * y + z * z), cosine) * 180) / Math.PI;
}

// What a viewer without our code makes of NORMAL: the sum of the stored normals and all targets.
function correctedNormals({ stored, targets, correctives }, weights) {
    const found = stored.slice();
    [...targets, ...correctives].forEach(({ normals }, number) => {
        const weight = weights[number] ?? 0;
        if (weight && normals) for (let i = 0; i < normals.length; i++) found[i] += weight * normals[i];
    });
    return found;
}

function morphedArrays({ positions, normals, tangents, targets, numbers, count }, weights) {
    const found = {
        positions: positions.slice(),
        normals: normals.slice(),
        inPlane: numbers ? new Float32Array(4 * count) : null,
        upward: numbers === 6 ? new Float32Array(2 * count) : null,
        tangents: tangents && Float32Array.from({ length: 3 * count }, (_, i) => tangents[4 * Math.floor(i / 3) + (i % 3)]),
    };
    targets.forEach((target, number) => {
        const weight = weights[number] ?? 0;
        if (!weight) return;
        for (const name of ['positions', 'normals', 'tangents', 'inPlane', 'upward']) {
            const moved = target[name];
            if (moved && found[name]) for (let i = 0; i < moved.length; i++) found[name][i] += weight * moved[i];
        }
    });
    for (let i = 0; i < found.normals.length; i += 3) {
        const length = Math.hypot(found.normals[i], found.normals[i + 1], found.normals[i + 2]);
        for (let axis = 0; axis < 3; axis++) found.normals[i + axis] = length ? found.normals[i + axis] / length : normals[i + axis];
    }
    return found;
}
