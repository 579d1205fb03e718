"""``skinbake render``."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import click

from skinbake.cli.console import Words, console, ended_by_errors, message_options, outside_option
from skinbake.cli.help import Helpful
from skinbake.cli.limits import memory_option
from skinbake.cli.names import check_readable_suffix
from skinbake.cli.targets import check_named, check_picture_target, sync_option
from skinbake.errors import printable
from skinbake.files.bounds import Bounds

SUFFIXES = (".png", ".webp", ".gif")
MOVING = (".webp", ".gif")
SMALLEST, LARGEST = 16, 2048


def _size(ctx: click.Context, param: click.Parameter, value: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", value)
    size = (int(found[1]), int(found[2])) if found else (0, 0)
    if not all(SMALLEST <= side <= LARGEST for side in size):
        raise click.BadParameter(f"must be like 960x600, each side from {SMALLEST} to {LARGEST}")
    return size


def _finite(ctx: click.Context, param: click.Parameter, value: float | None) -> float | None:
    if value is not None and not math.isfinite(value):
        raise click.BadParameter("must be a finite number")
    return value


@click.command(
    "render",
    cls=Helpful,
    examples=(
        "skinbake render hero.glb -o build/hero.png --split",
        "skinbake render hero.glb -o build/hero.webp --turntable",
    ),
)
@click.argument("source", metavar="FILE")
@click.option(
    "-o", "--output", required=True, metavar="PICTURE", help="Output file: .png, or .webp or .gif that move."
)
@click.option(
    "--clip",
    metavar="NAME",
    help="Name or number of a clip; by default the one in which standard lighting is worst.",
)
@click.option(
    "--time",
    type=float,
    callback=_finite,
    metavar="SECONDS",
    help="Time in the clip. By default the pose in which standard lighting is worst, or, in .webp and .gif, "
    "the whole clip.",
)
@click.option(
    "--mode",
    type=Words(["shaded", "reflections", "error", "normals"]),
    default="shaded",
    show_default=True,
    help="Shading, stripes mirrored in the surface, angle to the true normals as colour, or normals.",
)
@click.option(
    "--lighting",
    type=Words(["standard", "accurate"]),
    help="Lighting without --split, accurate by default.",
)
@click.option("--split", is_flag=True, help="Standard lighting on the left, accurate lighting on the right.")
@click.option("--clay", is_flag=True, help="Without the colours and images of the materials.")
@click.option("--turntable", is_flag=True, help="Turn the camera once around the model (.webp, .gif).")
@click.option(
    "--size",
    default="960x600",
    show_default=True,
    callback=_size,
    metavar="WxH",
    help=f"Width and height in pixels, each from {SMALLEST} to {LARGEST}.",
)
@outside_option
@sync_option
@memory_option
@message_options
def command(source: str, output: str, **given: Any) -> None:
    """Draw pictures of a file without a browser, on a GPU or on a software device.

    It needs the extra skinbake[render]. A file that is not baked is baked in memory.
    """
    check_readable_suffix(source)
    check_named(output)
    suffix = Path(output).suffix.lower()
    if suffix not in SUFFIXES:
        raise click.UsageError(f"{output}: expected a name that ends in {', '.join(SUFFIXES)}")
    check_picture_target(output)
    if given["turntable"] and suffix not in MOVING:
        raise click.UsageError(f"--turntable needs a name that ends in {' or '.join(MOVING)}")
    if given["split"] and given["lighting"]:
        raise click.UsageError("--split shows both lightings: leave out --lighting")
    say = console(given)
    from skinbake.commands.render import RenderOptions, render_file
    from skinbake.gltf.budget import memory_limited
    from skinbake.render.studio import Look

    width, height = given["size"]
    options = RenderOptions(
        look=Look(width, height, given["mode"]),
        sides=("standard", "accurate") if given["split"] else (given["lighting"] or "accurate",),
        clip=given["clip"],
        time=given["time"],
        turntable=given["turntable"],
        in_clay=given["clay"],
    )
    with ended_by_errors(say), memory_limited(given["max_memory"]):
        result = render_file(
            source,
            output,
            options,
            sync=not given["no_sync"],
            bounds=Bounds(allowed=given["allow_outside"]),
        )
    say.notices(result.notices)
    count = f"{result.pictures} pictures, " if result.pictures > 1 else ""
    how = "" if result.was_baked else ", baked in memory"
    say.written(f"{printable(source)} -> {printable(output)}: {count}{printable(result.pose)}{how}")
