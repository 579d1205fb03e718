"""``skinbake strip``."""

from __future__ import annotations

import sys
from typing import Any

import click

from skinbake.cli import exit_codes
from skinbake.cli.console import console, message_options, outside_option
from skinbake.cli.help import Helpful
from skinbake.cli.limits import memory_option
from skinbake.cli.names import STDIO, check_readable_suffix
from skinbake.cli.targets import check_target, sync_option
from skinbake.containment import Bounds
from skinbake.errors import SkinbakeError


@click.command(
    "strip",
    cls=Helpful,
    examples=("skinbake strip build/hero.glb -o hero.glb",),
)
@click.argument("source", metavar="INPUT")
@click.option("-o", "--output", required=True, metavar="FILE", help="Output file; - is a GLB on stdout.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@click.option(
    "--warnings-as-errors", is_flag=True, help="Fail (exit 3) and write nothing if there are warnings."
)
@outside_option
@sync_option
@memory_option
@message_options
def command(source: str, **given: Any) -> None:
    """Write the document as it was before bake: equal JSON, and the original influences."""
    check_readable_suffix(source)
    check_target(source, given["output"], instead="choose another name")
    to_stdout = given["output"] == STDIO
    if to_stdout and given["as_json"]:
        raise click.UsageError("stdout cannot take both the GLB and --json")
    say = console(
        verbose=given["verbose"], quiet=given["quiet"], color=given["color"], results_on_stderr=to_stdout
    )
    from skinbake.commands.strip import strip_file
    from skinbake.gltf.budget import memory_limited
    from skinbake.report.strip import as_json, closing_line

    try:
        with memory_limited(given["max_memory"]):
            result = strip_file(
                source,
                given["output"],
                warnings_as_errors=given["warnings_as_errors"],
                sync=not given["no_sync"],
                bounds=Bounds(allowed=given["allow_outside"]),
            )
    except SkinbakeError as error:
        say.error(error)
        sys.exit(exit_codes.of_error(error))
    say.notices(result.notices)
    if given["as_json"]:
        say.document(as_json(result))
    else:
        say.result(closing_line(result))
