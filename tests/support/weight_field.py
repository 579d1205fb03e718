"""The weights of a mesh as SciPy's sparse matrix: what verify computes without it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_array

from skinbake.geometry.skinned import SkinnedPrimitive
from skinbake.truth.mesh import normalised_weights


def weight_field(primitives: Sequence[SkinnedPrimitive]) -> csr_array:
    """Return the weight of every joint at every vertex of a mesh: sparse (V, J) float64, rows summing to 1.

    If a joint is in several slots of a vertex, it gets their sum. J is one more than the largest joint index
    in any slot, used or not.
    """
    weights = [normalised_weights(primitive.weights, primitive.joints) for primitive in primitives]
    counts = [len(primitive.joints) for primitive in primitives]
    slots = [primitive.joints.shape[1] for primitive in primitives]
    data = np.concatenate([block.ravel() for block in weights])
    columns = np.concatenate([primitive.joints.ravel().astype(np.int64) for primitive in primitives])
    rows = np.repeat(np.arange(sum(counts)), np.repeat(slots, counts))
    field = csr_array((data, (rows, columns)), shape=(sum(counts), int(columns.max(initial=-1)) + 1))
    field.eliminate_zeros()
    return field
