"""``skinbake render``."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import click

from skinbake.cli.console import console, ended_by_errors
from skinbake.cli.help import Helpful
from skinbake.cli.inputs import path_on_disk
from skinbake.cli.limits import within_limits
from skinbake.cli.targets import check_named, check_picture_target
from skinbake.errors import ChoiceError, Chosen, printable
from skinbake.files.bounds import Bounds

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
def command(source: str, output: str, **given: Any) -> None:
    """Draw pictures of a file without a browser, on a GPU or on a software device.

    It needs the extra skinbake[render]. A file that is not baked is baked in memory.
    """
    source = path_on_disk(source)
    check_named(output)
    suffix = Path(output).suffix.lower()
    if suffix not in SUFFIXES:
        raise click.UsageError(f"{output}: expected a name that ends in {', '.join(SUFFIXES)}")
    check_picture_target(output)
    if given["turntable"] and suffix not in MOVING:
        raise ChoiceError("turntable", reason=(f" needs a name that ends in {' or '.join(MOVING)}",))
    if given["split"] and given["lighting"]:
        raise ChoiceError("split", reason=(" shows both lightings: leave out ", Chosen("lighting")))
    say = console(given)
    from skinbake.commands.render import RenderOptions, render_file
    from skinbake.render.studio import Look

    width, height = given["size"]
    options = RenderOptions(
        look=Look(width, height, given["mode"]),
        sides=("standard", None) if given["split"] else (given["lighting"],),
        clip=given["clip"],
        time=given["time"],
        turntable=given["turntable"],
        in_clay=given["clay"],
        is_close=given["closeup"],
    )
    bounds = Bounds(allowed=given["allow_outside"])
    call = partial(render_file, source, output, options, sync=not given["no_sync"], bounds=bounds)
    with ended_by_errors(say):
        result = within_limits(call, given, source)
    say.notices(result.notices)
    count = f"{result.pictures} pictures, " if result.pictures > 1 else ""
    how = "" if result.was_baked else ", baked in memory"
    say.written(f"{printable(source)} -> {printable(output)}: {count}{printable(result.pose)}{how}")
