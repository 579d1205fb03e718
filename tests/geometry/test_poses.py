from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from skinbake.geometry import poses
from skinbake.geometry.skinned import Float64Array

TIMES = np.array([0.5, 0.75, 1.5, 4.0])
AT = np.concatenate([np.linspace(-1.0, 6.0, 141), TIMES])


def random_quaternions(count: int, seed: int) -> Float64Array:
    """Unit quaternions, w first, with signs as they fall: half of the arcs have to be turned around."""
    values: Float64Array = np.random.default_rng(seed).normal(size=(count, 4))
    values /= np.linalg.norm(values, axis=1, keepdims=True)
    return values


def scipy_rotation(quaternions: Float64Array) -> Rotation:
    return Rotation.from_quat(quaternions[:, [1, 2, 3, 0]])


def assert_same_rotations(found: Float64Array, expected: Rotation) -> None:
    assert np.abs(np.linalg.norm(found, axis=1) - 1.0).max() < 1e-15 * 4
    # q and −q are one rotation. Near 0° an angle is a root of rounding, the matrices are not.
    assert np.abs(scipy_rotation(found).as_matrix() - expected.as_matrix()).max() < 1e-12


@pytest.mark.parametrize("seed", range(5))
def test_linear_rotations_are_scipys_slerp(seed: int) -> None:
    keys = random_quaternions(len(TIMES), seed)
    found = poses.interpolated(TIMES, keys, AT, method=poses.LINEAR, rotation=True)
    expected = Slerp(TIMES, scipy_rotation(keys))(np.clip(AT, TIMES[0], TIMES[-1]))
    assert_same_rotations(found, expected)


@pytest.mark.parametrize("apart", [0.0, 1e-12, 1e-9, 1e-6, 1e-3])
def test_slerp_between_rotations_that_hardly_differ(apart: float) -> None:
    first = np.array([np.cos(0.3), np.sin(0.3), 0.0, 0.0])
    keys = np.stack([first, -np.array([np.cos(0.3 + apart), np.sin(0.3 + apart), 0.0, 0.0])])
    at = np.array([0.0, 0.25, 1.0])
    found = poses.interpolated(np.array([0.0, 1.0]), keys, at, method=poses.LINEAR, rotation=True)
    half = 0.3 + apart * at
    expected = np.stack([np.cos(half), np.sin(half), 0 * half, 0 * half], axis=1)
    assert np.abs(found * np.sign(found[:, :1]) - expected).max() < 1e-15 * 4


def test_keys_need_not_be_unit_and_one_without_length_is_the_identity() -> None:
    keys = np.array([[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 3.0]])
    at = np.array([0.0, 0.5, 1.0])
    found = poses.interpolated(np.array([0.0, 1.0]), keys, at, method=poses.LINEAR, rotation=True)
    # From the identity to a half turn about Z.
    expected = Rotation.from_rotvec([[0, 0, 0], [0, 0, np.pi / 2], [0, 0, np.pi]])
    assert_same_rotations(found, expected)


def test_linear_vectors_are_interpolated_component_by_component() -> None:
    keys = np.random.default_rng(1).normal(size=(4, 3))
    found = poses.interpolated(TIMES, keys, AT, method=poses.LINEAR, rotation=False)
    expected = np.stack([np.interp(AT, TIMES, column) for column in keys.T], axis=1)
    assert np.abs(found - expected).max() < 1e-14


@pytest.mark.parametrize("components", [3, 4])
def test_cubic_splines_are_scipys_hermite_splines(components: int) -> None:
    keys = np.random.default_rng(2).normal(size=(4, 3, components))
    found = poses.interpolated(TIMES, keys, AT, method=poses.CUBICSPLINE, rotation=False)
    for number, at in enumerate(np.clip(AT, TIMES[0], TIMES[-1])):
        left = min(int(np.searchsorted(TIMES, at, side="right")) - 1, 2)
        # In-tangent, value, out-tangent: a segment leaves by the left key's last and enters by the right's
        # first.
        segment = CubicHermiteSpline(
            TIMES[left : left + 2], keys[left : left + 2, 1], [keys[left, 2], keys[left + 1, 0]]
        )
        assert found[number] == pytest.approx(segment(at), abs=1e-12)


def test_cubic_rotations_are_normalised() -> None:
    keys = np.random.default_rng(3).normal(size=(4, 3, 4))
    found = poses.interpolated(TIMES, keys, AT, method=poses.CUBICSPLINE, rotation=True)
    plain = poses.interpolated(TIMES, keys, AT, method=poses.CUBICSPLINE, rotation=False)
    assert np.linalg.norm(found, axis=1) == pytest.approx(np.ones(len(AT)), abs=1e-15)
    assert np.einsum("ij,ij->i", found, plain) == pytest.approx(np.linalg.norm(plain, axis=1), rel=1e-12)


def test_steps_change_at_their_keys() -> None:
    keys = np.arange(4.0)[:, None]
    before = np.nextafter(TIMES, -np.inf)
    at = np.concatenate([TIMES, before, [TIMES[-1] + 1.0]])
    found = poses.interpolated(TIMES, keys, at, method=poses.STEP, rotation=False)[:, 0]
    assert found.tolist() == [0, 1, 2, 3, 0, 0, 1, 2, 3]


