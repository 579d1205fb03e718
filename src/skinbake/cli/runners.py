"""Who does the work of a plan, and within which limits: this process, other processes, or a cluster."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from skinbake.cli.plan import Plan
from skinbake.cli.targets import in_turns
from skinbake.errors import ChoiceError, Chosen, InputError, Place
from skinbake.files.urls import STDIO, is_url

if TYPE_CHECKING:
    from skinbake.jobs.work import Job, Result, Runner

T = TypeVar("T")
ResultT = TypeVar("ResultT", bound="Result")

SECONDS_A_URL = 0.1
"""The approximate time to fetch and store a file."""

WORTHWHILE = 0.5
"""The seconds of work from which other processes are started."""

SHARE = 0.05
"""The part of a process's time from which a file begins before others."""

LONG = 1.0
"""The seconds of work from which its progress is shown at once."""

ADDRESS = re.compile(r"((tcp|tls|ucx|wss?)://)?[^/\s]+:\d+/?|inproc://.+")

IN_BROWSERS = " is not available in a browser: it needs another process"

OR_CLUSTER = (
    " controls processes of this machine, ",
    Chosen("dask"),
    " uses a cluster: give only one",
)


def runner_of(plan: Plan[Any], module: str, guess: tuple[float, float]) -> Runner[Job, ResultT]:
    """Return the runner for the files of a plan.

    ``module`` is that of the command, which workers need. ``guess`` is the time that a file takes, and each
    byte of it. A file that has limits of its own gets a process that keeps them. Raises ChoiceError for
    options that do not go together, and InputError if a cluster cannot be used.
    """
    from skinbake.jobs.work import FirstThese, InThisProcess

    limited = next((name for name in ("timeout", "isolate") if getattr(plan, name)), None)
    if limited and sys.platform == "emscripten":
        raise ChoiceError(limited, reason=(IN_BROWSERS,))
    if limited and plan.dask:
        raise ChoiceError(limited, reason=OR_CLUSTER)
    if limited and STDIO in {*plan.names, plan.output}:
        raise ChoiceError(limited, reason=(" needs files, not - for stdin or stdout",))
    # What does not fit a cluster, or URLs.
    address = plan.dask
    if address is not None and not ADDRESS.fullmatch(address):
        raise ChoiceError(
            "dask", reason=(" needs the address that a scheduler prints, like tcp://host:8786",)
        )
    if address and plan.jobs != 1:
        raise ChoiceError("jobs", reason=OR_CLUSTER)
    if address and STDIO in {*plan.names, plan.output}:
        raise ChoiceError("dask", reason=(" needs files or URLs, not - for stdin or stdout",))
    named = [*plan.names, plan.out_dir or "", plan.output or ""]
    if plan.skip_unchanged and (address or any(map(is_url, named))):
        reason = " needs files on this disk, without ", Chosen("dask"), " and URLs"
        raise ChoiceError("skip_unchanged", reason=reason)
    turns = in_turns([entry for entry, _ in plan.targets]) if plan.out_dir else []
    if plan.dask:
        from skinbake.jobs.remote.dask_runner import DaskRunner

        cluster = DaskRunner(plan.dask)
        click.get_current_context().call_on_close(cluster.close)
        notices = cluster.connect()
        plan.say.notices(notices)
        if notices and plan.warnings_as_errors:
            raise InputError("nothing was sent: there are warnings (--warnings-as-errors)", Place(plan.dask))
        return FirstThese(turns, cluster.one_by_one(), cluster) if turns else cluster
    alone = plan.jobs == 1 or len(plan.targets) == 1 or STDIO in plan.names or sys.platform == "emscripten"
    if not limited and (alone or seconds_of(plan.names, guess) <= WORTHWHILE):
        return InThisProcess()
    from skinbake.jobs.processes import Processes
    from skinbake.jobs.worker import Limits
    from skinbake.threads import usable_cores

    limits = Limits(plan.timeout, memory_of_each(plan) if plan.isolate else None)
    workers, modules = plan.jobs or usable_cores(), ("skinbake.cli.main", module, "skinbake.jobs.file_work")
    whole = Processes(workers, modules, limits, partial(_large_ones, workers, guess))
    return FirstThese(turns, Processes(1, modules, limits), whole) if turns else whole


def within_limits(call: Callable[[], T], plan: Plan[Any], source: str) -> T:
    """Return the result of a call that works on one file, within --max-memory and --timeout.

    Under --timeout the call, which must be picklable, is made in another process. Raises SkinbakeError, and
    ChoiceError if another process cannot read the file.
    """
    if plan.timeout is None:
        from skinbake.gltf.budget import memory_limited

        with memory_limited(plan.max_memory):
            return call()
    if source == STDIO:
        raise ChoiceError("timeout", reason=(" needs a file, not - for stdin",))
    if sys.platform == "emscripten":
        raise ChoiceError("timeout", reason=(IN_BROWSERS,))
    from skinbake.jobs.processes import done_in_time
    from skinbake.threads import thread_count

    return done_in_time(call, source, plan.timeout, plan.max_memory, thread_count())


def memory_of_each(plan: Plan[Any]) -> int | None:
    """Return the memory that each file may take, or None for the default of one file at a time."""
    if plan.max_memory or plan.dask or (plan.jobs == 1 and not plan.isolate):
        return plan.max_memory
    from skinbake.gltf.budget import default_limit
    from skinbake.threads import usable_cores

    return default_limit(min(plan.jobs or usable_cores(), len(plan.targets)))


def threads_of_each(plan: Plan[Any]) -> int | None:
    """Return the threads for the work on a file, or None: the process that does it looks for itself."""
    if plan.threads is not None or plan.dask:
        return plan.threads
    if plan.isolate:
        return 1  # threads reserve addresses, which count for the process's limit
    if plan.jobs == 1 and not plan.timeout:
        return None
    from skinbake.threads import thread_count, usable_cores

    return thread_count(min(plan.jobs or usable_cores(), len(plan.targets)))


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
