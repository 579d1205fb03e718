"""Bake real models with ``--gradients surface`` and with ``rig``, and write what the fit is worth.

Usage: python -m benchmarks.fitted_gradients [FOLDER] [--output FILE]

Each model below the folder is baked both ways, and lit in poses that no bake has seen: its own clips, and all
joints turned at random, by up to 30° and by up to 60°. Without a folder, the models are those of the corpus's
public part (SKINBAKE_CORPUS, or ../shared/corpus). The tubes of ``analytic_truth``, whose normals have a
formula, follow. The part of docs/fitted.md between two marks is written anew.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.analytic_truth import KINDS, SIZES, grown
from benchmarks.corpus_table import REPOSITORY, SUFFIXES, corpus_folders, told_apart
from benchmarks.edge_noise import Lit, measured
from benchmarks.marked import write_between
from skinbake.choices import Gradients, PoseKind, Truth
from skinbake.commands.bake import Baker
from skinbake.errors import SkinbakeError
from skinbake.gltf.document import read_document
from skinbake.gltf.primitives import read_primitive, skinned_sources
from skinbake.lighting.poses import PoseRequest

DEFAULT_OUTPUT = REPOSITORY / "docs" / "fitted.md"
START, END = "<!-- fitted figures: begin -->", "<!-- fitted figures: end -->"

CLIPS, BY_30, BY_60 = "clips", "±30°", "±60°"
POSES = {
    CLIPS: PoseRequest(),
    BY_30: PoseRequest(PoseKind.RANDOM, 20, float(np.radians(30.0)), 77),
    BY_60: PoseRequest(PoseKind.RANDOM, 20, float(np.radians(60.0)), 5),
}
BENDS = 0.02
"""The mean error of standard lighting in degrees below which a model does not bend in some poses."""

MOST_LISTED = 12

FEWEST = 20
"""A model with fewer vertices is a test of a file format. It has no surface on which a normal is known."""

WORSE = 1.02
BOTH = Gradients.SURFACE, Gradients.RIG
Pair = tuple[Lit, Lit]
"""A model's lighting with the gradients of the surface, and with the fitted ones."""


@dataclass(frozen=True)
class Model:
    """One model: its name, its vertices, and by set of poses its lighting baked both ways."""

    name: str
    vertices: int
    lit: dict[str, Pair]

    def ratio(self, poses: str, truth: str, method: str = "lbs", lighting: str = "accurate") -> float:
        """Return the fitted mean error over that of the surface's gradients, NaN without poses."""
        if poses not in self.lit:
            return np.nan
        surface, rig = (lit.mean(truth, method, lighting) for lit in self.lit[poses])
        return rig / surface if surface else np.nan

    def gain(self, poses: str, truth: str, which: int) -> float:
        """Return the standard mean error over the accurate one: of surface (0) or rig (1)."""
        lit = self.lit[poses][which]
        return lit.mean(truth, lighting="approximated") / lit.mean(truth)

    def noise(self, poses: str, truth: str, *, squared: bool) -> float:
        """Return the fitted change of the error over an edge over that of the surface's gradients."""
        surface, rig = (lit.change(truth, squared=squared) for lit in self.lit[poses])
        return rig / surface if surface else np.nan


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
    text = "\n".join(figures(list(without_twins(models_of(paths)))))
    write_between(options.output, START, END, text)
    return 0


def models_of(paths: Sequence[Path]) -> Iterator[Model]:
    """Yield every model that bends."""
    for path, name in zip(paths, told_apart(list(paths)), strict=True):
        print(f"{name} ...", file=sys.stderr, flush=True)
        try:
            model = lit_both_ways(path, name)
        except SkinbakeError as error:
            print(f"  left out: {error.message}", file=sys.stderr)
            continue
        if model.lit:
            yield model


def lit_both_ways(path: Path, name: str) -> Model:
    """Bake a model both ways and light it in all sets of poses."""
    bakes = [
        Baker(gradients=gradients, generate_normals=True).bake_document(read_document(str(path)))
        for gradients in BOTH
    ]
    lit: dict[str, Pair] = {}
    for poses, request in POSES.items():
        surface, rig = (measured(bake.document, request, with_dqs=True) for bake in bakes)
        bends = surface.mean(Truth.TANGENTS, lighting="approximated") > BENDS
        if bends and (poses != CLIPS or surface.from_clips):
            lit[poses] = surface, rig
    document = bakes[0].document
    sources = skinned_sources(document)[0]
    vertices = sum(len(read_primitive(document, source).positions) for source in sources)
    return Model(name, vertices, lit)


def without_twins(models: Iterator[Model]) -> Iterator[Model]:
    """Yield the models without those that have the vertices and the errors of an earlier one."""
    seen = set()
    for model in models:
        poses = next(iter(model.lit))
        surface = model.lit[poses][0]
        key = model.vertices, round(surface.mean(Truth.TANGENTS), 2), round(surface.mean(Truth.TRIANGLES), 2)
        if key not in seen:
            seen.add(key)
            yield model


def figures(models: Sequence[Model]) -> Iterator[str]:
    """Yield the lines of the page's part."""
    real = [model for model in models if model.vertices >= FEWEST]
    small = [model for model in models if model.vertices < FEWEST]
    yield f"### {len(real)} models\n"
    yield from means(real)
    yield "\n### By model\n"
    yield from table(real)
    yield ""
    yield from remarks(real)
    if small:
        yield f"\n### Test files of less than {FEWEST} vertices\n"
        yield from table(small)
        yield ""
        yield from remarks(small)
    yield "\n### Noise\n"
    yield from noise(real)
    yield "\n### Against formulas\n"
    yield from analytic()


