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
"""Share below which entries are rounding: of the primitive's largest, or of the vertex's reach."""

EXPLAINED = 0.2
"""Share of a vertex's difference that a cause may leave: quantised positions leave noise of their own."""

MOST = 0.9
"""Share of the vertices that a cause must explain. The rest are rounding's, or were welded."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """How stored α and β (V, K − 1) differ from recomputed ones.

    differing counts the vertices that exceed the tolerance, of count; largest is the largest difference
    relative to the vertex's largest entry, worst its vertex. factors are the two numbers that α and β have
    been multiplied by, None where there are none. reordered tells whether the vertices have the right
    entries (up to factors) in other slots.
    """

    differing: int
    count: int
    largest: float
    worst: int
    factors: tuple[float, float] | None
    reordered: bool

    @property
    def agrees(self) -> bool:
        """Tell whether no vertex differs."""
        return self.differing == 0

    @property
    def mostly_agrees(self) -> bool:
        """Tell whether few enough vertices differ to say that the mesh is still the same."""
        return self.differing <= (1.0 - MOST) * self.count


def compare(
    stored: tuple[FloatArray, FloatArray],
    expected: tuple[FloatArray, FloatArray],
    *,
    reach: FloatArray | None = None,
    tolerance: float = RELATIVE_TOLERANCE,
) -> Comparison:
    """Compare stored with recomputed α and β, each a pair of (V, K − 1), in 1 / length unit of POSITION.

    reach (V,), in the same unit, is the most that the derivative of a weight could be at each vertex: where
    a weight is constant, both sides are rounding, and only this tells.
    """
    found, wanted = (_with_pivot(np.stack(pair, axis=2).astype(np.float64)) for pair in (stored, expected))
    scale = _scales(wanted, reach)
    difference = _distance(found[:, 1:], wanted[:, 1:]) / scale
    differing = difference > tolerance
    factors, reordered = None, False
    if differing.any():
        cause = _Cause(scale, difference, differing, tolerance)
        factors = _factors(found, wanted, cause)
        if factors is None:
            found, wanted = _by_size(found), _by_size(wanted)
            reordered = cause.explains(_distance(found, wanted))
            if not reordered:
                factors = _factors(found, wanted, cause)
                reordered = factors is not None
    return Comparison(
        differing=int(np.count_nonzero(differing)),
        count=len(difference),
        largest=float(difference.max(initial=0.0)),
        worst=int(difference.argmax()) if len(difference) else 0,
        factors=factors,
        reordered=reordered,
    )


@dataclass(frozen=True, slots=True)
class _Cause:
    """What a cause has to explain: by vertex (V,), the scale, the relative difference, whether it counts."""

    scale: Float64Array
    difference: Float64Array
    differing: BoolArray
    tolerance: float

    def explains(self, left: Float64Array) -> bool:
        """Tell whether little enough is left (V,) at most vertices, and at most of those that differ."""
        allowed = np.maximum(self.tolerance, EXPLAINED * self.difference)
        explained = left <= allowed * self.scale
        return bool(explained[self.differing].mean() >= MOST and explained.mean() >= MOST)


def _with_pivot(slots: Float64Array) -> Float64Array:
    """Return the entries of all slots (V, K, 2): slot 0's is minus the sum of the others'."""
    return np.concatenate([-slots.sum(axis=1, keepdims=True), slots], axis=1)


def _distance(found: Float64Array, wanted: Float64Array) -> Float64Array:
    """Return each vertex's largest difference of any slot, (V,)."""
    distance: Float64Array = np.abs(found - wanted).max(axis=(1, 2), initial=0.0)
    return distance


def _scales(wanted: Float64Array, reach: FloatArray | None) -> Float64Array:
    """Return what a difference at each vertex is measured against (V,)."""
    own = np.abs(wanted).max(axis=(1, 2), initial=0.0)
    scale = np.maximum(own, FLOOR * own.max(initial=0.0))
    if reach is not None:
        scale = np.maximum(scale, FLOOR * reach)
    return np.where(scale > 0.0, scale, 1.0)


def _factors(found: Float64Array, wanted: Float64Array, cause: _Cause) -> tuple[float, float] | None:
    """Return what turns the wanted α and β into those found, None where nothing does."""
    norms = (wanted * wanted).sum(axis=(0, 1))
    factors = np.divide((found * wanted).sum(axis=(0, 1)), norms, out=np.ones(2), where=norms > 0.0)
    if not cause.explains(_distance(found, factors * wanted)):
        return None
    return float(factors[0]), float(factors[1])


def _by_size(slots: Float64Array) -> Float64Array:
    """Return each vertex's slots (V, K, 2) in an order that depends on their entries alone.

    An entry's α and β stay together: sorted each by itself, an α negated between two joints would look like
    two slots exchanged.
    """
    key = slots @ np.array([1.0, 0.618])
    return np.take_along_axis(slots, np.argsort(key, axis=1)[:, :, None], axis=1)
