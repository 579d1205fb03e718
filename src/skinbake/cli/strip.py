"""``skinbake strip``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import click

from skinbake.cli import exit_codes
from skinbake.cli.console import Console, console
from skinbake.cli.depfile import OPTION, check_depfile, depfile_writer
from skinbake.cli.given import alone
from skinbake.cli.help import Helpful
from skinbake.cli.inputs import expanded
from skinbake.cli.many import Clock, Notes, Reporting, of_one, run_of, work_through
from skinbake.cli.targets import check_reports, in_turns, jobs_of, targets_of
from skinbake.cli.writing import writing_of
from skinbake.files.urls import STDIO

if TYPE_CHECKING:
    from typing import Unpack

    from skinbake.cli.given import Given
    from skinbake.report.strip import StripResult


@click.command(
    "strip",
    cls=Helpful,
    examples=(
        "skinbake strip build/hero.glb -o hero.glb",
        "skinbake strip build --out-dir unbaked",
    ),
)
@click.argument("inputs", nargs=-1, required=True, metavar="INPUT...")
def command(inputs: tuple[str, ...], **some: Unpack[Given]) -> None:
    """Write the document as it was before bake: equal JSON, and the original influences.

    INPUT is a .glb, .gltf or .vrm file, or - for a GLB on stdin; a folder, for all such files below it; or a
    quoted pattern like 'build/**/*.glb'. Inputs and outputs may be URLs.
    """
    clock, given = Clock(), alone(some)
    say = console(given, results_on_stderr=given.get("output") == STDIO)
    found, notes = expanded(inputs, but=given.get("out_dir")), Notes(say)
    targets = targets_of(found, given)
    output = targets[0][1] if given.get("output") else None
    reports = {"--summary": given["summary"], OPTION: given.get("depfile")}
    check_reports(reports, (entry.file for entry in found), output)
    depfile_at = check_depfile(given, targets, say)
    from skinbake.jobs.strip import Strip

    commands = [Strip(writing_of(given), given["warnings_as_errors"])]
    jobs = jobs_of(targets, given, notes)
    write_depfile = depfile_writer(depfile_at, given, say)
    reporting = _reporting(given, say, write_depfile, is_one=output is not None)
    turns = in_turns([entry for entry, _ in targets]) if given.get("out_dir") else []
    clock.imports_done()
    run = run_of(commands, jobs, given, say, notes, turns)
    sys.exit(work_through(run, reporting, given, say, clock, notes))


def _reporting(
    given: Given, say: Console, write: Callable[[Sequence[StripResult]], int] | None, *, is_one: bool
) -> Reporting[StripResult]:
    """Return how results are reported and counted. ``is_one``: of one file, which has its own schema."""
    from skinbake.report.strip import (
        FILES_SCHEMA,
        OUTCOMES,
        closing_line,
        count,
        file_json,
        files_json,
        one_json,
    )

    def tell(result: StripResult) -> None:
        say.notices(result.notices)
        if result.error is not None:
            say.error(result.error)
        elif not given["as_json"]:
            say.written(closing_line(result))

    return Reporting(
        schema=FILES_SCHEMA,
        outcomes=OUTCOMES,
        tell=tell,
        count=count,
        code=lambda result: exit_codes.of_error(result.error),
        file_json=file_json,
        document=of_one(one_json) if is_one else files_json,
        write=write,
    )
