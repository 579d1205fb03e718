"""Work on blocks in several threads, as many as the cores and the control groups of a container allow.

Results are in the blocks' order, the same at any number of threads.
"""

from __future__ import annotations

import os
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from itertools import chain, islice
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from concurrent.futures import Future


GROUPS, GROUP_ROOT = Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")
"""The paths where Linux lists the control groups of a process, and their limits."""


def group_limits(
    controller: str, files: Iterable[Sequence[str]], groups: Path = GROUPS, root: Path = GROUP_ROOT
) -> Iterator[str]:
    """Yield the limits of a controller for this process, as text: of its own groups and of those around them.

    ``files`` are the names of the files with a limit: version 2 and version 1 have other ones.
    """
    try:
        lines = groups.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, path = (*line.split(":", maxsplit=2), "", "")[:3]
        if controllers and controller not in controllers.split(","):
            continue
        base = root / controller if controllers else root
        own = base / path.strip("/")
        for folder in dict.fromkeys((own, *own.parents)):
            if folder != base and base not in folder.parents:
                break
            for names in files:
                with suppress(OSError, ValueError):
                    yield " ".join((folder / name).read_text(encoding="ascii") for name in names)


Item = TypeVar("Item")
Result = TypeVar("Result")

MOST = 8
"""The largest number of threads that is chosen unasked. With more, the gathering thread is the bottleneck."""

LARGEST = 64
"""The largest number of threads that can be asked for."""

AHEAD = 4
"""The number of blocks a thread may do before their results are taken. Results take memory."""

_asked: ContextVar[int | None] = ContextVar("_asked", default=None)


@contextmanager
def threads_limited(count: int | None) -> Iterator[None]:
    """Let the work in the block take ``count`` threads; None: as many as there are cores for it."""
    token = _asked.set(count)
    try:
        yield
    finally:
        _asked.reset(token)


def thread_count(processes: int = 1) -> int:
    """Return the number of threads for work in each of so many processes.

    It is the number that ``threads_limited`` set, else the value of OMP_NUM_THREADS, else a share of the
    cores. A worker process that was told nothing finds OMP_NUM_THREADS=1.
    """
    asked = _asked.get()
    if asked is not None:
        return asked
    told = os.environ.get("OMP_NUM_THREADS", "")
    if told.isdecimal() and int(told) > 0:
        return min(int(told), MOST)
    return min(max(usable_cores() // processes, 1), MOST)


def usable_cores() -> int:
    """Return the number of cores that affinity and the quotas of control groups leave to this process."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    # A quota of 1.5 cores is used up by two threads, and not by one.
    return max(1, min([cores, *(ceil(quota) for quota in cpu_quotas())]))


def cpu_quotas(groups: Path = GROUPS, root: Path = GROUP_ROOT) -> Iterator[float]:
    """Yield the cores that control groups leave to this process: their quota divided by its period."""
    files = ("cpu.max",), ("cpu.cfs_quota_us", "cpu.cfs_period_us")
    for text in group_limits("cpu", files, groups, root):
        with suppress(ValueError):  # "max 100000" means no limit
            quota, period = map(int, text.split())
            if quota > 0 and period > 0:  # -1 means no limit
                yield quota / period


class Threads:
    """Threads that exist while a block of code runs. With a count of 1 there are none."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._pool = None
        if count > 1 and sys.platform != "emscripten":  # where a thread cannot be started
            from concurrent.futures import ThreadPoolExecutor  # it takes some milliseconds

            self._pool = ThreadPoolExecutor(count)

    def __enter__(self) -> Threads:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def begun(self, work: Callable[[], Result]) -> Callable[[], Result]:
        """Begin some work on one thread, and return what waits for its result.

        Without threads, the work is done when its result is wanted. The work must not read a document, whose
        budget and caches belong to one thread.
        """
        return work if self._pool is None else self._pool.submit(_by_one_thread, work).result

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

    def done(self, work: Callable[[Item], None], items: Iterable[Item]) -> None:
        """Do ``work`` for each item. It puts its result where it belongs."""
        for _ in self.each(work, items):
            pass


def _by_one_thread(work: Callable[[], Result]) -> Result:
    with threads_limited(1):  # another thread does not know how many were asked for
        return work()
