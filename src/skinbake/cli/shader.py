"""``skinbake shader``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from itertools import product
from typing import Any

import click

from skinbake.choices import Frame
from skinbake.cli.console import ended_by_errors
from skinbake.cli.help import Helpful
from skinbake.cli.inputs import path_on_disk
from skinbake.cli.plan import Plan, planned
from skinbake.cli.targets import check_named, check_text_target
from skinbake.errors import ChoiceError, printable
from skinbake.files.urls import STDIO, named_file
from skinbake.options import SHADER, checked
from skinbake.shaders.choices import ShaderRequest
from skinbake.shaders.text import targets
from skinbake.wording import SUFFIXES


@click.command(
    "shader",
    cls=Helpful,
    words={"target": list(targets())},
    second=("--for", SUFFIXES),
    examples=(
        "skinbake shader --lang glsl --for build/hero.glb -o skinbake.glsl",
        "skinbake shader --target three --for build/hero.glb",
    ),
    usual=(
        *("output", "language", "target", "source", "method", "lighting", "stage", "normal_map", "cap"),
        *("frame", "encoding", "influences", "verbose"),
    ),
)
@planned()
def command(plan: Plan[Any], *, source: str | None, **choices: Any) -> None:
    """Write the shader code that reads α and β: GLSL, WGSL or HLSL, plain or for an engine.

    The text needs no other file. It has pure functions on values, for the algorithms 1 to 6 of the paper. Its
    header says which attributes it reads, and how to call it.
    """
    output = str(plan.output)
    check_named(output)
    if source is not None:
        source = path_on_disk(source)
        if named_file(source).is_same(named_file(output)):
            raise click.UsageError(f"{output} is the baked file itself")
    check_text_target(output)
    # The text may be the result on stdout, so everything else goes to stderr.
    say = plan.say._replace(results_on_stderr=True)
    from skinbake.commands.shader import shader
    from skinbake.files.writing import write_result
    from skinbake.gltf.budget import memory_limited

    with ended_by_errors(say), memory_limited(plan.max_memory):
        result = shader(_request(choices), source, output, plan.bounds())
        write_result([result.text.encode("utf-8")], output, sync=not plan.no_sync)
    say.notices(result.notices)
    if output != STDIO:
        say.result(f"{printable(output)}: {result.choices.words}")


def check_together(given: Mapping[str, Any]) -> None:
    """Raise ChoiceError if options contradict each other, whichever language and file come with them."""
    from skinbake.commands.shader import check_request

    choices = {one.name: given[one.name] for one in fields(ShaderRequest)}
    languages = [choices["language"]] if choices["language"] else targets()[choices["target"]]
    frames = [choices["frame"]] if choices["frame"] else list(Frame)
    errors = []
    for language, frame in product(languages, frames):
        try:
            check_request(_request({**choices, "language": language, "frame": frame}))
        except ChoiceError as error:
            errors.append(error)
        else:
            return
    raise errors[0]


def _request(choices: Mapping[str, Any]) -> ShaderRequest:
    """Return what is asked for. A target with one language needs no --lang. Raises click.UsageError."""
    languages = targets()[choices["target"]]
    if not choices["language"] and len(languages) > 1:
        raise click.UsageError("Missing option '--lang'. Choose from: " + ", ".join(languages))
    language = choices["language"] or languages[0]
    return ShaderRequest(**checked(SHADER, {**choices, "language": language}))
