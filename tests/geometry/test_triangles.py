from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from skinbake.geometry import triangles as measuring
from skinbake.geometry.skinned import Float64Array
from skinbake.geometry.triangles import (
    TRIANGLE_FAN,
    TRIANGLE_STRIP,
    TRIANGLES,
    mark_proper,
    smooth_normals,
    unrolled,
)


@pytest.mark.parametrize(
    ("mode", "indices", "expected"),
    [
        (TRIANGLES, [5, 6, 7, 7, 6, 9], [[5, 6, 7], [7, 6, 9]]),
        (TRIANGLES, [5, 6, 7, 7, 6], [[5, 6, 7]]),
        (TRIANGLES, [5, 6], []),
        (TRIANGLE_STRIP, [5, 6, 7, 8, 9], [[5, 6, 7], [6, 8, 7], [7, 8, 9]]),
        (TRIANGLE_STRIP, [5, 6, 7, 7, 9], [[5, 6, 7], [6, 7, 7], [7, 7, 9]]),
        (TRIANGLE_STRIP, [5, 6, 7], [[5, 6, 7]]),
        (TRIANGLE_STRIP, [5, 6], []),
        (TRIANGLE_STRIP, [5], []),
        (TRIANGLE_FAN, [5, 6, 7, 8], [[6, 7, 5], [7, 8, 5]]),
        (TRIANGLE_FAN, [5, 6, 7], [[6, 7, 5]]),
        (TRIANGLE_FAN, [5, 6], []),
        (TRIANGLE_FAN, [5], []),
        (TRIANGLE_FAN, [], []),
        (TRIANGLE_STRIP, [], []),
        (TRIANGLES, [], []),
    ],
)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.uint32, np.int64])
def test_lists_strips_and_fans_are_unrolled_as_gltf_says(
    mode: int, indices: list[int], expected: list[list[int]], dtype: type
) -> None:
    found = unrolled(np.array(indices, dtype=dtype), mode)
    assert found.shape == (len(expected), 3)
    assert found.tolist() == expected
    assert found.dtype == np.uint32


@pytest.mark.parametrize("mode", [TRIANGLE_STRIP, TRIANGLE_FAN])
def test_every_triangle_of_a_flat_strip_or_fan_faces_the_same_way(mode: int) -> None:
    turn = np.linspace(0.0, 3.0, 9)
    if mode == TRIANGLE_STRIP:
        corners = np.column_stack([np.arange(9.0) / 2, np.arange(9) % 2, np.zeros(9)])
        corners[:, 1] *= -1.0  # counter-clockwise from +Z
    else:
        corners = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(9)])
        corners[0] = 0.0
    a, b, c = np.moveaxis(corners[unrolled(np.arange(9), mode)], 1, 0)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


NEEDLE = 1e-6
"""Height of a needle of length 1: far above the limit of 1e-10 that counts as no area."""


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e9])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(
    ("corners", "has_area"),
    [
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], True),
        ([[0, 0, 0], [1, 0, 0], [0.5, NEEDLE, 0]], True),
        ([[0, 0, 0], [1, 0, 0], [1, 0, NEEDLE]], True),
        ([[0, 0, 0], [NEEDLE, 0, 0], [0, 0, NEEDLE]], True),
        ([[0, 0, 0], [0, 0, 0], [0, 0, 0]], False),
        ([[0, 0, 0], [1, 0, 0], [1, 0, 0]], False),
        ([[0, 0, 0], [1, 0, 0], [0, 0, 0]], False),
        ([[0, 0, 0], [1, 1, 1], [2, 2, 2]], False),
        ([[0, 0, 0], [1, 0, 0], [0.5, 1e-11, 0]], False),
        ([[1e-11, 0, 0], [0, 0, 0], [1, 0, 0]], False),
        ([[0, 0, 0], [0, 5e-11, 0], [1, 0, 0]], False),
        ([[0, 0, 0], [1, 0, 0], [0.5, 5e-11, 0]], False),
        ([[0, 0, 0], [0, 2e-10, 0], [1, 0, 0]], True),
    ],
)
def test_a_triangle_has_an_area_whatever_its_size_and_first_corner(
    corners: list[list[float]], has_area: bool, dtype: type, scale: float
) -> None:
    positions: npt.NDArray[np.floating] = (np.array(corners) * scale).astype(dtype)
    faces = np.array([[0, 1, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]])
    assert mark_proper(positions, faces).tolist() == [has_area] * 4


