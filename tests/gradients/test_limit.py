"""Which influences --limit-influences keeps, against a search vertex by vertex."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from skinbake.geometry.skinned import SkinnedPrimitive
from skinbake.gradients.influences import LimitedSlots, limited_slots
from tests.support.baked_arrays import PBR_TEST, meshes_of, path_of, reslotted


def vertices(joints: object, weights: object) -> SkinnedPrimitive:
    bound, shares = np.array(joints, dtype=np.int64), np.array(weights, dtype=np.float32)
    count = len(bound)
    return SkinnedPrimitive(
        np.zeros((count, 3)), np.zeros((count, 3)), None, bound, shares, np.zeros((0, 3), dtype=np.int64)
    )


def limit_one(joints: object, weights: object, count: int = 4) -> tuple[list[Any], list[float], bool, float]:
    """Return a vertex's joints (−1 for none), shares, whether they are rewritten, and what was dropped."""
    primitive = vertices([joints], [weights])
    found = limited_slots(primitive, count)
    return (
        joints_of(primitive, found)[0].tolist(),
        found.shares[0].tolist(),
        bool(found.rewritten[0]),
        float(found.dropped[0]),
    )


def joints_of(primitive: SkinnedPrimitive, found: LimitedSlots) -> npt.NDArray[np.int64]:
    taken = np.take_along_axis(primitive.joints, np.maximum(found.slots, 0), axis=1)
    return np.where(found.slots >= 0, taken, -1)


def searched(primitive: SkinnedPrimitive, count: int) -> list[dict[int, float]]:
    """Return the kept influences of every vertex, joint → share, by sorting a dictionary."""
    result = []
    for joints, weights in zip(primitive.joints.tolist(), primitive.weights.tolist(), strict=True):
        merged: dict[int, float] = {}
        for joint, weight in zip(joints, weights, strict=True):
            if weight > 0:
                merged[joint] = merged.get(joint, 0.0) + weight
        merged = merged or {joints[0]: 1.0}
        kept = sorted(merged.items(), key=lambda item: (-item[1], item[0]))[:count]
        total = sum(weight for _, weight in kept)
        result.append({joint: weight / total for joint, weight in kept})
    return result


@pytest.mark.parametrize("name", ["two_sets.glb", "hand_l-two-sets.glb", PBR_TEST])
def test_files_keep_what_a_search_keeps(name: str) -> None:
    for [primitive] in meshes_of(path_of(name)).values():
        found = limited_slots(primitive, 4)
        joints = joints_of(primitive, found)
        for vertex, expected in enumerate(searched(primitive, 4)):
            kept = {
                int(joint): float(share)
                for joint, share in zip(joints[vertex], found.shares[vertex], strict=True)
                if joint >= 0
            }
            # Weights are compared in float32, whose rounding is 6e-8 of each.
            assert kept == pytest.approx(expected, rel=3e-7)
        assert found.shares.sum(axis=1) == pytest.approx(1.0, abs=1e-15)
        assert (np.diff(found.shares, axis=1) <= 0).all()


def test_the_smallest_go_and_the_others_share_their_weight() -> None:
    joints, shares, rewritten, dropped = limit_one(
        [9, 8, 7, 6, 5, 0, 0, 0], [0.3, 0.1, 0.25, 0.2, 0.15, 0, 0, 0]
    )
    assert joints == [9, 7, 6, 5]
    assert shares == pytest.approx([0.3 / 0.9, 0.25 / 0.9, 0.2 / 0.9, 0.15 / 0.9], rel=1e-6)
    assert rewritten
    assert dropped == pytest.approx(0.1, rel=1e-6)


def test_of_equal_weights_the_lowest_joint_stays() -> None:
    joints, shares, *_ = limit_one([9, 3, 7, 1, 5, 0, 0, 0], [0.2, 0.2, 0.2, 0.2, 0.2, 0, 0, 0])
    assert joints == [1, 3, 5, 7]
    assert shares == [0.25] * 4


def test_repeats_are_merged_before_the_choice() -> None:
    # Joint 5 is the smallest in each of its slots, and the second largest in all.
    given = [5, 1, 2, 3, 5, 4, 0, 0], [0.12, 0.3, 0.18, 0.14, 0.12, 0.14, 0, 0]
    joints, shares, rewritten, dropped = limit_one(*given)
    assert joints == [1, 5, 2, 3]
    assert shares == pytest.approx(np.array([0.3, 0.24, 0.18, 0.14]) / 0.86, rel=1e-6)
    assert rewritten
    assert dropped == pytest.approx(0.14, rel=1e-6)


def test_merging_alone_is_a_change_without_a_loss() -> None:
    assert limit_one([5, 1, 0, 0, 5, 0, 0, 0], [0.25, 0.5, 0, 0, 0.25, 0, 0, 0]) == (
        [1, 5, -1, -1],
        [0.5, 0.5, 0.0, 0.0],
        True,
        0.0,
    )


def test_few_influences_in_any_slots_only_move() -> None:
    joints, _, rewritten, dropped = limit_one([3, 0, 0, 0, 0, 8, 0, 2], [0.25, 0, 0, 0, 0, 0.5, 0, 0.25])
    assert (joints, rewritten, dropped) == ([8, 2, 3, -1], False, 0.0)


def test_a_negative_weight_goes_and_is_told() -> None:
    joints, _, rewritten, _ = limit_one([3, 1, 0, 0, 2, 0, 0, 0], [0.75, 0.5, 0, 0, -0.25, 0, 0, 0])
    assert (joints, rewritten) == ([3, 1, -1, -1], True)


def test_a_vertex_without_weight_keeps_slot_0() -> None:
    joints, _, rewritten, dropped = limit_one([6, 1, 2, 3, 4, 5, 0, 0], [0.0] * 8)
    assert (joints, rewritten, dropped) == ([6, -1, -1, -1], False, 0.0)


@pytest.mark.parametrize("count", [4, 8])
def test_copies_in_any_slot_order_stay_copies_bit_by_bit(count: int) -> None:
    rng = np.random.default_rng(5)
    weights = rng.choice([0.0, 0.1, 0.1, 0.25, 1 / 3, 0.7], (500, 12))
    weights[:, 0] += 0.1
    joints = np.stack([rng.permutation(20)[:12] for _ in range(500)])
    primitive = vertices(joints, weights / weights.sum(axis=1, keepdims=True))
    expected, others = limited_slots(primitive, count), reslotted(primitive, 3)
    found = limited_slots(others, count)
    assert np.array_equal(joints_of(others, found), joints_of(primitive, expected))
    assert np.array_equal(found.shares, expected.shares)
    assert np.array_equal(found.rewritten, expected.rewritten)
    assert found.rewritten.any()
