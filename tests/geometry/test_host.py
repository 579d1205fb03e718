"""Joint matrices to the dual quaternions of shaders: against Hamilton's product, and what is refused."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest

import skinbake
from skinbake.errors import UnsupportedFeatureError

Array = np.ndarray[Any, np.dtype[np.float64]]


def rotation(axis: list[float], angle: float) -> Array:
    """Rodrigues' formula."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix: Array = np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
    return matrix


def rigid(axis: list[float], angle: float, translation: list[float], scale: float = 1.0) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3] = scale * rotation(axis, angle)
    matrix[:3, 3] = translation
    return matrix


def moved(parts: Array, point: Array) -> Array:
    """Move a point by a dual quaternion (2, 4) of (x, y, z, w), by quaternion products alone."""

    def times(a: Array, b: Array) -> Array:
        vector = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
        return np.append(vector, a[3] * b[3] - a[:3] @ b[:3])

    real, dual = parts.astype(np.float64)
    conjugate = real * [-1, -1, -1, 1]
    turned = times(times(real, np.append(point, 0.0)), conjugate)
    return np.asarray((turned + 2 * times(dual, conjugate))[:3])


MATRICES = np.stack(
    [
        rigid([1, 2, 3], 0.7, [1, -2, 0.5]),
        rigid([0, 1, 0], np.pi, [0, 0, 3]),
        rigid([-2, 0.1, 1], 3.1, [0.2, 0.3, -4]),
        np.eye(4),
    ]
)
POINT = np.array([0.3, -1.2, 2.0])


def test_dual_quaternions_move_points_as_the_matrices_do() -> None:
    scale, parts = skinbake.joint_dual_quaternions(MATRICES)
    assert scale.shape == ()
    assert parts.shape == (4, 2, 4)
    assert parts.dtype == np.float32
    assert scale == 1.0
    for matrix, part in zip(MATRICES, parts, strict=True):
        # float32 of terms of size 4: 4 · 2⁻²³.
        np.testing.assert_allclose(moved(part, POINT), (matrix @ [*POINT, 1])[:3], atol=2e-6)


def test_poses_keep_their_shape_and_a_common_scale_comes_out() -> None:
    poses = np.stack([MATRICES, MATRICES])
    poses[1, :, :3, :3] *= 0.01
    scale, parts = skinbake.joint_dual_quaternions(poses)
    np.testing.assert_allclose(scale, [1.0, 0.01], rtol=1e-6)
    assert parts.shape == (2, 4, 2, 4)
    for matrix, part in zip(poses[1], parts[1], strict=True):
        np.testing.assert_allclose(moved(part, scale[1] * POINT), (matrix @ [*POINT, 1])[:3], atol=2e-6)


def test_joints_that_are_not_rigid_are_refused_unless_unused() -> None:
    matrices = MATRICES.copy()
    matrices[2, :3, :3] *= [1.0, 1.0, 1.2]
    with pytest.raises(UnsupportedFeatureError, match="joints 2 are not rigid"):
        skinbake.joint_dual_quaternions(matrices)
    in_use = np.array([True, True, False, True])
    _, parts = skinbake.joint_dual_quaternions(matrices, in_use=in_use)
    np.testing.assert_array_equal(parts[2], [[0, 0, 0, 1], [0, 0, 0, 0]])


def test_scaled_motions_are_the_columns_times_the_rotation_and_the_rotation() -> None:
    matrices = np.stack([MATRICES, MATRICES]).astype(np.float32)
    matrices[1, :, :3, :3] *= [1.0, 0.5, 1.2]
    found = skinbake.joint_scaled_motions(matrices)
    assert found.shape == (2, 4, 5, 4)
    assert found.dtype == np.float32
    for matrix, (*columns, turn) in zip(matrices.reshape(-1, 4, 4), found.reshape(-1, 5, 4), strict=True):
        assert np.linalg.norm(turn) == pytest.approx(1.0)
        for number, column in enumerate(columns):
            # A quaternion over another one, both with the scalar last.
            x, r = column[[3, 0, 1, 2]], turn[[3, 0, 1, 2]] * [1, -1, -1, -1]
            vector = x[0] * r[1:] + r[0] * x[1:] + np.cross(x[1:], r[1:])
            np.testing.assert_allclose(vector, matrix[:3, number], atol=2e-6)
            assert x[0] * r[0] - x[1:] @ r[1:] == pytest.approx(0.0, abs=2e-6)


@pytest.mark.parametrize("shape", [(4, 4), (3, 4), (2, 3, 4)])
def test_joint_matrices_of_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    for prepare in (skinbake.joint_dual_quaternions, skinbake.joint_scaled_motions):
        with pytest.raises(ValueError, match="expected"):
            prepare(np.zeros(shape))


@pytest.mark.slow
def test_importing_skinbake_imports_no_numpy() -> None:
    code = (
        "import skinbake, sys; assert 'numpy' not in sys.modules; "
        "skinbake.joint_dual_quaternions; assert 'numpy' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_unknown_names_are_no_attributes_of_skinbake() -> None:
    with pytest.raises(AttributeError, match="no attribute 'bake_it'"):
        skinbake.bake_it  # noqa: B018  # reading it is the test
