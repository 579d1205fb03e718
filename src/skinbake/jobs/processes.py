"""Work on many files in several processes. A process that dies does not harm the files of the others.

``concurrent.futures`` does not suffice. When a worker of its pool dies, the pool cannot tell which job the
worker had, and it ends all other workers in the middle of their jobs. Here each worker has its own pipe.
"""

from __future__ import annotations

import logging
import signal
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from multiprocessing.reduction import ForkingPickler
from typing import Any, Generic, TypeVar

from skinbake.errors import InputError, Place, SkinbakeError
from skinbake.gltf.budget import memory_limited
from skinbake.jobs.starting import check_descriptors, context_for, no_interrupts, started
from skinbake.jobs.work import JobT, ReturnT, Work, survived
from skinbake.jobs.worker import Limits
from skinbake.threads import threads_limited
from skinbake.timing import WRITTEN, Told, tell

T = TypeVar("T")

WINDOW = 4096
"""The number of jobs that may be done ahead of a slow one. Their results wait in memory."""

QUICK = 0.05
"""Seconds: a worker that needs less time for a job is sent the next job before it asks."""

AHEAD_BYTES = 1 << 14
"""The largest job that is sent ahead. A pipe holds some more.

While a worker sends a large result, it reads nothing. To send it more than the pipe holds would take for
ever.
"""

PATIENCE = 10.0
"""The seconds that a worker has for tidying up after it was told to stop."""

GRACE = 3.0
"""The seconds that a worker has to stop if its file took too long. C loops do not notice the signal."""

LONGEST_WAIT = 3600.0
"""The seconds of one wait for messages. The system's call takes no more than some weeks."""

ATTEMPTS = 2
"""The number of times that a job is tried if its worker dies, and that the start of a worker is tried."""

PAUSE = 0.1
"""The seconds before the start of a worker is tried again. The system has removed a dead server by then."""


logger = logging.getLogger(__name__)


@dataclass(eq=False, slots=True)
class _Worker:
    """A process, this end of its pipe, and the jobs that it was sent. The job in work is the first.

    begun is the time when that job began. late is the time when the worker was told to stop because that job
    takes too long. has_written tells that the output of that job is in place.
    """

    process: BaseProcess
    connection: Connection
    sent: deque[int] = field(default_factory=deque)
    is_quick: bool = False
    has_written: bool = False
    is_warm: bool = False
    begun: float = 0.0
    late: float | None = None


def done_in_time(call: Callable[[], T], file: str, seconds: float, max_memory: int | None, threads: int) -> T:
    """Return the result of a call, which a process of its own makes; it and its result can be pickled.

    ``file`` is the file that it works on, for messages. Raises SkinbakeError, also if it takes too long.
    """
    work: Work[None, T | SkinbakeError] = _OneCall(call, file, max_memory, threads)
    ((_, found),) = Processes(1, limits=Limits(seconds)).run(work, [None])
    if isinstance(found, SkinbakeError):
        raise found
    return found


@dataclass(frozen=True, slots=True)
class _OneCall(Generic[T]):
    """The work of ``done_in_time``."""

    call: Callable[[], T]
    file: str
    max_memory: int | None
    threads: int

    def __call__(self, job: None) -> T | SkinbakeError:
        with memory_limited(self.max_memory), threads_limited(self.threads):
            call: Callable[[], T | SkinbakeError] = self.call
            return survived(call, lambda error: error, self.file)

    def failed(self, job: None, error: SkinbakeError) -> T | SkinbakeError:
        return error

    def lost(self, job: None, reason: str, *, is_written: bool = False) -> T | SkinbakeError:
        return InputError(f"not done: {reason}", Place(self.file))


@dataclass(frozen=True, slots=True)
class Processes:
    """A runner with ``workers`` processes of its own.

    If workers are forks of one server process, the server imports ``modules`` once, before it forks them. If
    a worker dies, the work of the others is not lost. Its job is tried again while no other job runs, because
    the jobs together may have used up the memory. A job that takes longer than ``limits`` allow is lost.
    The jobs whose numbers ``early`` returns begin before the others.
    """

    workers: int
    modules: Sequence[str] = ()
    limits: Limits = field(default_factory=Limits)
    early: Callable[[Sequence[Any]], Sequence[int]] | None = None

    def run(
        self, work: Work[JobT, ReturnT], jobs: Sequence[JobT]
    ) -> Generator[tuple[int, ReturnT], None, None]:
        """Yield (number, ``work(job)``) as jobs are done. Raises SkinbakeError if no worker starts.

        Closing the generator, or an interrupt, ends the workers at once. The jobs in work are undone.
        """
        pool = _Pool(self, work, jobs)
        try:
            yield from pool.results()
        finally:
            pool.stop()


