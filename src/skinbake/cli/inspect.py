"""``skinbake inspect``."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import click

from skinbake.cli import exit_codes
from skinbake.cli.console import Console, console
from skinbake.cli.given import alone
from skinbake.cli.help import Helpful
from skinbake.cli.inputs import expanded, is_one_file
from skinbake.cli.many import Clock, Notes, Reporting, of_one, run_of, work_through
from skinbake.cli.targets import check_reports, jobs_of

if TYPE_CHECKING:
    from typing import Unpack

    from skinbake.cli.given import Given
    from skinbake.report.inspect import FileSummary


@click.command(
    "inspect",
    cls=Helpful,
    examples=(
        "skinbake inspect hero.glb",
        "skinbake inspect art/characters",
        "skinbake inspect build/hero.glb --json",
    ),
)
@click.argument("inputs", nargs=-1, required=True, metavar="INPUT...")
def command(inputs: tuple[str, ...], **some: Unpack[Given]) -> None:
    """Show the skinned primitives: how influences and frames are stored, and the bakes with their sizes.

    INPUT is a .glb, .gltf or .vrm file, or - for a GLB on stdin; a folder, for all such files below it; or a
    quoted pattern like 'art/**/*.glb'. Each may be a URL. Several files, folders and patterns have a line for
    each file; -v shows all of them in full.
    """
    clock, given = Clock(), alone(some)
    say = console(given)
    found, notes = expanded(inputs), Notes(say)
    check_reports({"--summary": given["summary"]}, (entry.file for entry in found))
    from skinbake.jobs.inspect import Inspect

    jobs = jobs_of([(entry, None) for entry in found], given, notes)
    reporting = _reporting(given, say, is_one=is_one_file(inputs))
    clock.imports_done()
    run = run_of([Inspect()], jobs, given, say, notes)
    sys.exit(work_through(run, reporting, given, say, clock, notes))


def _reporting(given: Given, say: Console, *, is_one: bool) -> Reporting[FileSummary]:
    """Return how summaries are reported and counted. ``is_one``: of one file, which has its own schema."""
    from skinbake.report.inspect import (
        FILES_SCHEMA,
        OUTCOMES,
        as_line,
        as_text,
        count,
        file_json,
        files_json,
        one_json,
    )

    def tell(result: FileSummary) -> None:
        say.notices(result.notices)
        if result.error is not None:
            say.error(result.error)
        elif result.summary is not None and not given["as_json"]:
            in_full = is_one or given["verbose"]
            say.result(as_text(result.summary) if in_full else as_line(result.summary))

    return Reporting(
        schema=FILES_SCHEMA,
        outcomes=OUTCOMES,
        tell=tell,
        count=count,
        code=lambda result: exit_codes.of_error(result.error),
        file_json=file_json,
        document=of_one(one_json) if is_one else files_json,
    )
