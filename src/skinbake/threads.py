"""Work on blocks in several threads. Results are in the blocks' order, the same at any number of threads."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import chain, islice
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

MOST = 8
"""The largest number of threads. With more, the thread that gathers results is the bottleneck."""

AHEAD = 4
"""The number of blocks a thread may do before their results are taken. Results take memory."""


def thread_count() -> int:
    """Return the number of threads: the number of cores, or the value of OMP_NUM_THREADS.

    A worker process finds 1 there, because the processes are the parallelism.
    """
    told = os.environ.get("OMP_NUM_THREADS", "")
    if told.isdecimal() and int(told) > 0:
        return min(int(told), MOST)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(cores, MOST)


class Threads:
    """Threads that exist while a block of code runs. With a count of 1 there are none."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._pool = ThreadPoolExecutor(count) if count > 1 else None

    def __enter__(self) -> Threads:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def each(self, work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Yield the result of ``work`` for each item, in the items' order."""
        pending = iter(items)
        first = list(islice(pending, 2))
        if self._pool is None or len(first) < 2:  # one block gains nothing from another thread
            yield from map(work, chain(first, pending))
            return
        waiting: deque[Future[Result]] = deque()
        for item in chain(first, pending):
            waiting.append(self._pool.submit(work, item))
            if len(waiting) > AHEAD * self._count:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
