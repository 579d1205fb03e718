"""``skinbake inspect``."""

from __future__ import annotations

import sys

import click

from skinbake.cli.help import Helpful
from skinbake.cli.inputs import is_one_file
from skinbake.cli.many import Reporting, work_through
from skinbake.cli.plan import Plan, planned
from skinbake.cli.targets import check_reports


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
@planned(for_many=True)
def command(plan: Plan[None]) -> None:
    """Show the skinned primitives: how influences and frames are stored, and the bakes with their sizes.

    INPUT is a .glb, .gltf or .vrm file, or - for a GLB on stdin; a folder, for all such files below it; or a
    quoted pattern like 'art/**/*.glb'. Each may be a URL. Several files, folders and patterns have a line for
    each file; -v shows all of them in full.
    """
    check_reports({"--summary": plan.summary}, (entry.file for entry in plan.inputs))
    is_one = is_one_file(plan.arguments)
    from skinbake.jobs.inspect import Inspect
    from skinbake.report.inspect import (
        FILES_SCHEMA,
        OUTCOMES,
        FileSummary,
        as_json,
        as_line,
        as_text,
        file_json,
    )

    def tell(result: FileSummary) -> None:
        plan.say.notices(result.notices)
        if result.error is not None:
            plan.say.error(result.error)
        elif result.summary is not None and not plan.as_json:
            in_full = is_one or plan.say.verbosity > 0
            plan.say.result(as_text(result.summary) if in_full else as_line(result.summary))

    reporting = Reporting(
        schema=FILES_SCHEMA,
        outcomes=OUTCOMES,
        tell=tell,
        file_json=file_json,
        alone=(lambda one: as_json(one.summary) if one.summary else {}) if is_one else None,
    )
    sys.exit(work_through(plan, [Inspect()], reporting))
