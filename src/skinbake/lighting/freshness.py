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

ROUGH = 0.1
"""Relative difference that quantised positions and normals leave in many gradients' lengths."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """How stored α and β (V, K − 1) differ from recomputed ones.

    differing counts the vertices that exceed the tolerance, of count; largest is the largest difference
    relative to the vertex's largest entry, worst its vertex.

    What explains the difference exactly: factors are the two numbers that α and β have been multiplied by,
    None where there are none; reordered tells whether the vertices have the right entries in other slots.
    What explains it roughly, whatever else noise and other normals did: the positions were multiplied by
    rescaled (None: they were not), and resorted tells whether the slots are in another order.
    """

    differing: int
    count: int
    largest: float
    worst: int
    factors: tuple[float, float] | None
    reordered: bool
    rescaled: float | None
    resorted: bool

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
    rounding: FloatArray | None = None,
    tolerance: float = RELATIVE_TOLERANCE,
) -> Comparison:
    """Compare stored with recomputed α and β, each a pair of (V, K − 1), in 1 / length unit of POSITION.

    reach (V,), in the same unit, is the most that the derivative of a weight could be at each vertex: where
    a weight is constant, both sides are rounding, and only this tells. rounding (V, 2), in the same unit, is
    the most by which an encoding may have changed a stored α, and a stored β: that much is forgiven.
    """
    found, wanted = (_with_pivot(np.stack(pair, axis=2).astype(np.float64)) for pair in (stored, expected))
    scale = _scales(wanted, reach)
    allowed = np.zeros((len(found), 1, 2)) if rounding is None else np.asarray(rounding)[:, None]
    difference = _distance(found[:, 1:], wanted[:, 1:], allowed) / scale
    differing = difference > tolerance
    factors, reordered, rescaled, resorted = None, False, None, False
    if differing.any():
        cause = _Cause(scale, difference, differing, tolerance, allowed)
        factors = _factors(found, wanted, cause)
        # Slot 0's entry has the rounding of all others.
        pivot = allowed * (found.shape[1] - 1)
        reordered = factors is None and cause.explains(_distance(_by_size(found), _by_size(wanted), pivot))
        lengths = np.linalg.norm(found, axis=2), np.linalg.norm(wanted, axis=2)
        rescaled = _length_ratio(*lengths)
        resorted = _is_resorted(lengths[0] / (rescaled or 1.0), lengths[1])
    return Comparison(
        differing=int(np.count_nonzero(differing)),
        count=len(difference),
        largest=float(difference.max(initial=0.0)),
        worst=int(difference.argmax()) if len(difference) else 0,
        factors=factors,
        reordered=reordered,
        rescaled=rescaled,
        resorted=resorted,
    )


@dataclass(frozen=True, slots=True)
class _Cause:
    """What a cause has to explain: by vertex (V,), the scale, the relative difference, whether it counts.

    rounding (V, 1, 2) is what no cause need explain.
    """

    scale: Float64Array
    difference: Float64Array
    differing: BoolArray
    tolerance: float
    rounding: FloatArray

    def explains(self, left: Float64Array) -> bool:
        """Tell whether little enough is left (V,) at most vertices, and at most of those that differ."""
        allowed = np.maximum(self.tolerance, EXPLAINED * self.difference)
        explained = left <= allowed * self.scale
        return bool(explained[self.differing].mean() >= MOST and explained.mean() >= MOST)


def _with_pivot(slots: Float64Array) -> Float64Array:
    """Return the entries of all slots (V, K, 2): slot 0's is minus the sum of the others'."""
    return np.concatenate([-slots.sum(axis=1, keepdims=True), slots], axis=1)


def _distance(found: Float64Array, wanted: Float64Array, rounding: FloatArray) -> Float64Array:
    """Return each vertex's largest difference of any slot, (V,), less the rounding (V, 1, 2) of α and β."""
    distance: Float64Array = (np.abs(found - wanted) - rounding).max(axis=(1, 2), initial=0.0)
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
    if not cause.explains(_distance(found[:, 1:], factors * wanted[:, 1:], cause.rounding)):
        return None
    return float(factors[0]), float(factors[1])


def _by_size(slots: Float64Array) -> Float64Array:
    """Return each vertex's slots (V, K, 2) in an order that depends on their entries alone.

    An entry's α and β stay together: sorted each by itself, an α negated between two joints would look like
    two slots exchanged.
    """
    key = slots @ np.array([1.0, 0.618])
    return np.take_along_axis(slots, np.argsort(key, axis=1)[:, :, None], axis=1)


def _length_ratio(found: Float64Array, wanted: Float64Array) -> float | None:
    """Return the common ratio of gradient lengths (V, K), None where there is none but 1.

    A vertex's length over all slots depends neither on their order nor on the frame, which other normals
    turn: quantised to 8 bits they leave half of the vertices within a tenth of the true ratio.
    """
    lengths, others = np.linalg.norm(found, axis=1), np.linalg.norm(wanted, axis=1)
    usable = others > FLOOR * others.max(initial=0.0)
    if not usable.any():
        return None
    ratios = lengths[usable] / others[usable]
    ratio = float(np.median(ratios))
    near = np.abs(ratios - ratio) < ROUGH * ratio
    return ratio if near.mean() >= 0.5 and abs(ratio - 1.0) > ROUGH / 2.0 else None


def _is_resorted(found: Float64Array, wanted: Float64Array) -> bool:
    """Tell whether most gradient lengths (V, K) that do not fit would fit in another order of the slots."""
    largest = np.maximum(wanted.max(axis=1), FLOOR * wanted.max(initial=0.0))
    apart = np.abs(found - wanted).max(axis=1) > 2.0 * ROUGH * largest
    sorted_apart = (
        np.abs(np.sort(found, axis=1) - np.sort(wanted, axis=1)).max(axis=1) > 2.0 * ROUGH * largest
    )
    moved = apart & ~sorted_apart
    return bool(np.count_nonzero(moved) >= max(0.5 * np.count_nonzero(apart), (1.0 - MOST) * len(moved), 1))
