"""The tallies of the errors of a file: all in all and for each primitive, and the figures made of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from skinbake.choices import Truth
from skinbake.errors import Place
from skinbake.lighting.angles import METHODS, NOT_MEASURED, MeasuredBlock
from skinbake.lighting.draws import Draw
from skinbake.lighting.metrics import total_area
from skinbake.lighting.poses import PoseSet
from skinbake.lighting.tally import ErrorTally
from skinbake.report.verify import ErrorFigures, Normals, Worst
from skinbake.threads import Threads, thread_count
from skinbake.timing import stage


@dataclass(frozen=True, slots=True)
class _Segment:
    """One primitive under one skin: its place and its poses."""

    place: Place
    poses: PoseSet


_Tallies = dict[tuple[str, str], dict[str, ErrorTally]]
"""Tallies by truth and method, then by lighting."""


class FileTallies:
    """Tallies of a file by truth, method and lighting: of the whole file, and of each primitive."""

    def __init__(self) -> None:
        self._segments: list[_Segment] = []
        self._whole: _Tallies = {}
        self._by_place: dict[Place, _Tallies] = {}

    def expect(self, method: str, drawn: Sequence[Draw]) -> None:
        """Prepare to count the results of a method. A tally must know how much weight may come."""
        weights: dict[Place, float] = {}
        for draw in drawn:
            for view, areas in zip(draw.views, draw.areas, strict=True):
                weight = len(draw.poses.clips) * total_area(areas)
                weights[view.source.place] = weights.get(view.source.place, 0.0) + weight
        for truth in Truth:
            lightings = [one for one in METHODS[method] if (truth, one) not in NOT_MEASURED]
            self._whole[truth, method] = {one: ErrorTally(sum(weights.values())) for one in lightings}
            for place, weight in weights.items():
                # A single primitive has the figures of the whole, so nothing is counted twice.
                own = {one: ErrorTally(weight) for one in lightings}
                tallies = self._whole[truth, method] if len(weights) == 1 else own
                self._by_place.setdefault(place, {})[truth, method] = tallies

    def counting(self, method: str, draw: Draw) -> Callable[[MeasuredBlock], Callable[[], None]]:
        """Return what counts a block of a draw by a method. It returns what adds the count to the tallies.

        Several threads may count. One thread adds, in the order of the blocks.
        """
        first = len(self._segments)
        self._segments += [_Segment(view.source.place, draw.poses) for view in draw.views]
        return partial(self._count, method, draw, first)

    def _count(self, method: str, draw: Draw, first: int, block: MeasuredBlock) -> Callable[[], None]:
        """Count a block of a draw whose segments begin with ``first``. Return what adds it to its tallies."""
        areas = draw.areas[block.primitive][block.vertex : block.vertex + block.errors.shape[1]]
        start = first + block.primitive, block.pose, block.vertex
        by_place = self._by_place[draw.views[block.primitive].source.place]
        whole, own = (tallies[block.truth, method][block.lighting] for tallies in (self._whole, by_place))
        tallies = [whole] if own is whole else [whole, own]
        with stage("figures"):
            # A tally that keeps more serves the other one, too.
            keeps_most = min(tallies, key=lambda tally: tally.least)
            counted = keeps_most.counted(block.errors, areas, valid=block.valid)

        def add() -> None:
            with stage("figures"):
                for tally in tallies:
                    tally.take(counted, start)

        return add

    def sum_up(self) -> None:
        """Summarise the tallies that are complete. Their largest errors take memory until then."""
        found = {
            id(tally): tally
            for tallies in (self._whole, *self._by_place.values())
            for lightings in tallies.values()
            for tally in lightings.values()
        }
        with stage("figures"), Threads(thread_count()) as threads:
            for _ in threads.each(ErrorTally.summary, found.values()):
                pass

    def figures(self, truth: Truth) -> Normals:
        """Return the figures of the whole file by one truth."""
        return self._figures(self._whole, truth)

    def figures_of_primitives(self, truth: Truth) -> tuple[tuple[Place, Normals], ...]:
        """Return the figures of each primitive by one truth."""
        return tuple((place, self._figures(tallies, truth)) for place, tallies in self._by_place.items())

    def _figures(self, tallies: _Tallies, truth: str) -> Normals:
        """Return the figures by one truth, by method and lighting. All poses weigh the same."""
        result: Normals = {}
        for (of, method), lightings in tallies.items():
            for lighting, tally in lightings.items() if of == truth else ():
                summary = tally.summary()
                if summary is not None:
                    segment, pose = self._segments[summary.worst_part], summary.worst_pose
                    clip, time = segment.poses.clips[pose], segment.poses.times[pose]
                    worst = Worst(segment.place, summary.worst_vertex, clip, time)
                    result.setdefault(method, {})[lighting] = ErrorFigures(
                        summary.mean, summary.p95, summary.p99, summary.max, worst
                    )
        return result
