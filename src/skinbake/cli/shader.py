"""``skinbake shader``."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from skinbake.choices import STANDARD, Encoding, Frame, Language, Layout, Lighting, Method, Morphs, Range
from skinbake.cli.console import (
    Words,
    console,
    ended_by_errors,
    in_range,
    message_options,
    one_of,
    outside_option,
)
from skinbake.cli.help import Helpful
from skinbake.cli.names import STDIO, check_readable_suffix
from skinbake.cli.targets import check_named, check_text_target, sync_option
from skinbake.errors import ChoiceError, printable
from skinbake.files.bounds import Bounds
from skinbake.files.urls import SUFFIXES
from skinbake.shaders.text import targets

if TYPE_CHECKING:
    from skinbake.commands.shader import ShaderRequest

PUBLISHED_CAP = 0.9
"""The limit of the paper's published demo."""


@click.command(
    "shader",
    cls=Helpful,
    second=("--for", SUFFIXES),
    examples=(
        "skinbake shader --lang glsl --for build/hero.glb -o skinbake.glsl",
        "skinbake shader --target three --for build/hero.glb",
    ),
)
@click.option(
    "--lang",
    "language",
    type=one_of(Language),
    help="Shading language; not needed if --target has only one.",
)
@click.option(
    "--method",
    type=one_of(Method),
    default=Method.LBS.value,
    show_default=True,
    help="Linear blend skinning, or dual quaternions.",
)
@click.option(
    "--lighting",
    type=Words([STANDARD, *(lighting.value for lighting in Lighting)]),
    help="standard or approximated (the same: that of common engines), direct (LBS only), accurate, "
    "exact (DQS only). By default accurate for LBS, exact for DQS.",
)
@click.option(
    "--influences",
    type=in_range(Range(1, 64, is_whole=True)),
    metavar="N",
    help="Influences per vertex, 1 to 64; by default those of --for, else 4.",
)
@click.option(
    "--frame",
    type=one_of(Frame),
    help="Source of the tangent frame (t0, b0); by default that of --for.",
)
@click.option(
    "--cap",
    type=in_range(Range(0, is_open=True)),
    is_flag=False,
    flag_value=PUBLISHED_CAP,
    metavar="[X]",
    help=f"Limit a tangent's correction to X times its length ({PUBLISHED_CAP} without X); off by default.",
)
@click.option(
    "--mirrored-joints",
    is_flag=True,
    help="Keep normals outside if joints mirror the surface; --for sets it if they do.",
)
@click.option(
    "--encoding",
    type=one_of(Encoding),
    help="Number type of α and β; by default that of --for, else float32.",
)
@click.option(
    "--layout",
    type=one_of(Layout),
    help="Attributes of α and β; by default those of --for, else their own.",
)
@click.option(
    "--morphs",
    type=one_of(Morphs),
    help="Direction that t0 and b0 follow under morph targets: the morphed normal, or the morphed "
    "TANGENT. By default it fits the targets of --for, else none.",
)
@click.option(
    "--target",
    type=Words(list(targets())),
    default="plain",
    show_default=True,
    help="plain functions, or an adapter for an engine.",
)
@click.option(
    "--for",
    "source",
    metavar="BAKED_FILE",
    help="Match this baked file (.glb, .gltf, .vrm; - for a GLB on stdin), and refuse options that "
    "contradict it.",
)
@click.option("-o", "--output", metavar="FILE", default=STDIO, help="Output file; stdout by default.")
@outside_option
@sync_option
@message_options
def command(source: str | None, output: str, **given: Any) -> None:
    """Write the shader code that reads α and β: GLSL, WGSL or HLSL, plain or for an engine.

    The text is self-contained. It has pure functions on values, for the algorithms 1 to 6. Its header says
    which attributes it reads, and how to call it.
    """
    check_named(output)
    if source is not None:
        check_readable_suffix(source)
        if STDIO not in {output, source} and _is(source, output):
            raise click.UsageError(f"{output} is the baked file itself")
    check_text_target(output)
    # The text may be the result on stdout, so everything else goes to stderr.
    say = console(given, results_on_stderr=True)
    from skinbake.commands.shader import shader, write_shader

    with ended_by_errors(say):
        result = shader(_request(given), source, output, Bounds(allowed=given["allow_outside"]))
        write_shader(result, output, sync=not given["no_sync"])
    say.notices(result.notices)
    if output != STDIO:
        say.result(f"{printable(output)}: {result.choices.words}")


def check_together(given: Mapping[str, Any]) -> None:
    """Raise ChoiceError if options contradict each other, whichever language and file come with them."""
    from skinbake.commands.shader import check_request

    languages = [given["language"]] if given["language"] else targets()[given["target"]]
    frames = [given["frame"]] if given["frame"] else list(Frame)
    errors = []
    for language, frame in product(languages, frames):
        try:
            check_request(_request({**given, "language": language, "frame": frame}))
        except ChoiceError as error:
            errors.append(error)
        else:
            return
    raise errors[0]


def _request(given: Mapping[str, Any]) -> ShaderRequest:
    from skinbake.commands.shader import ShaderRequest

    return ShaderRequest(
        language=_language(given["language"], given["target"]),
        method=Method(given["method"]),
        lighting=Lighting(given["lighting"]) if given["lighting"] else None,
        influences=given["influences"],
        frame=Frame(given["frame"]) if given["frame"] else None,
        cap=given["cap"],
        mirrored_joints=given["mirrored_joints"],
        target=given["target"],
        encoding=Encoding(given["encoding"]) if given["encoding"] else None,
        layout=Layout(given["layout"]) if given["layout"] else None,
        morphs=Morphs(given["morphs"]) if given["morphs"] else None,
    )


def _language(asked: str | None, target: str) -> Language:
    languages = targets()[target]
    if asked is not None:
        return Language(asked)
    if len(languages) > 1:
        raise click.UsageError("Missing option '--lang'. Choose from: " + ", ".join(languages))
    return languages[0]


def _is(source: str, output: str) -> bool:
    try:
        return Path(source).samefile(output)
    except (OSError, ValueError):
        return False
