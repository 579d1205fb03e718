"""Measure moved and scaled bones, whose normals standard lighting leaves at rest: into docs/why.md.

Usage: python -m benchmarks.squash_and_stretch [--output FILE]

The fixtures are baked with the defaults, and measured in their clips. The part of the page between two marks
is written anew.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

from benchmarks.corpus_table import REPOSITORY
from benchmarks.marked import write_between
from fixtures.make_fixtures import FOLDER
from skinbake.choices import Lighting, Method
from skinbake.commands.bake import bake_document
from skinbake.commands.bake_options import DEFAULTS
from skinbake.commands.verify import verify_document
from skinbake.gltf.document import read_document
from skinbake.measure.options import VerifyOptions

DEFAULT_OUTPUT = REPOSITORY / "docs" / "why.md"
START, END = "<!-- squash and stretch: begin -->", "<!-- squash and stretch: end -->"
MODELS = {
    "a plane, pushed out by a bone": "squash_and_stretch/moved_bone.glb",
    "a ball, one half scaled to 1.6 by a bone": "squash_and_stretch/scaled_bone.glb",
    "beside them, an arm that bends": "bent_tube.glb",
}


def main() -> int:
    """Write the table into the page; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--output", type=Path, default=DEFAULT_OUTPUT, help="the page to write into")
    text = "\n".join(table())
    print(text)
    write_between(parser.parse_args().output, START, END, text)
    return 0


def table() -> Iterator[str]:
    """Yield the lines of the table: mean errors in degrees, by triangles."""
    yield "| model | standard lighting | with skinbake |"
    yield "|---|--:|--:|"
    for words, name in MODELS.items():
        standard, accurate = errors(FOLDER / name)
        yield f"| {words} | {standard:.2f}° | {accurate:.2f}° |"


def errors(path: Path) -> tuple[float, float]:
    """Return the mean errors of standard and accurate lighting of a model in its clips, in degrees."""
    result = bake_document(read_document(str(path)), DEFAULTS)
    verdict = verify_document(result.document, VerifyOptions(methods=(Method.LBS,)))
    figures = verdict.by_truth["triangles"][Method.LBS]
    return figures[Lighting.STANDARD].mean, figures[Lighting.ACCURATE].mean


if __name__ == "__main__":
    sys.exit(main())
