"""Who does the work that a command line asks for: this process, others of this machine, or a cluster."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from skinbake.cli.console import Console
from skinbake.cli.limits import worker_limits
from skinbake.cli.many import chosen_runner
from skinbake.cli.remote import cluster_runner

if TYPE_CHECKING:
    from skinbake.jobs.runners import Runner


def runner_of(
    given: Mapping[str, Any],
    sources: Sequence[str],
    turns: Sequence[int],
    modules: Sequence[str],
    guess: tuple[float, float],
    say: Console,
) -> Runner:
    """Return the runner for some sources; parameters as for ``chosen_runner`` and ``cluster_runner``.

    Raises click.UsageError for options that do not go together, InputError where a cluster cannot be used.
    """
    limits = worker_limits(given, sources)
    cluster = cluster_runner(given, sources, turns, say)
    return cluster or chosen_runner(given, sources, turns, modules, guess, limits)


def is_elsewhere(given: Mapping[str, Any]) -> bool:
    """Tell whether even a single file is worked on in another process."""
    return bool(given["dask"] or given["timeout"] or given["isolate"])
