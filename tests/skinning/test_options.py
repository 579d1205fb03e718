"""The cap on the correction, and the normals that engines ship, against numpy's own linear algebra."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skinbake.choices import Baseline
from skinbake.options import PUBLISHED_CAP
from skinbake.skinning.rest import Algorithm, RestPrimitive
from tests.support import analytic
from tests.support.analytic_rest import poses, rest_primitive, sample
from tests.support.replay import replay

# The algorithm that is capped, and the one whose tangents are T t.
CAPPED = [
    (Algorithm.LBS_ACCURATE, Algorithm.LBS_STANDARD),
    (Algorithm.DQS_ACCURATE, Algorithm.DQS_STANDARD),
    (Algorithm.DQS_EXACT, Algorithm.DQS_STANDARD),
]


@pytest.mark.parametrize(("algorithm", "standard"), CAPPED)
@pytest.mark.parametrize("field", ["tangents", "bitangents"])
def test_the_cap_shortens_long_corrections_and_only_those(
    algorithm: Algorithm, standard: Algorithm, field: str
) -> None:
    rest = rest_primitive(sample())
    base = getattr(replay(standard, rest, poses()), field)
    free = getattr(replay(algorithm, rest, poses()), field) - base
    capped = getattr(replay(algorithm, rest, poses(), cap=0.3), field) - base
    allowed = 0.3 * np.linalg.norm(base, axis=-1)
    long = np.linalg.norm(free, axis=-1) > allowed
    assert 0 < long.sum() < long.size
    np.testing.assert_allclose(capped[~long], free[~long], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(capped[long], axis=-1), allowed[long], rtol=1e-9)
    parallel = np.sum(capped[long] * free[long], axis=-1)
    lengths = np.linalg.norm(capped[long], axis=-1) * np.linalg.norm(free[long], axis=-1)
    np.testing.assert_allclose(parallel, lengths, rtol=1e-9)


@pytest.mark.parametrize(("algorithm", "_"), CAPPED)
def test_a_cap_out_of_reach_changes_nothing(algorithm: Algorithm, _: Algorithm) -> None:
    rest = rest_primitive(sample())
    free, capped = replay(algorithm, rest, poses()), replay(algorithm, rest, poses(), cap=1e6)
    np.testing.assert_allclose(capped.normals, free.normals, atol=1e-11)


@pytest.mark.parametrize(("algorithm", "_"), CAPPED)
def test_the_cap_spares_the_normal_from_turning_inside_out(algorithm: Algorithm, _: Algorithm) -> None:
    """The normal of a folded vertex turns back towards the standard one."""
    rest = rest_primitive(sample())
    strong = poses()[2:3]
    standard = replay(CAPPED[0][1] if algorithm is CAPPED[0][0] else CAPPED[1][1], rest, strong).normals
    free = analytic.degrees_between(replay(algorithm, rest, strong).normals, standard)
    capped = analytic.degrees_between(replay(algorithm, rest, strong, cap=0.5).normals, standard)
    assert (capped[free > 90] < free[free > 90]).all()
    assert capped.mean() < free.mean()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_cap_survives_a_tangent_that_collapses(dtype: type[np.floating]) -> None:
    """A half turn between equal weights squeezes T t to zero, so that the cap has nothing to refer to."""
    half_turn = np.diag([1.0, -1.0, -1.0, 1.0])
    rest = single_vertex()
    matrices = np.stack([np.eye(4), half_turn])[None]
    free = replay(Algorithm.LBS_ACCURATE, rest, matrices, dtype=dtype)
    capped = replay(Algorithm.LBS_ACCURATE, rest, matrices, dtype=dtype, cap=PUBLISHED_CAP)
    assert np.linalg.norm(replay(Algorithm.LBS_STANDARD, rest, matrices).tangents) == 0
    assert np.linalg.norm(free.tangents) > 0
    np.testing.assert_array_equal(capped.tangents, free.tangents)
    assert capped.tangents.dtype == dtype


def test_the_cap_of_one_influence_is_idle() -> None:
    rest = single_vertex()
    alone = replace(
        rest,
        joints=rest.joints[:, :1],
        weights=np.ones((1, 1)),
        alpha=np.zeros((1, 0)),
        beta=np.zeros((1, 0)),
    )
    for algorithm, _ in CAPPED:
        skinned = replay(algorithm, alone, np.eye(4)[None, None], cap=PUBLISHED_CAP)
        np.testing.assert_allclose(skinned.normals[0], rest.normals, atol=1e-15)


def single_vertex() -> RestPrimitive:
    """A vertex at (0, 1, 0) between two joints, its tangent along y, its bitangent along z."""
    return RestPrimitive(
        positions=np.array([[0.0, 1.0, 0.5]]),
        normals=np.array([[1.0, 0.0, 0.0]]),
        tangents=np.array([[0.0, 1.0, 0.0]]),
        bitangents=np.array([[0.0, 0.0, 1.0]]),
        joints=np.array([[0, 1]]),
        weights=np.array([[0.5, 0.5]]),
        alpha=np.array([[0.7]]),
        beta=np.array([[0.2]]),
    )


def sheared_poses() -> analytic.Array:
    """Joint matrices with shear and unlike scales, which tell the baselines apart."""
    rng = np.random.default_rng(3)
    matrices = poses()
    matrices[:, :, :3, :3] += 0.4 * rng.normal(size=(4, 3, 3, 3))
    return matrices


def test_baselines_are_the_normals_that_engines_ship() -> None:
    rest = rest_primitive(sample())
    matrices = sheared_poses()
    linear = matrices[:, :, :3, :3][:, rest.joints]
    blended = np.einsum("vk,pvkij->pvij", rest.weights, linear)
    cofactors = np.linalg.det(linear)[..., None, None] * np.swapaxes(np.linalg.inv(linear), -1, -2)
    expected = {
        Baseline.BLENDED: np.einsum("pvij,vj->pvi", blended, rest.normals),
        Baseline.INVERSE_TRANSPOSE: np.einsum("pvji,vj->pvi", np.linalg.inv(blended), rest.normals),
        Baseline.COFACTOR: np.einsum("vk,pvkij,vj->pvi", rest.weights, cofactors, rest.normals),
    }
    for baseline, normals in expected.items():
        found = replay(Algorithm.LBS_STANDARD, rest, matrices, baseline=baseline).normals
        np.testing.assert_allclose(found, normals, rtol=1e-9, atol=1e-12, err_msg=baseline)
    assert analytic.degrees_between(*list(expected.values())[:2]).mean() > 5
    assert analytic.degrees_between(*list(expected.values())[1:]).mean() > 1


@pytest.mark.parametrize("baseline", Baseline)
def test_baselines_agree_where_one_rigid_joint_rules(baseline: Baseline) -> None:
    rest = rest_primitive(sample())
    alone = replace(rest, weights=np.tile([1.0, 0.0, 0.0], (len(rest.weights), 1)))
    found = replay(Algorithm.LBS_STANDARD, alone, poses(), baseline=baseline).normals
    expected = np.einsum("pvij,vj->pvi", poses()[:, :, :3, :3][:, rest.joints[:, 0]], rest.normals)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_blend_without_volume_has_a_finite_inverse_transpose() -> None:
    """Equal weights and a half turn leave T of rank one: its cofactors stand in for the inverse."""
    matrices = np.stack([np.eye(4), np.diag([1.0, -1.0, -1.0, 1.0])])[None]
    found = replay(Algorithm.LBS_STANDARD, single_vertex(), matrices, baseline=Baseline.INVERSE_TRANSPOSE)
    assert np.isfinite(found.normals).all()
