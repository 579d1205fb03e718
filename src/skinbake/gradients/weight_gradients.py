"""Weight gradients at welded vertices (Tarini et al. 2014, §4; the mean over triangles after Max 1999).

This module is the definition. ``_kernel.c`` does the same in one pass over the corners of each vertex.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skinbake.geometry.skinned import Float64Array, FloatArray, IntArray
from skinbake.gradients.corner import WEIGHTINGS, corner_coefficients
from skinbake.gradients.field import WeightField


@dataclass(frozen=True, slots=True)
class VertexGradients:
    """Sparse weight gradients of C weld classes, in rows like CSR.

    Class c has the entries offsets[c] … offsets[c + 1]. An entry is a joint (int64) whose weight varies
    around the class, and its gradient (E, 3) float64 in mesh space, in 1 / length unit. Joints ascend within
    a class.
    """

    offsets: npt.NDArray[np.int64]
    joints: npt.NDArray[np.int64]
    gradients: Float64Array


def weight_gradients(
    positions: FloatArray,
    triangles: IntArray,
    field: WeightField,
    classes: IntArray,
    *,
    weighting: str,
) -> VertexGradients:
    """Return the gradient of every joint's weight at every weld class.

    positions are (V, 3). triangles (T, 3) index them, and all have an area. field has the normalised weights
    (V, K). classes (V,) is the weld class of each vertex. A class's gradient is the mean of its corners'
    triangle gradients, normalised by the weight of *all* its corners, so that the gradients of all joints sum
    to zero. A class without triangles has no entries. weighting is a key of WEIGHTINGS.
    """
    method, classes = WEIGHTINGS[weighting], classes.astype(np.int64)
    count, points = int(classes.max(initial=-1)) + 1, positions.astype(np.float64)
    total = np.zeros(count)
    keys, vectors = [], []
    joint_count = int(field.joints.max(initial=0)) + 1
    for turn in range(3):
        origin, first, second = np.roll(triangles, -turn, axis=1).T
        e1 = tuple((points[first] - points[origin]).T)
        e2 = tuple((points[second] - points[origin]).T)
        weight, c1, c2 = corner_coefficients(e1, e2, method)
        total += np.bincount(classes[origin], weight, count)
        for neighbour, coefficients in ((first, c1), (second, c2)):
            corner, joints, difference = _differences(field, origin, neighbour)
            keys.append(classes[origin[corner]] * joint_count + joints)
            vectors.append(np.stack([c[corner] * difference for c in coefficients]))
    return _reduced(np.concatenate(keys), np.concatenate(vectors, axis=1), total, joint_count)


def _differences(
    field: WeightField, origin: IntArray, neighbour: IntArray
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], Float64Array]:
    """Return each difference of a joint's weight between two ends: (pair, joint, w_neighbour − w_origin)."""
    joints0, weights0 = field.joints[origin], field.weights[origin]
    joints1, weights1 = field.joints[neighbour], field.weights[neighbour]
    same = joints1[:, :, None] == joints0[:, None, :]
    gained = weights1 - np.einsum("pij,pj->pi", same, weights0)
    lost = np.where(same.any(axis=1), 0.0, -weights0)
    difference = np.concatenate([gained, lost], axis=1)
    joints = np.concatenate([joints1, joints0], axis=1)
    pair, slot = np.nonzero((difference != 0) & (joints >= 0))
    return pair, joints[pair, slot], difference[pair, slot]


def _reduced(
    keys: npt.NDArray[np.int64], vectors: Float64Array, total: Float64Array, joint_count: int
) -> VertexGradients:
    """Sum the vectors (3, N) of equal keys and divide by the class's total weight."""
    unique, inverse = np.unique(keys, return_inverse=True)
    sums = np.stack([np.bincount(inverse, row, len(unique)) for row in vectors], axis=1)
    owner, joints = np.divmod(unique, joint_count)
    gradients = sums / total[owner, None]
    offsets = np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=len(total)))])
    return VertexGradients(offsets, joints, gradients)
