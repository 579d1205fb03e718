"""Linear blend skinning in matrix form, for many poses at once, as far as it is linear in joint matrices.

Algorithms 1–3 (Tarini et al. 2014, supplement, §1–3) are linear in the joint matrices until they take a
product of two posed vectors. ``skinning.lbs`` has them line by line. With p̃ = (p, 1), each intermediate
vector before that product has one form:

    F(u, c) = Σ w[s] M[s] u + Σ c[s] M[s] p̃

    p' = F(p̃, 0)        T v = F((v, 0), 0)        t' = F((t, 0), α)        column i of J = F((eᵢ, 0), aᵢ)

α[0] is minus the sum of the others, as in Σ α (M[s] p − M[0] p). F is a sparse matrix with one row for each
vertex, times the joint matrices of all poses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from skinbake.choices import Baseline
from skinbake.geometry.skinned import Float64Array, FloatArray, IntArray
from skinbake.lighting import kernel
from skinbake.skinning.algorithms import Algorithm
from skinbake.skinning.components import Vector, cofactors, corrected, cross
from skinbake.skinning.surface import Options, RestSurface, all_slots

Form: TypeAlias = tuple[FloatArray, FloatArray | None]
"""The arguments of F: u (V, 3) or (3,), a direction, and c (V, K), or None for zeros."""

CHUNK_SAMPLES = 1 << 21
"""Vertices × poses that are deformed before they are measured: 50 MB of positions."""

CHUNK_POSES = 4
"""The least number of poses in a chunk, for any number of vertices. Sparse products need that many."""

BLOCK_SAMPLES = 1 << 16
"""Vertices × poses in work at a time. A block of 2¹⁴ is no faster alone, and threads wait for each other."""

BLOCK_VERTICES = 1 << 13
"""The most vertices in work at a time. With few poses, what is made of each vertex would take more memory."""


def chunks(vertices: int, poses: int) -> list[slice]:
    """Cut the poses of so many vertices into chunks."""
    size = max(CHUNK_POSES, CHUNK_SAMPLES // max(vertices, 1))
    # Whole vectors: no pose is left over from groups of eight, and rows begin with a line of the cache.
    size -= size % 8 if size > 8 else 0
    return [slice(start, min(start + size, poses)) for start in range(0, poses, size)]


def blocks(vertices: slice, poses: int) -> list[slice]:
    """Cut vertices into blocks, for chunks of so many poses."""
    size = max(1, min(BLOCK_SAMPLES // max(poses, 1), BLOCK_VERTICES))
    return [
        slice(start, min(start + size, vertices.stop)) for start in range(vertices.start, vertices.stop, size)
    ]


class BlendedSurface:
    """A rest surface under linear blend skinning by joint matrices (P, J, 4, 4), block by block.

    Vectors are components (P, V), stored vertex by vertex.
    """

    def __init__(
        self,
        rest: RestSurface,
        joint_matrices: Float64Array,
        options: Options,
        *,
        direct: Callable[[slice], RestSurface] | None = None,
    ) -> None:
        """Prepare a surface. Algorithm 2 needs ``direct``, and starts from its result for a block."""
        self._rest, self._options, self._direct = rest, options, direct
        self._handedness = rest.handedness()
        self._matrices = _Table(joint_matrices)
        self._cofactors = None
        if options.baseline is Baseline.COFACTOR:
            turned = np.zeros_like(joint_matrices)
            rows = tuple(tuple(np.moveaxis(joint_matrices[..., row, :3], -1, 0)) for row in range(3))
            for row, entries in enumerate(cofactors(rows)):
                turned[..., row, :3] = np.stack(entries, axis=-1)
            self._cofactors = _Table(turned)

    def positions(self, pose: slice, part: slice) -> Float64Array:
        """Return p' of a block: (3, V, P)."""
        block = self._block(part)
        posed: Float64Array = self._matrices.product(block, [block.weights * block.points], pose)[0]
        return posed

    def normals(self, algorithms: Sequence[Algorithm], pose: slice, part: slice) -> list[Vector]:
        """Return the normals that algorithms 1–3 give a block. They are not of unit length."""
        steps = {
            Algorithm.LBS_APPROXIMATED: self._approximated,
            Algorithm.LBS_DIRECT: self._direct_normals,
            Algorithm.LBS_ACCURATE: self._accurate,
        }
        block = self._block(part)
        return [tuple(axis.T for axis in steps[algorithm](block, pose)) for algorithm in algorithms]

    def _block(self, part: slice) -> _Block:
        positions = self._rest.positions[part]
        points = np.concatenate([positions, np.ones((len(positions), 1))], axis=1)
        columns = 4 * self._rest.joints[part].astype(np.int32)[:, :, None] + np.arange(4, dtype=np.int32)
        flat = np.asarray(columns.reshape(len(columns), -1), dtype=np.int32)
        return _Block(part, self._rest.weights[part, :, None], points[:, None], flat)

    def _approximated(self, block: _Block, pose: slice) -> Float64Array:
        """Return T n, T⁻ᵀ n or Σ w cof(M[s]) n: (3, V, P)."""
        normal = self._rest.normals[block.part]
        if self._options.baseline is Baseline.INVERSE_TRANSPOSE:
            axes: list[Form] = [(axis, None) for axis in np.eye(3)]
            return self._matrices.normals(block, axes, pose, normal)
        table = self._cofactors or self._matrices
        found: Float64Array = table.product(block, [block.entries((normal, None))], pose)[0]
        return found

    def _direct_normals(self, block: _Block, pose: slice) -> Float64Array:
        """Return J⁻ᵀ n: (3, V, P)."""
        if self._direct is None:
            raise ValueError("algorithm 2 was not prepared for")
        rest = self._direct(block.part)
        gradients = rest.weight_gradients()
        axes: list[Form] = [(axis, gradients[:, :, i]) for i, axis in enumerate(np.eye(3))]
        return self._matrices.normals(block, axes, pose, rest.normals)

    def _accurate(self, block: _Block, pose: slice) -> Float64Array:
        """Return ± t' × b' with the sign of b': (3, V, P)."""
        sign = self._handedness[block.part, None]
        frame = self._rest.tangents[block.part], sign * self._rest.bitangents[block.part]
        alpha, beta = (
            all_slots(np.asarray(others[block.part], dtype=np.float64))
            for others in (self._rest.alpha, self._rest.beta)
        )
        changes = alpha, sign * beta
        cap = self._options.cap
        if cap is None or changes[0].shape[1] == 1:
            return self._matrices.normals(block, list(zip(frame, changes, strict=True)), pose)
        still: list[Form] = [(vector, None) for vector in frame]
        moved: list[Form] = [(np.zeros(3), change) for change in changes]
        entries = [block.entries(form) for form in still + moved]
        t, b, by_t, by_b = map(tuple, self._matrices.product(block, entries, pose))
        return np.stack(cross(corrected(t, by_t, cap), corrected(b, by_b, cap)))


