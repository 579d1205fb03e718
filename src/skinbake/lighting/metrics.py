"""The distance between two fields of normals: angles in degrees, weighted by area, and the largest one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skinbake.geometry.skinned import BoolArray, Float32Array, Float64Array, FloatArray, IntArray

_SHARES = (0.95, 0.99)

# The number of samples that a tail gathers before it is shortened for the first time.
_TAIL = 1 << 16


@dataclass(frozen=True, slots=True)
class ErrorSummary:
    """Angular errors over poses and vertices, in degrees.

    mean, p95 and p99 are weighted by rest area. worst_pose and worst_vertex index the first sample that has
    the maximum. worst_part is the part of that sample, in a tally of several. samples is the number of
    counted samples, excluded the number of others. undefined is the number of counted samples without a
    measured normal.
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
    worst_part: int = 0


def vertex_areas(positions: FloatArray, triangles: IntArray) -> Float64Array:
    """Return the area around each vertex, a third of each of its triangles: (V,) float64, squared unit."""
    corners = np.asarray(positions, dtype=np.float64)[triangles]
    with np.errstate(invalid="ignore", over="ignore"):
        doubled = np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        )
    shares = np.where(np.isfinite(doubled), doubled, 0.0) / 6.0
    corner_shares = np.repeat(shares, 3)
    return np.bincount(triangles.ravel(), corner_shares, minlength=len(positions)).astype(np.float64)


def angles_between(measured: Sequence[FloatArray], expected: Sequence[FloatArray]) -> Float64Array:
    """Return the result of ``angular_errors`` for vectors given by their three components (...)."""
    with np.errstate(all="ignore"):
        # atan2 takes twice as long as atan. The ratio of two zeros is NaN, as wanted.
        ratio: Float64Array = np.sqrt(squared_sine(measured, expected)) / cosine(measured, expected)
        angles: Float64Array = np.arctan(ratio)
        angles *= 180.0 / np.pi
        angles += 180.0 * np.signbit(ratio)
    return angles


def unit_vectors(vector: Sequence[FloatArray]) -> list[FloatArray]:
    """Return unit vectors by components; NaN for a vector that is zero, not finite or too long to square."""
    with np.errstate(all="ignore"):
        square = cosine(vector, vector)
        if square.max(initial=0.0) == np.inf:
            square[square == np.inf] = np.nan
        reciprocal = 1.0 / np.sqrt(square)
        return [reciprocal * component for component in vector]


def angles_of_units(measured: Sequence[FloatArray], expected: Sequence[FloatArray]) -> Float32Array:
    """Return the angle between unit vectors given by their components, in degrees, float32.

    It is twice the arctangent of half a chord over the rest of the diameter. It is as exact near 0° and 180°
    as ``angles_between``, and cheaper if one vector is compared with several.
    """
    with np.errstate(all="ignore"):
        chord: Float64Array = np.square(measured[0] - expected[0])
        chord += np.square(measured[1] - expected[1])
        chord += np.square(measured[2] - expected[2])
        ratio = (chord / (4.0 - chord)).astype(np.float32)
        # Rounding may make a chord longer than the diameter.
        angles: Float32Array = np.arctan(np.sqrt(np.abs(ratio)))
        angles *= np.float32(360.0 / np.pi)
    return angles


def squared_sine(a: Sequence[FloatArray], b: Sequence[FloatArray]) -> Float64Array:
    """Return |a × b|² of vectors given by their components."""
    (x, y, z), (u, v, w) = a, b
    total: Float64Array = np.square(y * w - z * v)
    total += np.square(z * u - x * w)
    total += np.square(x * v - y * u)
    return total


def cosine(a: Sequence[FloatArray], b: Sequence[FloatArray]) -> Float64Array:
    """Return a · b of vectors given by their components."""
    total: Float64Array = a[0] * b[0]
    total += a[1] * b[1]
    total += a[2] * b[2]
    return total


def total_area(areas: FloatArray) -> float:
    """Return the sum of the areas that count. These are the areas above 0."""
    return float(np.sum(areas, where=np.asarray(areas) > 0.0))


