"""Each vertex between linear blending and dual quaternions, against differences of the analytic surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skinbake.choices import Baseline
from skinbake.skinning.blended import accurate
from skinbake.skinning.components import PosedVertex
from skinbake.skinning.counting import Count, Sign, Tally
from skinbake.skinning.rest import Algorithm
from tests.support import analytic
from tests.support.analytic_rest import rest_primitive, sample, slots
from tests.support.blended_surface import RIGID, blended_rest, blended_surface
from tests.support.replay import blended_replay, replay
from tests.support.stretched_joints import STRETCHES

EXACT_DEGREES = 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("stretch", [RIGID, *STRETCHES])
@pytest.mark.parametrize("bend", analytic.BENDS)
def test_accurate_lighting_of_a_blend_is_that_of_the_blended_surface(bend: str, stretch: str) -> None:
    surface = sample()
    matrices, posed = blended_surface(bend, stretch, slots(surface)[:, 0])
    along, around = analytic.differences(surface.u, surface.v, posed)
    truth = np.cross(around, along)
    rest = blended_rest(surface)
    found = blended_replay(Algorithm.DQS_EXACT, rest, matrices)
    np.testing.assert_allclose(found.positions[0], posed(surface.u, surface.v), atol=1e-12)
    assert analytic.degrees_between(found.normals[0], truth).max() < EXACT_DEGREES
    # Neither standard lighting nor α and β alone tell how the blend weight varies.
    standard = blended_replay(Algorithm.DQS_STANDARD, rest, matrices)
    assert analytic.degrees_between(standard.normals[0], truth).mean() > 2.0
    assert rest.blend is not None
    flat = replace(rest, blend=rest.blend * [1.0, 0.0, 0.0])
    without = blended_replay(Algorithm.DQS_EXACT, flat, matrices)
    assert analytic.degrees_between(without.normals[0], truth).mean() > 0.5


@pytest.mark.parametrize(("weight", "dual"), [(0.0, False), (1.0, True)])
@pytest.mark.parametrize("algorithm", [Algorithm.DQS_STANDARD, Algorithm.DQS_EXACT])
def test_a_blend_weight_of_0_or_1_is_one_method_alone(
    weight: float, dual: bool, algorithm: Algorithm
) -> None:
    surface = sample()
    blend = np.tile([weight, 0.0, 0.0], (len(surface.u), 1))
    rest = replace(rest_primitive(surface), blend=blend)
    matrices = analytic.joint_matrices("strong")[None]
    linear = Algorithm.LBS_ACCURATE if algorithm is Algorithm.DQS_EXACT else Algorithm.LBS_STANDARD
    expected = replay(algorithm if dual else linear, rest, matrices)
    found = blended_replay(algorithm, rest, matrices)
    np.testing.assert_allclose(found.positions, expected.positions, atol=1e-12)
    assert analytic.degrees_between(found.normals, expected.normals).max() < 1e-9


def test_a_primitive_without_blend_weights_is_blended_linearly() -> None:
    rest, matrices = rest_primitive(sample()), analytic.joint_matrices("medium")[None]
    found = blended_replay(Algorithm.DQS_EXACT, rest, matrices)
    np.testing.assert_allclose(
        found.normals, replay(Algorithm.LBS_ACCURATE, rest, matrices).normals, atol=1e-12
    )


def test_accurate_lighting_of_a_blend_costs_what_its_docstring_says() -> None:
    tally = Tally()
    tally.mark(1)
    one, other = (PosedVertex(*(tuple(Count(tally) for _ in range(3)) for _ in range(4))) for _ in range(2))
    accurate(one, other, tuple(Count(tally) for _ in range(3)), Sign())
    assert tally.lines == {1: 30}


@pytest.mark.parametrize("baseline", Baseline)
def test_a_standard_normal_lies_between_those_of_both_methods_at_length_1(baseline: Baseline) -> None:
    rest, matrices = blended_rest(sample()), analytic.joint_matrices("strong")[None]
    linear = replay(Algorithm.LBS_STANDARD, rest, matrices, baseline=baseline).normals[0]
    dual = replay(Algorithm.DQS_STANDARD, rest, matrices).normals[0]
    units = [one / np.linalg.norm(one, axis=1, keepdims=True) for one in (linear, dual)]
    assert rest.blend is not None
    weight = rest.blend[:, :1]
    found = blended_replay(Algorithm.DQS_STANDARD, rest, matrices, baseline=baseline)
    np.testing.assert_allclose(found.normals[0], (1 - weight) * units[0] + weight * units[1], atol=1e-12)
