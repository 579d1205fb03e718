"""Work on many files in several processes, of which any may die without harm to the others' files.

``concurrent.futures`` would not do: when a worker of its pool dies, it cannot tell on which job, and ends
all the others in the middle of theirs. Here each worker has a pipe of its own.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import TYPE_CHECKING, Generic

from skinbake.errors import SkinbakeError
from skinbake.jobs.boundary import survived
from skinbake.jobs.logs import log_to_stderr
from skinbake.jobs.work import JobT, ReturnT, Work

if TYPE_CHECKING:
    from multiprocessing.context import ForkServerContext, SpawnContext

WINDOW = 4096
"""Jobs that may be done ahead of one that takes long: their results wait in memory."""

QUICK = 0.05
"""Seconds: a worker that takes less for a job is sent the next one before it asks."""

PATIENCE = 10.0
"""Seconds that a worker is given to tidy up after it was told to stop."""

GRACE = 3.0
"""Seconds that one is given whose file has taken too long: loops in C do not hear that they are to stop."""

BASE = 1 << 30
"""Bytes of addresses that a worker has besides its limit: for code, stacks and the files that it maps."""

ATTEMPTS = 2
"""How often a job is tried whose worker dies."""

ENVIRONMENT = {
    **dict.fromkeys(
        ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
    ),
    "MALLOC_MMAP_THRESHOLD_": str(16 << 20),
    "MALLOC_TRIM_THRESHOLD_": str(64 << 20),
}
"""What a worker finds in its environment where the user has not said otherwise.

