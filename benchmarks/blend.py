"""Measure lighting between linear blending and dual quaternions, with and without the blend's own gradient.

``python -m benchmarks.blend [MODEL ...]`` prints mean errors in degrees: first of an analytic tube whose
gradients are known, then of models over their clips, along tangents. Blend weights are a wave over the
surface, from 0.1 to 0.9. Without models: the fixture, and characters of the corpus (SKINBAKE_CORPUS, or
../shared/corpus).
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from skinbake.choices import Truth
from skinbake.commands.bake import bake_file
from skinbake.commands.bake_options import BakeOptions
from skinbake.commands.verify import verify_file
from skinbake.format.note import BLEND_GRADIENT
from skinbake.measure.options import VerifyOptions
from skinbake.skinning.rest import Algorithm
from tests.support import analytic, corpus
from tests.support.analytic_rest import sample, slots
from tests.support.baked_files import Editable
from tests.support.blended_files import NAME, with_blend_weights
from tests.support.blended_surface import RIGID, blended_rest, blended_surface
from tests.support.replay import blended_replay

FIXTURE = Path(__file__).resolve().parents[1] / "fixtures" / "bent_tube.glb"
CHARACTERS = ("CesiumMan/CesiumMan.glb", "Mannequiny/mannequiny-0.3.0.glb")


def main() -> int:
    """Print the table; return the exit code."""
    models = [*map(Path, sys.argv[1:])] or [FIXTURE, *map(corpus.model, CHARACTERS)]
    print("| surface | standard | without the gradient of b | accurate |")
    print("|---|--:|--:|--:|")
    for bend in analytic.BENDS:
        print(_row(f"tube, {bend} bend", errors_of_tube(bend)))
    for model in models:
        print(_row(model.name, errors(model)), flush=True)
    return 0


def _row(name: str, found: Sequence[float]) -> str:
    return f"| {name} | {' | '.join(f'{error:.2f}°' for error in found)} |"


def errors_of_tube(bend: str) -> list[float]:
    """Return the same of the analytic tube in a bend."""
    surface = sample()
    matrices, posed = blended_surface(bend, RIGID, slots(surface)[:, 0])
    along, around = analytic.differences(surface.u, surface.v, posed)
    rest = blended_rest(surface)
    assert rest.blend is not None
    without = replace(rest, blend=rest.blend * [1.0, 0.0, 0.0])
    cases = (Algorithm.DQS_STANDARD, rest), (Algorithm.DQS_EXACT, without), (Algorithm.DQS_EXACT, rest)
    return [
        float(analytic.degrees_between(found.normals[0], np.cross(around, along)).mean())
        for found in (blended_replay(algorithm, of, matrices) for algorithm, of in cases)
    ]


def errors(model: Path) -> tuple[float, float, float]:
    """Return the mean errors of a model: standard, without the gradient of its blend weights, accurate."""
    with TemporaryDirectory() as folder:
        given, baked = Path(folder) / "given.glb", Path(folder) / "baked.glb"
        bake_file(str(with_blend_weights(model, given)), str(baked), BakeOptions(blend=NAME))
        standard, accurate = _means(baked)
        file = Editable(baked)
        for number, primitive in enumerate(file.content["meshes"][0]["primitives"]):
            if BLEND_GRADIENT in primitive["attributes"]:
                file.array(BLEND_GRADIENT, number)[:] = 0.0
        _, without = _means(file.write(baked))
    return standard, without, accurate


def _means(path: Path) -> tuple[float, float]:
    verdict = verify_file(str(path), VerifyOptions(methods=("blend",)))
    figures = verdict.by_truth[Truth.TANGENTS]["blend"]
    return figures["standard"].mean, figures["accurate"].mean


if __name__ == "__main__":
    sys.exit(main())
