"""The values that the loops take and return: forms, sparse rows, and counted errors."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from skinbake.geometry.skinned import Float64Array, FloatArray, IntArray
from skinbake.truth.mesh import Int32Array, Int64Array

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class Forms(NamedTuple):
    """Forms F(u, c) = Σ w[s] M[s] u + Σ c[s] M[s] p̃ of B vertices, for any joint matrices M.

    joints, weights (B, K) and points (B, 3) are those of the vertices at rest. directions u are
    (F, B, 3), or None for the one form with u = p̃. changes c are (F, B, K), or None for zeros.
    """

    joints: IntArray
    weights: FloatArray
    points: FloatArray
    directions: FloatArray | None = None
    changes: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class SparseRows:
    """B rows of a sparse matrix with V columns.

    starts (B + 1,) int32. Row r has the entries starts[r] … starts[r + 1] − 1 of columns (E,) int32 and
    values (E,) float64. These arrays may hold the entries of further rows too, before and after those of the
    B rows: blocks of rows that were made together share them.
    """

    starts: Int32Array
    columns: Int32Array
    values: Float64Array

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.starts) - 1

    @property
    def entries(self) -> slice:
        """Where the entries of these rows stand in columns and values."""
        return slice(int(self.starts[0]), int(self.starts[-1]))

    def some(self, part: slice) -> SparseRows:
        """Return some of the rows. part is a slice of starts: one longer than that of the rows."""
        return SparseRows(self.starts[part], self.columns, self.values)

    def owners(self) -> Int64Array:
        """Return the row of each of ``entries``, from 0."""
        return np.repeat(np.arange(len(self)), np.diff(self.starts))

    def magnitudes(self) -> SparseRows:
        """Return the rows with the magnitudes of their entries."""
        return SparseRows(self.starts, self.columns, np.abs(self.values))

    def times(self, field: FloatArray) -> Float64Array:
        """Return the product (B,) with a field (V,). Entries are added in their order, as SciPy adds them."""
        return self.times_each([field])[0]

    def times_each(self, fields: Iterable[FloatArray]) -> list[Float64Array]:
        """Return the products (B,) with several fields (V,)."""
        columns, values, owners = self.columns[self.entries], self.values[self.entries], self.owners()
        return [
            np.bincount(owners, values * field[columns], minlength=len(self)).astype(np.float64, copy=False)
            for field in fields
        ]

    def matrix(self, columns: int) -> csr_array:
        """Return the rows as SciPy's matrix of so many columns."""
        from scipy.sparse import csr_array

        entries = self.values[self.entries], self.columns[self.entries], self.starts - self.starts[0]
        return csr_array(entries, shape=(len(self), columns))


BIN_SHIFT = 17
"""The bits of a positive float32 that its bin ignores."""

BINS = 1 << (31 - BIN_SHIFT)
"""The number of bins of errors: 64 to each power of two."""

FINE_BITS = 10
"""The bits after those of the bin that tell the parts of it."""

FINE_BINS = 1 << FINE_BITS
"""The number of parts of one bin."""


class WeightedRuns(NamedTuple):
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


class CountedErrors(NamedTuple):
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
