"""The whole matrix of a gradient operator. The package makes its rows block by block, as they are needed."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array, vstack

from skinbake.geometry.skinned import FloatArray
from skinbake.truth.operator import GradientOperator


def derivative_along(operator: GradientOperator, directions: FloatArray) -> csr_array:
    """Return the sparse (V, V) float64 derivative along one direction for each vertex.

    directions (V, 3) are in mesh space. A direction's length scales its derivative.
    """
    count = len(operator.positions)
    blocks = [operator.rows(part, [directions[part]]).matrix(count) for part in operator.row_blocks()]
    return vstack(blocks, format="csr") if blocks else csr_array((count, count), dtype=np.float64)


def derivatives(operator: GradientOperator) -> list[csr_array]:
    """Return the sparse (V, V) derivatives along x, y and z, in 1 / length unit of POSITION."""
    return [derivative_along(operator, np.tile(axis, (len(operator.positions), 1))) for axis in np.eye(3)]
