"""Measure what ``--weld skin`` is worth on characters cut into several meshes: into docs/welding.md.

Usage: python -m benchmarks.welded_meshes [--output FILE]

Models of the corpus (SKINBAKE_CORPUS, or ../shared/corpus) are baked with both values of ``--weld``. Those of
one mesh are cut in half before. The part of the page between two marks is written anew.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.corpus_table import REPOSITORY, corpus_folders
from benchmarks.marked import write_between
from skinbake.choices import Gradients, Lighting, Method, Weld
from skinbake.commands.bake import bake_document
from skinbake.commands.bake_options import BakeOptions
from skinbake.commands.verify import verify_document
from skinbake.gltf.document import read_document
from skinbake.measure.options import VerifyOptions
from tests.support.cutting import cut_into_meshes, halved

DEFAULT_OUTPUT = REPOSITORY / "docs" / "welding.md"
START, END = "<!-- welded meshes: begin -->", "<!-- welded meshes: end -->"
SEVERAL_MESHES = (
    "BaseFemale.glb",
    "Barbarian.glb",
    "robot.glb",
)
TO_CUT = ("fox.glb", "hand_l-weights-u16.glb", "animated_robot_mantis.glb", "CesiumMan.glb")


def main() -> int:
    """Write the table into the page; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--output", type=Path, default=DEFAULT_OUTPUT, help="the page to write into")
    options = parser.parse_args()
    folders = corpus_folders()
    if not folders:
        print("no models: set SKINBAKE_CORPUS", file=sys.stderr)
        return 3
    paths = {path.name: path for folder in reversed(folders) for path in sorted(folder.rglob("*"))}
    text = "\n".join(table(paths))
    print(text)
    write_between(options.output, START, END, text)
    return 0


def table(paths: dict[str, Path]) -> Iterator[str]:
    """Yield the lines of the table."""
    yield "| model | meshes | per mesh | `--weld skin` | uncut |"
    yield "|---|--:|--:|--:|--:|"
    for name in SEVERAL_MESHES:
        yield f"| {name} | {' | '.join(cells(paths[name]))} | |"
    with TemporaryDirectory() as folder:
        for name in TO_CUT:
            whole, half = Path(folder, f"whole-{name}"), Path(folder, name)
            cut_into_meshes(halved(paths[name], whole), half)
            yield f"| {name}, cut in half | {' | '.join(cells(half))} | {errors(paths[name], Weld.MESH)} |"


def cells(path: Path) -> Iterator[str]:
    """Yield the number of a file's meshes, and its errors with both values of ``--weld``."""
    content = read_document(str(path)).json
    yield str(sum("skin" in node and "mesh" in node for node in content["nodes"]))
    for weld in (Weld.MESH, Weld.SKIN):
        yield errors(path, weld)


def errors(path: Path, weld: Weld) -> str:
    """Return mean, p99 and maximum of the error of accurate LBS normals by tangents, in degrees."""
    options = BakeOptions(gradients=Gradients.SURFACE, weld=weld, generate_normals=True)
    document = bake_document(read_document(str(path)), options).document
    normals = verify_document(document, VerifyOptions(methods=(Method.LBS,))).by_truth.get("tangents", {})
    found = normals[Method.LBS][Lighting.ACCURATE]
    return f"{found.mean:.3f} / {found.p99:.1f} / {found.max:.0f}"


if __name__ == "__main__":
    sys.exit(main())
