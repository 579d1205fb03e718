"""Angular errors that come block by block, and their summary: mean, percentiles and the largest one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray
from skinbake.truth import kernel
from skinbake.truth.values import (
    BINS,
    FINE_BINS,
    CountedErrors,
    Extent,
    WeightedRuns,
    bin_of,
    fine_bin_of,
    least_of_bin,
)

_SHARES = (0.95, 0.99)

# The number of samples that a tail gathers before it is shortened for the first time.
TAIL = 1 << 16

# The number of samples below which it takes less time to sort all of them than to fill their bins.
_FEW = 1 << 12

# The number of values up to which a tail gathers as many as it has before it is shortened again. Larger ones
# gather a quarter: less room takes more time, and more room more memory.
_ROOM = 1 << 20

# The number of samples that wait for their bins: to sum up the bins takes as long as to fill in so many.
_WAITING = 1 << 15


@dataclass(frozen=True, slots=True)
class ErrorSummary:
    """Angular errors over poses and vertices, in degrees.

    mean, p95 and p99 are weighted by rest area. worst_pose and worst_vertex index the first sample that has
    the maximum. worst_part is the part of that sample, in a tally of several. samples is the number of
    counted samples, undefined the number of them without a measured normal.
    """

    mean: float
    p95: float
    p99: float
    max: float
    worst_pose: int
    worst_vertex: int
    samples: int
    undefined: int
    worst_part: int = 0


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
        self._samples, self._undefined = 0, 0
        self._worst: tuple[float, int, int, int] | None = None
        self._tail = _Tail(self._needed)
        self._summary: ErrorSummary | None = None

    @property
    def least(self) -> float:
        """The error below which none is kept for the percentiles, so far."""
        return self._tail.least

    def add(self, errors: FloatArray, areas: FloatArray, *, valid: BoolArray | None = None) -> None:
        """Count a block of errors (P, V) that begins with the first pose and vertex, as ``counted`` does."""
        self.take(self.counted(errors, areas, valid=valid), (0, 0, 0))

    def counted(
        self, errors: FloatArray, areas: FloatArray, *, valid: BoolArray | None = None
    ) -> CountedErrors:
        """Count a block of errors (P, V) in degrees, with the areas (V,) of the vertices, for ``take``.

        valid (P, V), all true by default, tells where the *expected* normal exists. Samples outside it, and
        vertices without area, are left out. A NaN inside it means that the measured normal does not exist. It
        counts as 180°: a method that yields no normal must not look better for it. Several threads may count
        at a time, while another one takes.
        """
        return kernel.count_errors(errors, np.asarray(areas, dtype=np.float64), valid, self.least)

    def take(self, found: CountedErrors, start: tuple[int, int, int]) -> None:
        """Add a counted block. The order of the blocks matters for the last bits of the summary.

        start is the part that the block belongs to, and its first pose and vertex there. Where the largest
        error is found more than once, the first in this order is the worst.
        """
        if self._summary is not None:
            raise ValueError("its errors are summarised already")
        self._samples += found.samples
        self._undefined += found.undefined
        self._weight += found.weight
        self._sum += found.total
        if found.samples and (self._worst is None or found.largest >= self._worst[0]):
            worst = (found.largest, start[0], start[1] + found.pose, start[2] + found.vertex)
            if self._worst is None or found.largest > self._worst[0] or worst[1:] < self._worst[1:]:
                self._worst = worst
        # Fewer errors are needed now than when the block was counted, which several threads may do early.
        self._tail.add(found.tail)

    def summary(self) -> ErrorSummary | None:
        """Summarise the counted errors; None if there are none. No more can be added afterwards."""
        if self._worst is None or not self._samples or self._summary is not None:
            return self._summary
        p95, p99 = self._tail.percentiles(self._weight)
        self._tail = _Tail(0.0)
        self._summary = ErrorSummary(
            mean=self._sum / self._weight,
            p95=p95,
            p99=p99,
            max=self._worst[0],
            worst_pose=self._worst[2],
            worst_vertex=self._worst[3],
            samples=self._samples,
            undefined=self._undefined,
            worst_part=self._worst[1],
        )
        return self._summary


class _Tail:
    """The largest of weighted values. Together they have at least the needed weight.

    Values below ``least`` cannot be among them. Once there are many values, the weight in each bin of values
    tells which ones are needed.
    """

    def __init__(self, needed: float) -> None:
        self._needed = needed
        self.least = 0.0
        self._room = WeightedRuns.room(0, 0)
        self._end = self._noted = Extent(0, 0)
        self._limit = TAIL
        self._bins: Float64Array | None = None
        self._first_bin = 0

    def add(self, found: WeightedRuns) -> None:
        """Take values that may be in the tail."""
        free = self._free_room(found.end, found.values.dtype)
        kept = kernel.keep_at_least(found, free, self.least)
        self._end = Extent(self._end.values + kept.values, self._end.runs + kept.runs)
        count = self._end.values
        if count > self._limit or (self._bins is not None and count - self._noted.values > _WAITING):
            self._note()
        if count > self._limit:
            self._shorten()

    def _free_room(self, wanted: Extent, dtype: np.dtype[np.floating]) -> WeightedRuns:
        """Return the free room behind the values: for so many more of a type, and so many runs of them."""
        end, sizes = self._end, self._room.end
        if end.values:
            dtype = np.result_type(self._room.values, dtype)
        needed = Extent(end.values + wanted.values, end.runs + wanted.runs)
        if needed.values > sizes.values or needed.runs > sizes.runs or dtype != self._room.values.dtype:
            # Twice as much: the system gives memory only where something is written.
            sizes = Extent(*(b if a <= b else max(a, 2 * b) for a, b in zip(needed, sizes, strict=True)))
            kept, self._room = self._values(), WeightedRuns.room(*sizes, dtype)
            copied = self._values()
            copied.values[:], copied.weights[:], copied.lengths[:] = kept.arrays
        return self._room.part(end, sizes)

    def _values(self) -> WeightedRuns:
        """Return all values that are kept."""
        return self._room.part(Extent(0, 0), self._end)

    def _note(self) -> Float64Array:
        """Add the new values to their bins, and raise ``least`` while enough weight stays above it.

        Return the weight of each bin.
        """
        if self._bins is None:
            self._bins = np.zeros(BINS)
        kernel.add_to_bins(self._room.part(self._noted, self._end), self._bins)
        self._noted = self._end
        above = np.cumsum(self._bins[self._first_bin :][::-1])
        place = int(np.searchsorted(above, self._needed))
        if place < len(above):
            self._first_bin = BINS - 1 - place
            # float64 values may be a little below the float32 that named their bin.
            self.least = least_of_bin(self._first_bin) * (1.0 - 1e-6)
        return self._bins

    def _shorten(self) -> None:
        """Drop the values below ``least``."""
        self._end = self._noted = kernel.keep_at_least(self._values(), self._room, self.least)
        count = self._end.values
        self._limit = max(TAIL, min(2 * count, _ROOM), count + count // 4)

    def percentiles(self, weight: float) -> list[float]:
        """Invert the cumulative weight of all values that were added, ``weight`` in total."""
        kept = self._values()
        values = kept.values
        if self._bins is None and len(values) < _FEW:
            order = np.argsort(values)
            sums = np.cumsum(kept.weights_at(order))
            sums += max(0.0, weight - float(sums[-1]))
            return [_at(values[order], sums, share * weight) for share in _SHARES]
        in_bins = self._note()
        below = max(0.0, weight - float(in_bins.sum()))
        cumulative = below + np.cumsum(in_bins)
        binned = values.astype(np.float32, copy=False)
        last = int(bin_of(binned.max()))
        found = []
        for wanted in (share * weight for share in _SHARES):
            own = min(_index_of(cumulative, wanted), last)
            inside = np.flatnonzero((binned >= least_of_bin(own)) & (binned < least_of_bin(own + 1)))
            start = float(cumulative[own - 1]) if own else below
            found.append(_in_bin(values[inside], kept.weights_at(inside), start, wanted))
        return found


def _in_bin(values: FloatArray, weights: Float64Array, below: float, wanted: float) -> float:
    """Return the first value of one bin whose sum is at least a weight.

    ``below`` is the weight of the bins below. A bin may hold many values, so only those of one fine bin are
    sorted.
    """
    bins = fine_bin_of(values)
    cumulative = below + np.cumsum(np.bincount(bins, weights, minlength=FINE_BINS), dtype=np.float64)
    own = min(_index_of(cumulative, wanted), int(bins.max()))
    inside = np.flatnonzero(bins == own)
    order = inside[np.argsort(values[inside])]
    start = float(cumulative[own - 1]) if own else below
    return _at(values[order], start + np.cumsum(weights[order]), wanted)


def _index_of(sums: Float64Array, weight: float) -> int:
    """Return the index of the first sum that is at least a weight.

    Rounding may leave a sum a few units below its own share. That must not push a percentile up.
    """
    return int(np.searchsorted(sums, weight * (1.0 - 1e-9)))


def _at(ordered: FloatArray, sums: Float64Array, weight: float) -> float:
    """Return the first value whose sum is at least a weight, the last one if none is."""
    return float(ordered[min(_index_of(sums, weight), len(ordered) - 1)])