class ErrorTally:
    """Angular errors that come block by block, and their summary, weighted by area.

    The weighted percentile q is the smallest counted error such that the samples up to it carry at least the
    share q of the counted weight. It is always an error that occurs, without interpolation. Percentiles are
    exact although few samples are kept: a sample with more than a twentieth of all weight above it cannot be
    one of them.
    """

    def __init__(self, weight: float) -> None:
        """Expect samples that weigh at most ``weight`` in all. The less they weigh, the fewer are kept."""
        # Rounding must not make the tail too short.
        self._needed = weight * (1.0 - _SHARES[0]) * (1.0 + 1e-6)
        self._weight, self._sum = 0.0, 0.0
        self._samples, self._excluded, self._undefined = 0, 0, 0
        self._worst: tuple[float, int, int, int] | None = None
        self._tail = _Tail(self._needed)

    def add(
        self,
        errors: FloatArray,
        areas: FloatArray,
        *,
        valid: BoolArray | None = None,
        start: tuple[int, int, int] = (0, 0, 0),
    ) -> None:
        """Count a block of errors (P, V) in degrees, with the areas (V,) of the vertices.

        valid (P, V), all true by default, tells where the *expected* normal exists. Samples outside it, and
        vertices without area, are left out. A NaN inside it means that the measured normal does not exist. It
        counts as 180°: a method that yields no normal must not look better for it.
        start is the part that the block belongs to, and its first pose and vertex there: where the largest
        error is found more than once, the first in this order is the worst.
        """
        weights = np.asarray(areas, dtype=np.float64)
        # The sum uses the errors' own type: pairwise sums of float32 are exact to seven digits, and five
        # times as fast.
        sums = errors.sum(axis=0).astype(np.float64)
        if (weights > 0.0).all() and (valid is None or valid.all()) and not np.isnan(sums).any():
            self._samples += errors.size
            self._weight += float(weights.sum()) * len(errors)
            self._count(errors, sums, weights, start)
            return
        counted = np.broadcast_to(weights > 0.0, errors.shape)
        if valid is not None:
            counted = counted & valid
        undefined = counted & np.isnan(errors)
        self._samples += int(np.count_nonzero(counted))
        self._excluded += int(errors.size - np.count_nonzero(counted))
        self._undefined += int(np.count_nonzero(undefined))
        weights = np.where(weights > 0.0, weights, 0.0)
        self._weight += float(counted.sum(axis=0) @ weights)
        values = np.where(undefined, errors.dtype.type(180.0), np.where(counted, errors, -1.0))
        sums = np.sum(values, axis=0, dtype=np.float64, where=counted)
        self._count(values.astype(errors.dtype, copy=False), sums, weights, start)

    def _count(
        self, errors: FloatArray, sums: Float64Array, weights: Float64Array, start: tuple[int, int, int]
    ) -> None:
        """Count errors (P, V), −1 if an error is not counted. Their sums over poses are (V,)."""
        self._sum += float(sums @ weights)
        largest = float(errors.max(initial=-1.0))
        if largest >= 0.0 and (self._worst is None or largest >= self._worst[0]):
            pose, vertex = (int(index) for index in np.argwhere(errors == largest).min(axis=0))
            found = (largest, start[0], start[1] + pose, start[2] + vertex)
            if self._worst is None or largest > self._worst[0] or found[1:] < self._worst[1:]:
                self._worst = found
        self._tail.add(errors, weights)

    def summary(self) -> ErrorSummary | None:
        """Summarise the counted errors; None if there are none."""
        if self._worst is None or not self._samples:
            return None
        p95, p99 = self._tail.percentiles(self._weight)
        return ErrorSummary(
            mean=self._sum / self._weight,
            p95=p95,
            p99=p99,
            max=self._worst[0],
            worst_pose=self._worst[2],
            worst_vertex=self._worst[3],
            samples=self._samples,
            excluded=self._excluded,
            undefined=self._undefined,
            worst_part=self._worst[1],
        )


class _Tail:
    """The largest of weighted values. Together they have at least the needed weight."""

    def __init__(self, needed: float) -> None:
        self._needed = needed
        self._least = 0.0
        self._values: list[FloatArray] = []
        self._weights: list[Float64Array] = []
        self._count, self._limit = 0, _TAIL

    def add(self, errors: FloatArray, weights: Float64Array) -> None:
        """Keep the errors (P, V), with weights (V,), that may be in the tail. Negative errors are dropped."""
        by_vertex = np.ascontiguousarray(errors.T)
        places = np.flatnonzero(by_vertex.ravel() >= self._least)
        self._values.append(by_vertex.ravel()[places])
        self._weights.append(weights[places // max(1, len(errors))])
        self._count += len(places)
        if self._count > self._limit:
            self._shorten()

    def _shorten(self) -> None:
        """Drop the smallest values as long as the others have the needed weight."""
        values, weights = np.concatenate(self._values), np.concatenate(self._weights)
        share, total = 0.0, float(weights.sum())
        if total > 0.0:
            # This assumes that weights and values are independent. If they are not, it may not be enough.
            share = 1.1 * self._needed / total
        if len(values) and share < 0.9:
            least = np.partition(values, -1 - int(share * len(values)))[-1 - int(share * len(values))]
            chosen = values >= least
            if float(np.sum(weights, where=chosen)) >= self._needed:
                values, weights = values[chosen], weights[chosen]
                self._least = float(least)
        self._values, self._weights = [values], [weights]
        self._count = len(values)
        self._limit = max(_TAIL, 2 * self._count)

    def percentiles(self, weight: float) -> list[float]:
        """Invert the cumulative weight of all values that were added, ``weight`` in total."""
        self._shorten()
        (values,), (weights,) = self._values, self._weights
        order = np.argsort(values)
        cumulative = np.cumsum(weights[order]) + max(0.0, weight - float(weights.sum()))
        # Rounding may leave a sum a few units below its own share. That must not push a percentile up.
        wanted = np.array(_SHARES) * weight * (1.0 - 1e-9)
        places = np.minimum(np.searchsorted(cumulative, wanted), len(order) - 1)
        return [float(value) for value in values[order][places]]
