"""The only entrance to ``jobs.remote``: URLs and clusters. A build can leave that package out.

Only URLs and ``--dask`` use this module. No other module imports that package.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from skinbake.errors import InputError, OutputError, Place
from skinbake.files.urls import is_url

if TYPE_CHECKING:
    from skinbake.gltf.output import Writing
    from skinbake.jobs.remote.dask_runner import DaskRunner
    from skinbake.jobs.work import Elsewhere, Job


def elsewhere_of(job: Job) -> Elsewhere | None:
    """Return the object that fetches and stores a job's files, or None if all files are on the local disk.

    Raises InputError or OutputError for a URL if ``jobs.remote`` is not installed.
    """
    if job.elsewhere is not None:
        return job.elsewhere
    error: type[InputError | OutputError]
    if is_url(job.source):
        url, error = job.source, InputError
    elif job.target is not None and is_url(job.target):
        url, error = job.target, OutputError
    else:
        return None
    with _installed("URLs need", url, error):
        from skinbake.jobs.remote.staging import Staging
    return Staging()


def files_behind(url: str) -> list[tuple[str, str]]:
    """Return (URL, relative path) of each file that a URL stands for. Raises InputError."""
    with _installed("URLs need", url):
        from skinbake.jobs.remote.storages import expand_url
    return expand_url(url)


def dask_runner(address: str, writing: Writing) -> DaskRunner:
    """Return the runner for a scheduler's address. Raises InputError."""
    with _installed("--dask needs", address):
        from skinbake.jobs.remote.dask_runner import DaskRunner
    return DaskRunner(address, writing)


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
