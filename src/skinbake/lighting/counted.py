"""The count of a block of errors: what the kernel returns of it, and what a tally adds up."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from skinbake.geometry.skinned import Float64Array, FloatArray, IntArray
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
class WeightedRuns:
    """Values in runs of one weight, such as the errors of a vertex in several poses.

    values (N,) are float32 or float64. weights (R,) and lengths (R,) int32 are those of the runs. The lengths
    add up to N. Runs take half the memory, and so half the time, of values that have a weight each.
    """

    values: FloatArray
    weights: Float64Array
    lengths: Int32Array

    @classmethod
    def room(cls, values: int, runs: int, dtype: DTypeLike = np.float32) -> WeightedRuns:
        """Return arrays of these lengths, to be filled."""
        return cls(np.empty(values, dtype=dtype), np.empty(runs), np.empty(runs, dtype=np.int32))

    def part(self, first: Extent, end: Extent) -> WeightedRuns:
        """Return the runs between two places, without a copy."""
        values, runs = (slice(*bounds) for bounds in zip(first, end, strict=True))
        return WeightedRuns(self.values[values], self.weights[runs], self.lengths[runs])

    def copied(self, end: Extent) -> WeightedRuns:
        """Return a copy of what stands before a place."""
        part = self.part(Extent(0, 0), end)
        return WeightedRuns(part.values.copy(), part.weights.copy(), part.lengths.copy())

    @property
    def arrays(self) -> tuple[FloatArray, Float64Array, Int32Array]:
        """The values, weights and lengths."""
        return self.values, self.weights, self.lengths

    @property
    def end(self) -> Extent:
        """The place behind the last run."""
        return Extent(len(self.values), len(self.lengths))

    def weights_at(self, places: IntArray) -> Float64Array:
        """Return the weights of the values at some places (M,) among N."""
        return self.weights[np.searchsorted(np.cumsum(self.lengths), places, side="right")]


class Extent(NamedTuple):
    """A number of values, and of the runs that they are in: all of them, or those before a place."""

    values: int
    runs: int


@dataclass(frozen=True, slots=True)
class CountedErrors:
    """A block of errors in degrees, counted.

    samples are counted, among them undefined ones without a measured normal. weight is the weight of the
    samples, total the weighted sum of their errors. largest is the largest error, −1 if there are no samples.
    pose and vertex are the first place of it in the block, by pose. tail has the errors that are large enough
    to be kept.
    """

    samples: int
    undefined: int
    weight: float
    total: float
    largest: float
    pose: int
    vertex: int
    tail: WeightedRuns


def bin_of(values: FloatArray) -> Int32Array:
    """Return the bin of each value: the exponent and the first bits of its float32."""
    return _bits_of(values) >> BIN_SHIFT


def least_of_bin(place: int) -> float:
    """Return the smallest value of a bin."""
    return float(np.array([place << BIN_SHIFT], dtype=np.int32).view(np.float32)[0])


def fine_bin_of(values: FloatArray) -> Int32Array:
    """Return the part of its bin for each value: the next bits of its float32."""
    return (_bits_of(values) >> (BIN_SHIFT - FINE_BITS)) % FINE_BINS


def _bits_of(values: FloatArray) -> Int32Array:
    return np.abs(values).astype(np.float32).view(np.int32)
