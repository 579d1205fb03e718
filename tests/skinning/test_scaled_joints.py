"""Dual quaternions of joints that scale, shear or mirror, against differences of another definition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skinbake.geometry.dual_quaternions import polar_quaternions, scaled_motions
from skinbake.skinning.counting import multiply_adds
from skinbake.skinning.rest import Algorithm
from tests.support import analytic
from tests.support.analytic_rest import poses, rest_primitive, sample, slots
from tests.support.replay import replay
from tests.support.stretched_joints import STRETCHES, blend_about_the_vertex, rotation_of, stretched_joints

DUAL_QUATERNIONS = [Algorithm.DQS_STANDARD, Algorithm.DQS_ACCURATE, Algorithm.DQS_EXACT]
EXACT_DEGREES = 1e-4


@pytest.mark.parametrize("stretch", STRETCHES)
@pytest.mark.parametrize("bend", analytic.BENDS)
def test_exact_lighting_is_that_of_the_surface_where_joints_scale(bend: str, stretch: str) -> None:
    surface = sample()
    matrices, quaternions = stretched_joints(bend, stretch)
    joints = slots(surface)
    skinning = blend_about_the_vertex(matrices, quaternions, joints[:, 0])
    skinned = replay(Algorithm.DQS_EXACT, rest_primitive(surface, joints), matrices[None])
    expected = skinning(surface.positions, surface.weights)
    np.testing.assert_allclose(skinned.positions[0], expected, atol=1e-12)
    truth = analytic.skinned_normals(surface.u, surface.v, skinning)
    assert analytic.degrees_between(skinned.normals[0], truth).max() < EXACT_DEGREES
    standard = replay(Algorithm.DQS_STANDARD, rest_primitive(surface, joints), matrices[None])
    assert analytic.degrees_between(standard.normals[0], truth).mean() > 2.0


@pytest.mark.parametrize("algorithm", DUAL_QUATERNIONS)
@pytest.mark.parametrize("cap", [None, 0.5])
def test_a_small_scale_changes_rigid_joints_little(algorithm: Algorithm, cap: float | None) -> None:
    """The two forms of an algorithm meet: the scale is just beyond what counts as rigid."""
    rest, rigid = rest_primitive(sample()), poses()
    near = rigid.copy()
    near[:, 1, :3, :3] *= 1.0 + 1e-7
    expected = replay(algorithm, rest, rigid, cap=cap)
    found = replay(algorithm, rest, near, cap=cap, tolerance=1e-8)
    for field in ("positions", "normals", "tangents", "bitangents"):
        there, here = getattr(expected, field), getattr(found, field)
        np.testing.assert_allclose(here, there, atol=1e-5)
        assert not np.array_equal(here, there), "the form for rigid joints was taken"


@pytest.mark.parametrize("algorithm", DUAL_QUATERNIONS)
def test_the_place_of_the_origin_changes_nothing(algorithm: Algorithm) -> None:
    rest = rest_primitive(sample())
    matrices, _ = stretched_joints("strong", "sheared")
    expected = replay(algorithm, rest, matrices[None])
    shift = np.array([3.0, -2.0, 5.0])
    # The mesh is modelled elsewhere.
    back = np.eye(4)
    back[:3, 3] = -shift
    moved = replay(algorithm, replace(rest, positions=rest.positions + shift), (matrices @ back)[None])
    # The character stands elsewhere.
    away = matrices.copy()
    away[:, :3, 3] += shift
    carried = replay(algorithm, rest, away[None])
    np.testing.assert_allclose(moved.positions, expected.positions, atol=1e-12)
    np.testing.assert_allclose(carried.positions - shift, expected.positions, atol=1e-12)
    for found in (moved, carried):
        np.testing.assert_allclose(found.normals, expected.normals, atol=1e-11)
        np.testing.assert_allclose(found.tangents, expected.tangents, atol=1e-11)


@pytest.mark.parametrize("algorithm", DUAL_QUATERNIONS)
def test_a_mirror_that_all_joints_share_mirrors_the_surface(algorithm: Algorithm) -> None:
    rest = rest_primitive(sample())
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    expected = replay(algorithm, rest, poses())
    found = replay(algorithm, rest, mirror @ poses())
    np.testing.assert_allclose(found.positions, expected.positions * [1, -1, 1], atol=1e-12)
    np.testing.assert_allclose(found.tangents, expected.tangents * [1, -1, 1], atol=1e-12)


def test_a_normal_map_has_the_cofactors_of_the_tangents_and_the_carried_normal() -> None:
    rest = rest_primitive(sample())
    matrices, _ = stretched_joints("medium", "sheared")
    for algorithm in (Algorithm.DQS_ACCURATE, Algorithm.DQS_EXACT):
        found = replay(algorithm, rest, matrices[None], normal_map=True)
        carried = replay(Algorithm.DQS_STANDARD, rest, matrices[None]).normals[0]
        side = rest.handedness()[:, None]
        expected = side * np.cross(found.bitangents[0], carried)
        assert found.cotangents is not None
        np.testing.assert_allclose(found.cotangents[0], expected, atol=1e-12)


def test_the_rotation_of_a_joint_is_that_of_its_polar_decomposition() -> None:
    rng = np.random.default_rng(1)
    quaternions = rng.normal(size=(50, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    turns = np.linalg.qr(rng.normal(size=(50, 3, 3))).Q
    stretches = np.einsum("nij,nj,nkj->nik", turns, rng.uniform(0.1, 3.0, (50, 3)), turns)
    rotations = np.array([rotation_of(quaternion) for quaternion in quaternions])
    for sign in (1.0, -1.0):
        found = polar_quaternions(sign * rotations @ stretches)
        np.testing.assert_allclose(np.abs(np.sum(found * quaternions, axis=1)), 1.0, atol=1e-12)


@pytest.mark.parametrize("noise", [0.0, 1e-17, -1e-17])
def test_a_joint_that_flattens_does_not_turn_over(noise: float) -> None:
    np.testing.assert_allclose(polar_quaternions(np.diag([1.0, 2.0, noise])), [1, 0, 0, 0], atol=1e-12)


@pytest.mark.parametrize("scales", [(0, 0, 0), (0, 2, 0), (1e-9, 2, 1e-9)])
@pytest.mark.parametrize("turn", [(1, 0, 0, 0), (0.5, 0.5, -0.5, 0.5)])
def test_a_joint_that_leaves_a_line_or_a_point_has_no_rotation(
    scales: tuple[float, ...], turn: tuple[float, ...]
) -> None:
    """No rotation follows from it, and that of an arbitrary basis would jump from pose to pose."""
    matrix = rotation_of(np.array(turn)) @ np.diag(scales)
    np.testing.assert_array_equal(polar_quaternions(matrix), [0, 0, 0, 0])
    np.testing.assert_array_equal(polar_quaternions(-matrix), [0, 0, 0, 0])


@pytest.mark.parametrize("hidden", range(3))
def test_a_joint_of_scale_0_brings_no_rotation_into_the_mix(hidden: int) -> None:
    """The surface is that of a joint that turns like the vertex's first other one, and shrinks to a point."""
    surface = sample()
    matrices, quaternions = stretched_joints("strong", "sheared")
    # A root that turns by 180°.
    matrices = np.diag([-1.0, -1.0, 1.0, 1.0]) @ matrices
    quaternions = analytic.hamilton(np.array([0.0, 0.0, 0.0, 1.0]), quaternions)
    matrices[hidden, :3, :3] = 0.0
    order = slots(surface)
    first = np.where(order[:, 0] == hidden, order[:, 1], order[:, 0])
    found = replay(Algorithm.DQS_EXACT, rest_primitive(surface, order), matrices[None])
    seen = 0
    for other in set(range(3)) - {hidden}:
        own = first == other
        turns = quaternions.copy()
        turns[hidden] = quaternions[other]
        skinning = blend_about_the_vertex(matrices, turns, np.full(len(own), other))
        expected = skinning(surface.positions, surface.weights)
        np.testing.assert_allclose(found.positions[0][own], expected[own], atol=1e-12)
        # Where nearly all of a vertex is in one point, its normal is rounding.
        lit = own & (surface.weights[:, hidden] < 0.99)
        truth = analytic.skinned_normals(surface.u, surface.v, skinning)
        assert analytic.degrees_between(found.normals[0], truth)[lit].max() < EXACT_DEGREES
        seen += int(lit.sum())
    assert seen > len(surface.u) / 3


