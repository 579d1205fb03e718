"""The hierarchy of joints: who carries whom, against walks from joint to joint."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from skinbake.geometry.rig import LONG_CHAIN, NO_CHAIN, NO_PARENT, Lineage, Rig


def rig_of(parents: list[int]) -> Rig:
    return Rig(np.array(parents, dtype=np.int32), np.zeros((len(parents), 3)))


def way_up(parents: list[int], joint: int) -> list[int]:
    """Return a joint and all joints that carry it, from below."""
    way = [joint]
    while parents[way[-1]] != NO_PARENT:
        way.append(parents[way[-1]])
    return way


def random_parents(seed: int) -> list[int]:
    """Return up to 30 joints in any order: several trees, some of them long chains."""
    chance = np.random.default_rng(seed)
    order = chance.permutation(chance.integers(1, 30))
    parents = [NO_PARENT] * len(order)
    longs = chance.random()
    for place, joint in enumerate(order[1:].tolist()):
        if chance.random() > 0.1:
            parents[joint] = int(
                order[place] if chance.random() < longs else order[chance.integers(0, place + 1)]
            )
    return parents


SEEDS = range(30)


@pytest.fixture(params=SEEDS)
def parents(request: pytest.FixtureRequest) -> list[int]:
    return random_parents(request.param)


def test_a_joint_comes_after_the_joints_that_carry_it(parents: list[int]) -> None:
    rig = rig_of(parents)
    assert rig.depths.tolist() == [len(way_up(parents, joint)) - 1 for joint in range(len(parents))]
    assert sorted(rig.ranks) == list(range(len(parents)))
    assert all(rig.ranks[parent] < rig.ranks[joint] for joint, parent in enumerate(parents) if parent >= 0)


def test_a_joint_carries_the_joints_below_it(parents: list[int]) -> None:
    above, joints = np.indices((len(parents), len(parents)))
    found = Lineage(rig_of(parents)).carries(above, joints)
    for joint in range(len(parents)):
        assert np.flatnonzero(found[:, joint]).tolist() == sorted(way_up(parents, joint))


def test_groups_meet_at_the_lowest_joint_above_them(parents: list[int]) -> None:
    chance = np.random.default_rng(len(parents))
    groups, joints = chance.integers(0, 6, 15), chance.integers(0, len(parents), 15)
    found = Lineage(rig_of(parents)).lowest_above(groups, joints, 6)
    for group, lowest in enumerate(found.tolist()):
        ways = [way_up(parents, joint) for joint in joints[groups == group].tolist()]
        shared = [joint for joint in (ways[0] if ways else []) if all(joint in way for way in ways)]
        assert lowest == (shared[0] if shared else len(parents))


def test_ways_up_are_as_long_as_asked(parents: list[int]) -> None:
    joints = np.repeat(np.arange(len(parents)), 2)[::-1]
    counts = [number % (len(way_up(parents, joint)) + 1) for number, joint in enumerate(joints.tolist())]
    rows, passed = Lineage(rig_of(parents)).upwards(joints, np.array(counts))
    expected = [
        (row, joint)
        for row, (start, count) in enumerate(zip(joints.tolist(), counts, strict=True))
        for joint in way_up(parents, start)[:count]
    ]
    assert list(zip(rows.tolist(), passed.tolist(), strict=True)) == expected


def test_long_chains_have_one_number(parents: list[int]) -> None:
    runs: dict[int, list[int]] = {}
    for joint in range(len(parents)):
        first = joint
        while parents[first] != NO_PARENT and parents.count(parents[first]) == 1:
            first = parents[first]
        runs.setdefault(first, []).append(joint)
    expected = {joint: first for first, run in runs.items() if len(run) >= LONG_CHAIN for joint in run}
    found = rig_of(parents).chains.tolist()
    assert found == [expected.get(joint, NO_CHAIN) for joint in range(len(parents))]


def test_random_rigs_have_long_chains_and_none() -> None:
    found = [set(rig_of(random_parents(seed)).chains.tolist()) for seed in SEEDS]
    assert any(len(chains - {NO_CHAIN}) > 1 for chains in found)
    assert any(chains == {NO_CHAIN} for chains in found)


def test_a_long_chain_takes_little_memory() -> None:
    """A hostile skin may have a chain of all its joints. A mask of all pairs would take 400 MB here."""
    count = 20_000
    rig = rig_of([NO_PARENT, *range(count - 1)])
    tracemalloc.start()
    try:
        lineage = Lineage(rig)
        lowest = lineage.lowest_above(np.array([0, 0]), np.array([count - 1, count - 9]), 1)
        assert (rig.ranks == np.arange(count)).all()
        assert (rig.chains == 0).all()
        assert tracemalloc.get_traced_memory()[1] < 32 << 20
    finally:
        tracemalloc.stop()
    assert lowest.tolist() == [count - 9]
