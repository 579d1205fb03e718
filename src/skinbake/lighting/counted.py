"""The count of a block of errors: what the kernel returns of it, and what a tally adds up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skinbake.geometry.skinned import Float64Array, FloatArray
from skinbake.lighting.influences import Int32Array

BIN_SHIFT = 17
"""The bits of a positive float32 that its bin ignores."""

BINS = 1 << (31 - BIN_SHIFT)
"""The number of bins of errors: 64 to each power of two."""

FINE_BITS = 10
"""The bits after those of the bin that tell the parts of it."""

FINE_BINS = 1 << FINE_BITS
"""The number of parts of one bin."""


@dataclass(frozen=True, slots=True)
class CountedErrors:
    """A block of errors in degrees, counted.

    samples are counted, among them undefined ones without a measured normal. weight is the weight of the
    samples, total the weighted sum of their errors. largest is the largest error, −1 if there are no samples.
    pose and vertex are the first place of it in the block, by pose. tail and tail_weights (N,) are the errors
    that are large enough to be kept.
    """

    samples: int
    undefined: int
    weight: float
    total: float
    largest: float
    pose: int
    vertex: int
    tail: FloatArray
    tail_weights: Float64Array


def bin_of(values: FloatArray) -> Int32Array:
    """Return the bin of each value: the exponent and the first bits of its float32."""
    return _bits_of(values) >> BIN_SHIFT


def fine_bin_of(values: FloatArray) -> Int32Array:
    """Return the part of its bin for each value: the next bits of its float32."""
    return (_bits_of(values) >> (BIN_SHIFT - FINE_BITS)) % FINE_BINS


def _bits_of(values: FloatArray) -> Int32Array:
    return np.abs(values).astype(np.float32).view(np.int32)
