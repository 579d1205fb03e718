"""Run an algorithm over all poses and vertices, in blocks small enough for the processor's cache."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skinbake.errors import UnsupportedFeatureError
from skinbake.geometry.dual_quaternions import RIGID_TOLERANCE, rigid_motions
from skinbake.geometry.skinned import FloatArray
from skinbake.replay.algorithms import STEPS, Algorithm
from skinbake.replay.components import PosedVertex, RestVertex, Rows, Vector, scaled
from skinbake.replay.surface import Baseline, Options, RestSurface, SkinnedSurface

# Bytes of one component of a block, some sixty of which are alive at a time. Measured at 10,000 vertices ×
# 100 poses: flat from 32 to 256 KiB, half as long again at 16, where the interpreter begins to show.
_BLOCK_BYTES = 65536


def replay(
    algorithm: Algorithm,
    rest: RestSurface,
    joint_matrices: FloatArray,
    *,
    dtype: npt.DTypeLike = np.float64,
    cap: float | None = None,
    baseline: Baseline = Baseline.BLENDED,
    tolerance: float = RIGID_TOLERANCE,
) -> SkinnedSurface:
    """Skin a rest surface by joint matrices (P, J, 4, 4), with the frame that the algorithm gives it.

    Every number is converted to ``dtype`` (float32 or float64) first, and so is the result, in mesh space
    moved by the joint matrices. Normals are not unit. ``cap`` limits the length of the correction of t' and
    of b' to cap × |T t| and cap × |T b| in algorithms 3, 5 and 6 (DEFAULT_CAP is the published figure; None
    is off); ``baseline`` chooses the normal of algorithm 1. Both are ignored by the algorithms that they do
    not concern.

    Algorithms 4–6 apply the scale common to all joints of a pose to p, t and b first; a joint in use that is
    not rigid beyond it, within ``tolerance``, raises UnsupportedFeatureError (ask ``rigid_motions``
    beforehand). A vertex without weight collapses to the origin under linear blending and stays in place
    under dual quaternions.
    """
    motions = _motions(algorithm, rest, joint_matrices, tolerance)
    vertices = _Vertices.of(rest, dtype)
    table = np.ascontiguousarray(motions.table, dtype=dtype)
    scale = motions.scale.astype(dtype)
    poses, count = table.shape[1], len(rest.positions)
    posed = [np.empty((poses, count, 3), dtype=dtype) for _ in range(4)]
    steps, options = STEPS[algorithm], Options(cap, baseline)
    for pose, part in _blocks(poses, count, table.dtype.itemsize):
        vertex = vertices.block(part, scale[pose] if algorithm.uses_dual_quaternions else None)
        per_slot = [motions.of_slot(table[:, pose], joints[part]) for joints in vertices.joints]
        _write(posed, pose, part, steps(vertex, per_slot, options, _ignore_line))
    return SkinnedSurface(*posed)


def _ignore_line(number: int) -> None:
    """Mark nothing: only counting listens to the lines."""


@dataclass(frozen=True, slots=True)
class _Motions:
    """Joint motions as a table (components, P, J), the uniform scale (P,), and a row's length or None."""

    table: FloatArray
    scale: FloatArray
    row_length: int | None

    def of_slot(self, table: FloatArray, joints: npt.NDArray[np.intp]) -> Vector | Rows:
        """Gather the motions of one slot for a block: components (P, V), or three rows of four of them."""
        gathered = tuple(table.take(joints, axis=2))
        if self.row_length is None:
            return gathered
        return tuple(gathered[start : start + self.row_length] for start in range(0, 12, self.row_length))


def _motions(
    algorithm: Algorithm, rest: RestSurface, joint_matrices: FloatArray, tolerance: float
) -> _Motions:
    """Bring joint matrices into the form that the algorithm reads."""
    poses, joints = joint_matrices.shape[:2]
    if not algorithm.uses_dual_quaternions:
        rows = joint_matrices[:, :, :3, :].reshape(poses, joints, 12)
        return _Motions(np.moveaxis(rows, 2, 0), np.ones(poses), 4)
    motions = rigid_motions(joint_matrices, tolerance=tolerance, in_use=rest.joints_in_use(joints))
    if not motions.is_rigid:
        found = ", ".join(str(joint) for joint in motions.not_rigid[:8])
        more = f" and {motions.not_rigid.size - 8} more" if motions.not_rigid.size > 8 else ""
        raise UnsupportedFeatureError(
            f"dual quaternions need rigid joints, up to one uniform scale common to all; "
            f"joints {found}{more} are not within {tolerance:g}. Use linear blend skinning for them"
        )
    return _Motions(np.moveaxis(motions.dual_quaternions, 2, 0), motions.scale, None)


@dataclass(frozen=True, slots=True)
class _Vertices:
    """A rest surface turned round: one contiguous array a component, vertices last."""

    position: FloatArray
    normal: FloatArray
    tangent: FloatArray
    bitangent: FloatArray
    weights: FloatArray
    alpha: FloatArray
    beta: FloatArray
    gradients: FloatArray
    handedness: FloatArray
    joints: npt.NDArray[np.intp]

    @classmethod
    def of(cls, rest: RestSurface, dtype: npt.DTypeLike) -> _Vertices:
        """Transpose and convert every array of the surface."""

        def turned(array: FloatArray) -> FloatArray:
            return np.ascontiguousarray(np.moveaxis(array, 0, -1), dtype=dtype)

        return cls(
            position=turned(rest.positions),
            normal=turned(rest.normals),
            tangent=turned(rest.tangents),
            bitangent=turned(rest.bitangents),
            weights=turned(rest.weights),
            alpha=turned(rest.alpha),
            beta=turned(rest.beta),
            gradients=turned(rest.weight_gradients()),
            handedness=rest.handedness().astype(dtype),
            joints=np.ascontiguousarray(rest.joints.T, dtype=np.intp),
        )

    def block(self, part: slice, scale: FloatArray | None) -> RestVertex:
        """Return the vertices of a block; p, t and b times the scale (P,) of its poses where there is one."""
        position, tangent, bitangent = (
            tuple(vectors[:, part]) if scale is None else scaled(scale[:, None], tuple(vectors[:, part]))
            for vectors in (self.position, self.tangent, self.bitangent)
        )
        return RestVertex(
            position=position,
            normal=tuple(self.normal[:, part]),
            tangent=tangent,
            bitangent=bitangent,
            weights=tuple(self.weights[:, part]),
            alpha=tuple(self.alpha[:, part]),
            beta=tuple(self.beta[:, part]),
            gradients=[tuple(gradient[:, part]) for gradient in self.gradients],
            handedness=self.handedness[part],
        )


def _blocks(poses: int, vertices: int, itemsize: int) -> Iterator[tuple[slice, slice]]:
    """Cut poses × vertices into blocks of one size: part of a pose, or several poses of a small mesh."""
    size = _BLOCK_BYTES // itemsize
    pose_step = max(1, size // max(1, vertices))
    for vertex in range(0, vertices, size):
        for pose in range(0, poses, pose_step):
            yield slice(pose, pose + pose_step), slice(vertex, vertex + size)


def _write(posed: Sequence[FloatArray], pose: slice, part: slice, vertex: PosedVertex) -> None:
    """Write the components of a block into arrays (P, V, 3)."""
    vectors = (vertex.position, vertex.normal, vertex.tangent, vertex.bitangent)
    for array, vector in zip(posed, vectors, strict=True):
        for axis, component in enumerate(vector):
            array[pose, part, axis] = component