class _Pool(Generic[JobT, ReturnT]):
    """The workers of one run, and the jobs that each worker has."""

    def __init__(self, runner: Processes, work: Work[JobT, ReturnT], jobs: Sequence[JobT]) -> None:
        self._work, self._jobs, self._limits = work, jobs, runner.limits
        self._retired: list[BaseProcess] = []
        self._size = min(runner.workers, len(jobs))
        self._context = context_for(runner.modules)
        self._workers: list[_Worker] = []
        self._back = deque[int](runner.early(jobs) if runner.early else ())
        self._waiting: deque[int] = deque(sorted({*range(len(jobs))} - {*self._back}))
        self._suspects: deque[int] = deque()
        self._deaths: dict[int, int] = {}
        self._unfinished = len(jobs)
        self._done_ahead: set[int] = set()
        self._oldest = 0
        self._stillborn = 0

    def results(self) -> Iterator[tuple[int, ReturnT]]:
        while self._unfinished:
            self._hand_out()
            until_late = None  # the seconds until the next worker must be told to stop, or must be killed
            if (seconds := self._limits.seconds) is not None:
                ends = [
                    worker.begun + seconds if worker.late is None else worker.late + GRACE
                    for worker in self._workers
                    if worker.sent and worker.is_warm
                ]
                until_late = min(LONGEST_WAIT, max(0.0, min(ends) - time.monotonic())) if ends else None
            ready = wait([worker.connection for worker in self._workers], until_late)
            self._stop_late()
            for connection in ready:
                worker = next(w for w in self._workers if w.connection is connection)
                try:
                    message: tuple[int, ReturnT, float] | Told | None = worker.connection.recv()
                except (EOFError, OSError):
                    yield from self._bury(worker)
                    continue
                if isinstance(message, Told):
                    worker.has_written |= message.stage == WRITTEN
                    tell(message)
                    continue
                if not worker.is_warm:
                    worker.begun = time.monotonic()
                worker.is_warm, self._stillborn = True, 0
                if message is not None:
                    finished = self._finished(worker, *message)
                    self._hand_out()  # the workers go on while the caller uses the result
                    yield finished

    def _stop_late(self) -> None:
        """Tell a worker to stop if its job takes too long, and kill it if it does not stop.

        This process may have been away for longer than that, for example while nobody read its output. A
        worker whose message waits in the pipe is heard first.
        """
        seconds, now = self._limits.seconds, time.monotonic()
        if seconds is None:
            return
        for worker in self._workers:
            if not worker.sent or not worker.is_warm:
                continue
            if worker.late is not None:
                if now >= worker.late + GRACE:
                    worker.process.kill()
            elif now >= worker.begun + seconds and not wait([worker.connection], 0):
                worker.late = now
                worker.process.terminate()

    def stop(self) -> None:
        """End all workers. Idle workers see their pipe close, and busy workers get a signal."""
        with no_interrupts():
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
        """Start the missing workers, and send jobs to workers that have too few."""
        self._start_workers()
        if self._suspects:  # tried again alone
            if not any(worker.sent for worker in self._workers):
                suspect = self._suspects.popleft()
                self._send(self._workers[0], suspect, self._packed(suspect))
            return
        if any(self._deaths.get(number) for worker in self._workers for number in worker.sent):
            return
        for depth in (1,) if self._is_isolated else (1, 2):
            for worker in self._workers:
                if len(worker.sent) < depth and (depth == 1 or worker.is_quick):
                    number = self._next_number()
                    if number is None:
                        return
                    job = self._packed(number)
                    if worker.sent and len(job) > AHEAD_BYTES:
                        self._back.appendleft(number)
                        return
                    self._send(worker, number, job)

    def _start_workers(self) -> None:
        """Start the missing workers. If the system allows no more processes or files, go on with fewer.

        A start is tried again, because the server that forks workers may just have been killed.
        """
        failures = 0
        while len(self._workers) < min(self._size, self._unfinished):
            try:
                if self._workers:
                    check_descriptors()
                worker = _Worker(*started(self._context, self._work, self._limits))
            except (OSError, EOFError) as error:  # EOFError: the server has died
                failures += 1
                if failures < ATTEMPTS:
                    time.sleep(PAUSE)
                    continue
                reason = (
                    getattr(error, "strerror", None) or str(error) or "the system allows no more processes"
                )
                if not self._workers:
                    raise SkinbakeError(_not_started(reason, self._limits)) from error
                self._size = len(self._workers)
                logger.info("no more than %d workers: %s", self._size, reason)
            else:
                self._workers.append(worker)
                failures = 0

    def _next_number(self) -> int | None:
        if self._back:
            return self._back.popleft()
        if not self._waiting or self._waiting[0] >= self._oldest + WINDOW:
            return None
        return self._waiting.popleft()

    def _packed(self, number: int) -> bytes:
        """Return a job as it goes to a worker."""
        return bytes(ForkingPickler.dumps((number, self._jobs[number])))

    def _send(self, worker: _Worker, number: int, job: bytes) -> None:
        if not worker.sent:
            worker.begun = time.monotonic()
        worker.sent.append(number)
        with suppress(OSError):  # the worker has died: its pipe reports that next
            worker.connection.send_bytes(job)

    def _finished(self, worker: _Worker, number: int, result: ReturnT, seconds: float) -> tuple[int, ReturnT]:
        worker.sent.remove(number)
        worker.is_quick, worker.has_written = seconds < QUICK, False
        worker.begun = time.monotonic()
        if self._is_isolated or worker.late is not None:  # it was told to stop just before it was done
            # Release the worker. It sees its pipe close. Jobs sent ahead go back.
            self._workers.remove(worker)
            self._back.extendleft(reversed(worker.sent))
            worker.connection.close()
            self._retired = [process for process in self._retired if process.is_alive()]
            self._retired.append(worker.process)
        self._close_file(number)
        return number, result

    @property
    def _is_isolated(self) -> bool:
        """Tell whether each job has its own process, so that no job finds memory that another job left."""
        return self._limits.memory is not None

    def _close_file(self, number: int) -> None:
        self._unfinished -= 1
        self._done_ahead.add(number)
        while self._oldest in self._done_ahead:
            self._done_ahead.remove(self._oldest)
            self._oldest += 1

    def _bury(self, worker: _Worker) -> Iterator[tuple[int, ReturnT]]:
        """Remove a dead worker. Its first job is tried again alone, or yielded as lost. Others go back."""
        self._workers.remove(worker)
        worker.connection.close()
        worker.process.join(PATIENCE)
        # The cause of its death, as its exit code tells it.
        code = worker.process.exitcode
        how = f"exit code {code}"
        if code is not None and code < 0:
            how = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
            how += "; is there too little memory?" if how == "SIGKILL" else ""
        if not worker.is_warm:
            self._stillborn += 1
            if self._stillborn >= ATTEMPTS * self._size:
                raise SkinbakeError(_not_started(how, self._limits))
            self._back.extendleft(reversed(worker.sent))
            return
        if not worker.sent:
            return
        number, *rest = worker.sent
        self._back.extendleft(reversed(rest))
        if worker.late is not None:
            self._close_file(number)
            reason = f"it took longer than {self._limits.seconds:g} s (--timeout)"
            yield number, self._work.lost(self._jobs[number], reason, is_written=worker.has_written)
            return
        deaths = self._deaths[number] = self._deaths.get(number, 0) + 1
        if deaths < ATTEMPTS:
            self._suspects.append(number)
            return
        self._close_file(number)
        reason = f"the process that worked on it died, and so did a second one by itself ({how})"
        yield number, self._work.lost(self._jobs[number], reason, is_written=worker.has_written)


def _not_started(why: str, limits: Limits) -> str:
    without = "" if limits == Limits() else " without --timeout and --isolate"
    return f"worker processes cannot be started ({why}): try --jobs 1{without}"
