from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
import pytest

from skinbake.geometry.frames import (
    frame_from_normal,
    frame_from_tangent,
    parts_along,
    tangent_deviation,
    unit_normals,
    unit_vectors,
)
from skinbake.geometry.skinned import Float32Array, Float64Array

F = np.float32


def sphere(count: int, seed: int = 0) -> Float32Array:
    """Random unit normals, and those where the formula could break: poles, equator, both zeros."""
    normals = np.random.default_rng(seed).normal(size=(count, 3))
    # Close to −Z, where a basis without the sign flip loses all its digits.
    normals[: count // 4, :2] *= 10.0 ** np.random.default_rng(seed).uniform(-8, 0, (count // 4, 1))
    special = [
        [0, 0, 1],
        [0, 0, -1],
        [1, 0, 0],
        [-1, 0, 0],
        [0, 1, 0],
        [0, -1, 0],
        [1, 0, -0.0],
        [0, -1, -0.0],
        [0.6, 0.8, 0.0],
        [0.6, -0.8, -0.0],
        [0.6, 0.8, 1e-30],
        [0.6, 0.8, -1e-30],
        [-0.0, -0.0, -1],
    ]
    return unit_normals(np.concatenate([normals, special]))


def duff(normal: Iterable[np.float32]) -> tuple[list[np.float32], list[np.float32]]:
    """Evaluate the frame of one normal number by number, in float32, in the order that the shaders keep.

    sign = z ≥ 0 ? 1 : −1;  a = −1 / (sign + z);  b = (x y) a;
    t = (1 + sign ((x x) a), sign b, −sign x);  b0 = (b, sign + (y y) a, −y).
    """
    x, y, z = (F(value) for value in normal)
    sign = F(1.0) if z >= F(0.0) else F(-1.0)
    a = F(-1.0) / F(sign + z)
    b = F(F(x * y) * a)
    tangent = [F(F(1.0) + F(sign * F(F(x * x) * a))), F(sign * b), F(F(-sign) * x)]
    bitangent = [b, F(sign + F(F(y * y) * a)), F(-y)]
    return tangent, bitangent


def bits(values: object) -> npt.NDArray[np.uint32]:
    return np.ascontiguousarray(values, dtype=np.float32).view(np.uint32)


def test_the_frame_from_a_normal_is_orthonormal_and_right_handed() -> None:
    normals = sphere(20_000)
    tangents, bitangents = (values.astype(np.float64) for values in frame_from_normal(normals))
    frame = np.stack([tangents, bitangents, normals.astype(np.float64)], axis=1)
    # A dozen float32 operations on numbers up to 2: 3e-7, measured.
    assert np.abs(frame @ np.swapaxes(frame, 1, 2) - np.eye(3)).max() < 1e-6
    assert np.abs(np.linalg.det(frame) - 1.0).max() < 1e-6


def test_the_frame_from_a_normal_has_the_bits_that_shaders_get() -> None:
    normals = sphere(2_000, seed=1)
    tangents, bitangents = frame_from_normal(normals)
    assert tangents.dtype == bitangents.dtype == np.float32
    expected = [duff(normal) for normal in normals]
    assert np.array_equal(bits(tangents), bits([tangent for tangent, _ in expected]))
    assert np.array_equal(bits(bitangents), bits([bitangent for _, bitangent in expected]))


@pytest.mark.parametrize(
    ("normal", "tangent", "bitangent"),
    [
        ([0, 0, 1], [1, 0, 0], [0, 1, 0]),
        ([0, 0, -1], [1, 0, 0], [0, -1, 0]),
        # z = 0 and −0 alike count as positive: a = −1.
        ([1, 0, 0.0], [0, 0, -1], [0, 1, 0]),
        ([1, 0, -0.0], [0, 0, -1], [0, 1, 0]),
        ([0, 1, 0.0], [1, 0, 0], [0, 0, -1]),
        ([0, 1, -0.0], [1, 0, 0], [0, 0, -1]),
        ([0, -1, -0.0], [1, 0, 0], [0, 0, 1]),
    ],
)
def test_the_frame_is_fixed_on_the_axes(
    normal: list[float], tangent: list[float], bitangent: list[float]
) -> None:
    found = frame_from_normal(np.array([normal], dtype=np.float32))
    assert found[0].tolist() == [tangent]
    assert found[1].tolist() == [bitangent]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_normals_of_any_length_become_unit_and_those_of_none_point_along_z(dtype: type) -> None:
    lengths = np.array([1e-15, 1e-3, 1.0, 7.0, 1e15])
    directions: npt.NDArray[np.floating] = sphere(200, seed=2)[:, None].astype(dtype) * lengths[
        :, None
    ].astype(dtype)
    found = unit_normals(directions.reshape(-1, 3))
    assert found.dtype == np.float32
    # One rounding to float32 a component.
    assert np.abs(np.linalg.norm(found.astype(np.float64), axis=1) - 1.0).max() < 1.2e-7
    assert np.abs(found.reshape(-1, 5, 3) - sphere(200, seed=2)[:, None]).max() < 2e-7
    assert unit_normals(np.zeros((2, 3), dtype=dtype)).tolist() == [[0.0, 0.0, 1.0]] * 2
    assert unit_vectors(np.array([[0.0, 3.0, 4.0]], dtype=dtype)) == pytest.approx(np.array([[0, 0.6, 0.8]]))


@pytest.mark.parametrize("length", [1e-300, 1e-200, 1e-160, 1e-145, 1e154, 1e200, 1e300])
def test_lengths_whose_squares_are_no_floats_change_no_direction(length: float) -> None:
    directions = sphere(200, seed=3)
    found = unit_vectors(directions.astype(np.float64) * length)
    # The directions are unit to a rounding of float32. Their smallest components underflow in part.
    assert np.abs(np.linalg.norm(found, axis=1) - 1.0).max() < 1e-15
    assert np.abs(found - directions).max() < 2e-7


def test_an_extreme_vector_changes_no_bit_of_the_others() -> None:
    usual = np.random.default_rng(4).normal(size=(50, 3))
    extreme = np.array([[3e200, 0.0, 4e200], [0.0, -5e-324, 0.0], [0.0, 0.0, 0.0], [np.inf, 0.0, 1.0]])
    found = unit_vectors(np.concatenate([usual, extreme]))
    assert found[:50].tobytes() == unit_vectors(usual).tobytes()
    assert found[50:] == pytest.approx(np.array([[0.6, 0, 0.8], [0, -1, 0], [0, 0, 1], [0, 0, 1]]), abs=1e-15)


@pytest.mark.parametrize("handedness", [1.0, -1.0])
def test_the_bitangent_follows_the_handedness_of_tangent(handedness: float) -> None:
    normals = np.array([[0, 0, 1], [0, 1, 0]], dtype=np.float32)
    tangents = np.array([[1, 0, 0, handedness], [0, 0, 1, handedness]], dtype=np.float32)
    tangent, bitangent = frame_from_tangent(normals, tangents)
    assert tangent.tolist() == [[1, 0, 0], [0, 0, 1]]
    # (0, 0, 1) × (1, 0, 0) = (0, 1, 0) and (0, 1, 0) × (0, 0, 1) = (1, 0, 0).
    assert bitangent.tolist() == [[0, handedness, 0], [handedness, 0, 0]]
    assert tangent_deviation(normals, tangents).tolist() == [0.0, 0.0]


def skewed(normals: Float64Array, degrees: float, seed: int) -> Float64Array:
    """Return tangents that lean out of the tangent plane by an angle, with random handedness."""
    rng = np.random.default_rng(seed)
    across = np.cross(normals, rng.normal(size=normals.shape))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    angle = math.radians(degrees)
    leaning = math.cos(angle) * across + math.sin(angle) * normals
    return np.column_stack([leaning, rng.choice([-1.0, 1.0], len(normals))])


@pytest.mark.parametrize("degrees", [0.0, 0.05, 0.2, 5.0, 60.0])
@pytest.mark.parametrize("length", [1e-3, 1.0, 40.0])
def test_the_deviation_is_the_angle_between_tangent_times_bitangent_and_the_normal(
    degrees: float, length: float
) -> None:
    # b0 = n0 × t0 is perpendicular to t0, so t0 × b0 leans from n0 as t0 leans out of the plane.
    normals = sphere(300, seed=3)
    tangents = skewed(normals.astype(np.float64), degrees, 4) * [length, length, length, 1.0]
    # Float32 normals are a unit in the last place off: 7e-8 rad.
    assert tangent_deviation(normals, tangents) == pytest.approx(np.full(len(normals), degrees), abs=1e-5)


@pytest.mark.parametrize("tangent", [[0, 0, 0, 1], [1, 0, 0, 0], [1, 0, 0, 0.5], [1, 0, 0, -2], [0, 0, 1, 1]])
def test_a_tangent_that_spans_no_frame_deviates_by_180_degrees(tangent: list[float]) -> None:
    # Without length, without a handedness, along the normal.
    normals = np.array([[0, 0, 1]], dtype=np.float32)
    assert tangent_deviation(normals, np.array([tangent], dtype=np.float32)).tolist() == [180.0]


def test_parts_along_two_vectors_add_up_to_a_vector() -> None:
    random = np.random.default_rng(7)
    a, b, vectors = random.normal(size=(3, 20, 3))
    across = np.cross(a, b)
    wanted = np.linalg.solve(np.stack([a, b, across], axis=2), vectors[..., None])[..., 0]
    assert np.allclose(parts_along(vectors, a, b), wanted[:, :2], rtol=1e-9)
