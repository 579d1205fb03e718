"""``--depfile``: the files that outputs depend on, for Make and Ninja."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import click

from skinbake.cli import exit_codes
from skinbake.cli.console import ended_by_errors
from skinbake.cli.many import write_report
from skinbake.cli.plan import Plan
from skinbake.errors import InputError
from skinbake.files.urls import STDIO, is_url

if TYPE_CHECKING:
    from skinbake.report.bake import FileResult
    from skinbake.report.strip import StripResult

OPTION = "--depfile"


def check_depfile(plan: Plan[Any], also_read: Sequence[str] = ()) -> None:
    """Check that --depfile can have rules for all files of a plan.

    ``also_read`` are files that every output was made of. Raises click.UsageError if a rule would not name
    two files of this machine. Ends the run if a name cannot stand in a rule: nothing is written yet.
    """
    if plan.depfile is None:
        return
    if plan.dask:
        raise click.UsageError(f"{OPTION} names files of this machine, --dask uses a cluster: give only one")
    from skinbake.report.depfile import depfile, prerequisites

    for entry, written in plan.targets:
        source, target = entry.source, written and written.given
        if STDIO in {source, target} or is_url(source) or is_url(target or ""):
            raise click.UsageError(f"{OPTION} needs files as inputs and outputs, not - and no URLs")
        if source == target:
            raise click.UsageError(
                f"{OPTION}: with --in-place each file would depend on itself; name an output"
            )
        with ended_by_errors(plan.say):
            read = [source, *prerequisites(source, plan.configuration), *also_read]
            depfile([] if target is None else [(target, read)])


def write_depfile(
    plan: Plan[Any], results: Sequence[FileResult | StripResult], also_read: Sequence[str] = ()
) -> int:
    """Write the rules of results, if --depfile is given, and return the exit code.

    A file that failed has no rule: its output is an earlier run's, and the exit code tells the build tool.
    If no file worked, nothing is written. The configuration file becomes relative if the input was given so.
    """
    if plan.depfile is None or plan.dry_run:
        return exit_codes.OK
    from skinbake.report.depfile import depfile, prerequisites

    rules = [
        (
            result.output,
            [
                result.input,
                *result.read,
                *prerequisites(result.input, plan.configuration),
                *also_read,
            ],
        )
        for result in results
        if result.output is not None and result.error is None
    ]
    if not rules and any(result.error is not None for result in results):
        return exit_codes.OK
    return write_report(plan, plan.depfile, depfile(rules))  # no name is refused by now


def clip_files_read(paths: Iterable[str]) -> list[str]:
    """Return the files of poses, and the buffers beside them. Raises OutputError, see ``prerequisites``."""
    from skinbake.gltf.document import read_document
    from skinbake.gltf.writing.beside import files_read
    from skinbake.report.depfile import prerequisites

    found = []
    for path in paths:
        try:
            buffers = files_read(read_document(path), None, pack=False)
        except InputError:
            buffers = ()  # the bake reports it
        found += [path, *prerequisites(path, buffers)]
    return found
