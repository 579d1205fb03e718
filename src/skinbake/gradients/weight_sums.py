"""Weights that do not sum to 1, and the normals that a shader makes from them."""

from __future__ import annotations

import numpy as np

from skinbake.errors import Notice, Place
from skinbake.geometry.skinned import SkinnedPrimitive
from skinbake.gradients.influences import SUM_TOLERANCE


def weight_sum_notices(primitive: SkinnedPrimitive, place: Place) -> list[Notice]:
    """Return a notice if weights (V, K) do not sum to 1, with negative ones counted as 0, else none.

    A vertex without any weight is another case. A shader adds the joints' motions with the given weights,
    which are Σw times as large as the ones for which α and β are made. So the correction of the normal counts
    1 / Σw times.
    """
    sums = np.maximum(primitive.weights, 0.0).sum(axis=1, dtype=np.float64)
    off = sums[(np.abs(sums - 1.0) > SUM_TOLERANCE) & (sums > 0.0)]
    if not len(off):
        return []
    low, high = float(off.min()), float(off.max())
    bounds, factors = _span(low, high), _span(1.0 / high, 1.0 / low)
    message = (
        f"the weights of {len(off):,} vertices miss a sum of 1 by over {SUM_TOLERANCE} ({bounds}): taken as "
        "divided by it, by bake and verify. A shader takes weights as they are, and corrects normals by "
        f"{factors} times what is right: mend the weights, or divide them by their sum before the shader"
    )
    return [Notice("weights-sum", message, place, len(off))]


def _span(low: float, high: float) -> str:
    """Return two bounds in words, or one number if they are equal."""
    first, last = f"{low:.3g}", f"{high:.3g}"
    return first if first == last else f"{first} … {last}"
