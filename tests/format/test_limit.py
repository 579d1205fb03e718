"""How fewer influences are stored, in every component type."""

from __future__ import annotations

import numpy as np
import pytest

from skinbake.format.influences import common_unit, with_limit
from skinbake.gltf.reading.accessors import StoredArray
from skinbake.gltf.reading.meshes import StoredInfluences


def influences(joints: object, weights: object, joint_type: str, weight_type: str) -> StoredInfluences:
    return StoredInfluences(
        StoredArray(np.array(joints, dtype=joint_type), normalized=False),
        StoredArray(np.array(weights, dtype=weight_type), normalized=weight_type != "f4"),
    )


def two_sets(weight_type: str, *, second: str | None = None) -> list[StoredInfluences]:
    return [
        influences([[4, 2, 9, 1]], [[60, 50, 40, 50]], "u1", weight_type),
        influences([[300, 0, 0, 0]], [[55, 0, 0, 0]], "u2", second or weight_type),
    ]


MOVED = np.array([[0, 4, 1, 3]])
SHARES = np.array([[60, 55, 50, 50]]) / 215


@pytest.mark.parametrize("weight_type", ["u1", "u2"])
def test_rewritten_integers_keep_their_type_and_sum_to_its_largest_value(weight_type: str) -> None:
    [found] = with_limit(two_sets(weight_type), MOVED, SHARES, np.array([True]))
    unit = np.iinfo(weight_type).max
    assert found.weights.values.dtype == weight_type
    assert found.weights.normalized
    assert found.weights.values.astype(int).sum() == unit
    # No weight is further from its share than the rounding of one.
    assert np.abs(found.weights.values.astype(float) - SHARES * unit).max() < 1
    assert found.joints.values.tolist() == [[4, 300, 2, 1]]
    assert found.joints.values.dtype == "u2"
    assert not found.joints.normalized


def test_of_equal_remainders_the_earlier_slot_is_rounded_up() -> None:
    [found] = with_limit(two_sets("u1"), MOVED, np.array([[0.25, 0.25, 0.25, 0.25]]), np.array([True]))
    assert found.weights.values.tolist() == [[64, 64, 64, 63]]


def test_rewritten_floats_are_the_shares() -> None:
    [found] = with_limit(two_sets("f4"), MOVED, SHARES, np.array([True]))
    assert found.weights.values.dtype == np.float32
    assert not found.weights.normalized
    assert found.weights.values.tolist() == SHARES.astype(np.float32).tolist()


@pytest.mark.parametrize("weight_type", ["u1", "u2", "f4"])
def test_what_only_moves_keeps_its_bits(weight_type: str) -> None:
    [found] = with_limit(two_sets(weight_type), np.array([[0, 4, -1, -1]]), SHARES, np.array([False]))
    assert found.weights.values.tolist() == [[60, 55, 0, 0]]
    assert found.joints.values.tolist() == [[4, 300, 0, 0]]


def test_a_weight_that_rounds_to_nothing_names_joint_0() -> None:
    shares = np.array([[0.999, 0.0005, 0.0004, 0.0001]])
    [found] = with_limit(two_sets("u1"), MOVED, shares, np.array([True]))
    assert found.weights.values.tolist() == [[255, 0, 0, 0]]
    assert found.joints.values.tolist() == [[4, 0, 0, 0]]


def test_sets_of_two_types_become_floats() -> None:
    sets = two_sets("u1", second="u2")
    assert common_unit(sets) is None
    [found] = with_limit(sets, np.array([[0, 4, -1, -1]]), SHARES, np.array([False]))
    assert found.weights.values.dtype == np.float32
    expected = np.array([[60 / 255, 55 / 65535, 0, 0]], dtype=np.float32)
    assert found.weights.values.tolist() == expected.tolist()


def test_eight_of_twelve_are_two_sets() -> None:
    sets = [influences([[n, n + 1, n + 2, n + 3]], [[0.1, 0.1, 0.05, 0.05]], "u1", "f4") for n in (0, 4, 8)]
    slots = np.array([[0, 1, 4, 5, 8, 9, 2, 3]])
    found = with_limit(sets, slots, np.full((1, 8), 0.125), np.array([True]))
    assert [entry.joints.values.tolist() for entry in found] == [[[0, 1, 4, 5]], [[8, 9, 2, 3]]]
    assert all(entry.joints.values.dtype == "u1" for entry in found)
    assert all(entry.weights.values.tolist() == [[0.125] * 4] for entry in found)
