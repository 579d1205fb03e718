"""The one door to ``jobs.remote``: URLs and clusters, which a build without them does not need.

Only what is reached by a URL or by ``--dask`` goes through here, and nothing else imports that package.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

from skinbake.errors import InputError, OutputError, Place
from skinbake.urls import is_url

if TYPE_CHECKING:
    from skinbake.gltf.output import Writing
    from skinbake.jobs.remote.dask_runner import DaskRunner
    from skinbake.jobs.work import Elsewhere, Job

T = TypeVar("T")

INSTALL = "which is not installed: pip install 'skinbake[dask]'"


def elsewhere_of(job: Job) -> Elsewhere | None:
    """Return who fetches and stores a job's files, None where all of them are on this machine's disk.

    Raises InputError or OutputError for a URL where that part of skinbake is left out.
    """
    if job.elsewhere is not None:
        return job.elsewhere
    if is_url(job.source):
        return _imported(
            _staging, InputError("URLs need skinbake.jobs.remote, " + INSTALL, Place(job.source))
        )
    if job.target is not None and is_url(job.target):
        return _imported(
            _staging, OutputError("URLs need skinbake.jobs.remote, " + INSTALL, Place(job.target))
        )
    return None


def files_behind(url: str) -> list[tuple[str, str]]:
    """Return (URL, relative path) of the files that a URL stands for; raises InputError."""
    expand_url = _imported(_expand_url, InputError("URLs need skinbake.jobs.remote, " + INSTALL, Place(url)))
    return expand_url(url)


def dask_runner(address: str, writing: Writing) -> DaskRunner:
    """Return the runner for a scheduler's address; raises InputError."""
    runner = _imported(
        _dask_runner, InputError("--dask needs skinbake.jobs.remote, " + INSTALL, Place(address))
    )
    return runner(address, writing)


def _imported(load: Callable[[], T], error: InputError | OutputError) -> T:
    """Return what ``load`` imports; raises the error where there is no such part."""
    try:
        return load()
    except ImportError as missing:
        raise error from missing


def _staging() -> Elsewhere:
    from skinbake.jobs.remote.staging import Staging

    return Staging()


def _expand_url() -> Callable[[str], list[tuple[str, str]]]:
    from skinbake.jobs.remote.storages import expand_url

    return expand_url


def _dask_runner() -> type[DaskRunner]:
    from skinbake.jobs.remote.dask_runner import DaskRunner

    return DaskRunner
