"""Measure what normal maps show on bent characters: in engines' own frames, and carried as a relief.

``python -m benchmarks.normal_maps [FILE...]``: files with normal maps and TANGENT (without a name: those of
the corpus), then characters without TANGENT. Each file is baked with the defaults, and measured as ``verify``
measures its reliefs, in its own clips. The goal is a ratio of at most 0.6 between the mean error of carried
normals and that of accurate normals in the frame that an engine rebuilds from n' and t'. Exits with 1 where
it is missed.

Without TANGENT, engines find the frame at each pixel, from the derivatives of position and texture
coordinates. They are cofactors of the deformed triangle, and the normal is their third vector. The last table
has their error with the engine's scale, by which the larger of the two has length 1.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from skinbake.choices import Truth
from skinbake.freshness.baked_views import sound_views
from skinbake.freshness.expected import true_operator_of
from skinbake.gltf.document import read_document
from skinbake.jobs.file_work import FileWork
from skinbake.jobs.verify import Verify
from skinbake.jobs.work import Job
from skinbake.measure.options import VerifyOptions
from skinbake.measure.reliefs import GOLDEN_TURN, RELIEF_TILT
from skinbake.report.verify import FileVerdict
from skinbake.skinning.rest import Algorithm
from tests.support.baking import bake_file
from tests.support.characters import Array, Character, Placement, Pose, angles, unit
from tests.support.corpus_folder import find_corpus
from tests.support.derivatives import derivative_along
from tests.support.replay import replay

GOAL = 0.6
BENDS = 0.05
"""The mean error of standard lighting in degrees, under which a model is rigid."""
WITH_TANGENT = (
    "public/TRex/trex.gltf",
    "public/Butterfly/animated_butterfly.glb",
    "public/VintageFan/vintageFan_animated.gltf",
    "cases/normal_map_tangent.glb",
)
WITHOUT_TANGENT = ("public/CesiumMan/CesiumMan.glb", "public/RiggedFigure/RiggedFigure.gltf")
TIMES = (0.3, 0.6, 0.9)


def main() -> int:
    """Print both tables; return the exit code."""
    corpus = find_corpus()
    files = [Path(name) for name in sys.argv[1:]]
    if not files and corpus is not None:
        files = [corpus / name for name in WITH_TANGENT]
    print(
        "| model | method | standard | accurate, engine's frame | carried | by area | normal alone | ratio |"
    )
    print("|---|---|--:|--:|--:|--:|--:|--:|")
    ratios: list[float] = []
    with TemporaryDirectory() as folder:
        for path in files:
            for row, ratio in rows(path, Path(folder)):
                ratios += [ratio]
                print(row, flush=True)
        if corpus is not None and not sys.argv[1:]:
            print(
                "\n| model without TANGENT | derivatives, standard normal | derivatives, accurate | carried |"
            )
            print("|---|--:|--:|--:|")
            for name in WITHOUT_TANGENT:
                print(by_derivatives(corpus / name, Path(folder)), flush=True)
    return int(any(ratio > GOAL for ratio in ratios))


def rows(path: Path, folder: Path) -> Iterator[tuple[str, float]]:
    """Yield a row for each method of skinning that a file allows, and its ratio."""
    target = folder / f"{path.stem}.glb"
    result = bake_file(path, target)
    if result.status != "baked":
        print(f"{path.name}: {result.status}", file=sys.stderr)
        return
    verdict: FileVerdict = FileWork((Verify(VerifyOptions.of()),))(Job(str(target)))
    for method, figures in ({} if verdict.reliefs is None else verdict.reliefs.by_normal.whole).items():
        assert verdict.reliefs is not None
        best = "exact" if "exact" in figures else "accurate"
        shown = [figures[name].mean for name in ("standard", "engine_frame", best)]
        plain = verdict.by_truth[Truth.TANGENTS][method][best].mean
        shown += [verdict.reliefs.by_area.whole[method][best].mean, plain]
        ratio = shown[2] / shown[1] if shown[1] > 0 else 0.0
        numbers = " | ".join(f"{value:.2f}" for value in shown)
        # What does not bend has nothing but rounding.
        judged = ratio if shown[0] > BENDS else 0.0
        yield f"| {path.stem} | {method.upper()} | {numbers} | {ratio:.2f} |", judged


def by_derivatives(path: Path, folder: Path) -> str:
    """Return the row of a character without TANGENT, whose texture is taken to follow t0 and b0."""
    target = folder / f"{path.stem}.glb"
    bake_file(path, target)
    sums = np.zeros((3, 2))
    for time in TIMES:
        character = Character(target, Pose(0, time))
        rest, document = character.rest, read_document(str(target))
        operator = true_operator_of(document, sound_views(document))
        standard, best = (
            replay(one, rest, character.matrices(Placement())[None], normal_map=one is Algorithm.LBS_ACCURATE)
            for one in (Algorithm.LBS_STANDARD, Algorithm.LBS_ACCURATE)
        )
        t, b = (derivative_along(operator, v) @ best.positions[0] for v in (rest.tangents, rest.bitangents))
        count = len(rest.positions)
        turn, tilt = GOLDEN_TURN * np.arange(count), np.radians(RELIEF_TILT)
        m = np.stack(
            [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.full(count, np.cos(tilt))], axis=1
        )
        wanted = relief(t, b, standard.normals[0], m)
        assert best.cotangents is not None
        assert best.cobitangents is not None
        columns = np.stack([best.cotangents[0], best.cobitangents[0], best.normals[0]], axis=2)
        found = [derived(t, b, one.normals[0], m) for one in (standard, best)]
        found.append(np.einsum("vij,vj->vi", columns, m))
        weight = np.linalg.norm(np.cross(t, b), axis=1)
        for number, normals in enumerate(found):
            error = angles(normals, wanted)
            known = np.isfinite(error) & (weight > 0)
            sums[number] += (error * weight)[known].sum(), weight[known].sum()
    means = sums[:, 0] / sums[:, 1]
    return f"| {path.stem} | {' | '.join(f'{mean:.2f}' for mean in means)} |"


def relief(t: Array, b: Array, carried: Array, m: Array) -> Array:
    """Return cof[t b T n0] m, (V, 3)."""
    columns = np.stack([np.cross(b, carried), np.cross(carried, t), np.cross(t, b)], axis=2)
    return np.asarray(np.einsum("vij,vj->vi", columns, m))


def derived(t: Array, b: Array, normal: Array, m: Array) -> Array:
    """Return a mapped normal in the frame that three.js derives at a pixel: N is the third vector."""
    n = unit(normal)
    first, second = np.cross(b, n), np.cross(n, t)
    longest = np.sqrt(np.maximum((first**2).sum(axis=1), (second**2).sum(axis=1)))[:, None]
    return np.asarray((m[:, :1] * first + m[:, 1:2] * second) / longest + m[:, 2:] * n)


if __name__ == "__main__":
    sys.exit(main())
