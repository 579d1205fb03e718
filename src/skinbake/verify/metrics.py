"""How far two fields of normals lie apart: angles in degrees, weighted by area, and where the largest is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class ErrorSummary:
    """Angular errors over poses and vertices, in degrees.

    mean, p95 and p99 are weighted by rest area; worst_pose and worst_vertex index the first sample that has
    the maximum. samples were counted, excluded were not, and undefined of the counted ones had no measured
    normal.
    """

    mean: float
    p95: float
    p99: float
    max: float
    worst_pose: int
    worst_vertex: int
    samples: int
    excluded: int
    undefined: int


def vertex_areas(positions: FloatArray, triangles: IntArray) -> Float64Array:
    """Return the rest area of each vertex, a third of every triangle's: (V,) float64, squared length unit.

    positions (V, 3), triangles (T, 3), every index < V. A triangle with a non-finite corner has no area.
    Copies of a vertex each have the share of their own triangles, so a split seam changes no total.
    """
    corners = np.asarray(positions, dtype=np.float64)[triangles]
    with np.errstate(invalid="ignore", over="ignore"):
        doubled = np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        )
    shares = np.where(np.isfinite(doubled), doubled, 0.0) / 6.0
    corner_shares = np.repeat(shares, 3)
    return np.bincount(triangles.ravel(), corner_shares, minlength=len(positions)).astype(np.float64)


def angular_errors(measured: FloatArray, expected: FloatArray) -> Float64Array:
    """Return the angle between two fields of vectors of any length, in degrees: (P, V) float64, or any (...).

    measured and expected (..., 3), one space. The angle is atan2(|m × e|, m · e), which keeps its digits
    near 0° where an arccos has none left. It is NaN where either vector is zero or not finite: a zero
    vector has no angle, and atan2 would call it 0°.
    """
    x, y, z = np.moveaxis(np.asarray(measured, dtype=np.float64), -1, 0)
    u, v, w = np.moveaxis(np.asarray(expected, dtype=np.float64), -1, 0)
    with np.errstate(invalid="ignore", over="ignore"):
        sine = np.sqrt((y * w - z * v) ** 2 + (z * u - x * w) ** 2 + (x * v - y * u) ** 2)
        cosine = x * u + y * v + z * w
        angles: Float64Array = np.degrees(np.arctan2(sine, cosine))
        angles[(sine == 0.0) & (cosine == 0.0)] = np.nan
    return angles


def summarise(
    errors: FloatArray, areas: FloatArray, *, valid: BoolArray | None = None
) -> ErrorSummary | None:
    """Summarise angular errors over poses and vertices, weighted by area; None where nothing counts.

    errors (P, V), degrees; areas (V,), rest areas in any unit. valid (P, V), all true by default, is where
    the *expected* normal exists: samples outside it, and vertices without area, are left out. A NaN inside
    it means that the measured normal does not exist, and it counts as 180°: a method that yields no normal
    must not look better for it.

    The weighted percentile q is the smallest counted error such that the samples up to it carry at least
    the share q of the counted weight: always an error that occurs, with no interpolation.
    """
    counted = np.broadcast_to(np.asarray(areas) > 0.0, errors.shape)
    if valid is not None:
        counted = counted & valid
    if not counted.any():
        return None
    undefined = counted & np.isnan(errors)
    values = np.where(undefined, 180.0, errors)
    worst = int(np.argmax(np.where(counted, values, -1.0)))
    samples = values[counted]
    weights = np.broadcast_to(np.asarray(areas, dtype=np.float64), errors.shape)[counted]
    pose, vertex = divmod(worst, errors.shape[1])
    p95, p99 = _weighted_percentiles(samples, weights, (0.95, 0.99))
    return ErrorSummary(
        mean=float(np.average(samples, weights=weights)),
        p95=p95,
        p99=p99,
        max=float(values[pose, vertex]),
        worst_pose=pose,
        worst_vertex=vertex,
        samples=samples.size,
        excluded=errors.size - samples.size,
        undefined=int(undefined.sum()),
    )


def _weighted_percentiles(
    values: Float64Array, weights: Float64Array, shares: tuple[float, ...]
) -> list[float]:
    """Invert the cumulative weight of the sorted values, for ascending shares."""
    # A histogram finds where the first share is reached, and only the values from there on are sorted: a
    # tenth of the time on millions. Its bins are the leading bits of float32 numbers, which order as the
    # numbers do.
    bins = values.astype(np.float32).view(np.int32) >> 16
    reached = np.cumsum(np.bincount(bins, weights))
    # Rounding may leave a sum below its own share by a few units: they must not push a percentile up.
    wanted = np.array(shares) * reached[-1] * (1.0 - 1e-9)
    first = int(np.searchsorted(reached, wanted[0]))
    tail = bins >= first
    order = np.argsort(values[tail])
    cumulative = np.cumsum(weights[tail][order]) + (reached[first - 1] if first else 0.0)
    places = np.minimum(np.searchsorted(cumulative, wanted), len(order) - 1)
    return [float(value) for value in values[tail][order][places]]