@dataclass(frozen=True, slots=True)
class _Block:
    """Some vertices: weights (V, K, 1), points p̃ (V, 1, 4) and columns of the joint matrices (V, 4 K)."""

    part: slice
    weights: FloatArray
    points: FloatArray
    columns: IntArray

    def entries(self, form: Form) -> Float64Array:
        """Return the entries (V, K, 4) of F's sparse matrix for one form."""
        direction, change = form
        wide = np.zeros((*direction.shape[:-1], 1, 4))
        wide[..., 0, :3] = direction
        entries = np.asarray(self.weights * wide, dtype=np.float64)
        if change is not None:
            entries += change[:, :, None] * self.points
        return entries


class _Table:
    """The first three rows of matrices (P, J, 4, 4), in the form that F is multiplied with."""

    def __init__(self, matrices: Float64Array) -> None:
        self._matrices = matrices
        self._pose: slice | None = None
        self._table: Float64Array = np.empty(0)

    def product(self, block: _Block, data: Sequence[Float64Array], pose: slice) -> Float64Array:
        """Multiply matrices with entries (V, K, 4) by the matrices of some poses: (forms, 3, V, P)."""
        return kernel.blend(_stacked(block, data), block.columns, self._of(pose))

    def normals(
        self, block: _Block, forms: Sequence[Form], pose: slice, normal: FloatArray | None = None
    ) -> Float64Array:
        """Return the cross product of two forms, or M⁻ᵀ n, the forms being M's columns: (3, V, P)."""
        entries = _stacked(block, [block.entries(form) for form in forms])
        return kernel.blended_normals(entries, block.columns, self._of(pose), normal)

    def _of(self, pose: slice) -> Float64Array:
        """Return the table of some poses. The last one is kept."""
        if pose != self._pose:
            rows = np.transpose(self._matrices[pose, :, :3], (1, 3, 2, 0))
            # This order matters: other threads look at the pose first.
            self._table = np.ascontiguousarray(rows, dtype=np.float64).reshape(rows.shape[0] * 4, 3, -1)
            self._pose = pose
        return self._table


def _stacked(block: _Block, data: Sequence[Float64Array]) -> Float64Array:
    """Return the entries of several forms, each (V, K, 4): (forms, V, 4 K)."""
    return np.stack(data).reshape(len(data), *block.columns.shape)


def blended_blocks(
    surfaces: Sequence[RestSurface], joint_matrices: Float64Array
) -> Iterator[tuple[slice, slice, list[BlendedSurface]]]:
    """Yield poses and vertices of blocks, with surfaces of the same vertices blended in all poses."""
    count = len(surfaces[0].positions)
    blended = [BlendedSurface(surface, joint_matrices, Options()) for surface in surfaces]
    for pose in chunks(count, len(joint_matrices)):
        for part in blocks(slice(0, count), pose.stop - pose.start):
            yield pose, part, blended
