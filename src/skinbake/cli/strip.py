"""``skinbake strip``."""

from __future__ import annotations

import sys

import click

from skinbake.cli.depfile import OPTION, check_depfile, write_depfile
from skinbake.cli.help import Helpful
from skinbake.cli.many import Reporting, work_through
from skinbake.cli.plan import Plan, planned
from skinbake.cli.targets import check_reports


@click.command(
    "strip",
    cls=Helpful,
    examples=(
        "skinbake strip build/hero.glb -o hero.glb",
        "skinbake strip build --out-dir unbaked",
    ),
)
@click.argument("inputs", nargs=-1, required=True, metavar="INPUT...")
@planned(for_many=True)
def command(plan: Plan[None]) -> None:
    """Write the document as it was before bake: equal JSON, and the original influences.

    INPUT is a .glb, .gltf or .vrm file, or - for a GLB on stdin; a folder, for all such files below it; or a
    quoted pattern like 'art/**/*.glb'. Inputs and outputs may be URLs.
    """
    output = plan.targets[0][1] if plan.output else None
    check_reports(
        {"--summary": plan.summary, OPTION: plan.depfile}, (entry.file for entry in plan.inputs), output
    )
    check_depfile(plan)
    from skinbake.jobs.strip import Strip
    from skinbake.report.strip import (
        FILES_SCHEMA,
        OUTCOMES,
        StripResult,
        as_json,
        closing_line,
        file_json,
    )

    def tell(result: StripResult) -> None:
        plan.say.notices(result.notices)
        if result.error is not None:
            plan.say.error(result.error)
        elif not plan.as_json:
            plan.say.written(closing_line(result))

    reporting = Reporting(
        schema=FILES_SCHEMA,
        outcomes=OUTCOMES,
        tell=tell,
        file_json=file_json,
        alone=None if output is None else as_json,
        write=(lambda results: write_depfile(plan, results)) if plan.depfile else None,
    )
    sys.exit(work_through(plan, [Strip(plan.writing, plan.warnings_as_errors)], reporting))
