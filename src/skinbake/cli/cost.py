"""``skinbake cost``."""

from __future__ import annotations

from typing import Any

import click

from skinbake.cli.help import Helpful
from skinbake.cli.plan import Plan, planned


@click.command("cost", cls=Helpful, examples=("skinbake cost", "skinbake cost --influences 4"))
@planned()
def command(plan: Plan[Any], *, influences: int | None) -> None:
    """Count multiply-adds and bytes per vertex of the paper's algorithms 1 to 5, and of 6."""
    from skinbake.commands.cost import as_json, as_text, costs_of

    rows = costs_of(influences)
    if plan.as_json:
        plan.say.document(as_json(rows))
    else:
        plan.say.result(as_text(rows))
