"""Weight gradients at welded vertices (Tarini et al. 2014, §4; the mean over triangles after Max 1999).

This module is the definition. ``loops/ring.h`` does the same in one pass over the corners of each vertex.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from skinbake.geometry.skinned import Float64Array, FloatArray, IntArray, bincount
from skinbake.gradients.surface import WeightField


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
    classes = classes.astype(np.int64)
    count = int(classes.max(initial=-1)) + 1
    total = np.zeros(count)
    keys, vectors = [], []
    joint_count = int(field.joints.max(initial=0)) + 1
    for corners in corners_of(positions, triangles, WEIGHTINGS[weighting]):
        # The weight of the corner counts, whether a joint varies there or not.
        total += bincount(classes[corners.origin], corners.weight, count)
        # Each joint adds the hat's gradient times its change of weight along the edge.
        for neighbour, _, coefficients in corners.ends():
            corner, joints, difference = corner_differences(field, corners.origin, neighbour)
            keys.append(classes[corners.origin[corner]] * joint_count + joints)
            vectors.append(coefficients[corner] * difference[:, None])
    # One entry for each class and joint, divided by the weight of all corners.
    offsets, joints, sums = summed_by_key(keys, vectors, joint_count, count)
    owner = np.repeat(np.arange(count), np.diff(offsets))
    return VertexGradients(offsets, joints, sums / total[owner, None])


def field_derivatives(
    positions: FloatArray,
    triangles: IntArray,
    values: FloatArray,
    classes: IntArray,
    frame: tuple[FloatArray, FloatArray],
    *,
    weighting: str,
) -> Float64Array:
    """Return the derivatives of one field (V,) along t0 and b0 (V, 3) at every vertex: (V, 2).

    The other arguments are those of ``weight_gradients``, and so is the mean. A vertex without triangles has
    zeros.
    """
    classes = classes.astype(np.int64)
    count = int(classes.max(initial=-1)) + 1
    total, sums = np.zeros(count), np.zeros((count, 3))
    for corners in corners_of(positions, triangles, WEIGHTINGS[weighting]):
        own = classes[corners.origin]
        total += bincount(own, corners.weight, count)
        for neighbour, _, coefficients in corners.ends():
            change = values[neighbour].astype(np.float64) - values[corners.origin]
            sums += summed_rows(own, coefficients * change[:, None], count)
    gradients = (sums / np.where(total > 0.0, total, 1.0)[:, None])[classes]
    return np.stack([np.einsum("vi,vi->v", gradients, axis) for axis in frame], axis=1)


def steepest_slopes(
    positions: FloatArray, triangles: IntArray, field: WeightField, classes: IntArray
) -> Float64Array:
    """Return the steepest slope of any joint's weight along an edge from each weld class, (C,).

    The arguments are those of ``weight_gradients``, and so is the unit, 1 / length unit.
    """
    slopes = np.zeros(int(classes.max(initial=-1)) + 1)
    points = positions.astype(np.float64)
    for turn in range(3):
        start, end, _ = np.roll(triangles, -turn, axis=1).T
        edge, _, difference = corner_differences(field, start, end)
        found = np.abs(difference) / np.linalg.norm(points[end] - points[start], axis=1)[edge]
        for ends in (start, end):
            np.maximum.at(slopes, classes[ends[edge]], found)
    return slopes


@dataclass(frozen=True, slots=True)
class Corners:
    """One corner of each of T triangles.

    origin, first and second (T,) are its vertex and the two others. edges (2, T, 3) lead to these. weight
    (T,) is the corner's weight in the mean, coefficients (2, T, 3) the weight times the gradients of both
    hats. faces (T, 3) are the normals of the triangles, as long as twice their areas.
    """

    origin: IntArray
    first: IntArray
    second: IntArray
    edges: Float64Array
    weight: Float64Array
    coefficients: Float64Array
    faces: Float64Array

    def ends(self) -> Iterator[tuple[IntArray, Float64Array, Float64Array]]:
        """Return both ends: the other vertex, the edge to it, and the coefficients."""
        yield from zip((self.first, self.second), self.edges, self.coefficients, strict=True)


def corners_of(positions: FloatArray, triangles: IntArray, weighting: int) -> Iterator[Corners]:
    """Return all first corners of the triangles, then all second ones, then all third ones.

    weighting is a value of WEIGHTINGS, or ROOT.
    """
    points = positions.astype(np.float64)
    for turn in range(3):
        origin, first, second = np.roll(triangles, -turn, axis=1).T
        edges = np.stack([points[first] - points[origin], points[second] - points[origin]])
        weight, c1, c2 = corner_coefficients(tuple(edges[0].T), tuple(edges[1].T), weighting)
        coefficients = np.stack([np.stack(c1, axis=1), np.stack(c2, axis=1)])
        yield Corners(origin, first, second, edges, weight, coefficients, np.cross(*edges))


def corner_differences(
    field: WeightField, origin: IntArray, neighbour: IntArray
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], Float64Array]:
    """Return each difference of a joint's weight between two ends of edges, where it is not 0.

    origin and neighbour (N,) are vertices. Returns three arrays (D,): the edge, the joint, and w_neighbour −
    w_origin. A joint that only one end has weighs 0 at the other.
    """
    joints0, weights0 = field.joints[origin], field.weights[origin]
    joints1, weights1 = field.joints[neighbour], field.weights[neighbour]
    # Joints of the neighbour: less what they weigh at the origin, if they are there.
    same = joints1[:, :, None] == joints0[:, None, :]
    gained = weights1 - np.einsum("pij,pj->pi", same, weights0)
    # Joints that only the origin has fall to 0.
    lost = np.where(same.any(axis=1), 0.0, -weights0)
    difference = np.concatenate([gained, lost], axis=1)
    joints = np.concatenate([joints1, joints0], axis=1)
    pair, slot = np.nonzero((difference != 0) & (joints >= 0))
    return pair, joints[pair, slot], difference[pair, slot]


def summed_by_key(
    keys: Sequence[npt.NDArray[np.int64]], values: Sequence[Float64Array], joint_count: int, count: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], Float64Array]:
    """Sum the rows of values that belong to one class and joint: key = class × joint_count + joint.

    Returns offsets (C + 1,), joints (E,) and sums (E, M), in rows like CSR.
    """
    unique, inverse = np.unique(np.concatenate(keys), return_inverse=True)
    rows = np.concatenate(values)
    sums = summed_rows(inverse, rows, len(unique))
    # The keys ascend by class and then by joint, as rows of CSR do.
    owner, joints = np.divmod(unique, joint_count)
    offsets = np.concatenate([[0], np.cumsum(bincount(owner, minlength=count))])
    return offsets, joints, sums


def summed_rows(groups: IntArray, rows: Float64Array, count: int) -> Float64Array:
    """Sum the rows (N, M) of each of ``count`` groups, (count, M). groups (N,) names the group of each."""
    sums = np.empty((count, rows.shape[1]))
    for number, column in enumerate(rows.T):
        sums[:, number] = bincount(groups, column, count)
    return sums


MAX, ANGLE, AREA, ANGLE_AREA, ROOT = range(5)
WEIGHTINGS = {"max": MAX, "angle": ANGLE, "area": AREA, "angle-area": ANGLE_AREA}


def corner_coefficients(e1: Any, e2: Any, weighting: int) -> Any:
    """Return (weight, c1, c2) of a corner: its weight, and the weight times the gradients of both hats.

    e1, e2 are the edges at the corner, each a triple of components: numbers, or arrays (N,) of N corners. c1
    and c2 are such triples too. The corner adds c1 (w1 − w0) + c2 (w2 − w0) to the vertex's sum. The triangle
    must have an area. weighting is MAX, ANGLE, AREA, ANGLE_AREA or ROOT.
    """
    e1x, e1y, e1z = e1
    e2x, e2y, e2z = e2
    # n = e1 × e2, as long as twice the area.
    nx = e1y * e2z - e1z * e2y
    ny = e1z * e2x - e1x * e2z
    nz = e1x * e2y - e1y * e2x
    squared_area2 = nx * nx + ny * ny + nz * nz
    area2 = np.sqrt(squared_area2)
    # |e1|² |e2|², and the weight of the corner.
    squared_lengths = (e1x * e1x + e1y * e1y + e1z * e1z) * (e2x * e2x + e2y * e2y + e2z * e2z)
    if weighting == MAX:
        weight = area2 / squared_lengths
    elif weighting == ROOT:
        weight = area2 / (np.sqrt(squared_lengths) * np.sqrt(np.sqrt(squared_lengths)))
    elif weighting == AREA:
        weight = area2
    else:
        weight = np.arctan2(area2, e1x * e2x + e1y * e2y + e1z * e2z)
        if weighting == ANGLE_AREA:
            weight = weight * area2
    # The weight times ∇ of the hats at the two ends: e2 × n / |n|² and n × e1 / |n|².
    scale = weight / squared_area2
    c1 = ((e2y * nz - e2z * ny) * scale, (e2z * nx - e2x * nz) * scale, (e2x * ny - e2y * nx) * scale)
    c2 = ((ny * e1z - nz * e1y) * scale, (nz * e1x - nx * e1z) * scale, (nx * e1y - ny * e1x) * scale)
    return weight, c1, c2
