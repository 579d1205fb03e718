"""Encode α and β in fewer bytes: normalised integers relative to a scale of each vertex.

The format is in docs/reference/file-format.md.

With one scale for all vertices, linear integers have a mean error of up to 1.9°: single outliers set the
scale and spoil the other values. So the fourth component of set 0 holds the square root of the vertex's own
scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from skinbake.choices import Encoding
from skinbake.geometry.skinned import Float64Array, FloatArray

CANDIDATES = 8
"""Number of scales that are tried for each vertex, from the smallest one on; the best is kept.

Mean error that packed8 adds, with 1, 2, 4, 8, 16 of them: 0.026, 0.022, 0.020, 0.018, 0.017° (CesiumMan),
0.028, 0.025, 0.021, 0.018, 0.016° (a hand), 0.033, 0.028, 0.024, 0.022, 0.020° (the hand with eight
influences).
"""

DTYPES: dict[Encoding, np.dtype[Any]] = {
    Encoding.FLOAT32: np.dtype("<f4"),
    Encoding.SNORM16: np.dtype("<i2"),
    Encoding.PACKED8: np.dtype("<i1"),
}

LARGEST = {Encoding.SNORM16: 32767, Encoding.PACKED8: 127}
"""The integer that means 1 (glTF 2.0, §3.11)."""


def vertex_bytes(encoding: Encoding, influences: int) -> int:
    """Return the bytes of α and β at a vertex with K slots: 2 (K − 1) numbers, and the scales."""
    return DTYPES[encoding].itemsize * 2 * (influences - (0 if encoding.is_scaled else 1))


class DecodedSlots(NamedTuple):
    """α or β as a shader decodes it: values (V, K − 1) float32, 1 / length unit of POSITION.

    rounding (V,) is the largest change of a value by its storage: half a step of the vertex's integers, 0 for
    FLOAT.
    """

    values: FloatArray
    rounding: Float64Array


def by_set(slots: npt.NDArray[Any]) -> list[npt.NDArray[Any]]:
    """Split (V, K − 1) into slots 1–3, then groups of four."""
    return [slots[:, :3], *(slots[:, start : start + 4] for start in range(3, slots.shape[1], 4))]


def common_scale(slots: Sequence[FloatArray]) -> float:
    """Return the largest |value| of all arrays (V, K − 1), 0 if all are zero, as a float32 value."""
    return max((float(np.abs(values).max(initial=0.0)) for values in slots), default=0.0)


def encoded(slots: FloatArray, encoding: Encoding, scale: float) -> list[npt.NDArray[Any]]:
    """Return α or β (V, K − 1) as arrays to store, one for each influence set.

    FLOAT: (V, 3), then (V, 4) float32. Other encodings: (V, 4) integers c, read as c / limit. Set 0 holds
    slots 1–3 relative to the scale s of the vertex, and w ≥ 0 with s = w² · scale. Each further set holds its
    four slots relative to s. No value is larger than s. scale is the ``common_scale`` of the file. A vertex
    of zeros is stored as zeros.
    """
    if not encoding.is_scaled:
        return by_set(slots)
    limit, wide = LARGEST[encoding], slots.astype(np.float64)
    largest = np.abs(wide).max(axis=1, initial=0.0)
    least = np.ceil(limit * np.sqrt(largest / (scale or 1.0)))
    least += (least / limit) ** 2 * scale < largest  # corrects the rounding of the root
    root, integers, error = _rounded(wide, least, limit, scale)
    for step in range(1, CANDIDATES):
        tried = _rounded(wide, np.where(least > 0, np.minimum(least + step, limit), 0), limit, scale)
        better = tried[2] < error
        root = np.where(better, tried[0], root)
        integers = np.where(better[:, None], tried[1], integers)
        error = np.where(better, tried[2], error)
    first, *others = by_set(integers.astype(DTYPES[encoding]))
    return [np.column_stack([first, root.astype(DTYPES[encoding])]), *others]


def _rounded(
    slots: Float64Array, root: Float64Array, limit: int, scale: float
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return the roots (V,) as given, the integers (V, K − 1) beside them, and the squared error (V,)."""
    own = ((root / limit) ** 2 * scale)[:, None]
    integers = np.rint(np.divide(limit * slots, own, out=np.zeros_like(slots), where=own > 0.0))
    error: Float64Array = ((integers * own / limit - slots) ** 2).sum(axis=1)
    return root, integers, error


def rounded(slots: FloatArray, encoding: Encoding, scale: float) -> FloatArray:
    """Return α or β (V, K − 1) float32 as a shader reads the arrays of ``encoded``."""
    return decoded(encoded(slots, encoding, scale), encoding, scale).values


def decoded(sets: Sequence[npt.NDArray[Any]], encoding: Encoding, scale: float) -> DecodedSlots:
    """Return α or β from the arrays of ``encoded``: set 0 and all further sets are (V, 4)."""
    if not encoding.is_scaled:
        values = np.concatenate(sets, axis=1).astype(np.float32)
        return DecodedSlots(values, np.zeros(len(values)))
    limit = LARGEST[encoding]
    parts = [np.maximum(part.astype(np.float64) / limit, -1.0) for part in sets]
    own = parts[0][:, 3] ** 2 * scale
    relative = np.concatenate([parts[0][:, :3], *parts[1:]], axis=1)
    return DecodedSlots((own[:, None] * relative).astype(np.float32), own / (2 * limit))
