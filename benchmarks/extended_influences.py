"""Measure what ``--neighbours extend`` is worth on real characters: into docs/five-minutes.md.

Usage: python -m benchmarks.extended_influences [--output FILE]

Models of the corpus (SKINBAKE_CORPUS, or ../shared/corpus) are baked with free slots only, and with a set
more. The part of the page between two marks is written anew.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

from benchmarks.corpus_table import REPOSITORY, corpus_folders
from benchmarks.marked import write_between
from skinbake.choices import Lighting, Method, Neighbours
from skinbake.commands.bake import bake_document
from skinbake.commands.bake_options import BakeOptions
from skinbake.commands.verify import verify_document
from skinbake.gltf.document import read_document
from skinbake.measure.options import VerifyOptions

DEFAULT_OUTPUT = REPOSITORY / "docs" / "five-minutes.md"
START, END = "<!-- extended influences: begin -->", "<!-- extended influences: end -->"
CHARACTERS = ("BaseFemale.glb", "hand_l.gltf", "trex.gltf", "CesiumMan.glb")


def main() -> int:
    """Write the table into the page; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--output", type=Path, default=DEFAULT_OUTPUT, help="the page to write into")
    options = parser.parse_args()
    folders = corpus_folders()
    if not folders:
        print("no models: set SKINBAKE_CORPUS", file=sys.stderr)
        return 3
    paths = {path.name: path for path in sorted(folders[0].rglob("*"))}
    text = "\n".join(table([paths[name] for name in CHARACTERS]))
    print(text)
    write_between(options.output, START, END, text)
    return 0


def table(paths: list[Path]) -> Iterator[str]:
    """Yield the lines of the table."""
    yield "| model | left out | mean error | with `--neighbours extend` |"
    yield "|---|--:|--:|--:|"
    for path in paths:
        (lost, plain), (_, extended) = (baked(path, how) for how in (Neighbours.ADOPT, Neighbours.EXTEND))
        yield f"| {path.name} | {100 * lost:.2f} % | {plain:.2f}° | {extended:.2f}° |"


def baked(path: Path, neighbours: Neighbours) -> tuple[float, float]:
    """Return the share of the gradient that a bake leaves out, and the mean error of LBS in degrees."""
    options = BakeOptions(neighbours=neighbours, generate_normals=True)
    result = bake_document(read_document(str(path)), options)
    verdict = verify_document(result.document, VerifyOptions(methods=(Method.LBS,)))
    normals = verdict.by_truth.get("triangles", {})
    counts = [count for _, count in result.primitives]
    lost = sum(count.lost_gradient * count.gradient for count in counts) / sum(c.gradient for c in counts)
    return lost, normals[Method.LBS][Lighting.ACCURATE].mean


if __name__ == "__main__":
    sys.exit(main())
