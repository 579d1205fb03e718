"""The same work on many files: who does it (this process, several, a Dask cluster) is a runner's affair."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol


class Runner(Protocol):
    """Does one work on many jobs, somewhere."""

    def run(self, work: Callable[[Any], Any], jobs: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """Yield (number of the job, ``work(job)``) as jobs are done, in any order, each exactly once.

        ``work`` and the jobs can be pickled. ``work`` raises nothing for a file's sake: its result says what
        failed. A runner that loses a worker (killed, out of memory) tries its job again, and at last
        yields ``work.lost(job, reason)``. Closing the iterator stops what has not begun.
        """
