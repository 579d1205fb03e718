"""From stored influences to a weight field: a partition of unity (docs/reference/gradients.md).

Here, too, are the influences that stay if a vertex may have only so many, and weights that do not sum to 1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from skinbake.errors import Notice, Place
from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray, IntArray, SkinnedPrimitive, blocks
from skinbake.gradients import kernel
from skinbake.gradients.surface import NO_JOINT, WeightDefects, WeightField
from skinbake.wording import one_or_many

SUM_TOLERANCE = 1e-3
"""The distance of Σw from 1 that gives a warning. A smaller distance is rounding of stored weights."""

ADOPTING_SUM = 1e-3
"""The Σw above which a vertex may adopt. Its largest weight must afford ``SLOT_COST`` for each slot too."""

SLOT_COST = 1 / 65535
"""What an adopted slot of integer weight takes from the largest weight."""


LEAST_WEIGHT = 2.0**-30
"""The share of a vertex's largest weight below which a weight counts as 0. Adopted slots have as much.

Some exporters leave weights of 1e-11, which move nothing and take slots from joints of neighbours.
"""


VALID_SUM = 2e-7
"""What the Khronos validator allows Σw to be off from 1 for each weight that is not 0, however small."""


def needs_tiny_weights(weights: FloatArray) -> BoolArray:
    """Tell at which vertices (V,) stored weights (V, K) would no longer be valid without those of no effect.

    Such a vertex may not adopt: a joint of tiny weight that it adopts into another slot would leave its own.
    """
    needs = np.zeros(len(weights), dtype=np.bool_)
    for block in blocks(len(weights)):
        part = weights[block]
        # Hardly any weight is tiny even against the largest one of all these vertices. Such are looked at.
        maybe = (part > 0.0) & (part <= LEAST_WEIGHT * float(part.max(initial=0.0)))
        places = np.flatnonzero(maybe) // part.shape[1]
        rows: IntArray = places[np.diff(places, prepend=-1) > 0]
        if not len(rows):
            continue
        part = part[rows]
        positive, largest = part > 0.0, part.max(axis=1, keepdims=True)
        tiny = positive & (part < LEAST_WEIGHT * largest.astype(np.float64))
        counts, tiny_counts = (np.count_nonzero(of_slots, axis=1) for of_slots in (positive, tiny))
        off = np.abs(part.sum(axis=1, dtype=np.float64) - 1.0)
        moved = 2.0 * LEAST_WEIGHT * tiny_counts  # by which clearing or adopting may change the sum
        valid = off <= VALID_SUM * counts + moved
        needs[block.start + rows] = (
            tiny.any(axis=1) & valid & (off > VALID_SUM * (counts - tiny_counts) - moved)
        )
    return needs


def weight_field(primitive: SkinnedPrimitive) -> tuple[WeightField, WeightDefects]:
    """Return the weight field of a primitive's stored influences, and the assumptions made.

    Negative weights count as 0. A vertex whose weights are all zero belongs to the joint of slot 0, as in
    three.js. Weights that move nothing count as 0, and all are divided by their sum. A joint in several slots
    keeps the first slot with a positive weight (or the first of all), with the sum of the weights.
    """
    field, defects = kernel.normalise_influences(
        primitive.joints,
        primitive.weights,
        adopting_sum=ADOPTING_SUM,
        adopting_weight=SLOT_COST * primitive.joints.shape[1],
        tolerance=SUM_TOLERANCE,
        least=LEAST_WEIGHT,
    )
    field.free[needs_tiny_weights(primitive.weights)] = False
    return field, defects


class LimitedSlots(NamedTuple):
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
    # The largest weights first; of equal ones the lowest joint.
    order = np.lexsort((field.joints, -weights), axis=1)
    kept = order[:, :count]
    chosen = np.take_along_axis(weights, kept, axis=1)
    # The sum goes one by one, so that it does not depend on how many are added.
    total = np.cumsum(chosen, axis=1)[:, -1:]
    # What is left out, and where joints in several slots were merged.
    dropped = np.take_along_axis(field.weights, order[:, count:], axis=1).sum(axis=1)
    merged = np.count_nonzero(primitive.weights > 0, axis=1) > np.count_nonzero(field.weights, axis=1)
    return LimitedSlots(
        slots=np.where(chosen > 0, kept, NO_JOINT),
        shares=chosen / total,
        rewritten=np.asarray((dropped > 0) | merged | (primitive.weights < 0).any(axis=1)),
        dropped=dropped,
    )


LARGE = 100.0
"""The factor from which on a percentage would have too many digits."""


def weight_sum_notices(primitive: SkinnedPrimitive, place: Place) -> list[Notice]:
    """Return a notice if weights (V, K) do not sum to 1, with negative ones counted as 0, else none.

    A vertex without any weight is another case. A shader adds the joints' motions with the given weights,
    which are Σw times as large as the ones for which α and β are made. So the correction of the normal counts
    1 / Σw times.
    """
    sums = np.maximum(primitive.weights, 0.0).sum(axis=1, dtype=np.float64)
    off = sums[(np.abs(sums - 1.0) > SUM_TOLERANCE) & (sums > 0.0)]
    if not len(off):
        return []
    low, high = float(off.min()), float(off.max())
    vertices = one_or_many(len(off), "1 vertex", "{} vertices")
    # Two bounds in words, or one number if they are equal.
    first, last = f"{low:.3g}", f"{high:.3g}"
    sums_told = first if first == last else f"{first} … {last}"
    up_to = "up to " if "…" in sums_told else ""
    # Sums below 1 make the correction too strong, and sums above 1 too weak.
    parts = [f"{up_to}{_excess(1.0 / low)} too strong"] if low < 1.0 else []
    parts += [f"{up_to}{_percent(1.0 - 1.0 / high)} too weak"] if high > 1.0 else []
    message = (
        f"the weights of {vertices} do not sum to 1 ({sums_told}): in a shader the correction of the "
        f"normals is {' or '.join(parts)} there; normalise the weights before the bake"
    )
    return [Notice("weights-sum", message, place, len(off))]


def _excess(factor: float) -> str:
    """Return by how much a factor is more than 1, in percent if it is not very large."""
    return _percent(factor - 1.0) if factor < LARGE else f"{factor:.3g} times"


def _percent(share: float) -> str:
    """Return a share in percent, with a digit after the point if it is small."""
    percent = 100.0 * share
    return f"{percent:.1f} %" if percent < 1.0 else f"{percent:,.0f} %"
