"""The gather of :mod:`skinbake.bake.gradients`, compiled by numba for large meshes.

It is one long function: calls inside its loop cost five times its work. The machine code is
kept in numba's cache beside this file, or in the user's cache directory where that is
read-only. The mathematics of a corner is the function of :mod:`skinbake.bake.corner`, compiled as it stands.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from skinbake.bake import corner

corner_coefficients = numba.njit(corner.corner_coefficients, error_model="numpy")


@numba.njit(cache=True)
def corners_by_class(triangles: Any, classes: Any, count: int) -> Any:
    """Return (offsets, corners): the corner numbers 3 t + i of every class, by counting sort."""
    offsets = np.zeros(count + 1, np.int64)
    for t in range(len(triangles)):
        for i in range(3):
            offsets[classes[triangles[t, i]] + 1] += 1
    for c in range(count):
        offsets[c + 1] += offsets[c]
    cursor = offsets[:-1].copy()
    corners = np.empty(offsets[-1], np.int64)
    for t in range(len(triangles)):
        for i in range(3):
            c = classes[triangles[t, i]]
            corners[cursor[c]] = 3 * t + i
            cursor[c] += 1
    return offsets, corners


@numba.njit(cache=True, error_model="numpy")
def gather(
    positions: Any, triangles: Any, joints: Any, weights: Any, classes: Any, count: int, weighting: int
) -> Any:
    """Return (offsets, joints, gradients) of every weld class; arguments as in weight_gradients.

    positions and weights float64; triangles, joints and classes int32. Around one class a joint has a local
    number, in the order in which it is met: the class's own joints first, so that the weight at the class is
    a look-up and every sum runs over differences of weights.
    """
    corner_offsets, corners = corners_by_class(triangles, classes, count)
    influences = joints.shape[1]
    joint_count = max(joints.max(), 0) + 1
    local = np.full(joint_count, -1, np.int64)
    met = np.empty(joint_count, np.int64)
    seen = np.full(joint_count, -1, np.int64)
    own = np.empty(joint_count)
    sums = np.empty((joint_count, 3))
    offsets = np.zeros(count + 1, np.int64)
    out_joints = np.empty(6 * count + 16, np.int64)
    out_gradients = np.empty((6 * count + 16, 3))
    visit = 0
    for c in range(count):
        used = 0
        own_used = 0
        total = 0.0
        for position in range(corner_offsets[c], corner_offsets[c + 1]):
            t = corners[position] // 3
            i = corners[position] - 3 * t
            origin = triangles[t, i]
            ends = (triangles[t, (i + 1) % 3], triangles[t, (i + 2) % 3])
            x, y, z = positions[origin, 0], positions[origin, 1], positions[origin, 2]
            share, c1, c2 = corner_coefficients(
                (positions[ends[0], 0] - x, positions[ends[0], 1] - y, positions[ends[0], 2] - z),
                (positions[ends[1], 0] - x, positions[ends[1], 1] - y, positions[ends[1], 2] - z),
                weighting,
            )
            total += share
            if own_used == 0:
                for k in range(influences):
                    if weights[origin, k] > 0.0:
                        joint = joints[origin, k]
                        local[joint] = used
                        met[used] = joint
                        own[used] = weights[origin, k]
                        seen[used] = -1
                        for axis in range(3):
                            sums[used, axis] = 0.0
                        used += 1
                own_used = used
            for side in range(2):
                end = ends[side]
                gx, gy, gz = c1 if side == 0 else c2
                visit += 1
                for k in range(influences):
                    weight = weights[end, k]
                    if weight == 0.0:
                        continue
                    joint = joints[end, k]
                    n = local[joint]
                    if n < 0:
                        n = used
                        local[joint] = n
                        met[n] = joint
                        own[n] = 0.0
                        for axis in range(3):
                            sums[n, axis] = 0.0
                        used += 1
                    seen[n] = visit
                    difference = weight - own[n]
                    sums[n, 0] += gx * difference
                    sums[n, 1] += gy * difference
                    sums[n, 2] += gz * difference
                for n in range(own_used):
                    if seen[n] != visit:
                        sums[n, 0] -= gx * own[n]
                        sums[n, 1] -= gy * own[n]
                        sums[n, 2] -= gz * own[n]
        start = offsets[c]
        if start + used > len(out_joints):
            wider_joints = np.empty(2 * len(out_joints) + used, np.int64)
            wider_gradients = np.empty((2 * len(out_joints) + used, 3))
            for place in range(start):
                wider_joints[place] = out_joints[place]
                for axis in range(3):
                    wider_gradients[place, axis] = out_gradients[place, axis]
            out_joints, out_gradients = wider_joints, wider_gradients
        kept = 0
        for n in range(used):
            local[met[n]] = -1
            if sums[n, 0] == 0.0 and sums[n, 1] == 0.0 and sums[n, 2] == 0.0:
                continue
            place = start + kept
            while place > start and out_joints[place - 1] > met[n]:
                out_joints[place] = out_joints[place - 1]
                for axis in range(3):
                    out_gradients[place, axis] = out_gradients[place - 1, axis]
                place -= 1
            out_joints[place] = met[n]
            for axis in range(3):
                out_gradients[place, axis] = sums[n, axis] / total
            kept += 1
        offsets[c + 1] = start + kept
    return offsets, out_joints[: offsets[-1]], out_gradients[: offsets[-1]]
