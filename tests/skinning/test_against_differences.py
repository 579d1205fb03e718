"""Every algorithm's normals against finite differences of the skinned analytic surface, gradients exact."""

from __future__ import annotations

import numpy as np
import pytest

from skinbake.skinning.rest import Algorithm
from tests.support import analytic
from tests.support.analytic_rest import rest_primitive, sample, slots
from tests.support.replay import replay

EXACT_DEGREES = 1e-4


def linear_truth(surface: analytic.Sample, bend: str) -> analytic.Array:
    skinning = analytic.linear_blend(analytic.joint_matrices(bend))
    return analytic.skinned_normals(surface.u, surface.v, skinning)


def dual_quaternion_truth(surface: analytic.Sample, bend: str, pivots: np.ndarray) -> analytic.Array:
    skinning = analytic.dual_quaternion_blend(analytic.joint_dual_quaternions(bend), pivots)
    return analytic.skinned_normals(surface.u, surface.v, skinning)


def errors(algorithm: Algorithm, bend: str, *, heaviest_first: bool = True) -> analytic.Array:
    surface = sample()
    joints = slots(surface, heaviest_first=heaviest_first)
    skinned = replay(algorithm, rest_primitive(surface, joints), analytic.joint_matrices(bend)[None])
    if algorithm.uses_dual_quaternions:
        truth = dual_quaternion_truth(surface, bend, joints[:, 0])
    else:
        truth = linear_truth(surface, bend)
    return analytic.degrees_between(skinned.normals[0], truth)


def test_weight_gradients_of_the_oracle_are_those_of_its_weights() -> None:
    surface = sample()
    step = 1e-5
    along, around = analytic.derivatives(surface.u, surface.v)
    for direction, du, dv in ((along, step, 0), (around, 0, step)):
        difference = analytic.weights(surface.u + du, surface.v + dv) - analytic.weights(
            surface.u - du, surface.v - dv
        )
        moved = analytic.positions(surface.u + du, surface.v + dv) - analytic.positions(
            surface.u - du, surface.v - dv
        )
        np.testing.assert_allclose(moved / (2 * step), direction, atol=1e-8)
        expected = np.einsum("vki,vi->vk", surface.gradients, direction)
        np.testing.assert_allclose(difference / (2 * step), expected, atol=1e-8)


@pytest.mark.parametrize("bend", analytic.BENDS)
def test_linear_blend_positions_are_the_oracle_s(bend: str) -> None:
    surface = sample()
    expected = analytic.linear_blend(analytic.joint_matrices(bend))(surface.positions, surface.weights)
    for algorithm in (Algorithm.LBS_STANDARD, Algorithm.LBS_DIRECT, Algorithm.LBS_ACCURATE):
        skinned = replay(algorithm, rest_primitive(surface), analytic.joint_matrices(bend)[None])
        np.testing.assert_allclose(skinned.positions[0], expected, atol=1e-13)


@pytest.mark.parametrize("bend", analytic.BENDS)
def test_dual_quaternion_positions_are_the_oracle_s(bend: str) -> None:
    surface = sample()
    skinning = analytic.dual_quaternion_blend(analytic.joint_dual_quaternions(bend), slots(surface)[:, 0])
    expected = skinning(surface.positions, surface.weights)
    for algorithm in (Algorithm.DQS_STANDARD, Algorithm.DQS_ACCURATE, Algorithm.DQS_EXACT):
        skinned = replay(algorithm, rest_primitive(surface), analytic.joint_matrices(bend)[None])
        np.testing.assert_allclose(skinned.positions[0], expected, atol=1e-13)


@pytest.mark.parametrize("bend", analytic.BENDS)
def test_algorithm_3_gives_the_normals_of_the_linearly_blended_surface(bend: str) -> None:
    assert errors(Algorithm.LBS_ACCURATE, bend).max() < EXACT_DEGREES


@pytest.mark.parametrize("bend", ["mild", "medium"])
def test_algorithm_2_gives_the_normals_of_the_linearly_blended_surface(bend: str) -> None:
    assert errors(Algorithm.LBS_DIRECT, bend).max() < EXACT_DEGREES


@pytest.mark.parametrize("bend", ["strong", "screw"])
def test_algorithm_2_gives_the_opposite_normal_exactly_where_a_bend_folds(bend: str) -> None:
    surface = sample()
    matrices = analytic.joint_matrices(bend)
    blended = np.einsum("vk,kij->vij", surface.weights, matrices[:, :3, :3])
    moved = np.einsum("kij,vj->vki", matrices[:, :3, :3], surface.positions) + matrices[:, :3, 3]
    jacobian = blended + np.einsum("vki,vkj->vij", moved, surface.gradients)
    folded = np.linalg.det(jacobian) < 0
    error = errors(Algorithm.LBS_DIRECT, bend)
    assert 0 < folded.sum() < len(folded) / 10
    assert error[~folded].max() < EXACT_DEGREES
    assert error[folded].min() > 180 - EXACT_DEGREES


