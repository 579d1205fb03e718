// A model in a pose: its matrices, its morphed vertices, its true normals, and the errors of each lighting.

import { determinant, movedBy, plus } from './matrices.js';
import { motionsOf, poseAt, randomClip } from './poses.js';
import { unitNormals } from './reader.js';
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
            if (part.skin === undefined || !part.primitive.slots) return;
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
            skinned(part.primitive, positions, this.posed.skins[skin], motions, surface.moved, { start: surface.starts[i] });
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
        const { primitive, skin, node } = part;
        const { positions } = this.morphed.get(part) ?? primitive;
        const found = new Float64Array(3 * Math.ceil(primitive.count / step));
        if (skin !== undefined && primitive.slots) skinned(primitive, positions, this.posed.skins[skin], null, found, { step });
        else for (let i = 0; i < found.length; i += 3) found.set(movedBy(this.posed.nodes[node], positions.subarray(step * i)).slice(0, 3), i);
        return found;
    }

    // Where a vertex of a skinned primitive is in this pose.
    positionOf({ mesh, primitive, skin, vertex }) {
        const wanted = this.model.primitives.get(`${mesh}/${primitive}/true`);
        const part = this.parts.find((one) => one.primitive === wanted && one.skin === skin);
        if (!part) return null;
        const found = [0, 0, 0];
        const { positions } = this.morphed.get(part) ?? wanted;
        skinned(wanted, positions, this.posed.skins[skin], null, found, { first: vertex, step: wanted.count });
        return found;
    }

    // The depth of the middle of a part in this pose.
    depth(part, projected) {
        const { middle } = boxOf([this.positions(part, Math.ceil(part.primitive.count / OF_MIDDLE))]);
        return movedBy(projected, middle)[3];
    }

    // The box around some parts over some poses of their clip.
    bounds(parts = this.parts, times = [0, 0.25, 0.5, 0.75, 1].map((share) => this.clip.start + share * (this.clip.end - this.clip.start))) {
        const { clip, time } = this;
        const step = Math.ceil(parts.reduce((sum, { primitive }) => sum + primitive.count, 0) / BOUNDING);
        const seen = times.flatMap((one) => {
            this.pose(clip, one);
            return parts.map((part) => this.positions(part, step));
        });
        this.pose(clip, time);
        return boxOf(seen);
    }
}

// The box around rows of positions: its middle, half its diagonal, its lowest point.
function boxOf(rows) {
    const low = [Infinity, Infinity, Infinity];
    const high = low.map((value) => -value);
    for (const positions of rows) {
        positions.forEach((value, i) => {
            if (value < low[i % 3]) low[i % 3] = value;
            if (value > high[i % 3]) high[i % 3] = value;
        });
    }
    const middle = plus(low, high).map((value) => value / 2);
    return { middle, radius: Math.hypot(...plus(high, low, -1)) / 2, low: low[1] };
}

// The nodes that move joints: joints, and all above them.
function movingNodes({ skins, nodes }) {
    const found = new Set();
    for (const joint of skins.flatMap((skin) => skin.joints)) {
        for (let node = joint; node >= 0 && !found.has(node); node = nodes[node].parent) found.add(node);
    }
    return found;
}

function usedJoints(parts) {
    const used = new Set();
    for (const { primitive } of parts) {
        primitive.joints.forEach((joint, i) => primitive.weights[i] > 0 && used.add(joint));
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
    [...targets, ...correctives].forEach(({ normals }, number) => addTo(found, normals, weights[number]));
    return found;
}

function addTo(found, moved, weight = 0) {
    if (found && moved && weight) for (let i = 0; i < moved.length; i++) found[i] += weight * moved[i];
}

function morphedArrays({ positions, normals, directions, targets, numbers, count }, weights) {
    const found = {
        positions: positions.slice(),
        normals: normals.slice(),
        inPlane: numbers ? new Float32Array(4 * count) : null,
        upward: numbers === 6 ? new Float32Array(2 * count) : null,
        tangents: directions && directions.slice(),
    };
    targets.forEach((target, number) => {
        for (const name of Object.keys(found)) addTo(found[name], target[name], weights[number]);
    });
    return { ...found, normals: unitNormals(found.normals, normals) };
}
