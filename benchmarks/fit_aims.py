"""Compare aims of the fit by all three truths, and choose between them with families of characters left out.

Usage: python -m benchmarks.fit_aims [FOLDER]

A candidate is a part of the drawn mesh in the aim (``DRAWN``; the rest is the smooth surface), with other
constants of ``fit_rules``, or with a rule left out. Every model is lit in its own clips and in random poses
of ±30° and ±60°, which no bake has seen. The figures are mean errors over those of ``surface``, by tangents,
by triangles, and by *fine*; then the largest regret: how much worse a mean is than that of the best
candidate, over all truths and poses. Each family of models is left out once: the candidate of the least
regret on the others is chosen, and judged on it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from unittest.mock import patch

import numpy as np

from benchmarks.corpus_table import SUFFIXES, corpus_folders, told_apart
from benchmarks.fitted_poses import BENDS, CLIPS, FEWEST, HELD_BACK, POSES
from benchmarks.lit_errors import WITHOUT_NORMAL
from skinbake.choices import Gradients, Neighbours
from skinbake.commands.bake import bake_document
from skinbake.commands.bake_options import BakeOptions
from skinbake.errors import SkinbakeError
from skinbake.freshness.baked_views import (
    BakedView,
    baked_views,
    gathered_together,
    rest_primitive,
    whole_surfaces,
)
from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.reading.clips import Clip, read_clips
from skinbake.gltf.reading.meshes import skinned_sources
from skinbake.gltf.reading.skins import fitting_rig
from skinbake.gradients import by_loops
from skinbake.gradients.baker import bake_primitives
from skinbake.skinning.algorithms import Algorithm
from skinbake.skinning.rest import Options
from skinbake.threads import Threads
from skinbake.truth import kernel
from skinbake.truth.areas import RestAreas
from skinbake.truth.blending import BlendedPrimitive, sides_of
from skinbake.truth.fine import FineMesh
from skinbake.truth.operator import true_operator
from skinbake.truth.poses import PoseRequest, draws_of, pose_set
from skinbake.truth.truths import PosedSurface, Truths

AIMS: Mapping[str, Mapping[str, float]] = {
    **{f"drawn {part:g}": {"DRAWN": part} for part in (1.0, 0.75, 0.6, 0.5, 0.4, 0.25)},
    "half, λ 0.03": {"STIFFNESS": 0.03},
    "half, λ 0.25": {"STIFFNESS": 0.25},
    "half, no chains": {"TOGETHER": 0.0},
    "half, no stored pose": {"STORED": 0.0},
}
"""The constants of each candidate that differ from those of the default."""

TRUTHS = "tangents", "triangles", "fine"

SAMPLES = {CLIPS: 24, "±30°": 10, "±60°": 10}
"""The poses of a model. Half of those of ``fitted_poses`` tell candidates apart."""


@dataclass(frozen=True)
class Model:
    """One model: its name, its family, and the ratios (3 truths) to ``surface`` by poses and candidate."""

    name: str
    family: str
    ratios: dict[str, dict[str, Float64Array]]


def main() -> int:
    """Print the figures; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path, nargs="?", help="where the models lie (default: the corpus)")
    options = parser.parse_args()
    folder = options.folder or next(iter(corpus_folders()), None)
    if folder is None:
        print("no models: name a folder, or set SKINBAKE_CORPUS", file=sys.stderr)
        return 3
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)
    models = list(models_of(paths))
    print("\n".join(figures(models)))
    print("\n".join(choices(models)))
    return 0


def models_of(paths: Sequence[Path]) -> Iterator[Model]:
    """Yield every model that bends. Models of one folder are one family."""
    seen: set[tuple[int, float]] = set()
    for path, name in zip(paths, told_apart(list(paths)), strict=True):
        print(f"{name} ...", file=sys.stderr, flush=True)
        try:
            model = lit_by_aims(path, name, seen)
        except SkinbakeError as error:
            print(f"  left out: {error.message}", file=sys.stderr)
            continue
        if model is not None:
            yield model


