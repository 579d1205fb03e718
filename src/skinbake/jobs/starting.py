"""The start of worker processes: how they begin, in which environment, and without signals in between."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import TYPE_CHECKING

from skinbake.jobs.work import JobT, ReturnT, Work
from skinbake.jobs.worker import Limits, serve
from skinbake.signals import ENDING
from skinbake.timing import is_heard

if TYPE_CHECKING:
    from multiprocessing.context import ForkServerContext, SpawnContext

LONGEST_FOLDER = 107 - len("/pymp-12345678/listener-12345678")
"""The longest path, in bytes, of a folder of temporary files that can hold the socket of the server.

Linux takes 107 bytes for the path of a socket.
"""

SPARE_DESCRIPTORS = 32
"""The number of files that this process can still open when it starts a further worker."""

ENVIRONMENT = {
    **dict.fromkeys(
        ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
    ),
    "PYTHONSAFEPATH": "1",
    "MALLOC_MMAP_THRESHOLD_": str(16 << 20),
    "MALLOC_TRIM_THRESHOLD_": str(64 << 20),
}
"""The environment of a worker, for each variable that the user has not set.

Linear algebra uses one thread, because the processes are the parallelism. A worker begins with ``python -c``,
which would search the current folder for the modules that it imports. glibc keeps memory from one file to
the next: fresh pages for the arrays of each file take a quarter of the work on small files.
"""


def context_for(modules: Sequence[str]) -> SpawnContext | ForkServerContext:
    """Return how processes start: as forks of a server that has done the imports, or from scratch.

    They are never forks of this process, because this process may have threads by then. From scratch takes
    longer, and needs no socket.
    """
    import tempfile

    has_place = False  # for a socket: TMPDIR may be long, or no folder
    with suppress(OSError):
        has_place = len(os.fsencode(tempfile.gettempdir())) <= LONGEST_FOLDER
    if sys.platform != "linux" or not has_place:
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(modules))
    return context


def check_descriptors() -> None:
    """Raise OSError if this process can open few more files: the pipes of a worker, reports, outputs.

    A start that fails midway would also end the server that forks workers.
    """
    with ExitStack() as held:
        for _ in range(SPARE_DESCRIPTORS):
            held.enter_context(Path(os.devnull).open("rb"))


def started(
    context: SpawnContext | ForkServerContext, work: Work[JobT, ReturnT], limits: Limits
) -> tuple[BaseProcess, Connection]:
    """Start a worker, and return its process and this end of its pipe. Raises OSError or EOFError."""
    here, there = context.Pipe()
    # The processes that start here have their environment, and no Ctrl-C until they are ready.
    missing = {name: value for name, value in ENVIRONMENT.items() if name not in os.environ}
    os.environ.update(missing)
    try:
        if sys.platform != "win32":
            resource_tracker.ensure_running()  # the tracker lifts the block when it starts
        logs = logging.getLogger()
        arguments = there, work, limits, logs.level, bool(logs.handlers), is_heard()
        with no_interrupts():
            process = context.Process(target=serve, args=arguments, daemon=True)
            process.start()
    finally:
        for name in missing:
            os.environ.pop(name, None)
    there.close()
    return process, here


@contextmanager
def no_interrupts() -> Iterator[None]:
    """Delay the signals that end the work until the block is done."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
