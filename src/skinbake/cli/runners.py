"""The runner of a command line's work: this process, other processes of this machine, or a cluster."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from skinbake.cli.console import Console
from skinbake.cli.limits import worker_limits
from skinbake.cli.remote import cluster_runner
from skinbake.files.urls import STDIO, is_url

if TYPE_CHECKING:
    from skinbake.cli.given import Given
    from skinbake.jobs.work import Job, Result, Runner
    from skinbake.jobs.worker import Limits

ResultT = TypeVar("ResultT", bound="Result")

SECONDS_A_URL = 0.1
"""The approximate time to fetch and store a file."""

WORTHWHILE = 0.5
"""The seconds of work from which other processes are started."""

SHARE = 0.05
"""The part of a process's time from which a file begins before others."""

LONG = 1.0
"""The seconds of work from which its progress is shown at once."""


def runner_of(
    given: Given,
    sources: Sequence[str],
    turns: Sequence[int],
    modules: Sequence[str],
    guess: tuple[float, float],
    say: Console,
) -> Runner[Job, ResultT]:
    """Return the runner for some sources. Parameters are as for ``chosen_runner`` and ``cluster_runner``.

    Raises ChoiceError for options that do not go together, and InputError if a cluster cannot be used.
    """
    limits = worker_limits(given, sources)
    cluster: Runner[Job, ResultT] | None = cluster_runner(given, sources, turns, say)
    return cluster or chosen_runner(given, sources, turns, modules, guess, limits)


def chosen_runner(
    given: Given,
    sources: Sequence[str],
    turns: Sequence[int],
    modules: Sequence[str],
    guess: tuple[float, float],
    limits: Limits | None = None,
) -> Runner[Job, ResultT]:
    """Return the runner for the sources.

    ``turns`` are the numbers of the sources that must be done in order. ``modules`` are the modules that
    workers need. ``guess`` is the time that a file takes, and each byte of it. With ``limits``, even a single
    file gets a process that keeps them.
    """
    from skinbake.jobs.runners import FirstThese, InThisProcess

    count = given["jobs"]
    alone = count == 1 or len(sources) == 1 or STDIO in sources
    if limits is None and (alone or seconds_of(sources, guess) <= WORTHWHILE):
        return InThisProcess()
    from skinbake.jobs.processes import Processes
    from skinbake.jobs.worker import Limits
    from skinbake.threads import usable_cores

    limits = limits or Limits()
    workers = count or usable_cores()
    whole = Processes(workers, modules, limits, partial(_large_ones, workers, guess))
    return FirstThese(turns, Processes(1, modules, limits), whole) if turns else whole


def threads_of_each(given: Given, sources: Sequence[str]) -> int | None:
    """Return the threads for the work on a file, or None: the process that does it looks for itself."""
    if given["threads"] is not None or given["dask"]:
        return given["threads"]
    if given["isolate"]:
        return 1  # threads reserve addresses, which count for the process's limit
    if given["jobs"] == 1 and not given["timeout"]:
        return None
    from skinbake.threads import thread_count, usable_cores

    return thread_count(min(given["jobs"] or usable_cores(), len(sources)))


def _large_ones(workers: int, guess: tuple[float, float], jobs: Sequence[Job]) -> list[int]:
    """Return the numbers of the jobs to begin with, the largest first, so that none is left for the end.

    They are the files that take more than SHARE of a process's time. So they are few, and the results of the
    others still come in time, because these are done in order.
    """
    seconds = [_seconds(job.source, guess) for job in jobs]
    least = SHARE * sum(seconds) / workers
    large = [number for number, one in enumerate(seconds) if one > least]
    return sorted(large, key=lambda number: -seconds[number])


def seconds_of(sources: Sequence[str], guess: tuple[float, float]) -> float:
    """Return the approximate time that the work takes, or, if it is longer, LONG or more."""
    seconds = 0.0
    for source in sources:
        seconds += _seconds(source, guess)
        if seconds > LONG:
            break
    return seconds


def _seconds(source: str, guess: tuple[float, float]) -> float:
    """Return the approximate time that a file takes."""
    try:
        return guess[0] + guess[1] * Path(source).stat().st_size
    except (OSError, ValueError):
        return SECONDS_A_URL if is_url(source) else 0.0
