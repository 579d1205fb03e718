"""Weights that do not sum to 1, and the normals that a shader makes from them."""

from __future__ import annotations

import numpy as np

from skinbake.errors import Notice, Place
from skinbake.geometry.skinned import SkinnedPrimitive
from skinbake.gradients.influences import SUM_TOLERANCE
from skinbake.wording import one_or_many

LARGE = 100.0
"""The factor from which on a percentage would have too many digits."""


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
    vertices = one_or_many(len(off), "1 vertex", "{} vertices")
    sums_told = _span(low, high)
    up_to = "up to " if "…" in sums_told else ""
    parts = [f"{up_to}{_excess(1.0 / low)} too strong"] if low < 1.0 else []
    parts += [f"{up_to}{_percent(1.0 - 1.0 / high)} too weak"] if high > 1.0 else []
    message = (
        f"the weights of {vertices} do not sum to 1 ({sums_told}): in a shader the correction of the "
        f"normals is {' or '.join(parts)} there; normalise the weights before the bake"
    )
    return [Notice("weights-sum", message, place, len(off))]


def _excess(factor: float) -> str:
    """Return by how much a factor is more than 1, in percent if it is not very large."""
    return _percent(factor - 1.0) if factor < LARGE else f"{factor:.3g} times"


def _percent(share: float) -> str:
    """Return a share in percent, with a digit after the point if it is small."""
    percent = 100.0 * share
    return f"{percent:.1f} %" if percent < 1.0 else f"{percent:,.0f} %"


def _span(low: float, high: float) -> str:
    """Return two bounds in words, or one number if they are equal."""
    first, last = f"{low:.3g}", f"{high:.3g}"
    return first if first == last else f"{first} … {last}"
