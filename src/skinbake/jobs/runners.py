"""The runners of the work on many files: this process, several processes, or a Dask cluster."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Generic, TypeVar

from skinbake.jobs.work import JobT, ReturnT, Runner, Work

T = TypeVar("T")


class InThisProcess:
    """The runner for a single file, and for work that is too small for other processes."""

    def run(
        self, work: Work[JobT, ReturnT], jobs: Sequence[JobT]
    ) -> Generator[tuple[int, ReturnT], None, None]:
        """Yield (number, ``work(job)``) in order."""
        for number, job in enumerate(jobs):
            yield number, work(job)


@dataclass(frozen=True, slots=True)
class FirstThese(Generic[JobT, ReturnT]):
    """A runner for jobs of which some must run in order, because they may use the same file on the disk.

    The jobs numbered in ``turns`` are done first, one at a time. Then the other jobs run side by side.
    """

    turns: Sequence[int]
    one_by_one: Runner[JobT, ReturnT]
    side_by_side: Runner[JobT, ReturnT]

    def run(
        self, work: Work[JobT, ReturnT], jobs: Sequence[JobT]
    ) -> Generator[tuple[int, ReturnT], None, None]:
        """Yield (number, ``work(job)``). The jobs in ``turns`` come first."""
        first = set(self.turns)
        rest = [number for number in range(len(jobs)) if number not in first]
        for runner, numbers in ((self.one_by_one, sorted(first)), (self.side_by_side, rest)):
            if numbers:
                with closing(runner.run(work, [jobs[n] for n in numbers])) as results:
                    for at, result in results:
                        yield numbers[at], result


def in_order(results: Generator[tuple[int, T], None, None]) -> Generator[T, None, None]:
    """Yield results in the order of their numbers, each as soon as all earlier results are there.

    An interrupt comes after the results that wait for earlier ones: their outputs stay. Closing this
    generator closes ``results``.
    """
    waiting: dict[int, T] = {}
    following = 0
    with closing(results):
        try:
            for number, result in results:
                waiting[number] = result
                while following in waiting:
                    yield waiting.pop(following)
                    following += 1
        except KeyboardInterrupt:
            for _, result in sorted(waiting.items(), key=lambda item: item[0]):
                yield result
            raise
