"""Change one rule of the fit to the rig at a time, and write what each rule is worth.

Usage: python -m benchmarks.fit_rules [FOLDER] [--output FILE]

The models, the poses and the tubes are those of ``benchmarks.fitted_gradients``. Each row bakes all of them
anew with one constant changed. The part of docs/fitted.md between two marks is written anew.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias
from unittest.mock import patch

import numpy as np

from benchmarks.analytic_truth import KINDS, grown
from benchmarks.corpus_table import SUFFIXES, corpus_folders, told_apart
from benchmarks.edge_noise import Lit, measured
from benchmarks.fitted_gradients import BENDS, CLIPS, DEFAULT_OUTPUT, FEWEST, POSES
from benchmarks.marked import write_between
from skinbake.choices import Gradients, Truth
from skinbake.commands.bake import Baker
from skinbake.errors import SkinbakeError
from skinbake.geometry import rig
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.primitives import read_primitive, skinned_sources
from skinbake.gradients import by_loops, by_numpy, corner, fit_rules, kernel, rig_fit, ring_turns

START, END = "<!-- rule figures: begin -->", "<!-- rule figures: end -->"

HOLDERS = (fit_rules, rig_fit, ring_turns, by_loops, rig)
"""The modules that hold the constants of the fit, or name them."""

TUBES = ((11, 16), (17, 24))
"""Vertices around smooth tubes and along them, the seam's copies included."""


RULES: dict[str, dict[str, Any]] = {
    "as it is": {},
    "angles as the weights of triangles": {"ROOT": corner.ANGLE},
    "the weights of tangents": {"ROOT": corner.MAX},
    "the weights of tangents, missing joints pull no harder": {"ROOT": corner.MAX, "MISSING": 0.0},
    "missing joints pull no harder": {"MISSING": 0.0},
    "no doubt": {"DOUBT": 1e-9},
    "the doubt as large on smooth meshes as elsewhere": {"MOST_DOUBT": 1.0},
    "the doubt up to 0.06": {"MOST_DOUBT": 6.0},
    "the doubt 0.04 everywhere": {"DOUBT": 0.04, "MOST_DOUBT": 1.0},
    "λ = 0.06": {"STIFFNESS": 0.06},
    "λ = 0.24": {"STIFFNESS": 0.24},
    "joints that are hardly there are fitted like others": {"FAINT": 0.0},
    "the stored pose does not count": {"STORED": 0.0},
    "the stored pose counts 4": {"STORED": 4.0},
    "chains do not curl": {"TOGETHER": 0.0},
    "chains of four joints are long": {"LONG_CHAIN": 4},
}


Ratios: TypeAlias = dict[str, dict[tuple[str, str], float]]
"""By model, and by poses and truth: the error with the fit over that with the gradients of the surface."""

RANDOM = "random:200"
"""The poses of the last row, to which α and β are fitted after the rules as they are."""


@dataclass(frozen=True)
class Model:
    """One model: its path and name, and its lighting with the gradients of the surface by set of poses."""

    path: Path
    name: str
    surface: Mapping[str, Lit]


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
    """Yield every model that bends and is no test of a file format, each geometry once."""
    seen = set()
    for path, name in zip(paths, told_apart(list(paths)), strict=True):
        try:
            document = baked(path, Gradients.SURFACE)
        except SkinbakeError as error:
            print(f"{name} left out: {error.message}", file=sys.stderr)
            continue
        sources = skinned_sources(document)[0]
        vertices = sum(len(read_primitive(document, source).positions) for source in sources)
        lit = {
            poses: found
            for poses, found in lit_by(document).items()
            if found.mean(Truth.TANGENTS, lighting="approximated") > BENDS
            and (poses != CLIPS or found.from_clips)
        }
        if vertices < FEWEST or not lit:
            continue
        first = next(iter(lit.values()))
        key = vertices, round(first.mean(Truth.TANGENTS), 2), round(first.mean(Truth.TRIANGLES), 2)
        if key not in seen:
            seen.add(key)
            yield Model(path, name, lit)


