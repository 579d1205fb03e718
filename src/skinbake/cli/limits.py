"""The options that limit the resources of a file: memory, time, and a process of its own."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from skinbake.choices import Range
from skinbake.cli.console import Command, in_range
from skinbake.cli.names import STDIO

if TYPE_CHECKING:
    from skinbake.cli.given import Given
    from skinbake.jobs.worker import Limits

SIZE = re.compile(r"(\d+(?:\.\d+)?) ?([KMGT]?)(?:i?B)?", re.IGNORECASE)


def _size(ctx: click.Context, param: click.Parameter, value: str | None) -> int | None:
    if value is None:
        return None
    found = SIZE.fullmatch(value.strip())
    size = float(found[1]) * 1024 ** " KMGT".index(found[2].upper() or " ") if found else 0.0
    if not 1 <= size < math.inf:
        raise click.BadParameter("must be a size in bytes, or like 512M or 2G")
    return int(size)


def memory_option(command: Command) -> Command:
    """Add the option that limits the memory that a file may make the program allocate."""
    return click.option(
        "--max-memory",
        metavar="SIZE",
        callback=_size,
        help="Memory that a file may use, like 512M or 2G; by default a quarter of the machine's memory.",
    )(command)


def limit_options(command: Command) -> Command:
    """Add all options that limit the resources of a file."""
    for option in (
        click.option(
            "--isolate",
            is_flag=True,
            help="Work on each file in its own process, limited to --max-memory, so that a crash is exit 3.",
        ),
        click.option(
            "--timeout",
            type=in_range(Range(0, is_open=True)),
            metavar="SECONDS",
            help="Give up a file that takes longer.",
        ),
        memory_option,
    ):
        command = option(command)
    return command


def worker_limits(given: Given, sources: Sequence[str]) -> Limits | None:
    """Return the limits that workers keep, or None if files need no limits of their own.

    Raises click.UsageError if another process cannot do the work.
    """
    named = [
        f"--{name}" for name, value in (("timeout", given["timeout"]), ("isolate", given["isolate"])) if value
    ]
    if not named:
        return None
    if given["dask"]:
        raise click.UsageError(
            f"{named[0]} controls processes of this machine, --dask uses a cluster: give only one"
        )
    if STDIO in {*sources, given.get("output")}:
        raise click.UsageError(f"{named[0]} needs files, not - for stdin or stdout")
    from skinbake.jobs.worker import Limits

    return Limits(given["timeout"], memory_of_each(given, sources) if given["isolate"] else None)


def memory_of_each(given: Given, sources: Sequence[str]) -> int | None:
    """Return the memory that each source may take, or None for the default of one file at a time."""
    if given["max_memory"] or given["dask"] or (given["jobs"] == 1 and not given["isolate"]):
        return given["max_memory"]
    from skinbake.gltf.budget import default_limit
    from skinbake.threads import usable_cores

    return default_limit(min(given["jobs"] or usable_cores(), len(sources)))