One thread for linear algebra: the processes are the parallelism. And memory that is kept from one file to
the next (by glibc): faulting in fresh pages for each file's arrays is a quarter of the work on small files.
"""


def usable_cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@dataclass(eq=False, slots=True)
class _Worker:
    """A process, this end of its pipe, and the jobs that it was sent, the one at work first.

    begun is when it began that one, late when it was told to stop because that one takes too long.
    """

    process: BaseProcess
    connection: Connection
    sent: deque[int] = field(default_factory=deque)
    is_quick: bool = False
    is_warm: bool = False
    begun: float = 0.0
    late: float | None = None


@dataclass(frozen=True, slots=True)
class Limits:
    """What a job may take: seconds, and bytes of memory in a process that does nothing else (None: any)."""

    seconds: float | None = None
    memory: int | None = None


@dataclass(frozen=True, slots=True)
class Processes:
    """A runner with ``workers`` processes of its own.

    ``modules`` are imported before workers are, where they are forks of one process: once for all.
    A worker that dies costs nobody else's work. Its job is tried again while no other runs, in case
    it was memory that they lacked together. A job that takes longer than ``limits`` allow is lost.
    """

    workers: int
    modules: Sequence[str] = ()
    limits: Limits = field(default_factory=Limits)

    def run(
        self, work: Work[JobT, ReturnT], jobs: Sequence[JobT]
    ) -> Generator[tuple[int, ReturnT], None, None]:
        """Yield (number, ``work(job)``) as jobs are done; raises SkinbakeError where no worker starts.

        Closing the generator, or an interrupt, ends the workers at once: what they had begun is undone.
        """
        pool = _Pool(self, work, jobs)
        try:
            yield from pool.results()
        finally:
            pool.stop()


class _Pool(Generic[JobT, ReturnT]):
    """The workers of one run, and which job is where."""

    def __init__(self, runner: Processes, work: Work[JobT, ReturnT], jobs: Sequence[JobT]) -> None:
        self._work, self._jobs, self._limits = work, jobs, runner.limits
        self._retired: list[BaseProcess] = []
        self._size = min(runner.workers, len(jobs))
        self._context = _context(runner.modules)
        self._workers: list[_Worker] = []
        self._next = 0
        self._back: deque[int] = deque()
        self._suspects: deque[int] = deque()
        self._deaths: dict[int, int] = {}
        self._unfinished = len(jobs)
        self._done_ahead: set[int] = set()
        self._oldest = 0
        self._stillborn = 0

    def results(self) -> Iterator[tuple[int, ReturnT]]:
        while self._unfinished:
            self._hand_out()
            ready = wait([worker.connection for worker in self._workers], self._until_late())
            self._stop_late()
            for connection in ready:
                worker = next(w for w in self._workers if w.connection is connection)
                try:
                    message: tuple[int, ReturnT, float] | None = worker.connection.recv()
                except (EOFError, OSError):
                    yield from self._bury(worker)
                    continue
                if not worker.is_warm:
                    worker.begun = time.monotonic()
                worker.is_warm, self._stillborn = True, 0
                if message is not None:
                    finished = self._finished(worker, *message)
                    self._hand_out()  # nobody is to wait for who takes the result
                    yield finished

    def _until_late(self) -> float | None:
        """Return the seconds until the next worker has to be told to stop, or has to be killed."""
        seconds = self._limits.seconds
        if seconds is None:
            return None
        ends = [
            worker.begun + seconds if worker.late is None else worker.late + GRACE
            for worker in self._workers
            if worker.sent and worker.is_warm
        ]
        return max(0.0, min(ends) - time.monotonic()) if ends else None

    def _stop_late(self) -> None:
        """Tell workers to stop whose job takes too long, and kill those that do not."""
        seconds, now = self._limits.seconds, time.monotonic()
        if seconds is None:
            return
        for worker in self._workers:
            if not worker.sent or not worker.is_warm:
                continue
            if worker.late is not None:
                if now >= worker.late + GRACE:
                    worker.process.kill()
            elif now >= worker.begun + seconds:
                worker.late = now
                worker.process.terminate()

    def stop(self) -> None:
        """End all workers: the idle ones see their pipe close, the busy ones are told to."""
        with _no_interrupts():
            for worker in self._workers:
                if worker.sent:
                    worker.process.terminate()
                worker.connection.close()
            for process in (*(worker.process for worker in self._workers), *self._retired):
                process.join(PATIENCE)
                if process.is_alive():
                    process.kill()
                    process.join()
            self._workers.clear()
            self._retired.clear()

    def _hand_out(self) -> None:
        """Start the workers that are missing, and send jobs to those that have too few."""
        while len(self._workers) < min(self._size, self._unfinished):
            self._workers.append(_started(self._context, self._work, self._limits))
        if self._suspects:  # tried again alone
            if not any(worker.sent for worker in self._workers):
                self._send(self._workers[0], self._suspects.popleft())
            return
        if any(self._deaths.get(number) for worker in self._workers for number in worker.sent):
            return
        for depth in (1,) if self._is_isolated else (1, 2):
            for worker in self._workers:
                if len(worker.sent) < depth and (depth == 1 or worker.is_quick):
                    number = self._next_number()
                    if number is None:
                        return
                    self._send(worker, number)

    def _next_number(self) -> int | None:
        if self._back:
            return self._back.popleft()
        if self._next == len(self._jobs) or self._next >= self._oldest + WINDOW:
            return None
        self._next += 1
        return self._next - 1

    def _send(self, worker: _Worker, number: int) -> None:
        if not worker.sent:
            worker.begun = time.monotonic()
        worker.sent.append(number)
        with suppress(OSError):  # it has died: its pipe says so next
            worker.connection.send((number, self._jobs[number]))

    def _finished(self, worker: _Worker, number: int, result: ReturnT, seconds: float) -> tuple[int, ReturnT]:
        worker.sent.remove(number)
        worker.is_quick = seconds < QUICK
        worker.begun, worker.late = time.monotonic(), None
        if self._is_isolated:
            self._retire(worker)
        self._close_file(number)
        return number, result

    @property
    def _is_isolated(self) -> bool:
        """Tell whether each job has a process of its own: what one leaves in its memory reaches no other."""
        return self._limits.memory is not None

    def _retire(self, worker: _Worker) -> None:
        """Let a worker go that has done its job: it sees its pipe close."""
        self._workers.remove(worker)
        worker.connection.close()
        self._retired = [process for process in self._retired if process.is_alive()]
        self._retired.append(worker.process)

    def _close_file(self, number: int) -> None:
        self._unfinished -= 1
        self._done_ahead.add(number)
        while self._oldest in self._done_ahead:
            self._done_ahead.remove(self._oldest)
            self._oldest += 1

    def _bury(self, worker: _Worker) -> Iterator[tuple[int, ReturnT]]:
        """Take a dead worker out; its job is suspected, or yielded as lost, and the others go back."""
        self._workers.remove(worker)
        worker.connection.close()
        worker.process.join(PATIENCE)
        how = _cause_of_death(worker.process)
        if not worker.is_warm:
            self._stillborn += 1
            if self._stillborn >= ATTEMPTS * self._size:
                raise SkinbakeError(f"worker processes cannot be started ({how}): try --jobs 1")
            self._back.extendleft(reversed(worker.sent))
            return
        if not worker.sent:
            return
        number, *rest = worker.sent
        self._back.extendleft(reversed(rest))
        if worker.late is not None:
            self._close_file(number)
            reason = f"it took longer than {self._limits.seconds:g} s (--timeout)"
            yield number, self._work.lost(self._jobs[number], reason)
            return
        deaths = self._deaths[number] = self._deaths.get(number, 0) + 1
        if deaths < ATTEMPTS:
            self._suspects.append(number)
            return
        self._close_file(number)
        reason = f"the process that worked on it died, and so did a second one by itself ({how})"
        yield number, self._work.lost(self._jobs[number], reason)


def _cause_of_death(process: BaseProcess) -> str:
    code = process.exitcode
    if code is None or code >= 0:
        return f"exit code {code}"
    name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
    return f"{name}; is there too little memory?" if name == "SIGKILL" else name


def _context(modules: Sequence[str]) -> SpawnContext | ForkServerContext:
    """Return how processes are started: as forks of a server that has done the imports, or afresh.

    Never as forks of this process, which may have threads by then.
    """
    if sys.platform != "linux":
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(modules))
    return context


def _started(context: SpawnContext | ForkServerContext, work: Work[JobT, ReturnT], limits: Limits) -> _Worker:
    here, there = context.Pipe()
    with _quiet_start():
        process = context.Process(
            target=_serve,
            args=(there, work, limits, logging.getLogger().level, _handles_logs()),
            daemon=True,
        )
        process.start()
    there.close()
    return _Worker(process, here)


def _handles_logs() -> bool:
    return bool(logging.getLogger().handlers)


@contextmanager
def _quiet_start() -> Iterator[None]:
    """Have processes that start here find their environment, and be deaf to Ctrl-C until they are ready."""
    if sys.platform != "win32":
        resource_tracker.ensure_running()  # it lifts the block when it starts
    missing = {name: value for name, value in ENVIRONMENT.items() if name not in os.environ}
    os.environ.update(missing)
    try:
        with _no_interrupts():
            yield
    finally:
        for name in missing:
            os.environ.pop(name, None)


@contextmanager
def _no_interrupts() -> Iterator[None]:
    """Put Ctrl-C and SIGTERM off until the block is done."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(connection: Connection, work: Work[JobT, ReturnT], limits: Limits, level: int, logs: bool) -> None:
    """Do jobs as they come, until the pipe is closed or a signal says stop; the main of a worker."""
    stopped = threading.Event()
    try:
        _hear_signals(stopped)
        if logs:
            log_to_stderr(level)
        if limits.memory is not None:
            _limit_memory(limits.memory)
        connection.send(None)
        while not stopped.is_set():
            number, job = connection.recv()
            message = _message(work, number, job)
            if not stopped.is_set():  # an interrupt may have come out as another exception
                connection.send_bytes(message)
    except (EOFError, OSError, KeyboardInterrupt):
        pass  # the other end is gone, or we are to go


