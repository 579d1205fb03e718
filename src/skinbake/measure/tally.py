"""Angular errors that come block by block, and their summary: mean, percentiles and the largest one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from skinbake.errors import Place
from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray
from skinbake.report.verify import ErrorFigures, Figures, Normals, Worst
from skinbake.truth import kernel
from skinbake.truth.values import BINS_OF_OCTAVE, CountedErrors, end_of_bin

_SHARES = 0.95, 0.99


@dataclass(frozen=True, slots=True)
class ErrorSummary:
    """Angular errors over poses and vertices, in degrees.

    mean, p95 and p99 are weighted by rest area, and weight is the sum of these areas. worst_pose and
    worst_vertex index the first sample that has the maximum. worst_part is the part of that sample, in a
    tally of several. samples is the number of counted samples, undefined the number of them without a
    measured normal.
    """

    mean: float
    p95: float
    p99: float
    max: float
    worst_pose: int
    worst_vertex: int
    samples: int
    undefined: int
    weight: float
    worst_part: int = 0


class ErrorTally:
    """Angular errors that come block by block, and their summary, weighted by area.

    The weighted percentile q is the smallest error such that the samples up to it carry at least the share q
    of the counted weight. Errors are counted in bins, 128 to each power of two, and a percentile is where its
    bin ends, at most the largest error: never below the exact one, and less than 0.8 % above it.
    """

    def __init__(self) -> None:
        self._weight, self._sum = 0.0, 0.0
        self._samples, self._undefined = 0, 0
        self._worst = -1.0, (0, 0, 0)
        # The bins of those powers of two that any error lies in: a model may have thousands of tallies.
        self._octaves: dict[int, Float64Array] = {}

    def add(self, errors: FloatArray, areas: FloatArray, *, valid: BoolArray | None = None) -> None:
        """Count a block of errors (P, V) that begins with the first pose and vertex, see ``count_errors``."""
        self.take(kernel.count_errors(errors, np.asarray(areas, dtype=np.float64), valid), (0, 0, 0))

    def take(self, found: CountedErrors, start: tuple[int, int, int]) -> None:
        """Add a counted block. The order of the blocks matters for the last bits of the summary.

        start is the part that the block belongs to, and its first pose and vertex there. Where the largest
        error is found more than once, the first in this order is the worst.
        """
        if not found.samples:
            return
        self._samples += found.samples
        self._undefined += found.undefined
        self._weight += found.weight
        self._sum += found.total
        worst = start[0], start[1] + found.pose, start[2] + found.vertex
        if found.largest > self._worst[0] or (found.largest == self._worst[0] and worst < self._worst[1]):
            self._worst = found.largest, worst
        by_octave = found.bins.reshape(-1, BINS_OF_OCTAVE)
        for octave in np.flatnonzero(by_octave.any(axis=1)).tolist():
            self._octaves[octave] = self._octaves.get(octave, 0.0) + by_octave[octave]

    def summary(self) -> ErrorSummary | None:
        """Summarise the counted errors; None if there are none."""
        if not self._samples:
            return None
        largest, (part, pose, vertex) = self._worst
        octaves = sorted(self._octaves)
        sums = np.cumsum([self._octaves[octave] for octave in octaves])
        # Rounding may leave a sum a few units below its own share. That must not push a percentile up.
        wanted = np.searchsorted(sums, [share * sums[-1] * (1.0 - 1e-9) for share in _SHARES])
        bins = [octaves[n // BINS_OF_OCTAVE] * BINS_OF_OCTAVE + n % BINS_OF_OCTAVE for n in wanted.tolist()]
        p95, p99 = (min(end_of_bin(place), largest) for place in bins)
        return ErrorSummary(
            mean=self._sum / self._weight,
            p95=p95,
            p99=p99,
            max=largest,
            worst_pose=pose,
            worst_vertex=vertex,
            samples=self._samples,
            undefined=self._undefined,
            weight=self._weight,
            worst_part=part,
        )


class Tallies:
    """The errors of normals by truth, method and lighting: of a file, and of each of its primitives.

    places name the primitives. Each is counted in parts: a primitive in the poses of one skin.
    """

    def __init__(self, places: Iterable[Place]) -> None:
        self._places = tuple(dict.fromkeys(places))
        self._parts: list[tuple[Place, Sequence[str], Sequence[float | None]]] = []
        self._tallies: dict[tuple[str, str, str], dict[Place | None, ErrorTally]] = {}

    def begin(self, places: Iterable[Place], clips: Sequence[str], times: Sequence[float | None]) -> int:
        """Begin a part for each of the places, in poses of clips at times. Return the first part's number."""
        first = len(self._parts)
        self._parts += [(place, clips, times) for place in places]
        return first

    def take(self, key: tuple[str, str, str], counted: CountedErrors, start: tuple[int, int, int]) -> None:
        """Add a counted block of a truth, a method and a lighting; start is that of ``ErrorTally.take``."""
        tallies = self._tallies.setdefault(key, {})
        # A single primitive has the figures of the whole, so nothing is counted twice.
        places = [None, self._parts[start[0]][0]] if len(self._places) > 1 else [None]
        for place in places:
            tallies.setdefault(place, ErrorTally()).take(counted, start)

    def figures(self, truth: str) -> Figures:
        """Return the figures by one truth. All poses weigh the same."""
        of_places: dict[Place | None, Normals] = {place: {} for place in (None, *self._places)}
        for (of, method, lighting), tallies in self._tallies.items():
            for place, tally in tallies.items() if of == truth else ():
                summary = tally.summary()
                if summary is not None:
                    at, clips, times = self._parts[summary.worst_part]
                    pose = summary.worst_pose
                    worst = Worst(at, summary.worst_vertex, clips[pose], times[pose])
                    of_places[place].setdefault(method, {})[lighting] = ErrorFigures(
                        summary.mean, summary.p95, summary.p99, summary.max, worst, summary.weight
                    )
        whole = of_places.pop(None)
        if len(self._places) == 1:
            return Figures(whole, ((self._places[0], whole),))
        return Figures(whole, tuple((place, of_places[place]) for place in self._places))