@pytest.mark.parametrize("method", [poses.STEP, poses.LINEAR, poses.CUBICSPLINE])
@pytest.mark.parametrize("rotation", [False, True])
def test_outside_the_keys_and_at_them_the_keys_values_hold(method: str, rotation: bool) -> None:
    values = random_quaternions(4, 9)
    keys = values
    if method == poses.CUBICSPLINE:
        slopes = np.full_like(values, 100.0)
        keys = np.stack([slopes, values, -slopes], axis=1)
    at = np.concatenate([[-50.0], TIMES, [50.0]])
    found = poses.interpolated(TIMES, keys, at, method=method, rotation=rotation)
    expected = np.concatenate([values[:1], values, values[-1:]])
    if rotation:
        found = found * np.sign(np.einsum("ij,ij->i", found, expected))[:, None]
    assert np.abs(found - expected).max() < 1e-15 * 4


@pytest.mark.parametrize("method", [poses.STEP, poses.LINEAR, poses.CUBICSPLINE])
@pytest.mark.parametrize("rotation", [False, True])
def test_a_single_key_holds_always(method: str, rotation: bool) -> None:
    value = random_quaternions(1, 4)
    keys = np.stack([9.0 + value, value, 9.0 - value], axis=1) if method == poses.CUBICSPLINE else value
    at = np.array([-1.0, 2.0, 5.0])
    found = poses.interpolated(np.array([2.0]), keys, at, method=method, rotation=rotation)
    assert found == pytest.approx(np.repeat(value, 3, axis=0), abs=1e-15)


@pytest.mark.parametrize("method", [poses.STEP, poses.LINEAR])
def test_keys_at_one_time_jump_without_a_division(method: str) -> None:
    keys = np.array([[0.0], [1.0], [5.0], [6.0]])
    times = np.array([0.0, 1.0, 1.0, 2.0])
    at = np.array([0.0, 1.0, 2.0])
    assert poses.interpolated(times, keys, at, method=method, rotation=False)[:, 0].tolist() == [0, 5, 6]


def test_rotation_matrices_are_scipys() -> None:
    quaternions = random_quaternions(500, 5)
    found = poses.rotation_matrices(quaternions)
    assert np.abs(found - scipy_rotation(quaternions).as_matrix()).max() < 1e-14
    assert poses.rotation_matrices(quaternions.reshape(5, 100, 4)).shape == (5, 100, 3, 3)


def test_a_transform_scales_then_rotates_then_translates() -> None:
    rng = np.random.default_rng(6)
    translation, scale, point = rng.normal(size=(3, 7, 3))
    quaternions = random_quaternions(7, 7)
    found = poses.composed(translation, quaternions, scale)
    moved = np.einsum("pij,pj->pi", found, np.column_stack([point, np.ones(7)]))
    expected = scipy_rotation(quaternions).apply(scale * point) + translation
    assert moved == pytest.approx(np.column_stack([expected, np.ones(7)]), abs=1e-14)


def test_global_transforms_are_the_products_down_the_tree() -> None:
    parents = [-1, 0, 1, 0, -1, 4, 2]
    local = np.random.default_rng(8).normal(size=(7, 3, 4, 4))

    def walk(node: int, pose: int) -> Float64Array:
        own: Float64Array = local[node, pose]
        return own if parents[node] < 0 else walk(parents[node], pose) @ own

    found = poses.global_transforms(local, parents)
    expected = np.array([[walk(node, pose) for pose in range(3)] for node in range(7)])
    assert np.abs(found - expected).max() < 1e-13


def test_random_rotations_stay_within_the_angle_and_come_from_the_seed() -> None:
    angle = np.radians(40.0)
    found = poses.random_rotations((30, 200), angle, seed=3)
    assert found.shape == (30, 200, 4)
    turned = scipy_rotation(found.reshape(-1, 4)).as_rotvec()
    sizes = np.linalg.norm(turned, axis=1)
    assert sizes.max() <= angle * (1 + 1e-12)
    # Uniform in ± angle: the mean size is half of it, the mean turn none. 6,000 samples leave 1 % (4 σ).
    assert sizes.mean() == pytest.approx(angle / 2, rel=0.03)
    assert np.abs(turned.mean(axis=0)).max() < 0.03 * angle
    assert np.array_equal(found, poses.random_rotations((30, 200), angle, seed=3))
    assert not np.array_equal(found, poses.random_rotations((30, 200), angle, seed=4))


def test_random_rotations_by_no_angle_are_the_identity() -> None:
    found = poses.random_rotations((5,), 0.0, seed=1)
    assert np.array_equal(found, np.tile([1.0, 0.0, 0.0, 0.0], (5, 1)))


@pytest.mark.parametrize("method", [poses.STEP, poses.LINEAR, poses.CUBICSPLINE])
@pytest.mark.parametrize("rotation", [False, True])
def test_properties_of_the_same_times_may_be_interpolated_together(method: str, rotation: bool) -> None:
    shape = (3, len(TIMES), 3, 4) if method == poses.CUBICSPLINE else (3, len(TIMES), 4)
    values = np.random.default_rng(2).normal(size=shape)
    together = poses.interpolated(TIMES, values, AT, method=method, rotation=rotation)
    assert together.shape == (3, len(AT), 4)
    for one, found in zip(values, together, strict=True):
        alone = poses.interpolated(TIMES, one, AT, method=method, rotation=rotation)
        assert np.abs(found - alone).max() < 1e-15