def _limit_memory(size: int) -> None:
    """Let this process have ``size`` bytes more and leave no core behind, where the system can do that."""
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        used = pages * resource.getpagesize()
    except ImportError:
        return
    except (OSError, ValueError):
        used = 0  # not Linux: what it has is part of BASE
    wanted = {resource.RLIMIT_AS: used + size + BASE, resource.RLIMIT_CORE: 0}
    for kind, limit in wanted.items():
        _, hard = resource.getrlimit(kind)
        with suppress(OSError, ValueError):
            resource.setrlimit(kind, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))


def _message(work: Work[JobT, ReturnT], number: int, job: JobT) -> bytes:
    """Do a job, and return what is sent of it: its number, its result and the seconds that it took.

    A work that raises, and a result that cannot be pickled, are defects of ours: that job alone is lost.
    """
    start = time.perf_counter()

    def pickled(result: ReturnT) -> bytes:
        return bytes(ForkingPickler.dumps((number, result, time.perf_counter() - start)))

    return survived(
        lambda: pickled(work(job)), lambda error: pickled(work.lost(job, error.message)), f"job {number}"
    )


def _hear_signals(stopped: threading.Event) -> None:
    """Let SIGINT and SIGTERM end the work like Ctrl-C: whatever was begun is undone on the way out."""

    def stop(signum: int, frame: object) -> None:
        if not stopped.is_set():  # a second one must not disturb the tidying up
            stopped.set()
            raise KeyboardInterrupt

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGTERM})
