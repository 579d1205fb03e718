"""``--depfile``: the files that outputs depend on, for Make and Ninja."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING

import click

from skinbake.cli import exit_codes
from skinbake.cli.console import ended_by_errors
from skinbake.cli.writing import write_report
from skinbake.errors import InputError
from skinbake.files.urls import STDIO, File, is_url

if TYPE_CHECKING:
    from skinbake.cli.console import Console
    from skinbake.cli.given import Given
    from skinbake.cli.inputs import Input
    from skinbake.report.bake import FileResult
    from skinbake.report.strip import StripResult

OPTION = "--depfile"


def check_depfile(
    given: Given,
    targets: Iterable[tuple[Input, File | None]],
    say: Console,
    also_read: Sequence[str] = (),
    configuration: Sequence[str] = (),
) -> str | None:
    """Return the path of the depfile, None if there is none to write.

    The other parameters are as in ``depfile_writer``. Raises click.UsageError if a rule would not name two
    files of this machine. Ends the run if a name cannot stand in a rule: nothing is written yet.
    """
    path = given.get("depfile")
    if path is None:
        return None
    if given["dask"]:
        raise click.UsageError(f"{OPTION} names files of this machine, --dask uses a cluster: give only one")
    from skinbake.report.depfile import depfile, prerequisites

    for entry, written in targets:
        source, target = entry.source, written and written.given
        if STDIO in {source, target} or is_url(source) or is_url(target or ""):
            raise click.UsageError(f"{OPTION} needs files as inputs and outputs, not - and no URLs")
        if source == target:
            raise click.UsageError(
                f"{OPTION}: with --in-place each file would depend on itself; name an output"
            )
        with ended_by_errors(say):
            read = [source, *prerequisites(source, configuration), *also_read]
            depfile([] if target is None else [(target, read)])
    return None if given.get("dry_run") else path


def depfile_writer(
    path: str | None,
    given: Given,
    say: Console,
    also_read: Sequence[str] = (),
    configuration: Sequence[str] = (),
) -> Callable[[Sequence[FileResult | StripResult]], int] | None:
    """Return the function that writes the rules of results and returns its exit code; None for no path.

    A file that failed has no rule: its output is an earlier run's, and the exit code tells the build tool.
    If no file worked, nothing is written.

    ``also_read`` are files that every output was made of. So are those of ``configuration``, absolute paths
    that become relative if the input was given so.
    """
    if path is None:
        return None

    def write(results: Sequence[FileResult | StripResult]) -> int:
        from skinbake.report.depfile import depfile, prerequisites

        rules = [
            (
                result.output,
                [
                    result.input,
                    *result.read,
                    *prerequisites(result.input, configuration),
                    *also_read,
                ],
            )
            for result in results
            if result.output is not None and result.error is None
        ]
        if not rules and any(result.error is not None for result in results):
            return exit_codes.OK
        text = depfile(rules)  # no name is refused by now
        return write_report(path, text, say, sync=not given["no_sync"])

    return write


def clip_files_read(paths: Iterable[str]) -> list[str]:
    """Return the files of poses, and the buffers beside them. Raises OutputError, see ``prerequisites``."""
    from skinbake.gltf.beside import files_read
    from skinbake.gltf.document import read_document
    from skinbake.report.depfile import prerequisites

    found = []
    for path in paths:
        try:
            buffers = files_read(read_document(path), None, pack=False)
        except InputError:
            buffers = ()  # the bake reports it
        found += [path, *prerequisites(path, buffers)]
    return found
