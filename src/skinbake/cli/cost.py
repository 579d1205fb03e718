"""``skinbake cost``."""

from __future__ import annotations

from typing import Any

import click

from skinbake.cli.console import console
from skinbake.cli.help import Helpful


@click.command("cost", cls=Helpful, examples=("skinbake cost", "skinbake cost --influences 4"))
def command(influences: int | None, **given: Any) -> None:
    """Count multiply-adds and bytes per vertex of the paper's algorithms 1 to 5, and of 6."""
    from skinbake.commands.cost import as_json, as_text, costs_of

    say, rows = console(given), costs_of(influences)
    if given["as_json"]:
        say.document(as_json(rows))
    else:
        say.result(as_text(rows))
