"""Undo the filters of EXT_ and KHR_meshopt_compression, with equal results on every machine.

The formulas are in the specification of the extension, §"Filters". meshoptimizer has them too, but it uses
the 1 / sqrt estimate of the processor for octahedral bytes. So its results differ by a unit between brands of
processors, and so would α, β and the digests of their input. Here every operation is float32 as IEEE 754
rounds it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Values = npt.NDArray[Any]
TWO, HALF = np.float32(2.0), np.float32(0.5)


def unfiltered(rows: npt.NDArray[np.uint8], name: str) -> npt.NDArray[np.uint8]:
    """Return rows (count, stride) of bytes with the filter ``name`` undone."""
    if name == "EXPONENTIAL":
        # The highest byte is the exponent of 2, the other three the mantissa, both signed.
        stored = rows.view("<i4")
        with np.errstate(over="ignore"):  # infinity is what such an exponent means
            floats = np.ldexp(((stored << 8) >> 8).astype(np.float32), stored >> 24)
        return np.asarray(floats, dtype="<f4").view(np.uint8)
    if name == "NONE":
        return rows
    signed = rows.view("<i1" if rows.shape[1] == 4 else "<i2")
    if name == "OCTAHEDRAL":
        return _octahedral(signed).view(np.uint8)
    return (_quaternions(signed) if name == "QUATERNION" else _colours(signed)).view(np.uint8)


def _rounded(values: Values, dtype: np.dtype[Any]) -> Values:
    """Round halves away from zero, as C does."""
    with np.errstate(invalid="ignore"):  # a colour whose alpha is 0 may be past all integers
        return np.asarray(np.trunc(values + np.copysign(HALF, values)).astype(np.int64).astype(dtype))


def _octahedral(stored: Values) -> Values:
    """Return unit vectors; x and y are on the octahedron, z is the value that means 1, w stays."""
    x, y, one = (stored[:, column].astype(np.float32) for column in range(3))
    # |x| + |y| + |z| = 1 on the octahedron. Its lower half, with z < 0, is folded outward.
    z = one - np.abs(x) - np.abs(y)
    fold = np.minimum(z, np.float32(0))
    x, y = x + np.where(x >= 0, fold, -fold), y + np.where(y >= 0, fold, -fold)
    result = stored.copy()
    with np.errstate(divide="ignore", invalid="ignore"):  # a vector of zeros has no length
        scale = np.float32(np.iinfo(stored.dtype).max) / np.sqrt(x * x + y * y + z * z)
        for column, part in enumerate((x, y, z)):
            result[:, column] = _rounded(np.nan_to_num(part * scale), stored.dtype)
    return result


def _quaternions(stored: Values) -> Values:
    """Return quaternions; the largest component is left out; w has its index and the value of 1 / √2."""
    x, y, z = (stored[:, column].astype(np.float32) for column in range(3))
    # The two lowest bits of w are the index of the largest component. It follows from the unit length, and is
    # positive: −q is the same rotation.
    one = (stored[:, 3] | 3).astype(np.float32)
    w = np.sqrt(np.maximum(one * one * TWO - x * x - y * y - z * z, np.float32(0)))
    scale = np.float32(32767.0) / np.sqrt(TWO) / one
    largest = stored[:, 3] & 3
    result = np.empty_like(stored)
    row = np.arange(len(stored))
    for offset, part in enumerate((w, x, y, z)):
        result[row, (largest + offset) & 3] = _rounded(part * scale, stored.dtype)
    return result


def _colours(stored: Values) -> Values:
    """Return RGBA of YCoCgA; the highest set bit of alpha gives the value that means 1."""
    unsigned = stored.view(f"<u{stored.dtype.itemsize}").astype(np.int64)
    luma, orange, green = unsigned[:, 0], stored[:, 1].astype(np.int64), stored[:, 2].astype(np.int64)
    alpha, one = unsigned[:, 3], unsigned[:, 3].copy()
    # All bits below the highest one of alpha: the value that means 1.
    for shift in (1, 2, 4, 8):
        one |= one >> shift
    # That bit is not a part of alpha: the others move up, and the lowest one is there twice.
    parts = (
        luma + orange - green,
        luma + green,
        luma - orange - green,
        ((alpha << 1) & one) | (alpha & 1),
    )
    dtype = np.dtype(f"<u{stored.dtype.itemsize}")
    with np.errstate(divide="ignore", invalid="ignore"):  # an alpha of 0 means no scale
        scale = np.float32(np.iinfo(dtype).max) / one.astype(np.float32)
        columns = [_rounded(np.nan_to_num(part.astype(np.float32) * scale), dtype) for part in parts]
    return np.stack(columns, axis=1)