def test_a_joint_of_scale_0_takes_its_own_vertices_to_where_it_is() -> None:
    surface = sample()
    matrices, _ = stretched_joints("medium", "scaled")
    matrices[1, :3, :3] = 0.0
    rest = rest_primitive(surface, slots(surface, heaviest_first=False))
    alone = replace(rest, weights=np.tile([0.0, 1.0, 0.0], (len(surface.u), 1)))
    for algorithm in DUAL_QUATERNIONS:
        found = replay(algorithm, alone, matrices[None]).positions[0]
        np.testing.assert_allclose(found, np.tile(matrices[1, :3, 3], (len(found), 1)), atol=1e-9)


@pytest.mark.parametrize("algorithm", DUAL_QUATERNIONS)
def test_a_root_that_turns_turns_all_with_a_joint_of_scale_0_too(algorithm: Algorithm) -> None:
    rest = rest_primitive(sample())
    matrices, _ = stretched_joints("strong", "sheared")
    matrices[1, :3, :3] = 0.0
    half = np.diag([-1.0, -1.0, 1.0, 1.0])
    before, after = (replay(algorithm, rest, one[None]) for one in (matrices, half @ matrices))
    for field in ("positions", "normals", "tangents"):
        there, here = getattr(before, field)[0], getattr(after, field)[0]
        np.testing.assert_allclose(here, there @ half[:3, :3], atol=1e-11)


