"""The work of a Dask worker for skinbake. The worker imports it, and the client for its types."""

from __future__ import annotations

import pickle
import platform
import time
from collections.abc import Callable
from contextlib import nullcontext
from typing import TYPE_CHECKING

from skinbake.timing import Told, heard
from skinbake.version import __version__

if TYPE_CHECKING:
    from skinbake.jobs.remote.sent_files import JobWithFiles, ResultWithFiles, WorkWithFiles
    from skinbake.jobs.work import ResultT

TOLD_EVERY = 0.5
"""Seconds between two events of the same stage."""

Versions = tuple[str, str, str]
"""The versions of skinbake, Python and NumPy."""


class _Call:
    """Unpickling it calls the function with the arguments, and returns the result."""

    def __init__(self, function: Callable[..., object], *arguments: object) -> None:
        self._call = function, arguments

    def __reduce__(self) -> tuple[Callable[..., object], tuple[object, ...]]:
        return self._call


def call(function: Callable[..., object], *arguments: object) -> bytes:
    """Return a call as bytes. ``pickle.loads`` of them makes the call.

    Dask's schedulers unpickle the tasks that they pass on. A task made of ``pickle.loads`` and some bytes
    needs nothing there, so only workers need skinbake.
    """
    return pickle.dumps(_Call(function, *arguments))


def build() -> str:
    """Return skinbake's version, and whether it lacks its compiled loops: the last bits depend on both."""
    from skinbake.gradients import kernel

    return __version__ if kernel.IS_COMPILED else f"{__version__} without compiled loops"


def versions() -> Versions:
    """Return the versions that the bytes of an output depend on."""
    import numpy as np

    return build(), platform.python_version(), np.__version__


def perform(
    version: str, pickled: bytes, topic: str | None = None
) -> str | tuple[list[ResultWithFiles[ResultT]], float]:
    """Do a pickled (work, jobs). Return the results and the seconds that they took.

    With a topic, stages and steps are told to the cluster under it. If the client has another version, return
    a text that names the version here. Then nothing is unpickled, because the client's classes may have other
    members.
    """
    if version != build():
        from distributed import get_worker

        return f"{get_worker().address!s} has skinbake {build()}"
    work: WorkWithFiles[ResultT]
    jobs: list[JobWithFiles]
    work, jobs = pickle.loads(pickled)
    start = time.perf_counter()
    from distributed import get_worker

    workspace = str(get_worker().local_directory)  # Dask removes it, even if the worker was killed
    with heard(_teller(topic)) if topic else nullcontext():
        results = [work.result_there(job, workspace) for job in jobs]
    return results, time.perf_counter() - start


def _teller(topic: str) -> Callable[[Told], None]:
    """Return a listener that logs the progress of a job as events of the cluster, a few in a second."""
    from distributed import get_worker

    worker, last, due = get_worker(), Told(""), 0.0

    def tell(told: Told) -> None:
        nonlocal due, last
        now = time.monotonic()
        if told.stage != last.stage or now >= due:
            due, last = now + TOLD_EVERY, told
            worker.log_event(topic, [told.stage, told.done, told.total])

    return tell
