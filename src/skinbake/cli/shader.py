"""``skinbake shader``."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import TYPE_CHECKING, Any

import click

from skinbake.choices import Encoding, Frame, Language, Layout, Lighting, Method, Morphs, Stage
from skinbake.cli.console import console, ended_by_errors
from skinbake.cli.help import Helpful
from skinbake.cli.inputs import path_on_disk
from skinbake.cli.targets import check_named, check_text_target
from skinbake.errors import ChoiceError, printable
from skinbake.files.bounds import Bounds
from skinbake.files.urls import STDIO, named_file
from skinbake.shaders.text import targets
from skinbake.wording import SUFFIXES

if TYPE_CHECKING:
    from skinbake.commands.shader import ShaderRequest


@click.command(
    "shader",
    cls=Helpful,
    words={"target": list(targets())},
    second=("--for", SUFFIXES),
    examples=(
        "skinbake shader --lang glsl --for build/hero.glb -o skinbake.glsl",
        "skinbake shader --target three --for build/hero.glb",
    ),
)
def command(source: str | None, output: str, **given: Any) -> None:
    """Write the shader code that reads α and β: GLSL, WGSL or HLSL, plain or for an engine.

    The text is self-contained. It has pure functions on values, for the algorithms 1 to 6. Its header says
    which attributes it reads, and how to call it.
    """
    check_named(output)
    if source is not None:
        source = path_on_disk(source)
        if named_file(source).is_same(named_file(output)):
            raise click.UsageError(f"{output} is the baked file itself")
    check_text_target(output)
    # The text may be the result on stdout, so everything else goes to stderr.
    say = console(given, results_on_stderr=True)
    from skinbake.commands.shader import shader, write_shader
    from skinbake.gltf.budget import memory_limited

    with ended_by_errors(say), memory_limited(given["max_memory"]):
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
        scaled_joints=given["scaled_joints"],
        normal_map=given["normal_map"],
        stage=Stage(given["stage"]),
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
