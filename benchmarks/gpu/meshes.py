"""The meshes that are skinned: a sheet of any size for times, and the poses of its joints."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import isqrt

import numpy as np
import numpy.typing as npt

from benchmarks.gpu.adjacency import Adjacency
from skinbake.geometry.dual_quaternions import dual_quaternions_from_matrices

INFLUENCES = 4
SHEET_JOINTS = 64
LARGEST_TURN = np.radians(15.0)
"""How far the joints of a sheet turn: so little that the sheet stays within the picture."""

Single = npt.NDArray[np.float32]
Wide = npt.NDArray[np.float64]
Integers = npt.NDArray[np.integer]


@dataclass(frozen=True)
class Mesh:
    """A skinned mesh as a file stores it, four influences a vertex, with the normal frame.

    positions, normals (V, 3); joints (V, 4) uint8; weights (V, 4); alpha, beta (V, 3); triangles (T, 3);
    classes (V,): vertices of one number are one point of the surface, split at a seam.
    """

    positions: Single
    normals: Single
    joints: npt.NDArray[np.uint8]
    weights: Single
    alpha: Single
    beta: Single
    triangles: Integers
    classes: Integers

    @cached_property
    def adjacency(self) -> Adjacency:
        """The neighbours of each vertex, which only recomputed normals need."""
        return Adjacency.of(self.positions, self.normals, self.triangles, self.classes)

    def scaled(self, scale: float) -> Mesh:
        """Return the mesh in a unit that is so much smaller: dual quaternions have no scale of their own."""
        factor = np.float32(scale)
        return replace(
            self, positions=self.positions * factor, alpha=self.alpha / factor, beta=self.beta / factor
        )


def sheet(vertices: int) -> Mesh:
    """Return a bumpy sheet of at most so many vertices, over a row of joints.

    Neighbours lie near each other in memory, as in the files of most exporters. Each vertex follows its four
    nearest joints. α and β are random: their values change no time.
    """
    columns = max(2, isqrt(vertices))
    rows = max(2, vertices // columns)
    x, y = np.meshgrid(np.linspace(-0.9, 0.9, columns), np.linspace(-0.9, 0.9, rows))
    height = 0.05 * np.sin(9.0 * x) * np.cos(7.0 * y)
    slopes = 0.45 * np.cos(9.0 * x) * np.cos(7.0 * y), -0.35 * np.sin(9.0 * x) * np.sin(7.0 * y)
    normals = np.stack([-slopes[0], -slopes[1], np.ones_like(x)], axis=-1).reshape(-1, 3)
    joints, weights = _nearest_joints(x.ravel())
    rng = np.random.default_rng(0)
    alpha, beta = (rng.normal(size=(x.size, INFLUENCES - 1)).astype(np.float32) for _ in range(2))
    return Mesh(
        np.stack([x, y, height], axis=-1).reshape(-1, 3).astype(np.float32),
        (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32),
        joints,
        weights,
        alpha,
        beta,
        _triangles_of_a_sheet(rows, columns),
        np.arange(x.size),
    )


def _nearest_joints(x: Wide) -> tuple[npt.NDArray[np.uint8], Single]:
    """Return the four nearest joints along x, and weights that fall off with the distance."""
    place = (x + 1.0) / 2.0 * (SHEET_JOINTS - 1)
    first = np.clip(np.floor(place).astype(int) - 1, 0, SHEET_JOINTS - INFLUENCES)
    joints = first[:, None] + np.arange(INFLUENCES)
    weights = np.exp(-((joints - place[:, None]) ** 2))
    weights /= weights.sum(axis=1, keepdims=True)
    return joints.astype(np.uint8), weights.astype(np.float32)


def _triangles_of_a_sheet(rows: int, columns: int) -> Integers:
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    right, above = corner + 1, corner + columns
    lower = np.stack([corner, right, above], axis=1)
    upper = np.stack([right, above + 1, above], axis=1)
    return np.stack([lower, upper], axis=1).reshape(-1, 3)


def sheet_poses(poses: int) -> Wide:
    """Return joint matrices (P, J, 4, 4): each joint turned a little about its own place on the sheet."""
    rng = np.random.default_rng(1)
    axes = rng.normal(size=(poses, SHEET_JOINTS, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    half = 0.5 * rng.uniform(-LARGEST_TURN, LARGEST_TURN, (poses, SHEET_JOINTS, 1))
    x, y, z = np.moveaxis(axes * np.sin(half), -1, 0)
    w = np.cos(half)[..., 0]
    turned = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrices = np.tile(np.eye(4), (poses, SHEET_JOINTS, 1, 1))
    matrices[..., :3, :3] = np.moveaxis(turned, (0, 1), (2, 3))
    pivots = np.zeros((SHEET_JOINTS, 3))
    pivots[:, 0] = np.linspace(-1.0, 1.0, SHEET_JOINTS)
    matrices[..., :3, 3] = pivots - np.einsum("pjik,jk->pji", matrices[..., :3, :3], pivots)
    return matrices


@dataclass(frozen=True, slots=True)
class Palettes:
    """The joints of P poses as shaders have them.

    matrices (P, J, 4, 4) column by column; quaternions (P, J, 8), dual quaternions with scalars last.
    """

    matrices: Single
    quaternions: Single

    @classmethod
    def of(cls, matrices: Wide, dual_quaternions: Wide | None = None) -> Palettes:
        """Return the palettes of joint matrices (P, J, 4, 4), rigid if no dual quaternions are given."""
        if dual_quaternions is None:
            flat = dual_quaternions_from_matrices(matrices.reshape(-1, 4, 4))
            dual_quaternions = flat.reshape(*matrices.shape[:2], 8)
        return cls(
            np.ascontiguousarray(np.swapaxes(matrices, 2, 3), np.float32),
            np.ascontiguousarray(dual_quaternions[..., [1, 2, 3, 0, 5, 6, 7, 4]], np.float32),
        )

    def some(self, part: slice) -> Palettes:
        """Return the joints of some of the poses."""
        return Palettes(self.matrices[part], self.quaternions[part])

    @property
    def poses(self) -> int:
        """The number of poses."""
        return len(self.matrices)

    @property
    def joints(self) -> int:
        """The number of joints of a pose."""
        return int(self.matrices.shape[1])
