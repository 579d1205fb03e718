"""Rows of a sparse matrix, without the import of SciPy, which takes longer than to verify a small file."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from skinbake.geometry.skinned import Float64Array, FloatArray
from skinbake.lighting.influences import Int32Array, Int64Array

if TYPE_CHECKING:
    from scipy.sparse import csr_array


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
