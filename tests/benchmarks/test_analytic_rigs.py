"""The default bake against formulas: bent, twisted and stretched tubes, and SkinnedNormalsTest."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from benchmarks.analytic_rigs import (
    CLIP,
    FORMULA,
    LIGHTINGS,
    POSES,
    SEEDS,
    STANDARD,
    TRUTHS,
    TURNED,
    Measured,
    measured,
    parts,
    ratio,
)
from fixtures import skinned_normals_test as asset
from skinbake.choices import Gradients
from tests.support.analytic_rigs import SHAPES, Tube, tubes

STEEP = 3
"""A seed of tubes of which some were lit worse than by standard lighting outside their clips."""

REGRET = {
    "bend": {CLIP: (0.65, 0.90), TURNED: (0.73, 0.85)},
    "twist": {CLIP: (1.86, 0.11), TURNED: (1.74, 0.08)},
    "stretch": {CLIP: (1.61, 0.08), TURNED: (1.16, 0.07)},
    "all": {CLIP: (1.11, 0.23), TURNED: (0.97, 0.22)},
}
"""How large the error of the fit may be by formula, over that of ``surface`` and of standard lighting.

It is the mean over the shapes, and at most 2 % or 0.02 above what was measured: a change of the fit that
costs more is seen. Twisted tubes are nearly exact with ``surface``: an eighteenth of standard lighting.
"""


@cache
def lit(seeds: range) -> list[Measured]:
    return [measured(tube) for tube in tubes(seeds)]


def worse(found: list[Measured], kind: str, truths: tuple[str, ...]) -> list[str]:
    return [one.tube.name for one in found if one.is_worse(kind, truths)]


@pytest.mark.slow
def test_no_tube_is_lit_worse_than_by_standard_lighting_in_its_clip_and_outside() -> None:
    found = lit(range(STEEP, STEEP + 1))
    for kind in POSES:
        assert worse(found, kind, TRUTHS[1:]) == []
    # Else the tubes would tell nothing.
    assert sum(one.is_worse(TURNED, TRUTHS[1:], LIGHTINGS[1]) for one in found) > 4


@pytest.mark.slow
def test_at_most_five_of_176_tubes_are_lit_worse_than_by_standard_lighting_outside_their_clips() -> None:
    found = lit(range(SEEDS))
    assert len(found) == 176
    for truth in TRUTHS:
        assert len(worse(found, TURNED, (truth,))) <= 5
    assert worse(found, CLIP, TRUTHS[1:]) == []


@pytest.mark.slow
@pytest.mark.parametrize("kind", POSES)
@pytest.mark.parametrize("motion", REGRET)
def test_the_regret_by_formula_is_bounded(motion: str, kind: str) -> None:
    found = [one for one in lit(range(STEEP, STEEP + 1)) if one.tube.motion == motion]
    assert len(found) == len(SHAPES)
    over_surface, over_standard = REGRET[motion][kind]
    assert ratio(found, kind, FORMULA, LIGHTINGS[1]) < over_surface
    assert ratio(found, kind, FORMULA, STANDARD) < over_standard


def test_skinned_normals_test_is_lit_within_a_fifth_of_a_degree() -> None:
    """0.177° in the mean, where the gradients of the surface leave 0.164°."""
    fitted = parts(Gradients.FITTED)
    assert len(fitted) == len(asset.PARTS) - 1
    for part, most in {"Bend": 0.239, "Twist": 0.205, "Scale": 0.102, "NormalMap": 0.171}.items():
        assert fitted[part] < most
    assert np.mean(list(fitted.values())) < 0.179


@pytest.mark.parametrize("shape", ["bumps", "ellipse"])
def test_the_normals_of_tubes_are_those_of_finite_differences(shape: str) -> None:
    tube, step = Tube(shape, "all", 0), 1e-5
    random = np.random.default_rng(0)
    matrices = np.eye(4) + 0.3 * random.normal(size=(2, tube.joints, 4, 4))
    matrices[..., 3, :] = [0.0, 0.0, 0.0, 1.0]
    theta, z = tube.parameters

    def skinned(theta: np.ndarray, z: np.ndarray) -> np.ndarray:
        points = np.concatenate([tube.surface((theta, z))[0], np.ones((len(z), 1))], axis=1)
        return np.asarray(np.einsum("vj,pjab,vb->pva", tube.weights(z)[0], matrices[..., :3, :], points))

    around = skinned(theta + step, z) - skinned(theta - step, z)
    along = skinned(theta, z + step) - skinned(theta, z - step)
    expected = np.cross(around, along) / (4.0 * step * step)
    assert np.abs(tube.normals(matrices) - expected).max() < 1e-6 * np.abs(expected).max()
