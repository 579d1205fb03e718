"""The influences that ``bake --limit-influences`` leaves, found by another route than bake's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skinbake.geometry.skinned import Float64Array, SkinnedPrimitive
from skinbake.truth.mesh import influence_keys


def limited_primitive(primitive: SkinnedPrimitive, count: int, unit: int | None) -> SkinnedPrimitive:
    """Return a primitive with its ``count`` largest influences, largest first: joints and weights (V, count).

    Influences are joint → w / Σw in float32; of equal ones the lowest joint stays. Weights sum to 1: in
    steps of 1 / unit where ``unit`` is an integer, in float32 for None. Where no vertex has more than
    ``count``, or the same joint twice, weights are not rounded.
    """
    joints, shares = influence_keys([primitive])
    left = shares.astype(np.float64)
    rows = np.arange(len(left))
    chosen = np.zeros((len(left), count), dtype=np.int64)
    weights = np.zeros((len(left), count))
    for slot in range(min(count, left.shape[1])):
        # Joints ascend, and the first of equal maxima is taken.
        largest = left.argmax(axis=1)
        weights[:, slot] = left[rows, largest]
        chosen[:, slot] = np.where(weights[:, slot] > 0.0, joints[rows, largest], 0)
        left[rows, largest] = 0.0
    total = np.zeros(len(left))
    for slot in range(count):
        total += weights[:, slot]
    weights /= total[:, None]
    renewed = (left > 0.0).any(axis=1) | _untidy(primitive)
    weights[renewed] = _stored(weights[renewed], unit)
    return replace(primitive, joints=chosen, weights=weights)


def _untidy(primitive: SkinnedPrimitive) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Mark, (V,), where a joint has two positive weights, or a weight is negative."""
    used = np.where(
        primitive.weights > 0.0, primitive.joints.astype(np.int64), -1 - np.arange(_slots(primitive))
    )
    ordered = np.sort(used, axis=1)
    return np.asarray(
        (ordered[:, 1:] == ordered[:, :-1]).any(axis=1) | (primitive.weights < 0.0).any(axis=1),
        dtype=np.bool_,
    )


def _slots(primitive: SkinnedPrimitive) -> int:
    return int(primitive.joints.shape[1])


def _stored(weights: Float64Array, unit: int | None) -> Float64Array:
    """Round weights (V, N) that sum to 1 as they are stored: whole units go to the largest remainders."""
    if unit is None:
        return weights.astype(np.float32).astype(np.float64)
    units = np.floor(weights * unit)
    remainders = weights * unit - units
    for _ in range(weights.shape[1]):
        short = units.sum(axis=1) < unit
        first = remainders.argmax(axis=1)
        units[short, first[short]] += 1.0
        remainders[np.arange(len(units)), first] = -1.0
    return np.asarray(units / unit)
