"""Store fewer influences: the component type stays, and integer weights sum to their type's largest value."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from skinbake.geometry.skinned import BoolArray, Float64Array
from skinbake.gltf.accessors import StoredArray
from skinbake.gltf.primitives import StoredInfluences


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
    renewed = shares if unit is None else _shared_out(shares, unit)
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


def _shared_out(shares: Float64Array, unit: int) -> Float64Array:
    """Round shares (V, N) to integers that sum to ``unit``: the largest remainders are rounded up.

    Of equal remainders, that of the earlier slot is rounded up: the larger weight, then the lower joint.
    """
    exact = shares * unit
    floors = np.floor(exact)
    missing = unit - floors.sum(axis=1, keepdims=True)
    rank = np.argsort(np.argsort(floors - exact, axis=1, kind="stable"), axis=1, kind="stable")
    return np.asarray(floors + (rank < missing))
