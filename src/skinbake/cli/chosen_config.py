"""The choice of a configuration file, and the sets of options that it gives to the inputs of a command.

Every command imports this module. The modules that read a file are imported if there is one.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.core import ParameterSource

from skinbake.cli.names import LARGEST_CONFIG, OWN_CONFIG, SHARED_CONFIG

if TYPE_CHECKING:
    from skinbake.cli.configured import Configured
    from skinbake.jobs.work import Job

REPOSITORY = ".git"
"""The name that the root of a repository has. No search goes beyond it."""

MENTION = re.compile(rb"""tool["']?\s*\.\s*["']?skinbake""")
"""The bytes without which pyproject.toml says nothing to skinbake. It is not parsed then."""

META = "skinbake.configured"

MadeT = TypeVar("MadeT")


@dataclass(frozen=True, slots=True)
class OptionSets:
    """The different sets of options that the inputs have. ``numbers`` has the number of each input's set.

    The first set is that without overrides. ``origins`` tells where the others come from.
    """

    given: Sequence[Mapping[str, Any]]
    origins: Sequence[str]
    numbers: Sequence[int]

    def each(self, make: Callable[[Mapping[str, Any]], MadeT]) -> list[MadeT]:
        """Return what is made from each set. An error about an override's set says which override it is.

        Raises click.UsageError, and ConfigurationError for an override.
        """
        made = []
        for given, origin in zip(self.given, self.origins, strict=True):
            try:
                made.append(make(given))
            except click.UsageError as error:
                if not origin:
                    raise
                from skinbake.cli.configuration import ConfigurationError

                raise ConfigurationError(f"{origin}: {error.message}") from error
        return made

    def numbered(self, jobs: Sequence[Job]) -> Sequence[Job]:
        """Return the jobs of the inputs with the numbers of their sets."""
        if len(self.given) == 1:
            return jobs
        return [replace(job, variant=number) for job, number in zip(jobs, self.numbers, strict=True)]


def option_sets(ctx: click.Context, given: Mapping[str, Any], sources: Sequence[str]) -> OptionSets:
    """Return the sets of options of the inputs. An option of the command line is the same for all."""
    configured = configured_in(ctx)
    if configured is None or not configured.overrides:
        return OptionSets([given], [""], [0] * len(sources))
    typed = {name for name in given if ctx.get_parameter_source(name) is ParameterSource.COMMANDLINE}
    known: dict[tuple[int, ...], int] = {(): 0}
    sets, origins, numbers = [given], [""], []
    for source in sources:
        chosen = configured.overrides_of(source)
        if chosen not in known:
            known[chosen] = len(sets)
            changes = configured.given_by(chosen)
            sets.append({**given, **{name: one for name, one in changes.items() if name not in typed}})
            origins.append(configured.origin_of(chosen))
        numbers.append(known[chosen])
    return OptionSets(sets, origins, numbers)


def configured_in(ctx: click.Context) -> Configured | None:
    """Return the options that the file sets for the command of a context, or None without a file."""
    found: Configured | None = ctx.meta.get(META)
    return found


def config_files(ctx: click.Context) -> list[str]:
    """Return the absolute path of the file that was read, in a list, which is empty without one."""
    configured = configured_in(ctx)
    return [] if configured is None else [os.path.abspath(configured.configuration.name)]


def config_options() -> list[click.Parameter]:
    """Return the options that choose the configuration file. Every command has them."""
    return [
        # The order matters: if neither is given, this one is looked at before the other.
        click.Option(
            ["--no-config"],
            is_flag=True,
            is_eager=True,
            expose_value=False,
            callback=_leave_out,
            help="Read no configuration file.",
        ),
        click.Option(
            ["--config"],
            metavar="FILE",
            is_eager=True,
            expose_value=False,
            callback=_load,
            help="Configuration file, instead of the nearest skinbake.toml or pyproject.toml.",
        ),
    ]


def _leave_out(ctx: click.Context, param: click.Parameter, value: bool) -> None:
    if value and META in ctx.meta:
        raise click.UsageError("--config and --no-config contradict each other")
    if value:
        ctx.meta[META] = None


def _load(ctx: click.Context, param: click.Parameter, value: str | None) -> None:
    """Have click take the options of the file as defaults."""
    if ctx.resilient_parsing:
        return
    if META in ctx.meta:
        if value is not None:
            raise click.UsageError("--config and --no-config contradict each other")
        return
    paths = _candidates() if value is None else iter([value])
    first = next(paths, None)
    ctx.meta[META] = None
    if first is None:
        return
    from skinbake.cli.configured import configured_by

    configured = configured_by(chain([first], paths), ctx)
    if configured is not None:
        ctx.meta[META] = configured
        ctx.default_map = {name: setting.value for name, setting in configured.settings.items()}
    elif value is not None:
        raise click.UsageError(f"--config: {value} has no [tool.skinbake]")


def _candidates() -> Iterator[str]:
    """Yield the files that may have options, the nearest first, relative to the current folder."""
    try:
        start = os.path.realpath(os.curdir)
    except OSError:
        return  # the current folder was deleted
    for folder in searched_folders():
        for name, holds_options in ((OWN_CONFIG, os.path.lexists), (SHARED_CONFIG, _is_mentioned)):
            path = os.path.join(folder, name)
            if holds_options(path):
                yield os.path.relpath(path, start)


def searched_folders() -> Iterator[str]:
    """Yield the current folder and those above it, up to the root of a repository or of the file system."""
    folder = os.path.realpath(os.curdir)
    while True:
        yield folder
        above = os.path.dirname(folder)
        if above == folder or os.path.lexists(os.path.join(folder, REPOSITORY)):
            return
        folder = above


def _is_mentioned(path: str) -> bool:
    """Tell whether a file of a Python project may have options of skinbake."""
    if not os.path.lexists(path):
        return False
    from skinbake.files.folders import open_regular

    with suppress(OSError), os.fdopen(open_regular(path), "rb") as file:
        return MENTION.search(file.read(LARGEST_CONFIG)) is not None
    return False
