"""The true normals of a skinned mesh by its triangles: angle-weighted vertex normals, as tools shade.

Source: Thürmer, Wüthrich, *Computing vertex normals from polygonal facets*, Journal of Graphics Tools 3(1),
1998. The normal of a vertex is the mean of the unit normals of its triangles. Each is weighted by the
triangle's angle at the vertex. The mean runs over the corners of its weld class, so not across hard edges.
The authored normal keeps its coordinates in the frame of that normal and of a tangent, from the rest pose to
the deformed mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray, IntArray
from skinbake.lighting.operator import GradientOperator
from skinbake.lighting.reference import RestFrames, posed_tangents
from skinbake.skinning.components import Vector, cross, dot, minus_scaled, scaled

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# A deformed triangle with a corner of a larger cotangent is a line or a point, and has no normal.
_FLAT = 1e10

BLOCK_SAMPLES = 1 << 13
"""The triangles × poses in work at a time. The temporaries of a block stay in the processor's cache."""


@dataclass(frozen=True, slots=True)
class TriangleBlock:
    """Some triangles (B, 3), the weld classes (C,) that they touch, and the sum of their corners there.

    corners (C, 3B) is sparse. It has a one for each corner: all first corners, then all second ones, and so
    on.
    """

    triangles: IntArray
    classes: IntArray
    corners: csr_array


def triangle_blocks(operator: GradientOperator, poses: int) -> list[TriangleBlock]:
    """Cut a mesh's triangles into blocks, for chunks of so many poses."""
    from scipy.sparse import csr_array

    size = max(1, BLOCK_SAMPLES // max(poses, 1))
    # One array serves all blocks: a million vertices have six million corners.
    ones = np.ones(3 * min(size, len(operator.triangles)))
    blocks = []
    for start in range(0, len(operator.triangles), size):
        triangles = operator.triangles[start : start + size]
        places = operator.classes[triangles].T.ravel()
        classes, rows = np.unique(places, return_inverse=True)
        order = np.argsort(rows, kind="stable").astype(np.int32)
        ends = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=len(classes)))]).astype(np.int32)
        shape = (len(classes), len(places))
        corners = csr_array((ones[: len(places)], order, ends), shape=shape)
        blocks.append(TriangleBlock(triangles, classes, corners))
    return blocks


def corner_sums(block: TriangleBlock, positions: Float64Array) -> Float64Array:
    """Return Σ angle × unit normal over the corners of a block at each of its classes: (3, C, P).

    positions (3, V, P) belong to all vertices. Triangles without an area, or with a broken position, add
    nothing.
    """
    first, second, third = (np.ascontiguousarray(column) for column in block.triangles.T)
    with np.errstate(all="ignore"):
        origin = [component[first] for component in positions]
        e1 = tuple(component[second] for component in positions)
        e2 = tuple(component[third] for component in positions)
        for axis in range(3):
            np.subtract(e1[axis], origin[axis], out=e1[axis])
            np.subtract(e2[axis], origin[axis], out=e2[axis])
        aa, ab = dot(e1, e1), dot(e1, e2)
        normal = cross(e1, e2)
        area = np.sqrt(dot(normal, normal))
        reciprocal = 1.0 / area
        # The angles at the first two corners come from their cotangents. The third is the rest of 180°.
        cotangents = ab * reciprocal, (aa - ab) * reciprocal
        at_first, at_second = (np.arctan(cotangent) for cotangent in cotangents)
        at_third = at_first + at_second
        np.subtract(0.5 * np.pi, at_first, out=at_first)
        np.subtract(0.5 * np.pi, at_second, out=at_second)
        unit = scaled(reciprocal, normal)
    angles = at_first, at_second, at_third
    # The test is not "flat if beyond": a comparison with NaN is false. A flat triangle shows at one of two
    # corners.
    if not all(values.min() > -_FLAT and values.max() < _FLAT for values in cotangents):
        sound = (np.abs(cotangents[0]) < _FLAT) & (np.abs(cotangents[1]) < _FLAT)
        for values in (*angles, *unit):
            values[~sound] = 0.0
    count, poses = area.shape
    weighted = np.empty((3, count, poses))
    sums = np.empty((3, len(block.classes), poses))
    for axis, component in enumerate(unit):
        for corner, angle in enumerate(angles):
            np.multiply(angle, component, out=weighted[corner])
        sums[axis] = block.corners @ weighted.reshape(3 * count, poses)
    return sums


