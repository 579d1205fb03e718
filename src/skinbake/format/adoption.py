"""Store adopted joints with weights too small to see, so that no tool takes their slots for empty.

The Khronos validator warns of a joint with weight zero, and several tools reset it. So an adopted slot gets
the smallest weight that its type can afford. docs/reference/gradients.md states how little this moves a
vertex.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from skinbake.geometry.skinned import BoolArray, IntArray
from skinbake.gltf.accessors import StoredArray
from skinbake.gltf.primitives import StoredInfluences

TINY_WEIGHT = np.float32(2.0**-30)
"""FLOAT weight of an adopted slot. Other weights stay; the sum grows by a billionth for each slot."""

UNIT = 65535
"""Integer weights are stored as unsigned shorts. An adopted slot has 1, and the largest weight loses 1."""


def with_adopted(
    sets: Sequence[StoredInfluences], rows: IntArray, adopted: IntArray
) -> list[StoredInfluences]:
    """Return the influence sets with adopted joints; unchanged arrays are the same objects.

    rows (A,) are the vertices that adopt. adopted (A, K) is the joint that each slot adopts, −1 for none. No
    positive weight of the vertex may count for it. So another slot that names the joint is free, and becomes
    joint 0 of weight 0: glTF allows a joint once at a vertex. Unsigned bytes become shorts if they must
    change: v / 255 is exactly 257 v / 65535.
    """
    slots = [adopted[:, 4 * number : 4 * number + 4] for number in range(len(sets))]
    vacated = [
        (slot < 0) & (stored.joints.values[rows, :, None] == adopted[:, None, :]).any(axis=2)
        for stored, slot in zip(sets, slots, strict=True)
    ]
    dues = _dues(sets, rows, slots)
    return [
        replace(
            stored,
            joints=_new_joints(stored.joints, rows, slot, left),
            weights=_new_weights(stored.weights, rows, slot, left, due),
        )
        for stored, slot, left, due in zip(sets, slots, vacated, dues, strict=True)
    ]


def _dues(sets: Sequence[StoredInfluences], rows: IntArray, slots: Sequence[IntArray]) -> list[IntArray]:
    """Return per set (A, 4) the units that each slot loses: the largest weight of a vertex pays for all.

    Of equal weights, the weight of the lowest joint pays. So copies of a vertex with another order of slots
    still agree.
    """
    weights = np.concatenate([_rows_of(stored.weights, rows).decoded() for stored in sets], axis=1)
    joints = np.concatenate([stored.joints.values[rows].astype(np.int64) for stored in sets], axis=1)
    largest = weights == weights.max(axis=1, keepdims=True)
    payer = np.where(largest, joints, np.iinfo(np.int64).max).argmin(axis=1)
    units = np.zeros(len(weights), dtype=np.int64)
    for stored, slot in zip(sets, slots, strict=True):
        if stored.weights.values.dtype.kind != "f":
            units += np.count_nonzero(slot >= 0, axis=1)
    dues = np.zeros(weights.shape, dtype=np.int64)
    dues[np.arange(len(weights)), payer] = units
    return [dues[:, 4 * number : 4 * number + 4] for number in range(len(sets))]


def _rows_of(stored: StoredArray, rows: IntArray) -> StoredArray:
    return replace(stored, values=stored.values[rows])


def _new_joints(stored: StoredArray, rows: IntArray, slot: IntArray, vacated: BoolArray) -> StoredArray:
    kept: npt.NDArray[Any] = np.where(vacated, 0, stored.values[rows])
    if not (slot >= 0).any() and (kept == stored.values[rows]).all():
        return stored
    wide = slot.max() > np.iinfo(stored.values.dtype).max  # type: ignore[type-var]  # joints are integers
    values: npt.NDArray[Any] = stored.values.astype(np.uint16 if wide else stored.values.dtype)
    values[rows] = np.where(slot >= 0, slot, kept)
    return replace(stored, values=values)


def _new_weights(
    stored: StoredArray, rows: IntArray, slot: IntArray, vacated: BoolArray, due: IntArray
) -> StoredArray:
    before: npt.NDArray[Any] = stored.values
    if not (slot >= 0).any() and not due.any() and not before[rows][vacated].any():
        return stored
    if before.dtype.kind == "f":
        floats = before.astype(np.float32)
        paid = floats[rows] - (due / UNIT).astype(np.float32) if due.any() else floats[rows]
        floats[rows] = np.where(slot >= 0, TINY_WEIGHT, np.where(vacated, 0, paid))
        return replace(stored, values=floats)
    shorts = before.astype(np.uint16) * np.uint16(257 if before.dtype.itemsize == 1 else 1)
    shorts[rows] = np.where(slot >= 0, 1, shorts[rows]) - due
    return replace(stored, values=shorts)