def lit_by_aims(path: Path, name: str, seen: set[tuple[int, float]]) -> Model | None:
    """Fit a model with every aim, and light it. None if it has a twin in ``seen``, or does not bend."""
    made = bake_document(
        read_document(str(path)), BakeOptions(gradients=Gradients.SURFACE, generate_normals=True)
    )
    document, vertices = made.document, sum(counts.vertices for _, counts in made.primitives)
    if vertices < FEWEST:
        return None
    views, clips = baked_views(document, skinned_sources(document)), read_clips(document)
    plain: Slots = {id(view): (view.alpha, view.beta) for view in views}
    slots = {aim: fitted(document, views, constants) for aim, constants in AIMS.items()}
    ratios: dict[str, dict[str, Float64Array]] = {}
    for poses, usual in POSES.items():
        request = usual._replace(samples=SAMPLES[poses])
        if poses == CLIPS:  # between the samples of the fit and those of verify
            count = max(3, SAMPLES[poses] // max(len(clips), 1))
            request = usual._replace(samples=count, offset=0.37, most=HELD_BACK)
        surfaces = list(surfaces_in(document, views, clips, request))
        if poses == CLIPS and not all(one.from_clips for one in surfaces):
            continue
        standard, before = (
            mean_errors(surfaces, plain, one) for one in (Algorithm.LBS_STANDARD, Algorithm.LBS_ACCURATE)
        )
        if not standard[0] > BENDS:
            continue
        if not ratios:
            twin = vertices, round(float(standard[0]), 2)
            if twin in seen:
                return None
            seen.add(twin)
        ratios[poses] = {
            aim: mean_errors(surfaces, found, Algorithm.LBS_ACCURATE) / before for aim, found in slots.items()
        }
    return Model(name, path.parent.name, ratios) if ratios else None


Slots = dict[int, tuple[FloatArray, FloatArray]]
"""α and β (V, K − 1) of each view, by its identity."""


def fitted(document: Document, views: Sequence[BakedView], constants: Mapping[str, float]) -> Slots:
    """Return the fit itself, which no bake has held to standard lighting yet, in the slots of the views."""
    found: Slots = {}
    settings = BakeOptions().settings._replace(neighbours=Neighbours.DROP)
    for surface in gathered_together(document, views):
        rig = fitting_rig(document, surface[0].source)
        with rules(constants):
            bakes = bake_primitives([view.now for view in surface], settings, rig)
        found |= {id(view): (bake.alpha, bake.beta) for view, (bake, _) in zip(surface, bakes, strict=True)}
    return found


@dataclass(frozen=True)
class SeenSurface:
    """A surface as a skin draws it: its views, the areas (V,) of all vertices, and joint matrices.

    matrices are (P, J, 4, 4). normals (3, 3, V, P) are the true normals by ``TRUTHS``, exist (3, V, P) tells
    where they are. sides (P, V) are those of ``sides_of``.
    """

    views: Sequence[BakedView]
    areas: Float64Array
    matrices: Float64Array
    normals: Float64Array
    exist: BoolArray
    sides: Float64Array | None
    from_clips: bool


def surfaces_in(
    document: Document, views: Sequence[BakedView], clips: Sequence[Clip], request: PoseRequest
) -> Iterator[SeenSurface]:
    """Yield the surfaces of a document in some poses, as they are without morph targets."""
    for together in whole_surfaces(document, views):
        operator, rest = true_operator([view.now for view in together]), list(map(rest_primitive, together))
        mesh = FineMesh.of(operator)
        for skin, node in draws_of(document, together[0].source.mesh, clips):
            poses, space = pose_set(document, skin, clips, request, node), RestAreas(document, skin)
            matrices, every = poses.joint_matrices, slice(0, len(poses.clips))
            truths = Truths.of(operator, rest, len(matrices), fine=mesh)
            assert truths.fine is not None
            sides = sides_of(rest, matrices)
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # as verify measures
                moved = [
                    BlendedPrimitive(one, matrices, Options()).positions(every, slice(0, len(one.positions)))
                    for one in (*rest, truths.fine.points)
                ]
                posed = [
                    PosedSurface.of(part, np.concatenate(pieces, axis=1), Threads(1))
                    for part, pieces in ((truths, moved[:-1]), (truths.fine.truths, moved))
                ]
                blocks = [
                    [
                        surface.normals(block.number, None if sides is None else sides[:, block.part])
                        for block in truths.vertex_blocks
                    ]
                    for surface in posed
                ]
            yield SeenSurface(
                together,
                np.concatenate([space.of(view.now) for view in together]),
                matrices,
                np.concatenate([np.concatenate([one for one, _ in part], axis=2) for part in blocks]),
                np.concatenate([np.concatenate([one for _, one in part], axis=1) for part in blocks]),
                sides,
                None not in poses.times,
            )


def mean_errors(surfaces: Sequence[SeenSurface], slots: Slots, algorithm: Algorithm) -> Float64Array:
    """Return the mean errors (3,) by ``TRUTHS`` in degrees, by area; never 0."""
    sums = np.zeros((2, 3))
    for seen in surfaces:
        every = slice(0, len(seen.matrices))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # likewise
            parts = []
            for view in seen.views:
                alpha, beta = slots[id(view)]
                rest = replace(rest_primitive(view), alpha=alpha, beta=beta)
                blended = BlendedPrimitive(rest, seen.matrices, Options())
                parts.append(np.stack(blended.normals([algorithm], every, slice(0, len(alpha)))[0]))
            normals = np.concatenate(parts, axis=2)
            if seen.sides is not None and algorithm is Algorithm.LBS_ACCURATE:
                normals = normals * seen.sides
            errors = kernel.angles(tuple(normals), seen.normals)
        counted = np.where(seen.exist, np.maximum(seen.areas, 0.0)[None, :, None], 0.0)
        known = np.where(np.isfinite(errors), errors, WITHOUT_NORMAL)
        sums += (known * counted).sum(axis=(1, 2)), counted.sum(axis=(1, 2))
    return np.asarray(np.maximum(sums[0] / sums[1], 1e-9))


@contextmanager
def rules(constants: Mapping[str, float]) -> Iterator[None]:
    """Let the compiled loops fit with other constants."""
    with ExitStack() as stack:
        for name, value in constants.items():
            stack.enter_context(patch.object(by_loops, name, value))
        yield


def table_of(models: Sequence[Model]) -> Float64Array:
    """Return the mean ratios (candidates, 3 P): all truths in all kinds of poses."""
    return np.stack(
        [
            np.concatenate(
                [
                    np.mean([model.ratios[poses][aim] for model in models if poses in model.ratios], axis=0)
                    for poses in POSES
                    if any(poses in model.ratios for model in models)
                ]
            )
            for aim in AIMS
        ]
    )


def regrets_of(table: Float64Array) -> Float64Array:
    """Return the largest regret (candidates,) of each row."""
    return np.asarray((table / table.min(axis=0)).max(axis=1) - 1.0)


def figures(models: Sequence[Model]) -> Iterator[str]:
    """Yield the table of all candidates: means by poses, largest regret, largest ratio by the drawn mesh."""
    table = table_of(models)
    yield f"| aim | {' | '.join(POSES)} | largest regret | largest ratio by tangents or triangles |"
    yield "|---|" + "--:|" * (len(POSES) + 2)
    for aim, row, regret in zip(AIMS, table, regrets_of(table), strict=True):
        cells = [" / ".join(f"{mean:.3f}" for mean in part) for part in row.reshape(-1, 3)]
        worst, place = max(
            (float(ratio[aim][:2].max()), f"{model.name}, {poses}")
            for model in models
            for poses, ratio in model.ratios.items()
        )
        yield f"| {aim} | {' | '.join(cells)} | {100 * regret:.1f} % | {worst:.3f} ({place}) |"


def choices(models: Sequence[Model]) -> Iterator[str]:
    """Yield what is chosen with each family left out, and how that does on the families left out."""
    families = sorted({model.family for model in models})
    chosen: dict[str, str] = {}
    for family in families:
        others = [model for model in models if model.family != family]
        chosen[family] = list(AIMS)[int(regrets_of(table_of(others)).argmin())]
    counts = {aim: list(chosen.values()).count(aim) for aim in AIMS if aim in chosen.values()}
    told = ", ".join(f"{aim} {count} times" for aim, count in counts.items())
    yield f"\nWith each of {len(families)} families left out, the least regret has: {told}."
    for poses in POSES:
        left_out = [model.ratios[poses][chosen[model.family]] for model in models if poses in model.ratios]
        cells = " / ".join(f"{mean:.3f}" for mean in np.mean(left_out, axis=0))
        yield f"On the families left out, {poses}: {cells}."


if __name__ == "__main__":
    sys.exit(main())
