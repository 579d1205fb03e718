"""Measure fitted and surface gradients against normals that are known by formula: behind docs/fitted.md.

Usage: python -m benchmarks.analytic_rigs [--seeds N]

Tubes of four shapes are bent, twisted, stretched, or all of these: 16 for each seed. Each is lit at
moments of its clip that no bake saw, and with all joints turned at random by up to 30°. The parts of
SkinnedNormalsTest are lit in their pose.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.lit_errors import error_fields
from fixtures import skinned_normals_test as asset
from fixtures.builder import grid
from skinbake.choices import USUAL_TRUTHS, Gradients, PoseKind
from skinbake.commands.bake import bake_document
from skinbake.commands.bake_options import BakeOptions
from skinbake.freshness.baked_views import baked_views, rest_primitive
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.clips import read_clips
from skinbake.gltf.reading.meshes import skinned_sources
from skinbake.skinning.rest import Algorithm
from skinbake.truth.areas import vertex_areas
from skinbake.truth.poses import PoseRequest, pose_set
from tests.support.analytic_rigs import Tube, tubes
from tests.support.replay import replay
from tests.support.whole_fields import angular_errors

FORMULA = "formula"
TRUTHS = (FORMULA, *map(str, USUAL_TRUTHS))
STANDARD = "standard"
LIGHTINGS = (STANDARD, str(Gradients.SURFACE), str(Gradients.FITTED))
CLIP, TURNED = "clip", "±30°"
POSES = {
    CLIP: PoseRequest(samples=31, offset=0.55),
    TURNED: PoseRequest(PoseKind.RANDOM, 20, float(np.radians(30.0)), 77),
}
MODEL = Path(__file__).resolve().parents[1] / "fixtures" / asset.FOLDER / f"{asset.NAME}.gltf"
HELD = 2.0
"""The second at which the clip of the asset holds its pose."""

SEEDS = 11
WORSE, UNSEEN = 1.01, 0.1
"""A lighting is worse than another if its error is larger by this factor, and by these degrees."""

Errors = Mapping[tuple[str, str], float]
"""The mean errors in degrees, by lighting and truth."""


@dataclass(frozen=True)
class Measured:
    """A tube, its errors in the poses of each kind, and whether its fit stayed unbaked."""

    tube: Tube
    errors: Mapping[str, Errors]

    def is_worse(self, kind: str, truths: Sequence[str] = TRUTHS, lighting: str = LIGHTINGS[2]) -> bool:
        """Tell whether a lighting is worse than standard lighting by one of the truths."""
        found = self.errors[kind]
        pairs = [(found[lighting, truth], found[STANDARD, truth]) for truth in truths]
        return any(own > WORSE * standard and own - standard > UNSEEN for own, standard in pairs)


def measured(tube: Tube, options: BakeOptions | None = None) -> Measured:
    """Bake a tube with both kinds of gradients, and light it."""
    with TemporaryDirectory() as folder:
        given = read_document(str(tube.write(Path(folder))))
    errors: dict[str, dict[tuple[str, str], float]] = {kind: {} for kind in POSES}
    for gradients in (Gradients.SURFACE, Gradients.FITTED):
        document = bake_document(given, replace(options or BakeOptions(), gradients=gradients)).document
        views = baked_views(document, skinned_sources(document))
        for kind, request in POSES.items():
            found = errors[kind]
            if not views:  # it stayed unbaked
                found.update({(str(gradients), truth): found[STANDARD, truth] for truth in TRUTHS})
                continue
            (view,) = views
            poses = pose_set(document, 0, read_clips(document), request)
            areas = vertex_areas(view.now.positions, view.now.triangles)
            fields = error_fields(document, views, poses, "lbs")
            exact = tube.normals(poses.joint_matrices)
            for name, algorithm in (
                ("standard", Algorithm.LBS_STANDARD),
                ("accurate", Algorithm.LBS_ACCURATE),
            ):
                lighting = STANDARD if name == "standard" else str(gradients)
                normals = replay(algorithm, rest_primitive(view), poses.joint_matrices).normals
                found[lighting, FORMULA] = float(
                    np.average(angular_errors(normals, exact).mean(axis=0), weights=areas)
                )
                for truth in TRUTHS[1:]:
                    own, exists = fields[truth, name, 0]
                    weights = areas * exists
                    known = np.where(np.isfinite(own), own, 180.0) * weights
                    found[lighting, truth] = float(known.sum() / weights.sum())
    return Measured(tube, errors)


def ratio(found: Sequence[Measured], kind: str, truth: str, against: str) -> float:
    """Return the geometric mean of the fitted error over that of another lighting."""
    fitted = str(Gradients.FITTED)
    pairs = [(one.errors[kind][fitted, truth], one.errors[kind][against, truth]) for one in found]
    return float(np.exp(np.mean([np.log(own / other) for own, other in pairs])))


def parts(gradients: Gradients) -> dict[str, float]:
    """Return the mean errors in degrees of the parts of SkinnedNormalsTest in their poses.

    The morphed part is left out: a fit is made before any morph.
    """
    document = bake_document(read_document(str(MODEL)), BakeOptions(gradients=gradients)).document
    (clip,) = read_clips(document)
    found = {}
    for view in baked_views(document, skinned_sources(document)):
        part = next(one for one in asset.PARTS if one.rows * asset.COLUMNS == len(view.now.positions))
        if part.is_morphed:
            continue
        skin = document.asset.skins_of(view.source.mesh)[0]
        poses = pose_set(document, skin, [clip], PoseRequest(samples=3))
        held = poses.joint_matrices[[poses.times.index(HELD)]]
        height, theta, _ = grid(np.linspace(0, 2, part.rows), np.linspace(0, 2 * np.pi, asset.COLUMNS))
        _, by_theta, by_height = asset.posed(part, theta, height)
        normals = replay(Algorithm.LBS_ACCURATE, rest_primitive(view), held).normals
        found[part.name] = float(angular_errors(normals, np.cross(by_height, by_theta)[None]).mean())
    return found


def lines(seeds: int) -> Iterator[str]:
    """Yield the tables."""
    found = [measured(tube) for tube in tubes(range(seeds))]
    yield f"{len(found)} tubes: the fitted error over that of `surface`, and of standard lighting, as means"
    yield "| poses | truth | over `surface` | over standard | worse than standard | `surface` worse |"
    yield "|---|---|--:|--:|--:|--:|"
    for kind in POSES:
        for truth in TRUTHS:
            over = [f"{ratio(found, kind, truth, other):.3f}" for other in (LIGHTINGS[1], STANDARD)]
            worse = [sum(one.is_worse(kind, [truth], own) for one in found) for own in LIGHTINGS[:0:-1]]
            yield f"| {kind} | {truth} | {over[0]} | {over[1]} | {worse[0]} | {worse[1]} |"
    yield ""
    names = [part.name for part in asset.PARTS if not part.is_morphed]
    yield f"| SkinnedNormalsTest | {' | '.join(names)} | mean |"
    yield "|---|--:|--:|--:|--:|--:|"
    for gradients in (Gradients.SURFACE, Gradients.FITTED):
        values = [*parts(gradients).values()]
        yield f"| {gradients} | {' | '.join(f'{one:.3f}' for one in [*values, float(np.mean(values))])} |"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=SEEDS)
    for line in lines(parser.parse_args().seeds):
        print(line, flush=True)


if __name__ == "__main__":
    main()