def test_no_triangles_have_no_areas() -> None:
    assert mark_proper(np.zeros((3, 3)), np.zeros((0, 3), dtype=np.int64)).tolist() == []


def test_triangles_in_blocks_are_measured_each_at_its_place(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(6)
    positions = rng.random((40, 3))
    faces = rng.integers(0, 40, (100, 3))
    distinct = np.array([len(set(face)) == 3 for face in faces.tolist()])
    assert 0 < distinct.sum() < 100
    monkeypatch.setattr(measuring, "BLOCK", 7)
    assert np.array_equal(mark_proper(positions, faces), distinct)


def icosphere(rounds: int) -> tuple[Float64Array, npt.NDArray[np.int64]]:
    """Return a unit sphere of subdivided octahedron faces."""
    points = np.concatenate([np.eye(3), -np.eye(3)])
    faces = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])
    for _ in range(rounds):
        corners = points[faces]
        middles = corners + np.roll(corners, -1, axis=1)
        a, b, c = np.moveaxis(corners, 1, 0)
        ab, bc, ca = np.moveaxis(middles / np.linalg.norm(middles, axis=2, keepdims=True), 1, 0)
        split = np.concatenate(
            [np.stack(part, axis=1) for part in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        )
        points, inverse = np.unique(split.reshape(-1, 3).round(12), axis=0, return_inverse=True)
        faces = inverse.reshape(-1, 3)
    return points / np.linalg.norm(points, axis=1, keepdims=True), faces


def test_smooth_normals_of_any_triangulation_of_a_sphere_are_its_radii() -> None:
    # Max's weights are made so that they are exact for vertices on a sphere, whatever the triangles.
    points, faces = icosphere(3)
    jitter = np.random.default_rng(8).normal(size=points.shape) * 0.02
    points = (points + jitter) / np.linalg.norm(points + jitter, axis=1, keepdims=True)
    centre = np.array([3.0, -2.0, 1.0])
    found = smooth_normals(0.7 * points + centre, faces, np.arange(len(points)))
    # Differences of coordinates near 4 lose a digit or two of sixteen; edges are a tenth long.
    assert np.abs(found - points).max() < 1e-12


def test_smooth_normals_are_shared_within_a_group_and_only_there() -> None:
    # A floor and a wall along the X axis, each with its own copies of the edge.
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 0], [0, 0, 1]], dtype=np.float32)
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    floor, wall, both = [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, np.sqrt(0.5), np.sqrt(0.5)]
    # (1, 0, 0) × (0, 1, 0) = Z, and along the wall (−1, 0, 0) × (−1, 0, 1) = Y.
    apart = smooth_normals(positions, faces, np.arange(6))
    assert apart.tolist() == [floor] * 3 + [wall] * 3
    # The two triangles are mirror images, so both count the same.
    joined = smooth_normals(positions, faces, np.array([0, 1, 2, 1, 0, 5]))
    assert joined == pytest.approx(np.array([both, both, floor, both, both, wall]), abs=1e-15)


def test_a_vertex_without_an_area_around_it_points_along_z() -> None:
    positions = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [9, 9, 9]], dtype=np.float32)
    faces = np.array([[0, 1, 2], [0, 0, 1]])
    assert smooth_normals(positions, faces, np.arange(4)).tolist() == [[0.0, 0.0, 1.0]] * 4
