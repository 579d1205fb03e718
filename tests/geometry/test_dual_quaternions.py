"""Dual quaternions against axes and angles, and the check that a pose is rigid up to one scale."""

from __future__ import annotations

import numpy as np
import pytest

from skinbake.geometry.dual_quaternions import (
    RIGID_TOLERANCE,
    dual_quaternions_from_matrices,
    not_rigid_joints,
    quaternions_from_rotations,
    rigid_motions,
)
from tests.support import analytic
from tests.support.rigid_motions import matrices_from_dual_quaternions

AXES = (
    np.array(
        [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [0, 1, 1], [1, 0, -1], [1, 1, 1], [-1, 2, 3], [3, -2, 1]]
    )
    / np.sqrt([1, 1, 1, 2, 2, 2, 3, 14, 14])[:, None]
)
ANGLES = np.radians([0.0, 1e-6, 30.0, 90.0, 120.0, 179.9999, 180.0, 240.0, 359.0])


def up_to_sign(found: np.ndarray, expected: np.ndarray) -> np.ndarray:
    cosine = np.sum(found[..., :4] * expected[..., :4], axis=-1, keepdims=True)
    signed: analytic.Array = found * np.sign(cosine)
    return signed


def random_poses(poses: int = 4, joints: int = 6) -> np.ndarray:
    rng = np.random.default_rng(5)
    matrices = np.tile(np.eye(4), (poses, joints, 1, 1))
    for pose in range(poses):
        for joint in range(joints):
            axis, angle = rng.normal(size=3), rng.uniform(0, np.pi)
            matrices[pose, joint, :3, :3] = analytic.rotation_matrix(axis, angle)
    matrices[..., :3, 3] = rng.normal(size=(poses, joints, 3))
    return matrices


def test_quaternions_are_half_angles_about_the_axis_on_every_branch() -> None:
    axes = np.repeat(AXES, len(ANGLES), axis=0)
    angles = np.tile(ANGLES, len(AXES))
    rotations = np.array(
        [analytic.rotation_matrix(axis, angle) for axis, angle in zip(axes, angles, strict=True)]
    )
    expected = np.concatenate([np.cos(angles / 2)[:, None], np.sin(angles / 2)[:, None] * axes], axis=1)
    branches = np.argmax(expected**2, axis=1)
    assert set(branches.tolist()) == {0, 1, 2, 3}
    found = quaternions_from_rotations(rotations)
    np.testing.assert_allclose(up_to_sign(found, expected), expected, atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-15)


def test_quaternions_keep_any_leading_shape() -> None:
    rotations = random_poses()[..., :3, :3]
    found = quaternions_from_rotations(rotations)
    assert found.shape == (4, 6, 4)
    np.testing.assert_array_equal(found[2, 3], quaternions_from_rotations(rotations[2, 3]))


@pytest.mark.parametrize("bend", analytic.BENDS)
def test_dual_quaternions_are_those_composed_from_half_angles(bend: str) -> None:
    found = dual_quaternions_from_matrices(analytic.joint_matrices(bend))
    expected = analytic.joint_dual_quaternions(bend)
    np.testing.assert_allclose(up_to_sign(found, expected), expected, atol=1e-14)


def test_matrices_come_back_from_dual_quaternions_of_any_length_and_sign() -> None:
    matrices = random_poses()
    dual_quaternions = dual_quaternions_from_matrices(matrices)
    for factor in (1.0, -1.0, 0.2):
        found = matrices_from_dual_quaternions(factor * dual_quaternions)
        np.testing.assert_allclose(found, matrices, atol=1e-14)


def test_a_dual_part_along_the_real_one_moves_nothing() -> None:
    dual_quaternions = dual_quaternions_from_matrices(random_poses())
    shifted = dual_quaternions.copy()
    shifted[..., 4:] += 0.3 * shifted[..., :4]
    np.testing.assert_allclose(
        matrices_from_dual_quaternions(shifted), matrices_from_dual_quaternions(dual_quaternions), atol=1e-14
    )


def test_rigid_poses_are_rigid_of_scale_one() -> None:
    motions = rigid_motions(random_poses())
    assert motions.is_rigid
    assert motions.deviation.max() < 1e-14
    np.testing.assert_allclose(motions.scale, 1)
    np.testing.assert_allclose(
        matrices_from_dual_quaternions(motions.dual_quaternions), random_poses(), atol=1e-14
    )


def test_a_scale_common_to_all_joints_is_factored_out_pose_by_pose() -> None:
    matrices = random_poses()
    scale = np.array([0.01, 0.012, 1.0, 250.0])
    scaled = matrices.copy()
    scaled[..., :3, :3] *= scale[:, None, None, None]
    motions = rigid_motions(scaled)
    assert motions.is_rigid
    np.testing.assert_allclose(motions.scale, scale, rtol=1e-14)
    np.testing.assert_allclose(matrices_from_dual_quaternions(motions.dual_quaternions), matrices, atol=1e-13)


def spoiled(what: str) -> np.ndarray:
    matrices = random_poses()
    broken = matrices[2, 4]
    if what == "scale":
        broken[:3, :3] *= 1.01
    elif what == "shear":
        broken[:3, :3] = broken[:3, :3] @ np.array([[1, 0.01, 0], [0, 1, 0], [0, 0, 1]])
    elif what == "stretch":
        broken[:3, 1] *= 0.99
    elif what == "mirror":
        broken[:3, 0] *= -1
    elif what == "collapse":
        broken[:3, :3] = 0
    elif what == "nan":
        broken[1, 1] = np.nan
    else:
        broken[0, 3] = np.inf
    return matrices


@pytest.mark.parametrize("what", ["scale", "shear", "stretch", "mirror", "collapse", "nan", "infinite"])
def test_a_bad_joint_in_one_pose_is_named_and_harms_no_other(what: str) -> None:
    matrices = spoiled(what)
    motions = rigid_motions(matrices)
    assert not motions.is_rigid
    assert motions.not_rigid.tolist() == [4]
    assert not_rigid_joints(matrices, np.ones(6, dtype=np.bool_)).tolist() == [4]
    assert motions.deviation[4] > RIGID_TOLERANCE
    good = [0, 1, 2, 3, 5]
    np.testing.assert_allclose(
        matrices_from_dual_quaternions(motions.dual_quaternions[:, good]), matrices[:, good], atol=1e-13
    )
    assert np.isfinite(motions.dual_quaternions).all()


def test_joints_out_of_use_are_neither_judged_nor_converted() -> None:
    in_use = np.array([True, True, True, True, False, True])
    motions = rigid_motions(spoiled("nan"), in_use=in_use)
    assert motions.is_rigid
    assert not_rigid_joints(spoiled("nan"), in_use).size == 0
    np.testing.assert_array_equal(motions.dual_quaternions[:, 4], np.tile(np.eye(8)[0], (4, 1)))


def test_no_joint_in_use_is_rigid_of_scale_one() -> None:
    motions = rigid_motions(spoiled("nan"), in_use=np.zeros(6, dtype=np.bool_))
    assert motions.is_rigid
    np.testing.assert_array_equal(motions.scale, 1)


def test_the_tolerance_decides() -> None:
    matrices = random_poses()
    matrices[0, 0, :3, 0] *= 1.01
    deviation = 1.01**2 - 1
    assert rigid_motions(matrices, tolerance=1.05 * deviation).is_rigid
    assert rigid_motions(matrices, tolerance=0.95 * deviation).not_rigid.tolist() == [0]


def test_matrices_in_float32_are_rigid() -> None:
    assert rigid_motions(random_poses().astype(np.float32)).is_rigid