def means(models: Sequence[Model]) -> Iterator[str]:
    """Yield the table of ratios of all models."""
    yield "`rig` / `surface`: mean / median over the models, LBS where nothing else is said.\n"
    yield "| poses | models | by tangents | by triangles | DQS exact, by tangents | by triangles |"
    yield "|---|--:|--:|--:|--:|--:|"
    for poses in POSES:
        chosen = [model for model in models if poses in model.lit]
        cells = [mean_of(model.ratio(poses, truth) for model in chosen) for truth in Truth]
        cells += [mean_of(model.ratio(poses, truth, "dqs", "exact") for model in chosen) for truth in Truth]
        yield f"| {poses} | {len(chosen)} | {' | '.join(cells)} |"


def mean_of(ratios: Iterator[float]) -> str:
    """Return mean and median of the ratios that are known."""
    known = [ratio for ratio in ratios if np.isfinite(ratio)]
    return f"{np.mean(known):.3f} / {np.median(known):.3f}" if known else "—"


def table(models: Sequence[Model]) -> Iterator[str]:
    """Yield a table of errors: standard → surface → rig, by both truths, in all sets of poses."""
    head = " | ".join(f"{poses}, by tangents | by triangles" for poses in POSES)
    yield f"| model | vertices | {head} | DQS exact, {CLIPS} |"
    yield "|---|--:|" + "--:|" * (2 * len(POSES) + 1)
    for model in models:
        cells = [errors(model, poses, truth) for poses in POSES for truth in Truth]
        cells.append(errors(model, CLIPS, Truth.TANGENTS, "dqs", "exact"))
        yield f"| {model.name} | {model.vertices:,} | {' | '.join(cells)} |"


def errors(model: Model, poses: str, truth: str, method: str = "lbs", lighting: str = "accurate") -> str:
    """Return the mean errors of standard lighting, surface and rig, in degrees."""
    if poses not in model.lit:
        return "—"
    surface, rig = model.lit[poses]
    values = (
        surface.mean(truth, method, "approximated"),
        surface.mean(truth, method, lighting),
        rig.mean(truth, method, lighting),
    )
    return " → ".join(f"{value:.2f}" for value in values) if np.isfinite(values).all() else "—"


def remarks(models: Sequence[Model]) -> Iterator[str]:
    """Yield the models that the fit makes worse, and those that standard lighting serves better."""
    cases = [(model, poses, truth) for model in models for poses in model.lit for truth in Truth]
    worse = [
        f"{model.name} ({poses}, by {truth}: {100 * (model.ratio(poses, truth) - 1):.0f} %)"
        for model, poses, truth in cases
        if model.ratio(poses, truth) > WORSE
    ]
    yield f"- Worse than `surface` by more than {100 * (WORSE - 1):.0f} %: {'; '.join(worse) or 'none'}."
    for which, kind in enumerate(BOTH):
        lost = [
            f"{model.name} ({poses}, by {truth}: {model.gain(poses, truth, which):.2f} ×)"
            for model, poses, truth in cases
            if model.gain(poses, truth, which) < 1.0
        ]
        names = len({one.split(" (")[0] for one in lost})
        listed = f": {'; '.join(lost)}" if which and len(lost) <= MOST_LISTED else ""
        yield (
            f"- Worse than standard lighting with `{kind}`, in one or more of these {len(cases)} cases: "
            f"{len(lost)}, in {names} of the models{listed}."
        )


def noise(models: Sequence[Model]) -> Iterator[str]:
    """Yield the table of the change of the error over an edge."""
    yield "| model | " + " | ".join(f"{poses}, by tangents | by triangles" for poses in POSES) + " |"
    yield "|---|" + "--:|" * (2 * len(POSES))
    for model in models:
        cells = [changes(model, poses, truth) for poses in POSES for truth in Truth]
        yield f"| {model.name} | {' | '.join(cells)} |"
    for squared, name in ((True, "root mean square"), (False, "mean")):
        cells = [
            mean_of(model.noise(poses, truth, squared=squared) for model in models if poses in model.lit)
            for poses in POSES
            for truth in Truth
        ]
        yield f"| `rig` / `surface` of the {name}: mean / median | {' | '.join(cells)} |"
    yield ""
    for squared, name in ((True, "root mean square"), (False, "mean")):
        more = [
            f"{model.name} ({poses}, by {truth}: {100 * (ratio - 1):.0f} %)"
            for model in models
            for poses in model.lit
            for truth in Truth
            if (ratio := model.noise(poses, truth, squared=squared)) > WORSE
        ]
        yield f"- {name.capitalize()} above that of `surface` by more than 2 %: {'; '.join(more) or 'none'}."


def changes(model: Model, poses: str, truth: str) -> str:
    """Return the changes over an edge of standard lighting, surface and rig, in degrees."""
    if poses not in model.lit:
        return "—"
    surface, rig = model.lit[poses]
    values = surface.change(truth, "approximated"), surface.change(truth), rig.change(truth)
    return " → ".join(f"{value:.2f}" for value in values)


def analytic() -> Iterator[str]:
    """Yield the table of tubes: errors against the formula."""
    yield "| weights | vertices | standard | surface | rig | rig / surface |"
    yield "|---|--:|--:|--:|--:|--:|"
    for kind, weights in KINDS.items():
        for size in SIZES:
            surface, rig = (grown(weights, *size, gradients=one) for one in BOTH)
            yield (
                f"| {kind} | {rig.vertices:,} | {rig.standard:.3f}° | {surface.accurate:.3f}° "
                f"| {rig.accurate:.3f}° | {rig.accurate / surface.accurate:.3f} |"
            )


if __name__ == "__main__":
    sys.exit(main())
