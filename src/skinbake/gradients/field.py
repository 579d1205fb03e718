"""The weight field of a surface: which joint moves a vertex by how much."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skinbake.geometry.skinned import BoolArray, Float64Array, IntArray

NO_JOINT = -1


@dataclass(frozen=True, slots=True)
class WeightField:
    """The normalised weights of V vertices: joints (V, K) int32, weights (V, K) float64, Σ over K is 1.

    Every joint stands in one slot of a vertex only: repeats have joint −1 and weight 0, their weight
    added to the slot that keeps the joint. Slots keep the places they have in the file. free (V, K) tells
    which slots may adopt a joint: those stored with weight 0, unless the vertex has next to no weight (a sum
    of at most ``influences.ADOPTING_SUM``), where the smallest weight would be a share of it, or the whole.
    """

    joints: npt.NDArray[np.int32]
    weights: Float64Array
    free: BoolArray

    def rows(self, vertices: IntArray | slice) -> WeightField:
        """Return the field of some vertices."""
        return WeightField(self.joints[vertices], self.weights[vertices], self.free[vertices])


@dataclass(frozen=True, slots=True)
class WeightDefects:
    """How many vertices of a primitive needed which assumption."""

    negative: int
    all_zero: int
    not_normalised: int
    repeated_joint: int


def concatenate_fields(fields: Sequence[WeightField]) -> WeightField:
    """Return the weight fields of several primitives as one, filled up to the largest number of slots."""
    if len(fields) == 1:
        return fields[0]
    influences = max(field.joints.shape[1] for field in fields)
    joints, weights, free = [], [], []
    for field in fields:
        missing = ((0, 0), (0, influences - field.joints.shape[1]))
        joints.append(np.pad(field.joints, missing, constant_values=NO_JOINT))
        weights.append(np.pad(field.weights, missing))
        free.append(np.pad(field.free, missing))
    return WeightField(np.concatenate(joints), np.concatenate(weights), np.concatenate(free))
