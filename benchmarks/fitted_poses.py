"""Bake real models with ``--gradients poses`` and ``--neighbours extend``, and write what both are worth.

Usage: python -m benchmarks.fitted_poses [FOLDER] [--output FILE]

Each model below the folder is lit in poses that no bake has seen: its own clips at other times than the fit
samples, and all joints turned at random by up to 30° and 60°, with other random numbers. Without a folder,
the models are those of the corpus's public part. A part of docs/fitted.md between two marks is written anew.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.corpus_table import SUFFIXES, corpus_folders, told_apart
from benchmarks.edge_noise import Lit, measured
from benchmarks.fitted_gradients import BENDS, CLIPS, DEFAULT_OUTPUT, FEWEST, POSES, mean_of
from benchmarks.marked import write_between
from skinbake.choices import Gradients, Neighbours, Truth
from skinbake.commands.bake import Baker
from skinbake.errors import SkinbakeError
from skinbake.gltf.animation import read_clips
from skinbake.gltf.document import Document, read_document

START, END = "<!-- pose figures: begin -->", "<!-- pose figures: end -->"

KINDS = {
    "surface": (Gradients.SURFACE, Neighbours.ADOPT),
    "rig": (Gradients.RIG, Neighbours.ADOPT),
    "poses": (Gradients.POSES, Neighbours.ADOPT),
    "rig, extend": (Gradients.RIG, Neighbours.EXTEND),
    "poses, extend": (Gradients.POSES, Neighbours.EXTEND),
}

ALIKE = 0.01
"""The relative difference of errors up to which models of as many vertices are one in two files."""

HELD_BACK = 47
"""The poses of all clips together, from end to end. The fit takes others: none at an end of a clip."""


@dataclass(frozen=True)
class Model:
    """One model: its name, its vertices, those that extend serves, and its lighting by poses and kind."""

    name: str
    vertices: int
    extended: int
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
            model = lit_by_kinds(path, name)
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


def lit_by_kinds(path: Path, name: str) -> Model | None:
    """Bake a model in all ways and light it in all sets of poses. None if it has none, or does not bend."""
    baked: dict[str, Document] = {}
    vertices = extended = 0
    for kind, (gradients, neighbours) in KINDS.items():
        baker = Baker(gradients=gradients, neighbours=neighbours, generate_normals=True)
        made = baker.bake_document(read_document(str(path)))
        baked[kind] = made.document
        vertices = sum(counts.vertices for _, counts in made.primitives)
        extended = sum(counts.extended.vertices for _, counts in made.primitives if counts.extended)
    lit: dict[str, dict[str, Lit]] = {}
    clips = len(read_clips(baked["surface"]))
    for poses, usual in POSES.items():
        held_back = replace(usual, samples=max(4, HELD_BACK // max(clips, 1)))
        request = held_back if poses == CLIPS else usual
        surface = measured(baked["surface"], request, with_dqs=False)
        bends = surface.mean(Truth.TANGENTS, lighting="approximated") > BENDS
        if bends and (poses != CLIPS or surface.from_clips):
            others = {
                kind: measured(baked[kind], request, with_dqs=False) for kind in KINDS if kind != "surface"
            }
            lit[poses] = {"surface": surface, **others}
    return Model(name, vertices, extended, lit) if lit else None


def figures(models: Sequence[Model]) -> Iterator[str]:
    """Yield the lines of the page's part."""
    yield "What each way leaves of the error of `surface`: mean / median over the models, LBS.\n"
    others = [kind for kind in KINDS if kind != "surface"]
    yield (
        "| poses | models | " + " | ".join(f"`{kind}`, by tangents | by triangles" for kind in others) + " |"
    )
    yield "|---|--:|" + "--:|" * (2 * len(others))
    for poses in POSES:
        chosen = [model.lit[poses] for model in models if poses in model.lit]
        cells = [mean_of(ratio(lit, kind, truth) for lit in chosen) for kind in others for truth in Truth]
        yield f"| {poses} | {len(chosen)} | {' | '.join(cells)} |"
    yield f"\nMean errors in degrees in the {CLIPS}, by tangents / by triangles:\n"
    yield "| model | vertices | extended for | standard | " + " | ".join(KINDS) + " |"
    yield "|---|--:|--:|" + "--:|" * (len(KINDS) + 1)
    for model in models:
        if CLIPS in model.lit:
            lit = model.lit[CLIPS]
            cells = [
                degrees(lit["surface"], "approximated"),
                *(degrees(lit[kind], "accurate") for kind in KINDS),
            ]
            yield f"| {model.name} | {model.vertices:,} | {model.extended:,} | {' | '.join(cells)} |"
    yield ""
    worst = worse(models, "poses", "surface")
    listed = "; ".join(f"{where}: {100 * (found - 1):.0f} %)" for where, found in worst)
    yield f"- `poses` worse than `surface` by more than 2 %: {listed or 'never'}."
    cases = sum(len(model.lit) for model in models) * len(Truth)
    than_rig = list(worse(models, "poses", "rig"))
    in_clips = sum(f"({CLIPS}" in where for where, _ in than_rig)
    counted = f"in {len(than_rig)} of {cases} cases, {in_clips} of them in {CLIPS}"
    yield f"- `poses` worse than `rig` by more than 2 %: {counted}."


def ratio(lit: dict[str, Lit], kind: str, truth: str, other: str = "surface") -> float:
    """Return the mean error of one way over that of another, NaN where the other has none."""
    before = lit[other].mean(truth)
    return lit[kind].mean(truth) / before if before else np.nan


def degrees(lit: Lit, lighting: str) -> str:
    """Return the mean errors by both truths."""
    return " / ".join(f"{lit.mean(truth, lighting=lighting):.2f}" for truth in Truth)


def worse(models: Sequence[Model], kind: str, other: str) -> Iterator[tuple[str, float]]:
    """Yield the cases in which one way leaves over 2 % more error than another, with the ratio."""
    for model in models:
        for poses, lit in model.lit.items():
            for truth in Truth:
                found = ratio(lit, kind, truth, other)
                if found > 1.02:
                    yield f"{model.name} ({poses}, by {truth}", found


if __name__ == "__main__":
    sys.exit(main())
