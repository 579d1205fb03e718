"""Run algorithms over a block of poses and vertices, small enough for the processor's cache."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from skinbake.geometry.dual_quaternions import RIGID_TOLERANCE, rigid_motions, scaled_motions
from skinbake.geometry.skinned import BoolArray, FloatArray
from skinbake.skinning import dqs, dqs_scaled, lbs
from skinbake.skinning.components import LineMark, PosedVertex, RestVertex, Rows, Vector
from skinbake.skinning.rest import Algorithm, Options, RestPrimitive

# From this number of poses on, components are stored pose by pose; with fewer poses rows are too short.
_ROWS = 16

SCALED = 20
"""The numbers of a joint that ``scaled_motions`` gives."""


# The second argument has an entry for each slot: Rows for 1–3, dual quaternions for 4–6; Rows also for
# joints that scale.
Steps: TypeAlias = Callable[[RestVertex, Sequence[Any], Options, LineMark], PosedVertex]

STEPS: dict[Algorithm, Steps] = {
    Algorithm.LBS_STANDARD: lbs.standard,
    Algorithm.LBS_DIRECT: lbs.direct,
    Algorithm.LBS_ACCURATE: lbs.accurate,
    Algorithm.DQS_STANDARD: dqs.standard,
    Algorithm.DQS_ACCURATE: dqs.accurate,
    Algorithm.DQS_EXACT: dqs.exact,
}

SCALED_STEPS: dict[Algorithm, Steps] = {
    Algorithm.DQS_STANDARD: dqs_scaled.standard,
    Algorithm.DQS_ACCURATE: dqs_scaled.accurate,
    Algorithm.DQS_EXACT: dqs_scaled.exact,
}


@dataclass(frozen=True, slots=True)
class Skinning:
    """A primitive at rest and joint motions of P poses, on which the algorithms run block by block.

    The motions are joint matrices for algorithms 1–3. For 4–6 they are dual quaternions if all joints in use
    are rigid, up to one scale that they share, else those of ``scaled_motions``.
    """

    vertices: _Vertices
    motions: _Motions
    options: Options

    @classmethod
    def of(
        cls,
        rest: RestPrimitive,
        joint_matrices: FloatArray,
        *,
        dual_quaternions: bool,
        dtype: npt.DTypeLike = np.float64,
        options: Options | None = None,
        tolerance: float = RIGID_TOLERANCE,
    ) -> Skinning:
        """Prepare joint matrices (P, J, 4, 4); every number is converted to ``dtype`` first.

        For rigid joints, algorithms 4–6 (``dual_quaternions``) apply the scale common to all joints of a pose
        to p, t and b first. A joint in use is rigid within ``tolerance`` (``rigid_motions``).
        """
        if dual_quaternions:
            motions = _dual_motions([rest], joint_matrices, tolerance, dtype)
        else:  # the upper three rows of the matrices
            rows = joint_matrices[:, :, :3, :].reshape(*joint_matrices.shape[:2], 12)
            motions = _Motions(np.ascontiguousarray(np.transpose(rows, (2, 1, 0)), dtype=dtype), 4, None)
        return cls(_Vertices(rest, dtype), motions, options or Options())

    @classmethod
    def of_mesh(
        cls,
        primitives: Sequence[RestPrimitive],
        joint_matrices: FloatArray,
        options: Options,
        *,
        dual_quaternions: bool = True,
    ) -> list[Skinning]:
        """Prepare the primitives of one mesh. For algorithms 4–6 they share their motions."""
        if not dual_quaternions:
            return [
                cls.of(rest, joint_matrices, dual_quaternions=False, options=options) for rest in primitives
            ]
        motions = _dual_motions(primitives, joint_matrices, RIGID_TOLERANCE, np.float64)
        return [cls(_Vertices(rest, np.float64), motions, options) for rest in primitives]

    def run(self, algorithms: Sequence[Algorithm], pose: slice, part: slice) -> list[PosedVertex]:
        """Return the result of an algorithm for a block of poses and vertices, as components (P, V)."""
        scale = self.motions.scale
        of_poses = None if scale is None else scale[pose]
        vertex = self.vertices.block(part, of_poses, gradients=Algorithm.LBS_DIRECT in algorithms)
        per_slot: Sequence[Any] = [
            self.motions.of_slot(joints, pose) for joints in self.vertices.joints(part)
        ]
        if self.has_scaled_joints:
            per_slot = dqs_scaled.with_rotations(per_slot)
        steps = SCALED_STEPS if self.has_scaled_joints else STEPS
        return [
            # Only counting needs the marks of lines.
            steps[algorithm](vertex, per_slot, self.options, lambda number: None)
            for algorithm in algorithms
        ]

    @property
    def has_scaled_joints(self) -> bool:
        """Tell whether the motions come from ``scaled_motions``."""
        return len(self.motions.table) == SCALED

    @property
    def lacks_rotations(self) -> bool:
        """Tell whether a joint, in use or not, has no rotation in a pose."""
        turns = self.motions.table[4::5]
        return self.has_scaled_joints and not bool(turns.any(axis=0).all())


def joints_in_use(primitives: Sequence[RestPrimitive], count: int) -> BoolArray:
    """Mark the joints (J,) that have a weight or a derivative on one of the primitives, of so many joints."""
    in_use = np.zeros(count, dtype=np.bool_)
    for primitive in primitives:
        in_use |= primitive.joints_in_use(count)
    return in_use


@dataclass(frozen=True, slots=True)
class _Motions:
    """Joint motions as a table (components, J, P), the length of a row or None, and the uniform scale (P,).

    Components of a block are (P, V). If there are many poses, components are stored pose by pose, so that
    joints are gathered in rows. With few poses the rows would be too short. scale is None if there is none.
    """

    table: FloatArray
    row_length: int | None
    scale: FloatArray | None

    def of_slot(self, joints: npt.NDArray[np.intp], pose: slice) -> Vector | Rows:
        """Gather the motions of one slot for a block: components (P, V), or three rows of four of them."""
        table = self.table[:, :, pose]
        if table.shape[2] < _ROWS:
            gathered = tuple(np.swapaxes(table, 1, 2).take(joints, axis=2))
        else:
            gathered = tuple(component.T for component in table.take(joints, axis=1))
        if self.row_length is None:
            return gathered
        starts = range(0, len(gathered), self.row_length)
        return tuple(gathered[start : start + self.row_length] for start in starts)


def _dual_motions(
    primitives: Sequence[RestPrimitive], joint_matrices: FloatArray, tolerance: float, dtype: npt.DTypeLike
) -> _Motions:
    """Convert joint matrices for algorithms 4–6, for all joints that one of the primitives uses."""
    in_use = joints_in_use(primitives, joint_matrices.shape[1])
    rigid = rigid_motions(joint_matrices, tolerance=tolerance, in_use=in_use)
    if rigid.is_rigid:
        table, row_length, scale = rigid.dual_quaternions, None, rigid.scale.astype(dtype)
    else:
        scaled = scaled_motions(joint_matrices)
        table, row_length, scale = scaled.reshape(*scaled.shape[:2], SCALED), 5, None
    return _Motions(np.ascontiguousarray(np.transpose(table, (2, 1, 0)), dtype=dtype), row_length, scale)


@dataclass(frozen=True, slots=True)
class _Vertices:
    """A primitive at rest. Its blocks are transposed one by one: all at once would double its memory."""

    rest: RestPrimitive
    dtype: npt.DTypeLike

    def block(self, part: slice, scale: FloatArray | None, *, gradients: bool) -> RestVertex:
        """Return the vertices of a block; p, t and b times the scale (P,) of its poses if there is one."""
        rest = self.rest.rows(part)
        position, tangent, bitangent = (
            tuple(vectors) if scale is None else _scaled(scale, vectors)
            for vectors in map(self._transposed, (rest.positions, rest.tangents, rest.bitangents))
        )
        return RestVertex(
            position=position,
            normal=tuple(self._transposed(rest.normals)),
            tangent=tangent,
            bitangent=bitangent,
            weights=tuple(self._transposed(rest.weights)),
            alpha=tuple(self._transposed(rest.alpha)),
            beta=tuple(self._transposed(rest.beta)),
            gradients=list(map(tuple, self._transposed(rest.weight_gradients()))) if gradients else [],
            handedness=rest.handedness().astype(self.dtype),
        )

    def joints(self, part: slice) -> npt.NDArray[np.intp]:
        """Return the joints of a block by slot: (K, V)."""
        return np.ascontiguousarray(self.rest.joints[part].T, dtype=np.intp)

    def _transposed(self, array: FloatArray) -> FloatArray:
        """Return one contiguous row for each component, vertices last."""
        return np.ascontiguousarray(np.moveaxis(array, 0, -1), dtype=self.dtype)


def _scaled(scale: FloatArray, vectors: FloatArray) -> Vector:
    """Return vectors (3, V) times the scale of each pose (P,), stored like gathered motions."""
    if len(scale) < _ROWS:
        return tuple(scale[:, None] * component for component in vectors)
    return tuple((component[:, None] * scale).T for component in vectors)
