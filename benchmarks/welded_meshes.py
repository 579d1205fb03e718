"""Measure what ``--weld skin`` is worth on characters cut into several meshes: into docs/welding.md.

Usage: python -m benchmarks.welded_meshes [--output FILE]

Models of the corpus (SKINBAKE_CORPUS, or ../shared/corpus) are baked with both values of ``--weld``. Those of
one mesh are cut in half before. Two parts of the page between marks are written anew. The second says how
many points of seams the rule of rigid parts takes apart in smooth bodies that are cut into two materials.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.corpus_table import REPOSITORY, corpus_folders
from benchmarks.marked import write_between
from skinbake.choices import Gradients, Lighting, Method, Weld
from skinbake.commands.bake import bake_document
from skinbake.commands.bake_options import BakeOptions
from skinbake.commands.verify import verify_document
from skinbake.errors import SkinbakeError
from skinbake.geometry.skinned import BoolArray, IntArray, SkinnedPrimitive
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.meshes import has_surface, read_primitive, skinned_sources
from skinbake.measure.options import VerifyOptions
from skinbake.truth.mesh import influence_keys, row_numbers, weld_classes, with_rigid_parts
from tests.support.cutting import cut_into_meshes, halved

DEFAULT_OUTPUT = REPOSITORY / "docs" / "welding.md"
START, END = "<!-- welded meshes: begin -->", "<!-- welded meshes: end -->"
SEAMS_START, SEAMS_END = "<!-- seams: begin -->", "<!-- seams: end -->"
CUTS = (0.33, 0.5, 0.67, 0.85)
"""The share of a primitive's triangles on one side of a cut, along each axis."""
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
    text = seams(corpus_folders()[0])
    print(text)
    write_between(options.output, SEAMS_START, SEAMS_END, text)
    return 0


def seams(folder: Path) -> str:
    """Say how many seam points of smooth bodies weld no longer, by this rule and by a simpler one."""
    counts, bodies = np.zeros(3, dtype=int), 0
    for path in sorted(folder.rglob("*.gl*")):
        try:
            document = read_document(str(path))
            sources = [one for one in skinned_sources(document) if has_surface(document, one)]
            primitives = [read_primitive(document, source) for source in sources]
        except SkinbakeError:
            continue  # a broken file is no body
        for primitive in primitives:
            if len(primitive.normals):
                found = sum(cut_points(*parts) for parts in halves(primitive))
                counts, bodies = counts + found, bodies + bool(np.any(found))
    points, apart, simpler = counts.tolist()
    return (
        f"Of {points:,} points on twelve cuts through each of {bodies} smooth primitives of the corpus, "
        f"{apart / points:.1%} weld no longer: tips that are rigid as a whole. To part each copy whose own "
        f"triangles are rigid would open {simpler / points:.1%} of them."
    )


def halves(primitive: SkinnedPrimitive) -> Iterator[tuple[SkinnedPrimitive, SkinnedPrimitive]]:
    """Yield a primitive cut into two materials by planes."""
    centres = primitive.positions[primitive.triangles].mean(axis=1)
    for along in centres.T:
        for share in CUTS:
            below = along < np.quantile(along, share)
            if below.any() and not below.all():
                first, second = (replace_triangles(primitive, side) for side in (below, ~below))
                yield first, second


def replace_triangles(primitive: SkinnedPrimitive, kept: BoolArray) -> SkinnedPrimitive:
    """Return the primitive with some of its triangles, and all vertices."""
    return replace(primitive, triangles=primitive.triangles[kept])


def cut_points(*parts: SkinnedPrimitive) -> IntArray:
    """Return the welded points of a cut where weights vary: all, those that part, those by own triangles."""
    classes = weld_classes(parts)
    joints, shares = influence_keys(parts)
    influences = row_numbers(np.hstack([joints, shares.view(np.int32)]))
    start, count = len(parts[0].positions), int(classes.max()) + 1
    drawn, bending = np.zeros((2, 2, count), dtype=bool)
    triangles = [
        part.triangles.astype(np.int64) + first for part, first in zip(parts, (0, start), strict=True)
    ]
    for side, own in enumerate(triangles):
        drawn[side, classes[own]] = True
        bends = (influences[own] != influences[own[:, :1]]).any(axis=1)
        bending[side, classes[own[bends]]] = True
    seam = drawn.all(axis=0) & bending.any(axis=0)
    apart = with_rigid_parts(classes, parts, np.concatenate(triangles))
    return np.array(
        [seam.sum(), len(np.unique(apart)) - count, (seam & ~bending.all(axis=0)).sum()],
    )


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
    """Return mean, p99 and maximum of the error of accurate LBS normals by triangles, in degrees."""
    options = BakeOptions(gradients=Gradients.SURFACE, weld=weld, generate_normals=True)
    document = bake_document(read_document(str(path)), options).document
    normals = verify_document(document, VerifyOptions(methods=(Method.LBS,))).by_truth.get("triangles", {})
    found = normals[Method.LBS][Lighting.ACCURATE]
    return f"{found.mean:.3f} / {found.p99:.1f} / {found.max:.0f}"


if __name__ == "__main__":
    sys.exit(main())
