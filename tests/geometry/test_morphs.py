"""Frames carried along with morphed normals: properties that any smallest rotation has, and its limits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skinbake.geometry.frames import frame_from_normal
from skinbake.geometry.morphs import (
    Differences,
    MorphTarget,
    MorphTargets,
    carried_by_normal,
    carried_by_tangent,
    morphed_normals,
)
from skinbake.geometry.poses import random_weights
from skinbake.geometry.skinned import Float64Array, FloatArray


def unit(vectors: FloatArray) -> Float64Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True), dtype=np.float64)


def directions(count: int, seed: int) -> Float64Array:
    return unit(np.random.default_rng(seed).normal(size=(count, 3)))


def frame(normals: FloatArray) -> tuple[Float64Array, Float64Array]:
    """An orthonormal frame around each normal, turned at random, float64."""
    tangents = unit(np.cross(normals, directions(len(normals), 91)))
    return tangents, np.asarray(np.cross(normals, tangents), dtype=np.float64)


def test_the_frame_is_turned_by_the_smallest_rotation() -> None:
    """Against scipy, by axis and angle."""
    before, after = directions(500, 1), directions(500, 2)
    tangents, bitangents = frame(before)
    axes = unit(np.cross(before, after))
    angles = np.arctan2(np.linalg.norm(np.cross(before, after), axis=1), np.einsum("vi,vi->v", before, after))
    turn = Rotation.from_rotvec(axes * angles[:, None])
    t, b = carried_by_normal(before, (tangents, bitangents), after)
    # Conditioned like 1 / |n0 + n|, 20 at the worst of these directions.
    assert t == pytest.approx(turn.apply(tangents), abs=1e-13)
    assert b == pytest.approx(turn.apply(bitangents), abs=1e-13)


def test_the_frame_stays_orthonormal_and_keeps_its_hand() -> None:
    before, after = directions(5000, 3), directions(5000, 4)
    tangents, bitangents = frame(before)
    t, b = carried_by_normal(before, (tangents, -bitangents), after)
    assert np.cross(t, -b) == pytest.approx(after, abs=1e-12)
    assert np.linalg.norm(t, axis=1) == pytest.approx(1.0, abs=1e-12)


def test_a_normal_that_stays_keeps_the_frame_bit_for_bit() -> None:
    normals = directions(5000, 5).astype(np.float32)
    tangents, bitangents = frame_from_normal(normals)
    t, b = carried_by_normal(normals, (tangents, bitangents), normals)
    assert t.dtype == np.float32
    assert np.array_equal(t, tangents)
    assert np.array_equal(b, bitangents)


def test_a_tangent_that_leans_keeps_its_lean() -> None:
    before, after = directions(200, 6), directions(200, 7)
    tangents, bitangents = frame(before)
    leaning = tangents + 0.0017 * before
    t, _ = carried_by_normal(before, (leaning, bitangents), after)
    assert np.einsum("vi,vi->v", t, after) == pytest.approx(0.0017, abs=1e-12)


@pytest.mark.parametrize("degrees", [179.0, 179.39, 179.43, 179.9, 179.9999, 180.0])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_normal_that_turns_over_takes_the_frame_with_it(degrees: float, dtype: type) -> None:
    """On both sides of the threshold: no NaN, no flat frame, t × b along n, all of length 1."""
    before = directions(2000, 8)
    tangents, bitangents = frame(before)
    angle = np.radians(degrees)
    after = np.cos(angle) * before + np.sin(angle) * unit(np.cross(before, directions(2000, 9)))
    given: list[FloatArray] = [array.astype(dtype) for array in (before, tangents, bitangents, after)]
    t, b = carried_by_normal(given[0], given[1:3], given[3])
    # float32: n0 · t0 is 6e-8 and not 0, and counts 4 / |n0 + n| = 400 times; the half turn misses n by 0.6°.
    near = 1e-2 if degrees > 179.42 else 1e-4 if dtype is np.float32 else 1e-9
    assert np.cross(t, b) == pytest.approx(after, abs=near + 1e-4 * (dtype is np.float32))
    for vectors in (t, b):
        assert np.linalg.norm(vectors, axis=1) == pytest.approx(1.0, abs=1e-4)


def test_a_carried_frame_does_not_turn_where_that_of_the_new_normal_flips() -> None:
    """Across z = 0 Duff's frame of n turns by up to 180°; the carried one goes as far as n goes."""
    before, after = unit(np.array([[0.3, 0.6, 1e-3]])), unit(np.array([[0.3, 0.6, -1e-3]]))
    duff = [frame_from_normal(normal.astype(np.float32))[0].astype(np.float64) for normal in (before, after)]
    assert np.linalg.norm(duff[1] - duff[0]) > 0.5
    t, _ = carried_by_normal(before, (duff[0], np.cross(before, duff[0])), after)
    assert np.linalg.norm(t - duff[0]) < 0.01


