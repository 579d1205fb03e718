"""``skinbake render``."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import click

from skinbake.cli.console import ended_by_errors
from skinbake.cli.help import Helpful
from skinbake.cli.inputs import path_on_disk
from skinbake.cli.plan import Plan, planned
from skinbake.cli.runners import within_limits
from skinbake.cli.targets import check_named, check_picture_target
from skinbake.errors import ChoiceError, Chosen, printable

SUFFIXES = (".png", ".webp", ".gif")
MOVING = (".webp", ".gif")


@click.command(
    "render",
    cls=Helpful,
    examples=(
        "skinbake render hero.glb -o build/hero.png --split --closeup",
        "skinbake render hero.glb -o build/hero.webp --turntable",
    ),
)
@click.argument("source", metavar="FILE")
@planned()
def command(  # noqa: PLR0913  # one for each option, by keyword
    plan: Plan[Any],
    source: str,
    *,
    lighting: str | None,
    clip: str | None,
    time: float | None,
    mode: str,
    split: bool,
    closeup: bool,
    clay: bool,
    turntable: bool,
    size: tuple[int, int],
) -> None:
    """Draw pictures of a file without a browser, on a GPU or on a software device.

    It needs the extra skinbake[render]. A file that is not baked is baked in memory.
    """
    source, output = path_on_disk(source), str(plan.output)
    check_named(output)
    suffix = Path(output).suffix.lower()
    if suffix not in SUFFIXES:
        raise click.UsageError(f"{output}: expected a name that ends in {', '.join(SUFFIXES)}")
    check_picture_target(output)
    if turntable and suffix not in MOVING:
        raise ChoiceError("turntable", reason=(f" needs a name that ends in {' or '.join(MOVING)}",))
    if split and lighting:
        raise ChoiceError("split", reason=(" shows both lightings: leave out ", Chosen("lighting")))
    from skinbake.commands.render import RenderOptions, render_file
    from skinbake.render.studio import Look

    options = RenderOptions(
        look=Look(*size, mode),
        sides=("standard", None) if split else (lighting,),
        clip=clip,
        time=time,
        turntable=turntable,
        in_clay=clay,
        is_close=closeup,
    )
    call = partial(render_file, source, output, options, sync=not plan.no_sync, bounds=plan.bounds())
    with ended_by_errors(plan.say):
        result = within_limits(call, plan, source)
    plan.say.notices(result.notices)
    count = f"{result.pictures} pictures, " if result.pictures > 1 else ""
    how = "" if result.was_baked else ", baked in memory"
    plan.say.written(f"{printable(source)} -> {printable(output)}: {count}{printable(result.pose)}{how}")