def test_a_joint_without_numbers_does_not_turn() -> None:
    np.testing.assert_array_equal(polar_quaternions(np.full((3, 3), np.nan)), [1, 0, 0, 0])


def test_scaled_motions_hold_the_columns_times_the_rotation() -> None:
    matrices, quaternions = stretched_joints("strong", "sheared")
    found = scaled_motions(matrices)
    for matrix, quaternion, motion in zip(matrices, quaternions, found, strict=True):
        signed = motion[:, 4] * np.sign(motion[:, 4] @ quaternion)
        np.testing.assert_allclose(signed, quaternion, atol=1e-12)
        for column in range(4):
            expected = analytic.hamilton(analytic.pure(matrix[None, :3, column]), motion[None, :, 4])
            np.testing.assert_allclose(motion[:, column], expected[0], atol=1e-12)


@pytest.mark.parametrize("influences", range(2, 9))
def test_exact_lighting_of_scaled_joints_costs_what_its_docstring_says(influences: int) -> None:
    lines = multiply_adds(Algorithm.DQS_EXACT, influences, scaled_joints=True)
    assert sum(lines.values()) == 60 * influences + 83
    n, others = influences, influences - 1
    by_hand = [20 * n, 9, 12 * n, 8 * others, 4 * others + 16, 40 + 8 * others, 40 + 8 * others, 6]
    assert list(lines.values()) == by_hand


def test_scaled_joints_change_no_count_of_linear_blending() -> None:
    for algorithm in (Algorithm.LBS_STANDARD, Algorithm.LBS_DIRECT, Algorithm.LBS_ACCURATE):
        assert multiply_adds(algorithm, 4, scaled_joints=True) == multiply_adds(algorithm, 4)