def test_a_morphed_tangent_is_the_tangent_and_gives_the_bitangent() -> None:
    n0, n = directions(300, 10), directions(300, 11)
    rest = frame(n0)
    moved = 0.8 * unit(np.cross(n, directions(300, 12)))
    handedness = np.where(np.arange(300) % 2, 1.0, -1.0)
    t, b = carried_by_tangent(n0, rest, n, moved, handedness)
    assert t == pytest.approx(moved, abs=1e-14)
    assert np.cross(t, b) * handedness[:, None] == pytest.approx(0.64 * n, abs=1e-14)


def test_a_morphed_tangent_that_leans_out_of_the_surface_is_put_back() -> None:
    """Otherwise t × b would lean with it: the lighting of a morphed and unskinned mesh would be wrong."""
    n0, n = directions(300, 13), directions(300, 14)
    leaning = unit(np.cross(n, directions(300, 15))) + 0.3 * n
    t, b = carried_by_tangent(n0, frame(n0), n, leaning, np.ones(300))
    assert unit(np.cross(t, b)) == pytest.approx(n, abs=1e-14)


def test_a_tangent_that_stays_stays_bit_for_bit() -> None:
    n0 = directions(1000, 16).astype(np.float32)
    t0 = (frame(n0)[0] + 0.001 * n0).astype(np.float32)
    b0 = np.cross(n0, t0)
    t, b = carried_by_tangent(n0, (t0, b0), n0, t0, np.ones(1000, np.float32))
    assert np.array_equal(t, t0)
    assert np.array_equal(b, b0)


def test_a_tangent_that_targets_cancel_leaves_the_frame_to_the_normal() -> None:
    n0, n = directions(3, 19), directions(3, 20)
    t0, b0 = frame(n0)
    left = np.array([0.0, 0.0099, 0.0101])[:, None] * unit(np.cross(n, directions(3, 21)))
    t, b = carried_by_tangent(n0, (t0, b0), n, left, np.ones(3))
    expected = carried_by_normal(n0, (t0, b0), n)
    assert np.array_equal(t[:2], expected[0][:2])
    assert np.array_equal(b[:2], expected[1][:2])
    assert np.linalg.norm(t[2]) == pytest.approx(0.0101)


def test_normals_that_nothing_moves_stay_and_those_that_vanish_too() -> None:
    """Bit for bit: float32 normals are not quite of length 1, and normalising them anew would show."""
    normals = directions(1000, 17).astype(np.float32)
    differences = np.zeros_like(normals)
    differences[1:4] = [[0.5, 0, 0], -normals[2], [np.inf, 0, 0]]
    found, lengths = morphed_normals(normals.astype(np.float64), differences.astype(np.float64))
    kept = np.arange(1000) != 1
    assert np.array_equal(found[kept], normals[kept])
    assert found[1] == pytest.approx(unit((normals + differences)[1:2])[0], abs=1e-7)
    assert (lengths[kept] == 1.0).all()
    assert lengths[1] == pytest.approx(np.linalg.norm((normals + differences)[1]), abs=1e-7)


def test_random_weights_share_no_random_numbers_with_rotations() -> None:
    alike = np.random.default_rng(3).random((50, 2)).argsort(axis=1)[:, 0]
    chosen = random_weights(np.full(2, -1.0), 50, 1, 3).argmax(axis=1)
    assert 10 < np.count_nonzero(chosen == alike) < 40


def test_targets_add_up_where_they_move_something() -> None:
    rng = np.random.default_rng(18)
    dense = rng.normal(size=(3, 6, 3)) * (rng.random((3, 6, 1)) < 0.5)
    targets = MorphTargets(tuple(MorphTarget(Differences.of(one)) for one in dense))
    weights = np.array([0.5, 0.0, -1.25])
    found = targets.summed("positions", weights, 6)
    assert found == pytest.approx(np.tensordot(weights, dense, 1), abs=1e-15)
    assert not targets.summed("normals", weights, 6).any()


def test_differences_that_are_not_finite_count_as_none() -> None:
    dense = np.array([[0, np.nan, 0], [1, 0, 0], [0, 0, np.inf], [0, 0, 0.0]])
    assert Differences.of(dense).rows.tolist() == [1]
