"""The gather of :mod:`skinbake.bake.gradients`, compiled by numba for large meshes.

The machine code is kept in numba's cache beside this file, or in the user's cache directory where that is
read-only. The mathematics of a corner is the function of :mod:`skinbake.bake.corner`, compiled as it stands.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from skinbake.bake import corner

corner_coefficients = numba.njit(corner.corner_coefficients)


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


@numba.njit(cache=True)
def add_difference(
    sums: Any, touched: Any, stamp: Any, mark: int, joints: Any, weights: Any, origin: int, end: int, c: Any
) -> int:
    """Add c (w_end − w_origin) of every joint to the sums; return how many joints are touched by now."""
    influences = joints.shape[1]
    used = touched[0]
    for turn in range(2):
        here, there = (end, origin) if turn == 0 else (origin, end)
        for k in range(influences):
            joint = joints[here, k]
            if joint < 0:
                continue
            difference = weights[here, k]
            shared = False
            for m in range(influences):
                if joints[there, m] == joint:
                    difference -= weights[there, m]
                    shared = True
                    break
            if difference == 0.0 or (turn == 1 and shared):
                continue
            if turn == 1:
                difference = -difference
            if stamp[joint] != mark:
                stamp[joint] = mark
                used += 1
                touched[used] = joint
                sums[joint, 0] = 0.0
                sums[joint, 1] = 0.0
                sums[joint, 2] = 0.0
            sums[joint, 0] += c[0] * difference
            sums[joint, 1] += c[1] * difference
            sums[joint, 2] += c[2] * difference
    touched[0] = used
    return int(used)


@numba.njit(cache=True)
def gather(
    positions: Any, triangles: Any, joints: Any, weights: Any, classes: Any, count: int, weighting: int
) -> Any:
    """Return (offsets, joints, gradients) of every weld class; arguments as in weight_gradients."""
    corner_offsets, corners = corners_by_class(triangles, classes, count)
    joint_count = max(joints.max(), 0) + 1
    sums = np.zeros((joint_count, 3))
    stamp = np.full(joint_count, -1, np.int64)
    touched = np.zeros(joint_count + 1, np.int64)
    offsets = np.zeros(count + 1, np.int64)
    capacity = 8 * count + 16
    out_joints = np.empty(capacity, np.int64)
    out_gradients = np.empty((capacity, 3))
    for c in range(count):
        touched[0] = 0
        total = 0.0
        for position in range(corner_offsets[c], corner_offsets[c + 1]):
            t, i = divmod(corners[position], 3)
            origin, first, second = triangles[t, i], triangles[t, (i + 1) % 3], triangles[t, (i + 2) % 3]
            e1 = (
                positions[first, 0] - positions[origin, 0],
                positions[first, 1] - positions[origin, 1],
                positions[first, 2] - positions[origin, 2],
            )
            e2 = (
                positions[second, 0] - positions[origin, 0],
                positions[second, 1] - positions[origin, 1],
                positions[second, 2] - positions[origin, 2],
            )
            weight, c1, c2 = corner_coefficients(e1, e2, weighting)
            total += weight
            add_difference(sums, touched, stamp, c, joints, weights, origin, first, c1)
            add_difference(sums, touched, stamp, c, joints, weights, origin, second, c2)
        used = touched[0]
        start = offsets[c]
        if start + used > capacity:
            capacity = 2 * capacity + used
            wider_joints = np.empty(capacity, np.int64)
            wider_joints[:start] = out_joints[:start]
            out_joints = wider_joints
            wider_gradients = np.empty((capacity, 3))
            wider_gradients[:start] = out_gradients[:start]
            out_gradients = wider_gradients
        ascending = np.sort(touched[1 : used + 1])
        for entry in range(used):
            joint = ascending[entry]
            out_joints[start + entry] = joint
            for axis in range(3):
                out_gradients[start + entry, axis] = sums[joint, axis] / total
        offsets[c + 1] = start + used
    return offsets, out_joints[: offsets[-1]].copy(), out_gradients[: offsets[-1]].copy()