def baked(path: Path, kind: Gradients, fit_poses: Sequence[str] = ()) -> Document:
    """Bake a model with one kind of gradients."""
    baker = Baker(gradients=kind, fit_poses=tuple(fit_poses), generate_normals=True)
    return baker.bake_document(read_document(str(path))).document


def lit_by(document: Document) -> dict[str, Lit]:
    """Light a baked model in all sets of poses."""
    return {poses: measured(document, request, with_dqs=False) for poses, request in POSES.items()}


def figures(models: Sequence[Model]) -> Iterator[str]:
    """Yield the lines of the page's part."""
    cases = sum(len(model.surface) for model in models) * len(Truth)
    yield f"`rig` / `surface`: the mean over {len(models)} models in each set of poses, by tangents / by"
    yield f"triangles; the largest of all {cases} cases; the cases where `rig` is worse than standard"
    yield "lighting; and on two tubes with smooth weights, against the formula:\n"
    tubes = [grown(KINDS["smooth"], *size, gradients=Gradients.SURFACE) for size in TUBES]
    heads = [*POSES, "largest", "worse than standard", *(f"tube of {tube.vertices}" for tube in tubes)]
    yield f"| the fit with | {' | '.join(heads)} |"
    yield f"|---|{'--:|' * len(heads)}"
    for name, constants in RULES.items():
        print(f"{name} ...", file=sys.stderr, flush=True)
        with changed(constants):
            ratios, lost = ratios_of(models)
            fitted = [grown(KINDS["smooth"], *size, gradients=Gradients.RIG) for size in TUBES]
        ends = [f"{rig.accurate / plain.accurate:.2f}" for rig, plain in zip(fitted, tubes, strict=True)]
        yield row(name, ratios, lost, ends)
    name = f"as it is, then fitted to 200 random poses of up to 45° (`--fit-poses {RANDOM}`)"
    yield row(name, *ratios_of(models, Gradients.POSES, [RANDOM]), ["—"] * len(tubes))


def row(name: str, ratios: Ratios, lost: Counter[str], ends: Sequence[str]) -> str:
    """Return one row of the table, which ends with the cells of the tubes."""
    cells = [
        " / ".join(
            f"{np.mean([of[poses, truth] for of in ratios.values() if (poses, truth) in of]):.3f}"
            for truth in Truth
        )
        for poses in POSES
    ]
    largest, worst = max((max(of.values()), model) for model, of in ratios.items())
    cells.append(f"{largest:.2f}, {worst}")
    cells.append(f"{sum(lost.values())}: {', '.join(lost)}" if lost else "none")
    return f"| {' | '.join([name, *cells, *ends])} |"


def ratios_of(
    models: Sequence[Model], kind: Gradients = Gradients.RIG, fit_poses: Sequence[str] = ()
) -> tuple[Ratios, Counter[str]]:
    """Return the error that the fit leaves of that of the surface's gradients, by model, poses and truth.

    Also return by model the number of cases in which the fit leaves more than standard lighting has.
    """
    found: Ratios = {}
    lost: Counter[str] = Counter()
    for model in models:
        lit = lit_by(baked(model.path, kind, fit_poses))
        cases = [(poses, truth) for poses in model.surface for truth in Truth]
        found[model.name] = {
            (poses, truth): lit[poses].mean(truth) / model.surface[poses].mean(truth)
            for poses, truth in cases
        }
        worse = sum(
            lit[poses].mean(truth) > lit[poses].mean(truth, lighting="approximated") for poses, truth in cases
        )
        if worse:
            lost[model.name] = worse
    return found, lost


@contextmanager
def changed(constants: Mapping[str, Any]) -> Iterator[None]:
    """Let the fit take other constants. The weights of triangles are fixed in the compiled loops."""
    with ExitStack() as stack:
        for name, value in constants.items():
            holders = [module for module in HOLDERS if hasattr(module, name)]
            if not holders:
                raise ValueError(f"the fit has no constant {name}")
            for module in holders:
                stack.enter_context(patch.object(module, name, value))
        if "ROOT" in constants:
            stack.enter_context(patch.object(kernel, "bake_surface", by_numpy.bake_surface))
        yield


if __name__ == "__main__":
    sys.exit(main())
