"""Skinned meshes of one analytic surface: the truth is known, the triangulation is as bad as asked for.

A curved patch over [0, 4] × [0, 2], three joints along x, and smooth weights that are functions of the
position, so that their gradients have a formula. Everything is float64 and follows from the seed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial import Delaunay, cKDTree

from skinbake.geometry.skinned import Float64Array, SkinnedPrimitive

Triangulation = Literal["random", "irregular", "jittered"]

MILD, STRONG = 10.0, 28.0
"""Degrees by which each of the two bends turns."""

_SIZE = np.array([4.0, 2.0])
_JOINTS_AT = np.array([0.8, 2.0, 3.2])
_ACROSS = np.array([1.0, 0.3, 0.0])
_STEP = 1e-4


@dataclass(frozen=True)
class AnalyticSurface:
    """A triangulated patch and what is known about it.

    parameters (V, 2). tangents, bitangents (V, 3): an orthonormal frame with the exact normals. gradients
    (V, 3, 3): ∇w of joints 0 … 2, analytic, not projected onto the surface. sharpness: how fast one joint's
    weight gives way to the next, 1 / squared length.
    """

    primitive: SkinnedPrimitive
    parameters: Float64Array
    tangents: Float64Array
    bitangents: Float64Array
    gradients: Float64Array
    sharpness: float

    @property
    def alpha(self) -> Float64Array:
        """∇w · t0 of joints 0 … 2, (V, 3)."""
        alpha: Float64Array = np.einsum("vsi,vi->vs", self.gradients, self.tangents)
        return alpha

    @property
    def beta(self) -> Float64Array:
        """∇w · b0 of joints 0 … 2, (V, 3)."""
        beta: Float64Array = np.einsum("vsi,vi->vs", self.gradients, self.bitangents)
        return beta

    def deformed(self, poses: Float64Array) -> Float64Array:
        """Skin the rest positions, (P, V, 3), by joint matrices (P, 3, 4, 4)."""
        return np.stack(
            [_skin(self.primitive.positions.astype(np.float64), self.sharpness, pose) for pose in poses]
        )

    def exact_normals(self, poses: Float64Array) -> Float64Array:
        """Return the unit normals of the skinned surface, (P, V, 3), by differences in its parameters.

        Fourth order with a step of 1e-4: truncation and rounding both stay near 1e-10 degrees.
        """
        normals = []
        for pose in poses:
            skinned = partial(_skinned_patch, self.sharpness, pose)
            normals.append(_unit(np.cross(*_derivatives(skinned, self.parameters))))
        return np.stack(normals)


def analytic_surface(
    count: int, triangulation: Triangulation, *, sharpness: float = 4.0, jitter: float = 0.1, seed: int = 0
) -> AnalyticSurface:
    """Triangulate the patch with about ``count`` vertices.

    random: uniform random points, Delaunay. irregular: random points that keep a distance (Poisson discs),
    Delaunay, as remeshers and scans have them. jittered: a grid whose vertices move by up to ``jitter``
    cells.
    """
    parameters, triangles = flat_triangulation(count, triangulation, jitter=jitter, seed=seed)
    positions = _patch(parameters)
    along_u, along_v = _derivatives(_patch, parameters)
    normals, tangents = _unit(np.cross(along_u, along_v)), _unit(along_u)
    weights, gradients = _weights(positions, sharpness)
    # A fourth slot, unused, names joint 0 a second time: as exporters pad.
    joints = np.tile(np.array([0, 1, 2, 0], dtype=np.uint16), (len(positions), 1))
    padded = np.column_stack([weights, np.zeros(len(positions))])
    primitive = SkinnedPrimitive(positions, normals, None, joints, padded, triangles)
    return AnalyticSurface(primitive, parameters, tangents, np.cross(normals, tangents), gradients, sharpness)


def bends(degrees: Sequence[float]) -> Float64Array:
    """Return joint matrices (P, 3, 4, 4), one pose per angle: two bends about oblique axes."""
    poses = []
    for angle in np.radians(degrees):
        first = _turn_about([1.4, 0.0, 0.0], [0.0, 1.0, 0.3], float(angle))
        second = first @ _turn_about([2.6, 0.0, 0.0], [0.2, -0.3, 1.0], float(angle))
        poses.append(np.stack([np.eye(4), first, second]))
    return np.stack(poses)


def flat_triangulation(
    count: int, triangulation: Triangulation, *, jitter: float = 0.1, seed: int = 0
) -> tuple[Float64Array, npt.NDArray[np.int64]]:
    """Triangulate the rectangle: points (V, 2), triangles (T, 3) counter-clockwise."""
    rng = np.random.default_rng(seed)
    if triangulation == "jittered":
        return _jittered_grid(count, jitter, rng)
    spacing = float(np.sqrt(_SIZE.prod() / count))
    points = _border(spacing)
    if triangulation == "random":
        points = np.concatenate([points, rng.random((count - len(points), 2)) * _SIZE])
    else:
        # Discs at random end up 1.2 times their radius apart, measured: this radius yields about ``count``.
        points = _thinned(np.concatenate([points, rng.random((12 * count, 2)) * _SIZE]), 0.8 * spacing)
    return points, Delaunay(points).simplices.astype(np.int64)


def _jittered_grid(
    count: int, jitter: float, rng: np.random.Generator
) -> tuple[Float64Array, npt.NDArray[np.int64]]:
    rows = round(float(np.sqrt(count * _SIZE[0] / _SIZE[1])))
    columns = round(count / rows)
    u, v = np.linspace(0.0, _SIZE[0], rows), np.linspace(0.0, _SIZE[1], columns)
    grid = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1)
    moved = rng.uniform(-jitter, jitter, grid.shape) * [u[1], v[1]]
    moved[[0, -1], :, 0] = 0.0
    moved[:, [0, -1], 1] = 0.0
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    triangles = np.concatenate(
        [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, c), (a, c, d))]
    )
    return (grid + moved).reshape(-1, 2), triangles


def _border(spacing: float) -> Float64Array:
    """Points around the rectangle, so that the triangulation fills it."""
    width, height = _SIZE
    u = np.linspace(0.0, width, round(width / spacing) + 1)
    v = np.linspace(0.0, height, round(height / spacing) + 1)[1:-1]
    sides = [
        (u, np.zeros_like(u)),
        (u, np.full_like(u, height)),
        (np.zeros_like(v), v),
        (np.full_like(v, width), v),
    ]
    return np.concatenate([np.column_stack(side) for side in sides])


def _thinned(points: Float64Array, radius: float) -> Float64Array:
    """Keep each point, in order, that no kept one is nearer to than ``radius``."""
    tree = cKDTree(points)
    alive = np.ones(len(points), dtype=bool)
    for index in range(len(points)):
        if alive[index]:
            alive[tree.query_ball_point(points[index], radius)] = False
            alive[index] = True
    return points[alive]


def _patch(parameters: Float64Array) -> Float64Array:
    u, v = parameters[..., 0], parameters[..., 1]
    return np.stack([u, v, 0.3 * np.sin(1.2 * u) * np.cos(1.5 * v)], axis=-1)


def _weights(positions: Float64Array, sharpness: float) -> tuple[Float64Array, Float64Array]:
    """Weights (V, 3), a softmax of squared distances along one direction, and their gradients (V, 3, 3)."""
    apart = (positions @ _ACROSS)[:, None] - _JOINTS_AT
    powers = np.exp(-sharpness * apart**2)
    weights = powers / powers.sum(axis=1, keepdims=True)
    logarithmic = -2.0 * sharpness * apart
    slopes = weights * (logarithmic - (weights * logarithmic).sum(axis=1, keepdims=True))
    return weights, slopes[:, :, None] * _ACROSS


def _skin(positions: Float64Array, sharpness: float, pose: Float64Array) -> Float64Array:
    weights = _weights(positions, sharpness)[0]
    moved = np.einsum("sij,vj->vsi", pose[:, :3, :3], positions) + pose[:, :3, 3]
    skinned: Float64Array = np.einsum("vs,vsi->vi", weights, moved)
    return skinned


def _skinned_patch(sharpness: float, pose: Float64Array, parameters: Float64Array) -> Float64Array:
    return _skin(_patch(parameters), sharpness, pose)


def _derivatives(
    surface: Callable[[Float64Array], Float64Array], at: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Differentiate a map of parameters along u and along v, fourth order."""
    along = []
    for step in np.eye(2) * _STEP:
        near = surface(at + step) - surface(at - step)
        far = surface(at + 2.0 * step) - surface(at - 2.0 * step)
        along.append((8.0 * near - far) / (12.0 * _STEP))
    return along[0], along[1]


def _turn_about(pivot: Sequence[float], axis: Sequence[float], angle: float) -> Float64Array:
    """Return the (4, 4) rotation about an axis through a pivot (Rodrigues)."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix = np.eye(4)
    matrix[:3, :3] += np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    matrix[:3, 3] = np.array(pivot) - matrix[:3, :3] @ np.array(pivot)
    return matrix


def _unit(vectors: Float64Array) -> Float64Array:
    lengths: Float64Array = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / lengths
