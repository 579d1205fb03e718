"""Bake real models with ``--gradients fitted`` and ``--neighbours extend``, and write what both are worth.

Usage: python -m benchmarks.fitted_poses [FOLDER] [--output FILE]

Each model below the folder is lit in poses that no bake has seen: its own clips at other times than the fit
samples, and all joints turned at random by up to 30° and 60°, with other random numbers. Without a folder,
the models are those of the corpus's public part. A part of docs/fitted.md between two marks is written anew.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.corpus_table import REPOSITORY, SUFFIXES, corpus_folders, told_apart
from benchmarks.lit_errors import Lit, measured
from benchmarks.marked import write_between
from skinbake.choices import USUAL_TRUTHS, Gradients, Neighbours, PoseKind, Truth
from skinbake.commands.bake import bake_document
from skinbake.commands.bake_options import BakeOptions
from skinbake.errors import SkinbakeError
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.reading.clips import read_clips
from skinbake.truth.poses import PoseRequest

DEFAULT_OUTPUT = REPOSITORY / "docs" / "fitted.md"
START, END = "<!-- pose figures: begin -->", "<!-- pose figures: end -->"

CLIPS = "clips"
POSES = {
    CLIPS: PoseRequest(),
    "±30°": PoseRequest(PoseKind.RANDOM, 20, float(np.radians(30.0)), 77),
    "±60°": PoseRequest(PoseKind.RANDOM, 20, float(np.radians(60.0)), 5),
}

BENDS = 0.02
"""The mean error of standard lighting in degrees below which a model does not bend in some poses."""

FEWEST = 20
"""A model with fewer vertices is a test of a file format. It has no surface on which a normal is known."""

KINDS = {
    "surface": (Gradients.SURFACE, Neighbours.ADOPT),
    "fitted": (Gradients.FITTED, Neighbours.ADOPT),
    "fitted, extend": (Gradients.FITTED, Neighbours.EXTEND),
}

ALIKE = 0.01
"""The relative difference of errors up to which models of as many vertices are one in two files."""

HELD_BACK = 47
"""The poses of all clips together, from end to end. The fit takes others: none at an end of a clip."""


@dataclass(frozen=True)
class Model:
    """One model: its vertices, and its lighting by poses and kind."""

    vertices: int
    lit: dict[str, dict[str, Lit]]


def main() -> int:
    """Write the figures into the page; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path, nargs="?", help="where the models lie (default: the corpus)")
    parser.add_argument("--output", type=Path, default=DEFAULT_OUTPUT, help="the page to write into")
    options = parser.parse_args()
    folder = options.folder or next(iter(corpus_folders()), None)
    if folder is None:
        print("no models: name a folder, or set SKINBAKE_CORPUS", file=sys.stderr)
        return 3
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)
    text = "\n".join(figures(list(models_of(paths))))
    write_between(options.output, START, END, text)
    return 0


def models_of(paths: Sequence[Path]) -> Iterator[Model]:
    """Yield every model that bends in its clips, each geometry once."""
    seen: list[tuple[object, float]] = []
    for path, name in zip(paths, told_apart(list(paths)), strict=True):
        print(f"{name} ...", file=sys.stderr, flush=True)
        try:
            model = lit_by_kinds(path)
        except SkinbakeError as error:
            print(f"  left out: {error.message}", file=sys.stderr)
            continue
        if model is None or model.vertices < FEWEST:
            continue
        poses, lit = next(iter(model.lit.items()))
        key, mean = (model.vertices, poses), lit["surface"].mean(Truth.TANGENTS)
        if not any(key == other and np.isclose(mean, there, rtol=ALIKE) for other, there in seen):
            seen.append((key, mean))
            yield model


def lit_by_kinds(path: Path) -> Model | None:
    """Bake a model in all ways and light it in all sets of poses. None if it has none, or does not bend."""
    baked: dict[str, Document] = {}
    vertices = 0
    for kind, (gradients, neighbours) in KINDS.items():
        options = BakeOptions(gradients=gradients, neighbours=neighbours, generate_normals=True)
        made = bake_document(read_document(str(path)), options)
        baked[kind] = made.document
        vertices = sum(counts.vertices for _, counts in made.primitives)
    lit: dict[str, dict[str, Lit]] = {}
    clips = len(read_clips(baked["surface"]))
    for poses, usual in POSES.items():
        held_back = usual._replace(samples=max(4, HELD_BACK // max(clips, 1)))
        request = held_back if poses == CLIPS else usual
        surface = measured(baked["surface"], request)
        bends = surface.mean(Truth.TANGENTS, "standard") > BENDS
        if bends and (poses != CLIPS or surface.from_clips):
            others = {kind: measured(baked[kind], request) for kind in KINDS if kind != "surface"}
            lit[poses] = {"surface": surface, **others}
    return Model(vertices, lit) if lit else None


def figures(models: Sequence[Model]) -> Iterator[str]:
    """Yield the lines of the page's part."""
    yield "Error left of that of `surface`, by triangles / tangents: the mean over the models.\n"
    others = [kind for kind in KINDS if kind != "surface"]
    yield f"| poses | models | {' | '.join(f'`{kind}`'.replace(', ', '`, `') for kind in others)} |"
    yield "|---|--:|" + "--:|" * len(others)
    for poses in POSES:
        chosen = [model.lit[poses] for model in models if poses in model.lit]
        cells = [
            " / ".join(
                f"{np.mean([ratio(lit, kind, truth) for lit in chosen]):.3f}" for truth in USUAL_TRUTHS
            )
            for kind in others
        ]
        yield f"| {poses} | {len(chosen)} | {' | '.join(cells)} |"
    yield ""
    cases = sum(len(model.lit) for model in models) * len(USUAL_TRUTHS)
    yield f"- Worse than `surface` by over 2 %, of {cases} cases: {len(worse(models, 'fitted'))}."
    lost = {
        kind: sum(
            lit[kind].mean(truth) > lit["surface"].mean(truth, "standard")
            for model in models
            for lit in model.lit.values()
            for truth in USUAL_TRUTHS
        )
        for kind in ("surface", "fitted")
    }
    counts = ", ".join(f"`{kind}` {count}" for kind, count in lost.items())
    yield f"- Worse than standard lighting, of {cases} cases: {counts}."


def ratio(lit: dict[str, Lit], kind: str, truth: str) -> float:
    """Return the mean error of one way over that of ``surface``, 1 where that has none."""
    before = lit["surface"].mean(truth)
    return lit[kind].mean(truth) / before if before else 1.0


def worse(models: Sequence[Model], kind: str) -> list[str]:
    """Return the poses of each case in which a way leaves over 2 % more error than ``surface``."""
    return [
        poses
        for model in models
        for poses, lit in model.lit.items()
        for truth in USUAL_TRUTHS
        if ratio(lit, kind, truth) > 1.02
    ]


if __name__ == "__main__":
    sys.exit(main())
