"""The distance between two fields of normals, angles in degrees, and the areas that weight them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skinbake.geometry.poses import determinants, product
from skinbake.geometry.skinned import (
    Float32Array,
    Float64Array,
    FloatArray,
    IntArray,
    SkinnedPrimitive,
    bincount,
    blocks,
)
from skinbake.gltf.document import Document
from skinbake.gltf.reading.skins import Skeleton, read_skeleton, rest_pose
from skinbake.skinning.components import Vector, cross, dot, minus
from skinbake.truth.mesh import normalised_weights


def vertex_areas(positions: FloatArray, triangles: IntArray) -> Float64Array:
    """Return the area around each vertex, a third of each of its triangles: (V,) float64, squared unit."""
    axes = np.ascontiguousarray(np.asarray(positions, dtype=np.float64).T)
    doubled = np.empty(len(triangles))
    with np.errstate(invalid="ignore", over="ignore"):  # what is not finite counts as no area
        for rows in blocks(len(triangles)):
            corners = np.ascontiguousarray(triangles[rows].T, dtype=np.intp)
            first, second, third = (tuple(axis[corner] for axis in axes) for corner in corners)
            normal = cross(minus(second, first), minus(third, first))
            doubled[rows] = np.sqrt(dot(normal, normal))
    shares = np.where(np.isfinite(doubled), doubled, 0.0) / 6.0
    corner_shares = np.repeat(shares, 3)
    return bincount(triangles.ravel(), corner_shares, minlength=len(positions)).astype(np.float64)


def angles_between(measured: Vector, expected: Vector) -> Float64Array:
    """Return the angles in degrees, (…) float64, between vectors of any length, by components (…).

    An angle is NaN if one of its vectors has no direction, or is too long to square.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # of a vector of zeros, or too long
        # atan2 takes twice as long as atan. The ratio of two zeros is NaN, as wanted.
        ratio: Float64Array = np.sqrt(squared_cross(measured, expected)) / dot(measured, expected)
        angles: Float64Array = np.arctan(ratio)
        angles *= 180.0 / np.pi
        angles += 180.0 * np.signbit(ratio)
    return angles


def units_or_nan(vector: Vector) -> list[FloatArray]:
    """Return unit vectors by components; NaN for a vector that is zero, not finite or too long to square."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # likewise
        square = dot(vector, vector)
        square[square == np.inf] = np.nan
        reciprocal = 1.0 / np.sqrt(square)
        return [reciprocal * component for component in vector]


def angles_of_units(measured: Sequence[FloatArray], expected: Sequence[FloatArray]) -> Float32Array:
    """Return the angle between unit vectors given by their components, in degrees, float32.

    With the chord c between their ends, it is twice the arctangent of c / √(4 − c²). It is as exact near 0°
    and 180° as ``angles_between``, and cheaper if one vector is compared with several.
    """
    # Opposite vectors, or a NaN or infinity in place of a unit.
    with np.errstate(invalid="ignore", divide="ignore"):
        chord: Float64Array = np.square(measured[0] - expected[0])
        chord += np.square(measured[1] - expected[1])
        chord += np.square(measured[2] - expected[2])
        ratio = (chord / (4.0 - chord)).astype(np.float32)
        # Rounding may make a chord longer than the diameter.
        angles: Float32Array = np.arctan(np.sqrt(np.abs(ratio)))
        angles *= np.float32(360.0 / np.pi)
    return angles


def squared_cross(a: Vector, b: Vector) -> Float64Array:
    """Return |a × b|² of vectors of any length, given by their components."""
    (x, y, z), (u, v, w) = a, b
    total: Float64Array = np.square(y * w - z * v)
    total += np.square(z * u - x * w)
    total += np.square(x * v - y * u)
    return total


_COLLAPSED = 1e-12
"""A surface is collapsed by its joints below this share of its largest squared coordinate."""


class RestAreas:
    """The areas around vertices in the rest pose of one skin."""

    def __init__(self, document: Document, skin: int) -> None:
        self._skeleton: Skeleton = read_skeleton(document, skin)
        with np.errstate(over="ignore", invalid="ignore"):  # such poses are refused elsewhere
            self._matrices: Float64Array = rest_pose(self._skeleton)[0]

    def of(self, primitive: SkinnedPrimitive) -> Float64Array:
        """Return the area around each vertex of a primitive, (V,) float64, squared unit of the scene.

        The rest pose may hide a surface with a scale of 0. Then the area comes from the inverse bind matrices
        of its joints alone, because the animation may show the surface.
        """
        joints = np.where(primitive.joints < len(self._matrices), primitive.joints, 0)
        weights = normalised_weights(primitive.weights, joints)
        positions = primitive.positions.astype(np.float64)
        posed = np.zeros_like(positions)
        with np.errstate(over="ignore", invalid="ignore"):  # past all numbers: the matrices alone decide
            for rows in blocks(len(posed)):
                for joint, weight in zip(joints[rows].T, weights[rows].T, strict=True):
                    matrices = self._matrices[joint, :3]
                    moved = product(matrices[..., :3], positions[rows, :, None])[..., 0] + matrices[..., 3]
                    posed[rows] += weight[:, None] * moved
            areas = vertex_areas(posed, primitive.triangles)
            in_use = np.zeros(len(posed), dtype=np.bool_)
            in_use[primitive.triangles] = True
            extent = float(np.abs(posed[in_use]).max(initial=0.0))
            if _COLLAPSED * extent * extent < areas.sum() < np.inf:
                return areas
            scales = np.abs(determinants(self._skeleton.inverse_bind[joints[:, 0]])) ** (2.0 / 3.0)
            return np.asarray(vertex_areas(positions, primitive.triangles) * np.nan_to_num(scales, nan=1.0))
