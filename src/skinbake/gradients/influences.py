"""The weight field: stored influences made a partition of unity (docs/reference/gradients.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skinbake.geometry.skinned import BoolArray, Float64Array, IntArray, SkinnedPrimitive
from skinbake.gradients import kernel

SUM_TOLERANCE = 1e-3
"""How far Σw may be from 1 before it is worth a warning: below, it is the rounding of stored weights."""

ADOPTING_SUM = 1e-3
"""Σw above which a vertex may adopt: its largest weight must afford 1/65535 for each adopted slot."""

NO_JOINT = -1


@dataclass(frozen=True, slots=True)
class WeightField:
    """The normalised weights of V vertices: joints (V, K) int32, weights (V, K) float64, Σ over K is 1.

    Every joint stands in one slot of a vertex only: repeats have joint −1 and weight 0, their weight
    added to the slot that keeps the joint. Slots keep the places they have in the file. free (V, K) tells
    which slots may adopt a joint: those stored with weight 0, unless the vertex has next to no weight (a sum
    of at most SUM_TOLERANCE), where the smallest weight would be a share of it, or the whole.
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


def weight_field(primitive: SkinnedPrimitive) -> tuple[WeightField, WeightDefects]:
    """Return the weight field of a primitive's stored influences, and what had to be assumed.

    Negative weights count as 0. A vertex whose weights are all zero belongs to slot 0's joint, which is
    what three.js makes of it. Weights are divided by their sum. A joint that stands in several slots keeps
    the first slot with a positive weight (or the first of all), with the sum of the weights.
    """
    joints = primitive.joints.astype(np.int32, order="C")
    weights = primitive.weights.astype(np.float64, order="C")
    if kernel.compiled is not None:
        free = np.empty(joints.shape, dtype=np.bool_)
        counts = kernel.compiled.normalise(joints, weights, free, ADOPTING_SUM, SUM_TOLERANCE)
        return WeightField(joints, weights, free), WeightDefects(*counts)
    return _normalised(joints, weights)


def _normalised(joints: npt.NDArray[np.int32], weights: Float64Array) -> tuple[WeightField, WeightDefects]:
    """Do what ``_kernel.normalise`` does, with whole arrays."""
    free = weights == 0
    negative = weights < 0
    weights[negative] = 0.0
    total = weights.sum(axis=1)
    free &= (total > ADOPTING_SUM)[:, None]
    empty = total == 0
    weights[empty, 0] = 1.0
    total[empty] = 1.0
    repeated = _merge_repeats(joints, weights)
    defects = WeightDefects(
        negative=int(np.count_nonzero(negative.any(axis=1))),
        all_zero=int(np.count_nonzero(empty)),
        not_normalised=int(np.count_nonzero(np.abs(total - 1.0) > SUM_TOLERANCE)),
        repeated_joint=repeated,
    )
    weights /= total[:, None]
    return WeightField(joints, weights, free), defects


def _merge_repeats(joints: npt.NDArray[np.int32], weights: Float64Array) -> int:
    """Merge repeated joints in place; return at how many vertices two positive weights were merged."""
    influences = joints.shape[1]
    merged = np.zeros(len(joints), dtype=np.bool_)
    for later in range(1, influences):
        for earlier in range(later):
            same = (joints[:, later] == joints[:, earlier]) & (joints[:, later] != NO_JOINT)
            if not same.any():
                continue
            merged |= same & (weights[:, later] > 0) & (weights[:, earlier] > 0)
            moves_back = same & (weights[:, earlier] == 0) & (weights[:, later] > 0)
            keeps_first = same & ~moves_back
            weights[keeps_first, earlier] += weights[keeps_first, later]
            weights[keeps_first, later] = 0.0
            joints[keeps_first, later] = NO_JOINT
            joints[moves_back, earlier] = NO_JOINT
    return int(np.count_nonzero(merged))
