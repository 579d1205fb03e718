"""What a Dask worker does for skinbake; imported there, and by the client for its types."""

from __future__ import annotations

import pickle
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from skinbake import __version__

DONE, REFUSED = "done", "refused"

Versions = tuple[str, str, str]
"""Of skinbake, Python and NumPy."""


@dataclass(frozen=True, slots=True)
class Ready:
    """What stands for a job that need not be sent: its result."""

    result: Any
    size: int = 0


class _Call:
    """Unpickling it calls the function with the arguments, and returns what that returns."""

    def __init__(self, function: Callable[..., Any], *arguments: Any) -> None:
        self._call = function, arguments

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return self._call


def call(function: Callable[..., Any], *arguments: Any) -> bytes:
    """Return a call in such a form that ``pickle.loads`` makes it.

    Schedulers of Dask unpickle the tasks that they pass on. A task that is ``pickle.loads`` and some bytes
    asks nothing of them: only workers need skinbake.
    """
    return pickle.dumps(_Call(function, *arguments))


def build() -> str:
    """Return skinbake's version, and whether it lacks its compiled loops: the last bits depend on both."""
    from skinbake.gradients import kernel

    return __version__ if kernel.compiled is not None else f"{__version__} without compiled loops"


def versions() -> Versions:
    """Return the versions that the bytes of an output depend on."""
    import numpy as np

    return build(), platform.python_version(), np.__version__


def perform(version: str, pickled: bytes) -> tuple[str, Any]:
    """Do a pickled (work, jobs): return ``done`` with the results and the seconds that they took.

    Or ``refused``, and what is here instead: nothing but the version is read of a client with another one,
    since its classes may have other members.
    """
    if version != build():
        return REFUSED, f"{_address()} has skinbake {build()}"
    from skinbake.jobs.remote.staging import staged_in

    work, jobs = pickle.loads(pickled)
    start = time.perf_counter()
    with staged_in(_local_folder()):
        results = [work(job) for job in jobs]
    return DONE, (results, time.perf_counter() - start)


def _address() -> str:
    from distributed import get_worker

    return str(get_worker().address)


def _local_folder() -> str | None:
    """Return the worker's own folder, which Dask removes, also after a worker that was killed."""
    from distributed import get_worker

    return str(get_worker().local_directory)
