"""``skinbake cost``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from skinbake.cli.console import console, ended_by_errors
from skinbake.cli.help import Helpful
from skinbake.cli.inputs import path_on_disk
from skinbake.errors import ChoiceError
from skinbake.files.bounds import Bounds

if TYPE_CHECKING:
    from skinbake.report.cost import CostResult


@click.command(
    "cost",
    cls=Helpful,
    examples=(
        "skinbake cost",
        "skinbake cost hero.glb",
    ),
)
@click.argument("source", required=False, metavar="[FILE]")
def command(source: str | None, influences: int | None, **given: Any) -> None:
    """Count multiply-adds and bytes per vertex of the paper's algorithms 1 to 5, and of 6.

    FILE is a .glb, .gltf or .vrm file, or - for a GLB on stdin: then with the influences, types and vertices
    that it stores, per vertex, per frame, and for the whole file.
    """
    if source is not None and influences is not None:
        why = " N and FILE exclude each other: a file has its own influences"
        raise ChoiceError("influences", reason=(why,))
    if source is not None:
        source = path_on_disk(source)
    say = console(given)
    from skinbake.gltf.budget import memory_limited
    from skinbake.report.cost import FileCosts, as_json, as_text

    with ended_by_errors(say), memory_limited(given["max_memory"]):
        result = _count(source, influences, Bounds(allowed=given["allow_outside"]))
    if isinstance(result, FileCosts):
        say.notices(result.notices)
    if given["as_json"]:
        say.document(as_json(result))
    else:
        say.result(as_text(result))


def _count(source: str | None, influences: int | None, bounds: Bounds) -> CostResult:
    from skinbake.commands.cost import cost_by_influences, cost_of_file, cost_of_influences

    if source is not None:
        return cost_of_file(source, bounds)
    return cost_by_influences() if influences is None else cost_of_influences(influences)
