"""How much of a fit the primitives of a surface keep where all of it lights them worse.

With the gradients ∇ of the surface, a primitive keeps ∇ + fit × (fitted − ∇), with one number from 0 to 1.
Each vertex keeps a share of that: some eighths of its α and β. ``measure.guard`` chooses both. The metadata
hold the number. The eighths of a vertex follow from α and β as they are stored.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skinbake.geometry.skinned import Float64Array, FloatArray, IntArray

EIGHTHS = 8

Slots = tuple[FloatArray, FloatArray]
"""α and β (V, K − 1) of a primitive."""


def mixed(
    fitted: Sequence[Slots], plain: Sequence[Slots], classes: Sequence[IntArray], fits: Sequence[float]
) -> list[Slots]:
    """Return ∇ + fit × (fitted − ∇) of the primitives of a surface, with ∇ as ``plain``, in float64.

    classes (V,) of each primitive number the weld classes of the surface. Where primitives meet, both keep
    the lesser number: light must not change abruptly there.
    """
    least = np.ones(_count(classes))
    for own, fit in zip(classes, fits, strict=True):
        least[own] = np.minimum(least[own], fit)
    return [
        (alpha + share * (fit_alpha - alpha), beta + share * (fit_beta - beta))
        for (fit_alpha, fit_beta), (alpha, beta), share in zip(
            fitted, map(_wide, plain), (least[own][:, None] for own in classes), strict=True
        )
    ]


def scaled(
    slots: Sequence[Slots], classes: Sequence[IntArray], eighths: Sequence[IntArray | None]
) -> list[Slots]:
    """Return some eighths (V,) of α and β of the primitives of a surface, None for all, in float64.

    All copies of a point keep as much as the one that keeps least.
    """
    least = np.full(_count(classes), EIGHTHS)
    for own, kept in zip(classes, eighths, strict=True):
        if kept is not None:
            np.minimum.at(least, own, kept)
    shares = [least[own][:, None] / EIGHTHS for own in classes]
    return [(alpha * share, beta * share) for (alpha, beta), share in zip(slots, shares, strict=True)]


def kept_eighths(
    slots: Sequence[Slots],
    stored: Sequence[Slots],
    classes: Sequence[IntArray],
    keeps_part: Sequence[bool],
    scale: float = np.inf,
) -> list[IntArray]:
    """Return how many eighths of α and β the stored ones are nearest to, for each vertex (V,).

    keeps_part tells which primitives may keep a part. The points of the others keep all, unless one of these
    shares them. Numbers as large as the scale of an encoding tell nothing: it may have shortened them.
    """
    products, squares = np.zeros((2, _count(classes)))
    for ours, theirs, own in zip(map(_wide, slots), map(_wide, stored), classes, strict=True):
        tells = np.max([np.abs(found).max(axis=1, initial=0.0) for found in theirs], axis=0) < scale
        for values, found in zip(ours, theirs, strict=True):
            products += np.bincount(own, tells * (values * found).sum(axis=1), len(products))
            squares += np.bincount(own, tells * (values * values).sum(axis=1), len(products))
    shares = np.divide(products, squares, out=np.ones_like(products), where=squares > 0.0)
    nearest = np.rint(EIGHTHS * np.nan_to_num(shares, nan=1.0).clip(0.0, 1.0)).astype(np.int64)
    may = np.zeros(len(nearest), dtype=np.bool_)
    for own, keeps in zip(classes, keeps_part, strict=True):
        may[own] |= keeps
    return [np.where(may, nearest, EIGHTHS)[own] for own in classes]


def _count(classes: Sequence[IntArray]) -> int:
    return max(int(own.max(initial=-1)) for own in classes) + 1


def _wide(slots: Slots) -> tuple[Float64Array, Float64Array]:
    return slots[0].astype(np.float64), slots[1].astype(np.float64)
