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

import numpy as np

from skinbake.choices import Baseline
from skinbake.geometry.poses import determinants
from skinbake.geometry.skinned import Float64Array, FloatArray, IntArray, blocks
from skinbake.skinning.components import Vector, cofactors, corrected, cross
from skinbake.skinning.rest import Algorithm, Options, RestPrimitive, all_slots
from skinbake.truth import kernel
from skinbake.truth.values import Forms

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
    return list(blocks(poses, size))


def sample_blocks(vertices: slice, poses: int) -> list[slice]:
    """Cut vertices into blocks, for chunks of so many poses."""
    size = max(1, min(BLOCK_SAMPLES // max(poses, 1), BLOCK_VERTICES))
    first = vertices.start
    return [slice(first + part.start, first + part.stop) for part in blocks(vertices.stop - first, size)]


class BlendedPrimitive:
    """A primitive under linear blend skinning by joint matrices (P, J, 4, 4), block by block.

    Vectors are components (P, V), stored vertex by vertex.
    """

    def __init__(
        self,
        rest: RestPrimitive,
        joint_matrices: Float64Array,
        options: Options,
        *,
        direct: Callable[[slice | IntArray], RestPrimitive] | None = None,
    ) -> None:
        """Prepare a primitive. Algorithm 2 needs ``direct``, and starts from its result for a block."""
        self._rest, self._options, self._direct = rest, options, direct
        self._handedness = rest.handedness()
        self._matrices = _Table(joint_matrices)
        self._cofactors = None
        if options.baseline is Baseline.COFACTOR:
            of_cofactors = np.zeros_like(joint_matrices)
            rows = tuple(tuple(np.moveaxis(joint_matrices[..., row, :3], -1, 0)) for row in range(3))
            for row, entries in enumerate(cofactors(rows)):
                of_cofactors[..., row, :3] = np.stack(entries, axis=-1)
            self._cofactors = _Table(of_cofactors)

    def put_positions(self, pose: slice, part: slice, out: Float64Array, first_row: int) -> None:
        """Write p' of some vertices to the rows of out (3, V, P) from ``first_row`` on."""
        kernel.blend(self._forms(part), self._matrices.of(pose), out[None], first_row)

    def positions(self, pose: slice, part: slice) -> Float64Array:
        """Return p' of some vertices: (3, B, P)."""
        posed = np.empty((3, part.stop - part.start, pose.stop - pose.start))
        self.put_positions(pose, part, posed, 0)
        return posed

    def normals(self, algorithms: Sequence[Algorithm], pose: slice, part: slice | IntArray) -> list[Vector]:
        """Return the normals that algorithms 1–3 give some vertices. They are not of unit length."""
        steps = {
            Algorithm.LBS_STANDARD: self._standard,
            Algorithm.LBS_DIRECT: self._direct_normals,
            Algorithm.LBS_ACCURATE: self._accurate,
        }
        return [tuple(axis.T for axis in steps[algorithm](pose, part)) for algorithm in algorithms]

    def changed_normals(self, pose: slice, part: slice, changes: Float64Array) -> Float64Array:
        """Return T (n + δ) of some vertices for changes δ (3, B, P) of their summed normals: (3, B, P)."""
        changed = self._rest.summed_normals(part).T[:, :, None] + changes
        return np.asarray((self.columns(pose, part) * changed[:, None]).sum(axis=0))

    def columns(self, pose: slice, part: slice) -> Float64Array:
        """Return the columns of T = Σ w M of some vertices: (3, 3, B, P), the column first."""
        found = np.empty((3, 3, part.stop - part.start, pose.stop - pose.start))
        kernel.blend(self._forms(part, _axes(len(found[0, 0]))), self._matrices.of(pose), found)
        return found

    def _forms(
        self, part: slice | IntArray, directions: FloatArray | None = None, changes: FloatArray | None = None
    ) -> Forms:
        rest = self._rest
        return Forms(rest.joints[part], rest.weights[part], rest.positions[part], directions, changes)

    def _standard(self, pose: slice, part: slice | IntArray) -> Float64Array:
        """Return T n, T⁻ᵀ n or Σ w cof(M[s]) n: (3, B, P)."""
        normal = self._rest.normals[part]
        if self._options.baseline is Baseline.INVERSE_TRANSPOSE:
            # T⁻ᵀ n, from the columns of T.
            columns = self._forms(part, _axes(len(normal)))
            return kernel.blended_normals(columns, self._matrices.of(pose), normal)
        # Σ w M n or Σ w cof(M) n: the same blend, of other matrices.
        table = self._cofactors or self._matrices
        found = np.empty((3, len(normal), pose.stop - pose.start))
        kernel.blend(self._forms(part, normal[None]), table.of(pose), found[None])
        return found

    def _direct_normals(self, pose: slice, part: slice | IntArray) -> Float64Array:
        """Return J⁻ᵀ n: (3, B, P)."""
        if self._direct is None:
            raise ValueError("algorithm 2 was not prepared for")
        rest = self._direct(part)
        # The columns of J = T + Σ M p ∇wᵀ.
        gradients = np.moveaxis(rest.weight_gradients(), 2, 0)
        columns = self._forms(part, _axes(len(rest.normals)), gradients)
        return kernel.blended_normals(columns, self._matrices.of(pose), rest.normals)

    def _accurate(self, pose: slice, part: slice | IntArray) -> Float64Array:
        """Return ± t' × b' with the sign of b': (3, B, P)."""
        cap = self._options.cap
        if cap is None or self._rest.joints.shape[1] == 1:
            forms = self._forms(part, *self._frame_and_changes(part))
            return kernel.blended_normals(forms, self._matrices.of(pose))
        # With a cap the two parts of t' and b' are needed one by one.
        t, b = (corrected(tuple(v), tuple(by), cap) for v, by in zip(*self.tangents(pose, part), strict=True))
        return np.stack(cross(t, b))

    def tangents(self, pose: slice, part: slice | IntArray) -> Float64Array:
        """Return t' and ± b' of some vertices without α and β, and what these add: (2, 2, 3, B, P)."""
        frame, changes = self._frame_and_changes(part)
        table = self._matrices.of(pose)
        found = np.empty((2, *np.shape(np.swapaxes(frame, 1, 2)), pose.stop - pose.start))
        kernel.blend(self._forms(part, frame), table, found[0])
        kernel.blend(self._forms(part, np.zeros_like(frame), changes), table, found[1])
        return found

    def _frame_and_changes(self, part: slice | IntArray) -> tuple[Float64Array, Float64Array]:
        """Return t and ± b (2, B, 3), with the sign of the frame, and α and ± β of all slots (2, B, K)."""
        rest, sign = self._rest, self._handedness[part, None]
        others = rest.alpha[part], sign * rest.beta[part]
        changes = np.stack([all_slots(np.asarray(derivatives, dtype=np.float64)) for derivatives in others])
        return np.stack([rest.tangents[part], sign * rest.bitangents[part]]), changes


def _axes(count: int) -> Float64Array:
    """Return the three axes as directions of so many vertices: (3, B, 3)."""
    return np.broadcast_to(np.eye(3)[:, None], (3, count, 3))


class _Table:
    """The first three rows of matrices (P, J, 4, 4), in the form that F is multiplied with."""

    def __init__(self, matrices: Float64Array) -> None:
        self._matrices = matrices
        self._pose: slice | None = None
        self._table: Float64Array = np.empty(0)

    def of(self, pose: slice) -> Float64Array:
        """Return the columns of the matrices of some poses: (4 J, 3, P). The last result is kept."""
        if pose != self._pose:
            rows = np.transpose(self._matrices[pose, :, :3], (1, 3, 2, 0))
            # This order matters: other threads look at the pose first.
            self._table = np.ascontiguousarray(rows, dtype=np.float64).reshape(rows.shape[0] * 4, 3, -1)
            self._pose = pose
        return self._table


def blended_blocks(
    primitives: Sequence[RestPrimitive], joint_matrices: Float64Array
) -> Iterator[tuple[slice, slice, list[BlendedPrimitive]]]:
    """Yield poses and vertices of blocks, with primitives of the same vertices blended in all poses."""
    count = len(primitives[0].positions)
    blended = [BlendedPrimitive(primitive, joint_matrices, Options()) for primitive in primitives]
    for pose in chunks(count, len(joint_matrices)):
        for part in sample_blocks(slice(0, count), pose.stop - pose.start):
            yield pose, part, blended


SHRUNK, HIDDEN = 1e-12, 1e-6
"""The largest entry of a joint's linear part up to which what it leaves of a surface is rounding.

And the weight of all other joints up to which a vertex is hidden: adopted ones have less.
"""


def sides_of(primitives: Sequence[RestPrimitive], joint_matrices: Float64Array) -> Float64Array | None:
    """Return −1 (P, V) if the joint of the largest weight mirrors, else 1; None if all are 1.

    A joint that mirrors turns t' × b' to the inside. For example, some left hands are right hands under a
    negative scale. In a fold, the surface turns over although its joints do not mirror. A fold is left as it
    is, because the exact normal does turn inside out there. It is NaN where all joints of a vertex have the
    scale 0, which hides parts of a model: what rounding leaves of the surface there has no true normal.
    """
    mirrors = determinants(joint_matrices) < 0
    is_point = np.abs(joint_matrices[..., :3, :3]).max(axis=(2, 3)) <= SHRUNK
    if not (mirrors.any() or is_point.any()):
        return None
    dominant = np.concatenate(
        [
            np.take_along_axis(primitive.joints, primitive.weights.argmax(axis=1)[:, None], axis=1)[:, 0]
            for primitive in primitives
        ]
    )
    sides = np.where(mirrors.T[dominant], -1.0, 1.0).T
    for pose in np.flatnonzero(is_point.any(axis=1)):
        left = [(one.weights * ~is_point[pose][one.joints]).sum(axis=1) for one in primitives]
        sides[pose, np.concatenate(left) <= HIDDEN] = np.nan
    return sides