def vertex_normals(
    operator: GradientOperator, blocks: Sequence[TriangleBlock], positions: Float64Array
) -> Float64Array:
    """Return the angle-weighted sums of the weld classes: (3, C, P), from positions (3, V, P)."""
    total = np.zeros((3, len(operator.ends) - 1, positions.shape[2]))
    for block in blocks:
        total[:, block.classes] += corner_sums(block, positions)
    return total


@dataclass(frozen=True, slots=True)
class CarriedNormals:
    """The coordinates (3, V) of unit n0 in the frame t̂, n̂ × t̂, n̂ at rest, NaN if there is no frame.

    n̂ is the normal by triangles. t̂ is the part of the first tangent at right angles to n̂.
    """

    coefficients: Float64Array


def carried_normals(
    operator: GradientOperator, rest: RestFrames, positions: FloatArray, normals: FloatArray
) -> CarriedNormals:
    """Return the coordinates of the normals n0 (V, 3) on the mesh before skinning, with positions (V, 3)."""
    components = np.ascontiguousarray(np.asarray(positions, dtype=np.float64).T)[:, :, None]
    sums = vertex_normals(operator, triangle_blocks(operator, 1), components)
    coefficients = np.full((3, len(positions)), np.nan)
    with np.errstate(all="ignore"):
        for part, derivatives in zip(rest.parts, rest.tangents, strict=True):
            frame = _frame(posed_tangents(derivatives, components)[0], block_sums(operator, sums, part))
            n0 = tuple(np.asarray(normals[part], dtype=np.float64).T[:, None])
            found = np.concatenate([dot(axis, n0) for axis in frame])
            coefficients[:, part] = found / np.sqrt((found * found).sum(axis=0))
    return CarriedNormals(coefficients)


def block_sums(operator: GradientOperator, sums: FloatArray, part: slice) -> Vector:
    """Return the sums of a block of vertices, components (P, B), from the sums of all classes (3, C, P)."""
    classes = operator.classes[part]
    return tuple(component[classes].astype(np.float64).T for component in sums)


def triangle_normals(
    carried: CarriedNormals, part: slice, tangent: Vector, sums: Vector, sides: FloatArray | None = None
) -> tuple[Vector, BoolArray]:
    """Return the true normals of a block of vertices by triangles, components (P, B), and a mask of them.

    tangent is the block's first tangent after deformation (``posed_tangents``). sums are its ``block_sums``.
    sides (P, B) is −1 if the joints mirror a vertex, because the triangles' normals point inside there.
    """
    by_t, by_s, by_n = carried.coefficients[:, part]
    with np.errstate(all="ignore"):
        t, s, n = _frame(tangent, sums)
        if sides is not None:
            by_n = by_n * sides
        # The coordinates are unit in an orthonormal frame, so the result is already unit.
        found = tuple(by_t * t[i] + by_s * s[i] + by_n * n[i] for i in range(3))
    return found, np.isfinite(found[0])


def _frame(tangent: Vector, normal: Vector) -> tuple[Vector, Vector, Vector]:
    """Return the orthonormal frame t̂, n̂ × t̂, n̂; NaN if there is none."""
    n = scaled(1.0 / np.sqrt(dot(normal, normal)), normal)
    t = minus_scaled(tangent, dot(tangent, n), n)
    t = scaled(1.0 / np.sqrt(dot(t, t)), t)
    return t, cross(n, t), n
