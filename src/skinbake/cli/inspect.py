"""``skinbake inspect``."""

from __future__ import annotations

import sys
from typing import Any

import click

from skinbake.cli import exit_codes
from skinbake.cli.console import console, message_options, outside_option
from skinbake.cli.help import Helpful
from skinbake.cli.limits import memory_option
from skinbake.cli.names import check_readable_suffix
from skinbake.containment import Bounds
from skinbake.errors import SkinbakeError


@click.command(
    "inspect",
    cls=Helpful,
    examples=(
        "skinbake inspect hero.glb",
        "skinbake inspect build/hero.glb --json",
    ),
)
@click.argument("source", metavar="INPUT")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
@outside_option
@memory_option
@message_options
def command(source: str, **given: Any) -> None:
    """Show the skinned primitives: how influences and frames are stored, and the bakes with their sizes."""
    check_readable_suffix(source)
    say = console(verbose=given["verbose"], quiet=given["quiet"], color=given["color"])
    from skinbake.commands.inspect import inspect_file
    from skinbake.gltf.budget import memory_limited
    from skinbake.report.inspect import as_json, as_text

    try:
        with memory_limited(given["max_memory"]):
            result = inspect_file(source, Bounds(allowed=given["allow_outside"]))
    except SkinbakeError as error:
        say.error(error)
        sys.exit(exit_codes.of_error(error))
    say.notices(result.notices)
    if given["as_json"]:
        say.document(as_json(result))
    else:
        say.result(as_text(result))
