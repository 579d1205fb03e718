"""Store adopted joints: weights too small to see, so that no tool takes their slots for empty.

A joint with weight zero draws a warning from the Khronos validator, and several tools reset it. So an
adopted slot gets the smallest weight that its type can afford; CONVENTIONS.md states how little that moves a
vertex.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from skinbake.geometry.skinned import IntArray
from skinbake.gltf.accessors import StoredArray
from skinbake.gltf.primitives import StoredInfluences

TINY_WEIGHT = np.float32(2.0**-30)
"""FLOAT weight of an adopted slot; the others stay as they are, the sum grows by a billionth a slot."""

UNIT = 65535
"""Integer weights are kept as unsigned shorts, where an adopted slot has 1 and the largest gives it up."""


def with_adopted(sets: Sequence[StoredInfluences], adopted: IntArray) -> list[StoredInfluences]:
    """Return the influence sets with adopted joints in place; arrays without a change are the same objects.

    adopted (V, K) is the joint that each slot adopts, −1 where it stays. Unsigned bytes become shorts where
    they must change: v / 255 is exactly 257 v / 65535.
    """
    slots = [adopted[:, 4 * number : 4 * number + 4] for number in range(len(sets))]
    dues = _dues(sets, slots)
    return [
        replace(
            stored,
            joints=_new_joints(stored.joints, slot),
            weights=_new_weights(stored.weights, slot, due),
        )
        for stored, slot, due in zip(sets, slots, dues, strict=True)
    ]


def _dues(sets: Sequence[StoredInfluences], slots: Sequence[IntArray]) -> list[IntArray]:
    """Return per set (V, 4) how many units each slot gives up: a vertex's largest weight pays for all.

    Of equal weights the one of the lowest joint pays, so that copies of a vertex with their slots in another
    order still agree.
    """
    weights = np.concatenate([stored.weights.decoded() for stored in sets], axis=1)
    joints = np.concatenate([stored.joints.values.astype(np.int64) for stored in sets], axis=1)
    largest = weights == weights.max(axis=1, keepdims=True)
    payer = np.where(largest, joints, np.iinfo(np.int64).max).argmin(axis=1)
    units = np.zeros(len(weights), dtype=np.int64)
    for stored, slot in zip(sets, slots, strict=True):
        if stored.weights.values.dtype.kind != "f":
            units += np.count_nonzero(slot >= 0, axis=1)
    dues = np.zeros(weights.shape, dtype=np.int64)
    dues[np.arange(len(weights)), payer] = units
    return [dues[:, 4 * number : 4 * number + 4] for number in range(len(sets))]


def _new_joints(stored: StoredArray, slot: IntArray) -> StoredArray:
    if not (slot >= 0).any():
        return stored
    wide = slot.max() > np.iinfo(stored.values.dtype).max  # type: ignore[type-var]
    values: npt.NDArray[Any] = stored.values.astype(np.uint16 if wide else stored.values.dtype)
    values[slot >= 0] = slot[slot >= 0]
    return replace(stored, values=values)


def _new_weights(stored: StoredArray, slot: IntArray, due: IntArray) -> StoredArray:
    if not (slot >= 0).any() and not due.any():
        return stored
    if stored.values.dtype.kind == "f":
        floats = stored.values.astype(np.float32)
        floats[slot >= 0] = TINY_WEIGHT
        return replace(stored, values=floats - (due / UNIT).astype(np.float32) if due.any() else floats)
    widened = stored.values.astype(np.int64) * (257 if stored.values.dtype.itemsize == 1 else 1)
    shorts = np.where(slot >= 0, 1, widened) - due
    return replace(stored, values=shorts.astype(np.uint16))
