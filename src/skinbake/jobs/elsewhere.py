"""The only entrance to ``jobs.remote``: URLs and clusters. A build can leave that package out.

Only URLs and ``--dask`` use this module. No other module imports that package.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from skinbake.errors import InputError, OutputError, Place
from skinbake.files.bounds import Bounds
from skinbake.files.urls import is_url

if TYPE_CHECKING:
    from skinbake.gltf.writing.output import Writing
    from skinbake.jobs.remote.dask_runner import DaskRunner
    from skinbake.jobs.work import Job, Makes, ResultT, T


def read(job: Job, reads: Callable[[str, Bounds], T]) -> T:
    """Return ``reads(path, bounds)`` for a job's source, fetched if it has a URL. Raises SkinbakeError."""
    if not is_url(job.source):
        return reads(job.source, job.within.bounds)
    with _installed("URLs need", job.source):
        from skinbake.jobs.remote import staging
    return staging.read(job.source, job.within.bounds, reads)


def write(job: Job, makes: Makes[ResultT], how: Writing) -> ResultT:
    """Return what ``makes`` returns for a job, whose files may have URLs. Raises SkinbakeError."""
    error: type[InputError | OutputError] = InputError
    if is_url(job.source):
        url = job.source
    elif job.target is not None and is_url(job.target):
        url, error = job.target, OutputError
    else:
        return makes(job.source, job.target, how, job.within)
    with _installed("URLs need", url, error):
        from skinbake.jobs.remote import staging
    return staging.write(job.source, job.target, makes, how, job.within)


def files_behind(url: str) -> list[tuple[str, str]]:
    """Return (URL, relative path) of each file that a URL stands for. Raises InputError."""
    with _installed("URLs need", url):
        from skinbake.jobs.remote.storages import expand_url
    return expand_url(url)


def dask_runner(address: str) -> DaskRunner:
    """Return the runner for a scheduler's address. Raises InputError."""
    with _installed("--dask needs", address):
        from skinbake.jobs.remote.dask_runner import DaskRunner
    return DaskRunner(address)


@contextmanager
def _installed(
    what_needs: str, file: str, error: type[InputError | OutputError] = InputError
) -> Iterator[None]:
    """Raise an error that says how to install the package if the block cannot import it."""
    try:
        yield
    except ImportError as missing:
        message = f"{what_needs} skinbake.jobs.remote, which is not installed: pip install 'skinbake[dask]'"
        raise error(message, Place(file)) from missing
