"""The same work on many files: who does it (this process, several, a Dask cluster) is a runner's affair."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from skinbake.timing import recorded

Result = TypeVar("Result")

OTHER = "other"
"""The stage that stands for what no stage was recorded for."""


class Work(Protocol):
    """What is done with each file; a value that can be pickled, as its jobs and results can."""

    def __call__(self, job: Any) -> Any:
        """Return what became of one job; raises nothing for a file's sake."""

    def lost(self, job: Any, reason: str) -> Any:
        """Return the result of a job that nobody lived to report on."""


class Runner(Protocol):
    """Does one work on many jobs, somewhere."""

    def run(self, work: Work, jobs: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """Yield (number of the job, ``work(job)``) as jobs are done, in any order, each exactly once.

        ``work`` and the jobs can be pickled. ``work`` raises nothing for a file's sake: its result says what
        failed. A runner that loses a worker (killed, out of memory) tries its job again, and at last
        yields ``work.lost(job, reason)``. Closing the iterator stops what has not begun.
        """


class InThisProcess:
    """The runner for a single file, and for work that other processes are not worth starting for."""

    def run(self, work: Work, jobs: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """Yield (number, ``work(job)``) in order."""
        for number, job in enumerate(jobs):
            yield number, work(job)


@dataclass(frozen=True, slots=True)
class FirstThese:
    """A runner for jobs some of which must take their turns, in order, because they may meet on the disk.

    Those numbered in ``turns`` are done first, one at a time; then the others, side by side.
    """

    turns: Sequence[int]
    one_by_one: Runner
    side_by_side: Runner

    def run(self, work: Work, jobs: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """Yield (number, ``work(job)``), those in turns first."""
        first = set(self.turns)
        rest = [number for number in range(len(jobs)) if number not in first]
        for runner, numbers in ((self.one_by_one, sorted(first)), (self.side_by_side, rest)):
            if numbers:
                with closing(_closable(runner.run(work, [jobs[n] for n in numbers]))) as results:
                    for at, result in results:
                        yield numbers[at], result


def in_order(results: Iterator[tuple[int, Result]]) -> Generator[Result, None, None]:
    """Yield results in the order of their numbers, each as soon as those before it are there.

    Closing it closes ``results``.
    """
    waiting: dict[int, Result] = {}
    following = 0
    with closing(_closable(results)):
        for number, result in results:
            waiting[number] = result
            while following in waiting:
                yield waiting.pop(following)
                following += 1


def _closable(results: Iterable[Any]) -> Any:
    """Return what can be closed, be it a generator or a mere iterator."""
    return results if hasattr(results, "close") else (result for result in results)


def timed(call: Callable[[], Result]) -> tuple[Result, dict[str, float]]:
    """Return what the call returned, and its seconds by stage; ``other`` is what is outside of any."""
    start = time.perf_counter()
    with recorded() as timings:
        result = call()
    spent = time.perf_counter() - start
    return result, {**timings.seconds, OTHER: max(0.0, spent - sum(timings.seconds.values()))}
