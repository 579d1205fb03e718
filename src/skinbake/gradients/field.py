"""The weight field of a surface: the joints that move each vertex, and by how much."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from skinbake.geometry.skinned import BoolArray, Float64Array, IntArray

NO_JOINT = -1


class WeightField(NamedTuple):
    """The normalised weights of V vertices: joints (V, K) int32, weights (V, K) float64, Σ over K is 1.

    Every joint has only one slot of a vertex. A repeat gets joint −1 and weight 0, and the slot that keeps
    the joint gets its weight. Slots keep the places that they have in the file. free (V, K) tells which slots
    may adopt a joint: those stored with weight 0, or with so little that it counts as 0
    (``influences.LEAST_WEIGHT``). A vertex whose stored weights sum to at most ``influences.ADOPTING_SUM``
    has none. The weight that an adopted slot gets would be a visible part of so small a sum. A vertex with a
    negative weight has none either, since its slot may already name the joint.
    """

    joints: npt.NDArray[np.int32]
    weights: Float64Array
    free: BoolArray

    def rows(self, vertices: IntArray | slice) -> WeightField:
        """Return the field of some vertices."""
        return WeightField(self.joints[vertices], self.weights[vertices], self.free[vertices])


@dataclass(frozen=True, slots=True)
class WeightDefects:
    """The number of vertices of a primitive that needed each assumption."""

    negative: int
    all_zero: int
    not_normalised: int
    repeated_joint: int


def concatenate_fields(fields: Sequence[WeightField]) -> WeightField:
    """Return the weight fields of several primitives as one, filled to the largest number of slots."""
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
