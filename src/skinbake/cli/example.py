"""``skinbake example``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from skinbake.cli.console import ended_by_errors
from skinbake.cli.help import Helpful
from skinbake.cli.plan import Plan, planned
from skinbake.cli.targets import check_named
from skinbake.errors import printable
from skinbake.files.urls import STDIO


@click.command(
    "example",
    cls=Helpful,
    examples=("skinbake example -o hero.glb",),
)
@planned()
def command(plan: Plan[Any]) -> None:
    """Write a small model to try the other commands on: an arm that bends, with an animation."""
    output = str(plan.output)
    check_named(output)
    if output != STDIO and Path(output).suffix.lower() != ".glb":
        raise click.UsageError(
            f"{output}: the example is a GLB; expected a name that ends in .glb, or - for stdout"
        )
    from skinbake.commands.example import write_example

    with ended_by_errors(plan.say):
        size = write_example(output, sync=not plan.no_sync)
    if output != STDIO:
        plan.say.written(f"{printable(output)}: an arm that bends, {size:,} bytes")