@pytest.mark.parametrize("heaviest_first", [True, False])
@pytest.mark.parametrize("bend", analytic.BENDS)
def test_algorithm_6_gives_the_normals_of_the_dual_quaternion_surface(
    bend: str, heaviest_first: bool
) -> None:
    assert errors(Algorithm.DQS_EXACT, bend, heaviest_first=heaviest_first).max() < EXACT_DEGREES


@pytest.mark.parametrize("bend", analytic.BENDS)
def test_algorithm_6_equals_its_formula_in_angular_velocities(bend: str) -> None:
    surface = sample()
    rest = rest_primitive(surface, slots(surface, heaviest_first=False))
    skinned = replay(Algorithm.DQS_EXACT, rest, analytic.joint_matrices(bend)[None])
    found, _ = angular_velocity_tangents(surface, bend)
    np.testing.assert_allclose(skinned.tangents[0], found, atol=1e-12)


def test_the_term_that_pure_turns_hide_matters_in_the_screw_bend() -> None:
    """About pivots that neighbours share, (r · d) ω is next to nothing; where joints slide it is not."""
    surface = sample()
    for bend, smallest, largest in (("medium", 0.0, 0.1), ("screw", 2.0, 90.0)):
        tangents, lost = angular_velocity_tangents(surface, bend)
        assert smallest < analytic.degrees_between(tangents, tangents + lost).max() < largest


def angular_velocity_tangents(surface: analytic.Sample, bend: str) -> tuple[analytic.Array, analytic.Array]:
    """t' = R t + ω × (p' − τ/2) + ν − (ρ/2) τ − (r · d) ω by Hamilton products, and (r · d) ω alone."""
    joints = analytic.joint_dual_quaternions(bend)
    joints = joints * np.where(joints[:, :4] @ joints[0, :4] < 0, -1.0, 1.0)[:, None]
    blend = surface.weights @ joints
    rate = np.einsum("vki,vi->vk", surface.gradients, surface.tangents) @ joints
    length = np.linalg.norm(blend[:, :4], axis=1, keepdims=True)
    real, dual, real_rate, dual_rate = (
        part / length for part in (blend[:, :4], blend[:, 4:], rate[:, :4], rate[:, 4:])
    )
    backwards = analytic.conjugate(real)

    def turned(vectors: analytic.Array) -> analytic.Array:
        return analytic.hamilton(analytic.hamilton(real, analytic.pure(vectors)), backwards)[:, 1:]

    tau = 2 * analytic.hamilton(dual, backwards)[:, 1:]
    omega = 2 * analytic.hamilton(real_rate, backwards)[:, 1:]
    nu = 2 * analytic.hamilton(dual_rate, backwards)[:, 1:]
    rho = 2 * np.sum(real * real_rate, axis=1, keepdims=True)
    hidden = np.sum(real * dual, axis=1, keepdims=True) * omega
    lever = turned(surface.positions) + tau / 2
    return turned(surface.tangents) + np.cross(omega, lever) + nu - rho / 2 * tau - hidden, hidden


@pytest.mark.parametrize(
    ("bend", "standard", "accurate"), [("mild", 2.1, 1.6), ("medium", 6.8, 5.3), ("strong", 14.3, 9.1)]
)
def test_algorithms_4_and_5_err_as_much_as_published(bend: str, standard: float, accurate: float) -> None:
    """Another surface than the published one, fitted to it: a quarter either way is agreement."""
    assert errors(Algorithm.DQS_STANDARD, bend).mean() == pytest.approx(standard, rel=0.25)
    assert errors(Algorithm.DQS_ACCURATE, bend).mean() == pytest.approx(accurate, rel=0.25)
    assert errors(Algorithm.DQS_EXACT, bend).mean() < 5e-4


@pytest.mark.parametrize("algorithm", [Algorithm.LBS_DIRECT, Algorithm.LBS_ACCURATE, Algorithm.DQS_EXACT])
def test_tangents_are_derivatives_of_the_skinned_position(algorithm: Algorithm) -> None:
    surface = sample()
    joints = slots(surface)
    matrices = analytic.joint_matrices("medium")
    skinning = (
        analytic.dual_quaternion_blend(analytic.joint_dual_quaternions("medium"), joints[:, 0])
        if algorithm.uses_dual_quaternions
        else analytic.linear_blend(matrices)
    )
    skinned = replay(algorithm, rest_primitive(surface, joints), matrices[None])
    along, _ = analytic.derivatives(surface.u, surface.v)
    step = 1e-5 / np.linalg.norm(along, axis=1)

    def at(sign: float) -> analytic.Array:
        u = surface.u + sign * step
        return skinning(analytic.positions(u, surface.v), analytic.weights(u, surface.v))

    np.testing.assert_allclose(skinned.tangents[0], (at(1) - at(-1)) / 2e-5, atol=1e-8)
