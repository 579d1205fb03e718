"""The influences that stay if a vertex may have only so many (the policy of docs/reference/gradients.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skinbake.geometry.skinned import BoolArray, Float64Array, SkinnedPrimitive
from skinbake.gradients.field import NO_JOINT
from skinbake.gradients.influences import weight_field


@dataclass(frozen=True, slots=True)
class LimitedSlots:
    """The influences that V vertices keep, N slots each, the largest first.

    slots (V, N) int64 is the stored slot of the joint in each slot, −1 for none. shares (V, N) float64 is its
    share of the kept weight, Σ is 1. rewritten (V,) tells that the stored weights no longer fit, because
    influences were dropped or merged, or weights were negative. Elsewhere weights only change their slot.
    dropped (V,) float64 is the share of the vertex's weight that is left out.
    """

    slots: npt.NDArray[np.int64]
    shares: Float64Array
    rewritten: BoolArray
    dropped: Float64Array


def limited_slots(primitive: SkinnedPrimitive, count: int) -> LimitedSlots:
    """Return the ``count`` largest influences of every vertex. Of equal weights, the lowest joint's stays.

    Repeated joints are merged first, negative weights are 0, and a vertex without weight keeps the joint of
    slot 0 (see ``weight_field``). Weights are compared, and shared out again, as w / Σw in float32. Copies of
    a vertex that are equal to ``weld`` so get equal results, in any order of their slots. ``count`` must not
    exceed the primitive's slots.
    """
    field, _ = weight_field(primitive)
    weights = field.weights.astype(np.float32).astype(np.float64)
    order = np.lexsort((field.joints, -weights), axis=1)
    kept = order[:, :count]
    chosen = np.take_along_axis(weights, kept, axis=1)
    # The sum goes one by one, so that it does not depend on how many are added.
    total = np.cumsum(chosen, axis=1)[:, -1:]
    dropped = np.take_along_axis(field.weights, order[:, count:], axis=1).sum(axis=1)
    merged = np.count_nonzero(primitive.weights > 0, axis=1) > np.count_nonzero(field.weights, axis=1)
    return LimitedSlots(
        slots=np.where(chosen > 0, kept, NO_JOINT),
        shares=chosen / total,
        rewritten=np.asarray((dropped > 0) | merged | (primitive.weights < 0).any(axis=1)),
        dropped=dropped,
    )
