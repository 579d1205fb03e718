"""Whether stored α and β fit the mesh of the file. If they do not, the likely change of the mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray
from skinbake.skinning.rest import all_slots

RELATIVE_TOLERANCE = 1e-3
"""The largest allowed difference between stored and recomputed, relative to the vertex's largest entry.

float32 storage and two routes to the same mean differ by 1e-6. An α scaled by 1.01 differs by 1e-2.
"""

FLOOR = 1e-5
"""Entries below this share of the primitive's largest entry, or of the vertex's reach, are rounding."""

EXPLAINED = 0.2
"""The share of a vertex's difference that a cause may leave. Quantised positions leave noise of their own."""

MOST = 0.9
"""The share of the vertices that a cause must explain. The others have rounding, or were welded."""

ROUGH = 0.1
"""The relative difference that quantised positions and normals leave in the lengths of many gradients."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """The differences between stored α and β (V, K − 1) and recomputed ones.

    differing is the number of vertices, out of count, that exceed the tolerance. largest is the largest
    difference relative to the vertex's largest entry. worst is the vertex of that difference.

    Two fields explain the difference exactly. factors are the two numbers by which α and β were multiplied,
    or None. reordered tells whether the vertices have the right entries in other slots. Two fields explain it
    roughly, despite noise and other normals. rescaled is the number by which the positions were multiplied
    (None: they were not). resorted tells whether the slots are in another order.
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
        """Tell whether so few vertices differ that the mesh is still the same."""
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

    reach (V,), in the same unit, is the largest possible derivative of a weight at each vertex. If a weight
    is constant, both sides are rounding, and only reach shows it. rounding (V, 2), in the same unit, is the
    largest change that an encoding may have made to a stored α, and to a stored β. Differences up to it are
    allowed. A vertex whose recomputed α or β float32 cannot hold differs from anything.
    """
    given, wanted = (np.stack(pair, axis=2).astype(np.float64) for pair in (stored, expected))
    known = np.asarray(np.isfinite(wanted).all(axis=(1, 2)))
    wanted = all_slots(np.where(known[:, None, None], wanted, 0.0))
    # The scale (V,) to which the difference at each vertex is compared.
    own = np.abs(wanted).max(axis=(1, 2), initial=0.0)
    scale = np.maximum(own, FLOOR * own.max(initial=0.0))
    if reach is not None:
        scale = np.maximum(scale, FLOOR * reach)
    scale = np.where(scale > 0.0, scale, 1.0)
    allowed = np.zeros((len(given), 1, 2)) if rounding is None else np.asarray(rounding)[:, None]
    difference = np.where(known, _distance(given, wanted[:, 1:], allowed) / scale, np.inf)
    differing = difference > tolerance
    factors, reordered, rescaled, resorted = None, False, None, False
    if differing.any():
        found = all_slots(given)
        cause = _Cause(scale, difference, differing, tolerance, allowed)
        factors = _factors(found, wanted, cause)
        # The entry of slot 0 has the rounding of all others.
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
    """The difference to explain: by vertex (V,), scale, relative difference, and whether it counts."""

    scale: Float64Array
    difference: Float64Array
    differing: BoolArray
    tolerance: float
    rounding: FloatArray

    def explains(self, left: Float64Array) -> bool:
        """Tell whether the rest (V,) is small at most vertices, and at most of the differing vertices."""
        allowed = np.maximum(self.tolerance, EXPLAINED * self.difference)
        explained = (left <= allowed * self.scale) & np.isfinite(self.difference)
        return bool(explained[self.differing].mean() >= MOST and explained.mean() >= MOST)


def _distance(found: Float64Array, wanted: Float64Array, rounding: FloatArray) -> Float64Array:
    """Return each vertex's largest difference of any slot, (V,), less the rounding (V, 1, 2) of α and β."""
    distance: Float64Array = (np.abs(found - wanted) - rounding).max(axis=(1, 2), initial=0.0)
    return distance


def _factors(found: Float64Array, wanted: Float64Array, cause: _Cause) -> tuple[float, float] | None:
    """Return the factors that turn the wanted α and β into the found ones, or None if there are none."""
    norms = (wanted * wanted).sum(axis=(0, 1))
    factors = np.divide((found * wanted).sum(axis=(0, 1)), norms, out=np.ones(2), where=norms > 0.0)
    if not cause.explains(_distance(found[:, 1:], factors * wanted[:, 1:], cause.rounding)):
        return None
    return float(factors[0]), float(factors[1])


def _by_size(slots: Float64Array) -> Float64Array:
    """Return each vertex's slots (V, K, 2) in an order that depends only on their entries.

    The α and β of an entry stay together. If each were sorted by itself, an α negated between two joints
    would look like two exchanged slots.
    """
    key = slots @ np.array([1.0, 0.618])
    return np.take_along_axis(slots, np.argsort(key, axis=1)[:, :, None], axis=1)


def _length_ratio(found: Float64Array, wanted: Float64Array) -> float | None:
    """Return the common ratio of gradient lengths (V, K), or None if there is none but 1.

    The length of a vertex over all slots depends neither on their order nor on the frame. Other normals turn
    the frame. Normals quantised to 8 bits leave half of the vertices within a tenth of the true ratio.
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
