"""The values that the loops take and return: forms, sparse rows, and counted errors."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from skinbake.geometry.skinned import Float32Array, Float64Array, FloatArray, IntArray, bincount
from skinbake.truth.mesh import Int32Array, Int64Array

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class Forms(NamedTuple):
    """Forms F(u, c) = Σ w[s] M[s] u + Σ c[s] M[s] p̃ of B vertices, for any joint matrices M.

    joints, weights (B, K) and points (B, 3) belong to the vertices at rest. directions u are
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
            bincount(owners, values * field[columns], minlength=len(self)).astype(np.float64, copy=False)
            for field in fields
        ]

    def matrix(self, columns: int) -> csr_array:
        """Return the rows as SciPy's matrix of so many columns."""
        from scipy.sparse import csr_array

        entries = self.values[self.entries], self.columns[self.entries], self.starts - self.starts[0]
        return csr_array(entries, shape=(len(self), columns))


BIN_SHIFT = 16
"""The bits of a positive float32 that its bin ignores. The loops in C have the same number."""

BINS_OF_OCTAVE = 1 << (23 - BIN_SHIFT)
"""The number of bins to each power of two: 128, so that a bin ends at most 0.8 % above where it begins."""

FIRST_BIN = (127 - 32) * BINS_OF_OCTAVE
"""What is subtracted from a float32's upper bits: the first bin begins at 2⁻³². The loops in C do so too."""

BINS = 64 * BINS_OF_OCTAVE
"""The number of bins, up to 2³². The first one holds all smaller values too, the last one all larger ones."""


class CountedErrors(NamedTuple):
    """A block of errors in degrees, counted.

    samples are counted, among them undefined ones without a measured normal. weight is the weight of the
    samples, total the weighted sum of their errors. largest is the largest error, −1 if there are no samples.
    pose and vertex are the first place of it in the block, by pose. bins (BINS,) are the weights by error.
    """

    samples: int
    undefined: int
    weight: float
    total: float
    largest: float
    pose: int
    vertex: int
    bins: Float64Array


def bin_of(values: Float32Array) -> Int32Array:
    """Return the bin of each value: the exponent and the first bits of its float32."""
    upper: Int32Array = np.abs(values).view(np.int32) >> BIN_SHIFT
    return np.clip(upper - FIRST_BIN, 0, BINS - 1)


def end_of_bin(place: int) -> float:
    """Return where a bin ends. What is in the first bin counts as 0; the last bin has no end."""
    if place in (0, BINS - 1):
        return math.inf if place else 0.0
    return float(np.array([(place + 1 + FIRST_BIN) << BIN_SHIFT], dtype=np.int32).view(np.float32)[0])
