from __future__ import annotations

import numpy as np
import pytest

from skinbake.geometry.skinned import SkinnedPrimitive
from skinbake.truth.mesh import (
    carrying_slots,
    free_slots,
    influence_keys,
    joint_weights,
    normalised_weights,
)
from tests.support.weight_field import weight_field


def bound(joints: list[list[int]], weights: list[list[float]]) -> SkinnedPrimitive:
    points = np.zeros((len(joints), 3))
    return SkinnedPrimitive(
        points,
        points,
        None,
        np.array(joints, dtype=np.uint8),
        np.array(weights),
        np.zeros((0, 3), dtype=np.uint32),
    )


@pytest.mark.parametrize(
    ("stored", "meant"),
    [
        ([0.5, 0.25, 0.25, 0.0], [0.5, 0.25, 0.25, 0.0]),
        ([1.0, 0.5, 0.5, 0.0], [0.5, 0.25, 0.25, 0.0]),
        ([0.1, 0.1, 0.0, 0.0], [0.5, 0.5, 0.0, 0.0]),
        ([0.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]),
        ([-1.0, 0.0, 1.0, 1.0], [0.0, 0.0, 0.5, 0.5]),
        ([-1.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]),
        ([np.nan, 2.0, 0.0, 2.0], [0.0, 0.5, 0.0, 0.5]),
    ],
)
def test_the_policy_for_bad_weights(stored: list[float], meant: list[float]) -> None:
    weights = np.array([stored], dtype=np.float32)
    kept = weights.copy()
    found = normalised_weights(weights, np.zeros((1, 4), dtype=np.uint8))
    assert found.dtype == np.float64
    assert found.tolist() == [meant]
    assert np.array_equal(weights, kept, equal_nan=True)


def test_weights_and_joints_must_agree_in_shape() -> None:
    with pytest.raises(ValueError, match="differ in shape"):
        normalised_weights(np.ones((2, 4)), np.zeros((2, 8), dtype=np.uint8))


def test_a_joint_that_stands_twice_has_the_sum_in_primitives_of_any_width() -> None:
    first = bound([[2, 0, 2, 0]], [[0.5, 0.25, 0.25, 0.0]])
    second = bound([[1, 1, 1, 1, 3, 3, 3, 9]], [[0.0] * 4 + [0.5, 0.5, 1.0, 0.0]])
    joints, weights = joint_weights([first, second])
    found = [dict(zip(*row, strict=True)) for row in zip(joints.tolist(), weights.tolist(), strict=True)]
    assert found == [{-1: 0.0, 0: 0.25, 2: 0.75}, {-1: 0.0, 1: 0.0, 3: 1.0, 9: 0.0}]
    named = [[joint for joint in row if joint >= 0] for row in joints.tolist()]
    assert named == [[0, 2], [1, 3, 9]]


def test_the_weights_of_joints_are_those_of_a_sparse_matrix() -> None:
    rng = np.random.default_rng(11)
    primitives = [
        bound(rng.integers(0, 9, (200, slots)).tolist(), rng.normal(size=(200, slots)).tolist())
        for slots in (4, 8)
    ]
    joints, weights = joint_weights(primitives)
    found = np.zeros((400, 9))
    np.add.at(found, (np.arange(400)[:, None], joints), np.where(joints < 0, 0.0, weights))
    expected = weight_field(primitives).toarray()
    np.testing.assert_array_equal(found[:, : expected.shape[1]], expected)
    keys, shares = influence_keys(primitives)
    for row, (own, share) in enumerate(zip(keys, shares, strict=True)):
        present = np.flatnonzero(expected[row])
        assert own[own >= 0].tolist() == present.tolist()
        assert share[: len(present)].tolist() == expected[row, present].astype(np.float32).tolist()
        assert not share[len(present) :].any()


def test_a_vertex_without_weight_follows_its_first_joint() -> None:
    joints, weights = joint_weights([bound([[3, 1, 0, 0]], [[0.0] * 4])])
    assert dict(zip(joints[0].tolist(), weights[0].tolist(), strict=True))[3] == weights.sum() == 1.0


@pytest.mark.parametrize(
    ("joints", "weights", "carries"),
    [
        ([0, 1, 2, 3], [1.0, 1.0, 0.0, 0.0], [True, True, True, True]),
        ([0, 0, 0, 0], [0.0, 0.0, 1.0, 1.0], [False, False, True, False]),
        ([5, 0, 0, 0], [1.0, 0.0, 0.0, 0.0], [True, True, False, False]),
        ([5, 5, 6, 6], [0.0, 0.0, 0.0, 0.0], [True, False, True, False]),
        ([5, 5, 6, 6], [-1.0, 0.5, 0.5, 0.0], [False, True, True, False]),
        ([5, 0, 5, 0], [1e-11, 0.5, 0.5, 0.0], [False, True, True, False]),
        ([5, 5, 6, 6], [-1.0, 1e-11, 0.0, 1e-21], [False, True, True, False]),
    ],
)
def test_each_joint_is_carried_by_one_slot(
    joints: list[int], weights: list[float], carries: list[bool]
) -> None:
    assert carrying_slots(bound([joints], [weights])).tolist() == [carries]


def test_weights_that_move_nothing_do_not_turn_the_last_bit_of_others() -> None:
    """Bake leaves them out of the sum, so copies that are one point to bake are one to verify."""
    held = np.random.default_rng(4).uniform(0.1, 1.0, (20000, 2)).astype(np.float32).astype(np.float64)
    tiny = 0.9 * 2.0**-30 * held.max(axis=1, keepdims=True)
    joints = np.tile([0, 1, 2], (len(held), 1)).tolist()
    found_joints, found = influence_keys([bound(joints, np.hstack([held, tiny]).tolist())])
    wanted = (held / held.sum(axis=1, keepdims=True)).astype(np.float32)
    assert np.array_equal(found_joints, np.tile([0, 1], (len(held), 1)))
    assert np.array_equal(found, wanted)


@pytest.mark.parametrize(
    ("stored", "free"),
    [
        ([1.0, 0.0, 2.0**-30, 2.0**-31], [False, True, False, True]),
        ([1e-3, 1e-13, 1e-11, -1e-3], [False, True, False, False]),
        ([0.0, 0.0, -1.0, -0.0], [True, True, False, True]),
    ],
)
def test_free_slots(stored: list[float], free: list[bool]) -> None:
    rows = np.array([stored, [7.0, 0.0, 7.0, 1e-12]], dtype=np.float32)
    assert free_slots(rows).tolist() == [free, [False, True, False, True]]
    assert free_slots(rows[:1]).tolist() == [free]
    assert free_slots(rows[:0]).shape == (0, 4)
