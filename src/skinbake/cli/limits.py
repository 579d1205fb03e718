"""The options that limit the resources of a file: memory, time, and a process of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from skinbake.errors import ChoiceError, Chosen
from skinbake.files.urls import STDIO

if TYPE_CHECKING:
    from skinbake.cli.given import Given
    from skinbake.jobs.worker import Limits

T = TypeVar("T")

OR_CLUSTER = (
    " controls processes of this machine, ",
    Chosen("dask"),
    " uses a cluster: give only one",
)


def within_limits(call: Callable[[], T], given: Mapping[str, Any], source: str) -> T:
    """Return the result of a call that works on one file, within --max-memory and --timeout.

    Under --timeout the call, which must be picklable, is made in another process. Raises SkinbakeError, and
    ChoiceError if another process cannot read the file.
    """
    if given["timeout"] is None:
        from skinbake.gltf.budget import memory_limited

        with memory_limited(given["max_memory"]):
            return call()
    if source == STDIO:
        raise ChoiceError("timeout", reason=(" needs a file, not - for stdin",))
    from skinbake.jobs.processes import done_in_time
    from skinbake.threads import thread_count

    return done_in_time(call, source, given["timeout"], given["max_memory"], thread_count())


def worker_limits(given: Given, sources: Sequence[str]) -> Limits | None:
    """Return the limits that workers keep, or None if files need no limits of their own.

    Raises ChoiceError if another process cannot do the work.
    """
    if not (given["timeout"] or given["isolate"]):
        return None
    named = "timeout" if given["timeout"] else "isolate"
    if given["dask"]:
        raise ChoiceError(named, reason=OR_CLUSTER)
    if STDIO in {*sources, given.get("output")}:
        raise ChoiceError(named, reason=(" needs files, not - for stdin or stdout",))
    from skinbake.jobs.worker import Limits

    return Limits(given["timeout"], memory_of_each(given, sources) if given["isolate"] else None)


def memory_of_each(given: Given, sources: Sequence[str]) -> int | None:
    """Return the memory that each source may take, or None for the default of one file at a time."""
    if given["max_memory"] or given["dask"] or (given["jobs"] == 1 and not given["isolate"]):
        return given["max_memory"]
    from skinbake.gltf.budget import default_limit
    from skinbake.threads import usable_cores

    return default_limit(min(given["jobs"] or usable_cores(), len(sources)))
