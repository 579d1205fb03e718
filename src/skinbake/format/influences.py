"""The stored influences that a bake changes: adopted joints, fewer influences, one influence set more.

Adopted joints get weights too small to see, so that no tool takes their slots for empty.
``--limit-influences`` keeps the component type, and integer weights sum to their type's largest value.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from skinbake.choices import SLOTS_PER_SET
from skinbake.geometry.skinned import TINY_WEIGHT, UNIT, BoolArray, Float64Array, IntArray, SkinnedPrimitive
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.document import Document
from skinbake.gltf.reading.accessors import StoredArray
from skinbake.gltf.reading.meshes import StoredInfluences, joints_of_skin, read_influences
from skinbake.gradients.influences import limited_slots


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
    # The largest weight of a vertex pays for the units that all its slots take, and of equal ones that of the
    # lowest joint. So copies of a vertex with another order of slots still agree.
    weights = np.concatenate(
        [stored.weights._replace(values=stored.weights.values[rows]).decoded() for stored in sets], axis=1
    )
    joints = np.concatenate([stored.joints.values[rows].astype(np.int64) for stored in sets], axis=1)
    largest = weights == weights.max(axis=1, keepdims=True)
    payer = np.where(largest, joints, np.iinfo(np.int64).max).argmin(axis=1)
    units = np.zeros(len(weights), dtype=np.int64)
    for stored, slot in zip(sets, slots, strict=True):
        if stored.weights.values.dtype.kind != "f":
            units += np.count_nonzero(slot >= 0, axis=1)
    dues = np.zeros(weights.shape, dtype=np.int64)
    dues[np.arange(len(weights)), payer] = units
    found = []
    for number, (stored, slot) in enumerate(zip(sets, slots, strict=True)):
        names, due = stored.joints.values[rows], dues[:, 4 * number : 4 * number + 4]
        vacated = (slot < 0) & (names[:, :, None] == adopted[:, None, :]).any(axis=2)
        new_joints, new_weights = stored.joints, stored.weights
        # The joints: those that were adopted, and joint 0 in the slots that they have left.
        kept: npt.NDArray[Any] = np.where(vacated, 0, names)
        if (slot >= 0).any() or (kept != names).any():
            dtype = stored.joints.values.dtype
            wide = slot.max() > np.iinfo(dtype.str).max
            values: npt.NDArray[Any] = stored.joints.values.astype(np.uint16 if wide else dtype)
            values[rows] = np.where(slot >= 0, slot, kept)
            new_joints = new_joints._replace(values=values)
        # The weights: the least that a type holds in adopted slots.
        before: npt.NDArray[Any] = stored.weights.values
        if (slot >= 0).any() or due.any() or before[rows][vacated].any():
            after: npt.NDArray[Any]
            if before.dtype.kind == "f":
                after = before.astype(np.float32)
                paid = after[rows] - (due / UNIT).astype(np.float32) if due.any() else after[rows]
                after[rows] = np.where(slot >= 0, TINY_WEIGHT, np.where(vacated, 0, paid))
            else:
                after = before.astype(np.uint16) * np.uint16(257 if before.dtype.itemsize == 1 else 1)
                after[rows] = np.where(slot >= 0, 1, after[rows]) - due
            new_weights = new_weights._replace(values=after)
        found.append(stored._replace(joints=new_joints, weights=new_weights))
    return found


def with_limit(
    sets: Sequence[StoredInfluences],
    slots: npt.NDArray[np.int64],
    shares: Float64Array,
    rewritten: BoolArray,
) -> list[StoredInfluences]:
    """Return influence sets of N slots for each vertex, N a multiple of 4.

    slots (V, N) is the stored slot whose joint each new slot takes, −1 for none (joint 0, weight 0). At
    vertices in ``rewritten`` (V,), weights are ``shares`` (V, N), which sum to 1. At other vertices they are
    the stored ones. Joints take the widest type of the sets. Weights take the type that all sets have,
    otherwise FLOAT.
    """
    joints = np.concatenate([stored.joints.values.astype(np.int64) for stored in sets], axis=1)
    taken = np.where(slots >= 0, np.take_along_axis(joints, np.maximum(slots, 0), axis=1), 0)
    unit = common_unit(sets)
    dtype = np.dtype(np.float32) if unit is None else sets[0].weights.values.dtype
    # float64 holds every FLOAT and every integer of 16 bits exactly.
    parts = [entry.weights.decoded() if unit is None else entry.weights.values for entry in sets]
    stored = np.concatenate(parts, axis=1).astype(np.float64)
    renewed = shares
    if unit is not None:
        # Shares rounded to integers that sum to the unit: the largest remainders are rounded up, of equal
        # ones that of the earlier slot: the larger weight, then the lower joint.
        exact = shares * unit
        renewed = np.floor(exact)
        missing = unit - renewed.sum(axis=1, keepdims=True)
        rank = np.argsort(np.argsort(renewed - exact, axis=1, kind="stable"), axis=1, kind="stable")
        renewed = renewed + (rank < missing)
    moved = np.take_along_axis(stored, np.maximum(slots, 0), axis=1)
    weights = np.where(slots >= 0, np.where(rewritten[:, None], renewed, moved), 0)
    taken[(weights == 0) & rewritten[:, None]] = 0
    kind = max((stored.joints.values.dtype for stored in sets), key=lambda dtype: dtype.itemsize)
    return [
        StoredInfluences(
            StoredArray(taken[:, start : start + 4].astype(kind), normalized=False),
            StoredArray(weights[:, start : start + 4].astype(dtype), normalized=unit is not None),
        )
        for start in range(0, slots.shape[1], 4)
    ]


def common_unit(sets: Sequence[StoredInfluences]) -> int | None:
    """Return the integer that means a weight of 1 in all sets; None if they are FLOAT, or differ."""
    dtypes = {stored.weights.values.dtype for stored in sets}
    if len(dtypes) > 1 or any(dtype.kind == "f" for dtype in dtypes):
        return None
    return int(np.iinfo(dtypes.pop().str).max)


class Changed(NamedTuple):
    """A primitive with fewer influences, or with one set more, and the sets to store.

    vertices is the number of vertices that lost influences, or that need the set. left_out is the average
    share of weight that the former lost.
    """

    primitive: SkinnedPrimitive
    stored: Sequence[StoredInfluences]
    vertices: int
    left_out: float = 0.0


def extended(primitive: SkinnedPrimitive, sets: Sequence[StoredInfluences], vertices: int) -> Changed:
    """Return a primitive with a further set of weights 0, of the types of its last one."""
    last, count = sets[-1], len(primitive.positions)

    def empty(like: StoredArray) -> StoredArray:
        return StoredArray(np.zeros((count, SLOTS_PER_SET), like.values.dtype), like.normalized)

    added = StoredInfluences(empty(last.joints), empty(last.weights))
    wide = primitive.with_influences(
        np.pad(primitive.joints, ((0, 0), (0, SLOTS_PER_SET))),
        np.pad(primitive.weights, ((0, 0), (0, SLOTS_PER_SET))),
    )
    return Changed(wide, (*sets, added), vertices)


def limited(
    document: Document, source: PrimitiveSource, primitive: SkinnedPrimitive, count: int | None
) -> Changed | None:
    """Return the primitive with ``count`` influences a vertex, or None if it stores no more than that."""
    if count is None or primitive.joints.shape[1] <= count:
        return None
    kept = limited_slots(primitive, count)
    before = read_influences(document, source, len(primitive.positions))
    stored = with_limit(before, kept.slots, kept.shares, kept.rewritten)
    joints = np.concatenate([entry.joints.values.astype(np.int64) for entry in stored], axis=1)
    weights = np.concatenate([entry.weights.decoded() for entry in stored], axis=1)
    losing = kept.dropped > 0
    return Changed(
        primitive.with_influences(joints_of_skin(joints, weights, source), weights),
        stored,
        int(np.count_nonzero(losing)),
        float(kept.dropped[losing].mean()) if losing.any() else 0.0,
    )
