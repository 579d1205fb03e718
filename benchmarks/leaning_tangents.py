"""Show what one TANGENT that leans from the surface does to lighting: into docs/reference/frame.md.

Usage: python -m benchmarks.leaning_tangents [FILE] [--output FILE]

One TANGENT of a model is turned out of the surface. The model is then baked three times: with that TANGENT as
it is, with the normal frame, and as ``bake`` does, which straightens it. The part of the page between two
marks is written anew. Without a file, the model is the corpus's butterfly (SKINBAKE_CORPUS, or
../shared/corpus).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import numpy as np

from benchmarks.corpus_table import REPOSITORY, corpus_folders
from benchmarks.edge_noise import error_fields
from benchmarks.marked import write_between
from skinbake.choices import FrameChoice, Lighting, Truth
from skinbake.commands import surface_bake
from skinbake.commands.bake import Baker
from skinbake.gltf.animation import read_clips
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.primitives import skinned_sources
from skinbake.lighting.baked_views import baked_views
from skinbake.lighting.poses import PoseRequest, pose_set
from skinbake.lighting.rest_areas import RestAreas
from tests.support.gltf_reading import GltfFile, read
from tests.support.models import rewritten

DEFAULT_OUTPUT = REPOSITORY / "docs" / "reference" / "frame.md"
START, END = "<!-- leaning tangents: begin -->", "<!-- leaning tangents: end -->"
BUTTERFLY = Path("Butterfly", "animated_butterfly.glb")
LEANS = (0.0, 1.0, 10.0, 60.0)
WAYS = {
    "TANGENT as it is": FrameChoice.TANGENT,
    "normal frame": FrameChoice.NORMAL,
    "straightened": FrameChoice.AUTO,
}


def main() -> int:
    """Write the table into the page; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("file", type=Path, nargs="?", help="a GLB with TANGENT (default: the butterfly)")
    parser.add_argument("--output", type=Path, default=DEFAULT_OUTPUT, help="the page to write into")
    options = parser.parse_args()
    source = options.file or next((folder / BUTTERFLY for folder in corpus_folders()), None)
    if source is None:
        print("no model: name a file, or set SKINBAKE_CORPUS", file=sys.stderr)
        return 3
    text = "\n".join(table(source))
    print(text)
    write_between(options.output, START, END, text)
    return 0


def table(source: Path) -> Iterator[str]:
    """Yield the lines of the table: the errors of the vertex, and the mean of the file."""
    model = read(source)
    vertex = int(model.triangles(0)[0, 0])
    count = len(model.attribute("POSITION"))
    yield f"The TANGENT of one vertex of {count:,} leans (`{source.name}`). The figures are mean errors of"
    yield "normals by tangents, LBS, in the poses that `verify` takes: of that vertex, and of the file.\n"
    yield f"| lean | {' | '.join(WAYS)} | {' | '.join(f'file, {way}' for way in WAYS)} |"
    yield f"|--:|{'--:|' * (2 * len(WAYS))}"
    with TemporaryDirectory() as folder:
        for lean in LEANS:
            path = leaning(model, Path(folder, source.name), lean, vertex)
            errors = [lit(path, frame) for frame in WAYS.values()]
            cells = [f"{of[vertex]:.2f}°" for of, _ in errors] + [f"{mean:.4f}°" for _, mean in errors]
            yield f"| {lean:g}° | {' | '.join(cells)} |"


def leaning(model: GltfFile, target: Path, lean: float, vertex: int) -> Path:
    """Write a model with the TANGENT of a vertex turned towards its normal by degrees."""
    accessor = model.content["accessors"][model.primitive(0)["attributes"]["TANGENT"]]
    view = model.content["bufferViews"][accessor["bufferView"]]
    place = view.get("byteOffset", 0) + accessor.get("byteOffset", 0) + vertex * view.get("byteStride", 16)
    data = bytearray(model.binary_chunk or b"")
    tangent = np.frombuffer(data, "<f4", 3, place)
    normal = np.asarray(model.attribute("NORMAL"), np.float64)[vertex]
    turned = np.cos(np.radians(lean)) * tangent + np.sin(np.radians(lean)) * normal
    data[place : place + 12] = turned.astype("<f4").tobytes()
    return rewritten(GltfFile(target, model.content, bytes(data)), target)


def lit(path: Path, frame: FrameChoice) -> tuple[np.ndarray, float]:
    """Bake a model in a frame and light it: the mean error of each vertex (V,), and their mean by area."""
    as_it_is = patch.object(surface_bake, "with_straight_tangents", lambda primitive: primitive)
    with as_it_is if frame is FrameChoice.TANGENT else nullcontext():
        document = Baker(frame=frame).bake_document(read_document(str(path))).document
    return errors_of(document)


def errors_of(document: Document) -> tuple[np.ndarray, float]:
    """Return the mean error of each vertex of the first mesh (V,), and their mean by area."""
    (view,), _ = baked_views(document, skinned_sources(document)[0])
    poses = pose_set(document, 0, read_clips(document), PoseRequest())
    errors, valid = error_fields(document, [view], poses, "lbs")[Truth.TANGENTS, Lighting.ACCURATE, 0]
    areas = np.where(valid, RestAreas(document, 0).of(view.now), 0.0)
    by_vertex = (errors * valid).sum(axis=0) / np.maximum(valid.sum(axis=0), 1)
    return by_vertex, float((errors * areas).sum() / areas.sum())


if __name__ == "__main__":
    sys.exit(main())
