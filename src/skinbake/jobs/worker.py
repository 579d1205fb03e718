"""What runs in a worker process: it does jobs as they arrive through a pipe, and sends their results back."""

from __future__ import annotations

import signal
import threading
import time
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from pathlib import Path

from skinbake.jobs.work import JobT, ReturnT, Work, log_to_stderr, survived
from skinbake.signals import ENDING
from skinbake.timing import WRITTEN, Listener, Told, heard

TOLD_AFTER, TOLD_EVERY = 0.5, 0.25
"""The seconds after which a worker first tells of a file, and between two words of it."""

BASE = 1 << 30
"""Bytes of addresses that a worker has besides its limit: for code, stacks and mapped files."""


@dataclass(frozen=True, slots=True)
class Limits:
    """The limits of a job: seconds, and bytes of memory in a process that does nothing else (None: any)."""

    seconds: float | None = None
    memory: int | None = None


def _relay(connection: Connection) -> Listener:
    """Return what sends word of written outputs, and a few times a second of files that take long."""
    of, due = "", 0.0

    def relayed(told: Told) -> None:
        nonlocal of, due
        now = time.monotonic()
        if told.source != of:
            of, due = told.source, now + TOLD_AFTER
        elif now >= due or told.stage == WRITTEN:
            due = now + TOLD_EVERY
            with suppress(OSError):  # the other end has closed: the worker sees that next
                connection.send(told)

    return relayed


def serve(
    connection: Connection,
    work: Work[JobT, ReturnT],
    limits: Limits,
    level: int,
    logs: bool,
    listens: bool,
) -> None:
    """Do jobs as they arrive, until the pipe closes or a signal says stop. It is the main of a worker."""
    stopped = threading.Event()
    try:
        _hear_signals(stopped)
        if logs:
            log_to_stderr(level)
        if limits.memory is not None:
            _limit_memory(limits.memory)
        connection.send(None)
        with heard(_relay(connection)) if listens else nullcontext():
            while not stopped.is_set():
                number, job = connection.recv()
                message = _message(work, number, job)
                if not stopped.is_set():  # an interrupt may have become another exception
                    connection.send_bytes(message)
    except (EOFError, OSError, KeyboardInterrupt):
        pass  # the other end has closed, or this worker must stop


def _limit_memory(size: int) -> None:
    """Limit this process to ``size`` more bytes and forbid core dumps, if the system can do that."""
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        used = pages * resource.getpagesize()
    except ImportError:
        return
    except (OSError, ValueError):
        used = 0  # not Linux: BASE includes the memory in use
    wanted = {resource.RLIMIT_AS: used + size + BASE, resource.RLIMIT_CORE: 0}
    for kind, limit in wanted.items():
        _, hard = resource.getrlimit(kind)
        with suppress(OSError, ValueError, OverflowError):  # a system that has no such limit
            resource.setrlimit(kind, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))


def _message(work: Work[JobT, ReturnT], number: int, job: JobT) -> bytes:
    """Do a job, and return its message: the number, the result and the seconds that it took.

    A work that raises, or a result that cannot be pickled, is a defect of skinbake. Only that job is lost.
    """
    start = time.perf_counter()

    def pickled(result: ReturnT) -> bytes:
        return bytes(ForkingPickler.dumps((number, result, time.perf_counter() - start)))

    return survived(
        lambda: pickled(work(job)), lambda error: pickled(work.lost(job, error.message)), f"job {number}"
    )


def _hear_signals(stopped: threading.Event) -> None:
    """Let the signals that end the work raise an exception. The job in work is undone on the way out.

    A SIGHUP that is to be ignored, as after ``nohup``, stays ignored.
    """

    def stop(signum: int, frame: object) -> None:
        if not stopped.is_set():  # a second signal must not disturb the tidying up
            stopped.set()
            raise KeyboardInterrupt

    for number in ENDING:
        if number in {signal.SIGINT, signal.SIGTERM} or signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, stop)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
