"""Whether stored α and β are those of the mesh that they stand beside, and if not, what happened to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray

RELATIVE_TOLERANCE = 1e-3
"""Largest difference between stored and recomputed, relative to the vertex's largest entry.

float32 storage and two routes to the same mean differ by 1e-6; an α scaled by 1.01 differs by 1e-2.
"""

FLOOR = 1e-5
"""Share of the primitive's largest entry below which a vertex's entries are rounding."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """How stored α and β (V, K − 1) differ from recomputed ones.

    differing counts the vertices that exceed the tolerance, largest is the largest difference relative to
    the vertex's largest entry, worst its vertex. factor is the one number that the stored entries are of
    the recomputed ones, None where there is none; reordered tells whether each vertex has the right
    entries in other slots.
    """

    differing: int
    largest: float
    worst: int
    factor: float | None
    reordered: bool

    @property
    def agrees(self) -> bool:
        """Tell whether no vertex differs."""
        return self.differing == 0


def compare(
    stored: tuple[FloatArray, FloatArray],
    expected: tuple[FloatArray, FloatArray],
    *,
    tolerance: float = RELATIVE_TOLERANCE,
) -> Comparison:
    """Compare stored with recomputed α and β, each a pair of (V, K − 1), in 1 / length unit of POSITION."""
    found, wanted = (np.stack(pair, axis=2).astype(np.float64) for pair in (stored, expected))
    scale = _scales(wanted)
    difference = np.abs(found - wanted).max(axis=(1, 2), initial=0.0) / scale
    differing = difference > tolerance
    worst = int(difference.argmax()) if len(difference) else 0
    return Comparison(
        differing=int(np.count_nonzero(differing)),
        largest=float(difference.max(initial=0.0)),
        worst=worst,
        factor=_common_factor(found, wanted, tolerance) if differing.any() else None,
        reordered=bool(differing.any() and _is_reordered(found, wanted, scale, differing, tolerance)),
    )


def _scales(wanted: Float64Array) -> Float64Array:
    """Return what a difference at each vertex is measured against (V,), slot 0's entry included."""
    with_pivot = np.concatenate([wanted, -wanted.sum(axis=1, keepdims=True)], axis=1)
    own = np.abs(with_pivot).max(axis=(1, 2), initial=0.0)
    largest = own.max(initial=0.0)
    return np.maximum(own, FLOOR * largest) if largest > 0 else np.ones(len(wanted))


def _common_factor(found: Float64Array, wanted: Float64Array, tolerance: float) -> float | None:
    """Return the factor that turns wanted into found at nearly all vertices, None where there is none."""
    norm = float((wanted * wanted).sum())
    if norm == 0.0:
        return None
    factor = float((found * wanted).sum()) / norm
    left = np.abs(found - factor * wanted).max(axis=(1, 2), initial=0.0)
    fits = left <= 10 * tolerance * abs(factor) * _scales(wanted)
    return factor if np.count_nonzero(fits) >= 0.99 * len(fits) else None


def _is_reordered(
    found: Float64Array, wanted: Float64Array, scale: Float64Array, differing: BoolArray, tolerance: float
) -> bool:
    """Tell whether most differing vertices hold the wanted entries, slot 0's included, in another order."""

    def ordered(values: Float64Array) -> Float64Array:
        whole = np.concatenate([-values.sum(axis=1, keepdims=True), values], axis=1)
        return np.sort(whole[differing], axis=1)

    left = np.abs(ordered(found) - ordered(wanted)).max(axis=(1, 2), initial=0.0)
    same = left <= 10 * tolerance * scale[differing]
    return bool(np.count_nonzero(same) >= 0.5 * len(same))
