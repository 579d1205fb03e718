"""Influence slots: which joints of neighbours they adopt, what α and β then stand in them, what is lost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from skinbake.choices import Neighbours
from skinbake.geometry.skinned import BakedPrimitive, Float64Array, SkinnedPrimitive
from skinbake.gradients import slots
from skinbake.gradients.baker import BakeFindings, bake_primitives
from skinbake.truth.mesh import weld_classes
from skinbake.truth.operator import gradient_operator
from tests.support.baked_arrays import (
    AFRAME_HAND,
    BARBARIAN,
    CESIUM_MAN,
    ELF,
    HAND_U8,
    HAND_U16,
    MANTIS,
    PBR_TEST,
    bake_one,
    bake_to,
    meshes_of,
    path_of,
)
from tests.support.baking import bake_settings
from tests.support.derivatives import derivatives
from tests.support.surfaces import analytic_surface
from tests.support.weight_field import weight_field
from tests.support.whole_fields import rest_frame

FILES = [
    "foreign_joints.glb",
    "two_sets.glb",
    "weights_u8.glb",
    CESIUM_MAN,
    BARBARIAN,
    HAND_U8,
    AFRAME_HAND,  # vertices without any weight
    MANTIS,  # a repeated joint
    ELF,  # joints past the skin's in slots of weight zero
    PBR_TEST,  # eight slots
]

LARGE = (BARBARIAN, MANTIS, ELF)

NEGLIGIBLE = 1e-4
"""docs/reference/gradients.md: below this share of a vertex's gradient a joint gets no slot."""

SAME = 1.0 + 1e-9
"""Gradients of two implementations are taken for equal within this factor, which leaves ties open."""


@dataclass(frozen=True)
class Vertex:
    """One vertex as plain lists and dicts; gradients by joint, foreign ones by falling magnitude."""

    joints: list[int]
    weights: list[float]
    gradients: dict[int, Float64Array]
    own: set[int]
    foreign: list[int]
    capacity: int
    weightless: bool  # or one of its copies is

    def magnitude(self, joint: int) -> float:
        return float(np.linalg.norm(self.gradients[joint]))


def brute_force(primitives: Sequence[SkinnedPrimitive]) -> list[list[Vertex]]:
    """Return every vertex of a mesh, with libigl's gradients."""
    operator, field = gradient_operator(primitives), weight_field(primitives)
    by_axis = [(axis @ field).toarray() for axis in derivatives(operator)]
    dense = np.stack(by_axis, axis=-1)
    # What libigl's rounding makes of a constant weight is no gradient: 1e-16 of the operator's row.
    reach = sum(abs(axis).sum(axis=1) for axis in derivatives(operator))
    dense[np.linalg.norm(dense, axis=2) < 1e-13 * reach[:, None]] = 0.0
    classes = weld_classes(primitives).tolist()
    stored = [
        (joints, weights)
        for part in primitives
        for joints, weights in zip(part.joints.tolist(), part.weights.tolist(), strict=True)
    ]
    capacity: dict[int, int] = {}
    weightless = {label for label, (_, w) in zip(classes, stored, strict=True) if not max(w) > 0}
    for label, (_, weights) in zip(classes, stored, strict=True):
        free = weights.count(0.0) if any(weight > 0 for weight in weights) else 0
        capacity[label] = min(capacity.get(label, 99), free)
    vertices = []
    for number, (joints, weights) in enumerate(stored):
        own = {joint for joint, weight in zip(joints, weights, strict=True) if weight > 0} or {joints[0]}
        varying = np.flatnonzero(dense[number].any(axis=1)).tolist()
        gradients = {joint: dense[number, joint] for joint in varying}
        total = sum(float(np.linalg.norm(gradient)) for gradient in gradients.values())
        lengths = {joint: float(np.linalg.norm(gradients[joint])) for joint in varying if joint not in own}
        foreign = [joint for joint, length in lengths.items() if length > NEGLIGIBLE * total]
        foreign.sort(key=lambda joint: -lengths[joint])
        label = classes[number]
        room, no_weight = capacity[label], label in weightless
        vertices.append(Vertex(joints, weights, gradients, own, foreign, room, no_weight))
    return [vertices[rows] for rows in operator.slices]


def free_slots(vertex: Vertex) -> list[int]:
    return [slot for slot, weight in enumerate(vertex.weights) if weight == 0.0]


def named_slots(vertex: Vertex, adopted: list[int]) -> dict[int, int]:
    """Return which slot each joint's gradient stands in."""
    slot_of = {joint: slot for slot, joint in enumerate(adopted) if joint >= 0}
    for weighted in (True, False):
        for slot, joint in enumerate(vertex.joints):
            if adopted[slot] < 0 and (vertex.weights[slot] > 0) == weighted:
                slot_of.setdefault(joint, slot)
    return slot_of


def assert_adopts_as_specified(vertex: Vertex, adopted: list[int]) -> None:
    took = [joint for joint in adopted if joint >= 0]
    places = [slot for slot, joint in enumerate(adopted) if joint >= 0]
    if not any(weight > 0 for weight in vertex.weights):
        assert not took
        return
    assert len(took) == min(vertex.capacity, len(vertex.foreign))
    assert set(took) <= set(vertex.foreign)
    assert len(set(took)) == len(took)
    # Into the first slots that are stored with weight zero, the largest gradient first.
    assert places == free_slots(vertex)[: len(took)]
    lengths = [vertex.magnitude(joint) for joint in took]
    assert all(later <= earlier * SAME for earlier, later in pairwise(lengths))
    left = [vertex.magnitude(joint) for joint in vertex.foreign if joint not in took]
    assert not took or not left or max(left) <= min(lengths) * SAME


def assert_counts(
    vertices: list[Vertex], baked: BakedPrimitive, findings: BakeFindings, adopted: list[list[int]]
) -> None:
    total = unheld = 0.0
    overflowing = 0
    for vertex, took in zip(vertices, adopted, strict=True):
        slot_of = named_slots(vertex, took)
        total += sum(vertex.magnitude(joint) for joint in vertex.gradients)
        if vertex.weightless:
            continue  # no further slot would help it
        unheld += sum(vertex.magnitude(joint) for joint in vertex.gradients if joint not in slot_of)
        overflowing += any(joint not in slot_of for joint in vertex.foreign)
    assert findings.adopting_vertices == sum(max(took) >= 0 for took in adopted)
    assert findings.overflowing_vertices == overflowing
    # The same sums in another order, from another implementation's gradients.
    assert findings.lost == pytest.approx(unheld / total if total else 0.0, rel=1e-9, abs=1e-12)


def assert_slots_hold_their_joints(
    vertices: list[Vertex], baked: BakedPrimitive, adopted: list[list[int]], tangents: Float64Array
) -> None:
    """Check α in slots 1 … K − 1, and what minus their sum leaves to slot 0: its own and the homeless."""
    expected = np.zeros(baked.adopted_joints.shape)
    for number, (vertex, took) in enumerate(zip(vertices, adopted, strict=True)):
        slot_of = named_slots(vertex, took)
        for joint, gradient in vertex.gradients.items():
            expected[number, slot_of.get(joint, 0)] += gradient @ tangents[number]
    found = np.concatenate([-baked.alpha.sum(axis=1, keepdims=True, dtype=float), baked.alpha], axis=1)
    # float32, 6e-8 of each value, over a sum of up to seven.
    assert np.abs(found - expected).max() <= 5e-7 * np.abs(expected).max(initial=0.0)


@pytest.mark.slow
@pytest.mark.parametrize("neighbours", [Neighbours.ADOPT, Neighbours.DROP])
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in LARGE else []) for name in FILES]
)
def test_slots_are_filled_as_a_loop_over_vertices_fills_them(name: str, neighbours: Neighbours) -> None:
    adopts = False
    for primitives in meshes_of(path_of(name)).values():
        outcomes = bake_primitives(primitives, bake_settings(neighbours=neighbours))
        for vertices, primitive, (baked, findings) in zip(
            brute_force(primitives), primitives, outcomes, strict=True
        ):
            adopted = baked.adopted_joints.tolist()
            adopts |= baked.adopts
            for vertex, took in zip(vertices, adopted, strict=True):
                if neighbours == "adopt":
                    assert_adopts_as_specified(vertex, took)
            assert_counts(vertices, baked, findings, adopted)
            tangents = rest_frame(primitive, baked.frame).tangents.astype(np.float64)
            assert_slots_hold_their_joints(vertices, baked, adopted, tangents)
    assert adopts == (neighbours == "adopt")


@pytest.mark.slow
@pytest.mark.parametrize("name", [*FILES, HAND_U16, "weights_u16.glb"])
def test_what_was_one_point_before_the_bake_is_one_point_after(name: str, tmp_path: Path) -> None:
    before, after = meshes_of(path_of(name)), meshes_of(bake_to(name, tmp_path))
    for number, primitives in before.items():
        labels = weld_classes(primitives)
        written = weld_classes(after[number])
        # As many classes in the joint numbering as in each: the partitions are equal.
        pairs = set(zip(labels.tolist(), written.tolist(), strict=True))
        assert len(pairs) == len(set(labels.tolist())) == len(set(written.tolist()))


def star(hub_joints: Sequence[Sequence[int]], hub_weights: Sequence[Sequence[float]]) -> SkinnedPrimitive:
    """Return a square around a hub, one copy of the hub per row, on +Z; corner i is held by joint i + 1.

    The corners lie at distance 1, 2, 4, 8 along +X, +Y, −X, −Y; copies take the triangles in turn.
    """
    corners = [[1.0, 0, 0], [0, 2.0, 0], [-4.0, 0, 0], [0, -8.0, 0]]
    hubs = len(hub_joints)
    slots_count = len(hub_joints[0])
    joints = np.zeros((hubs + 4, slots_count), dtype=np.int64)
    weights = np.zeros((hubs + 4, slots_count))
    joints[:hubs], weights[:hubs] = hub_joints, hub_weights
    joints[hubs:, 0], weights[hubs:, 0] = [1, 2, 3, 4], 1.0
    faces = [[side % hubs, hubs + side, hubs + (side + 1) % 4] for side in range(4)]
    return SkinnedPrimitive(
        np.concatenate([np.zeros((hubs, 3)), corners]),
        np.tile([0.0, 0.0, 1.0], (hubs + 4, 1)),
        None,
        joints,
        weights,
        np.array(faces),
    )


def test_the_largest_gradients_are_adopted_first() -> None:
    # The hub has four right angles, so Max's weights are 1 / (|e1| |e2|) = 1/2, 1/8, 1/32, 1/8, of 25/32. The
    # hat of a corner has the slope 1 / distance in the two triangles beside it: joint 1, the nearest, has
    # the largest gradient, joint 4 the least.
    baked, findings = bake_one(star([[9, 0, 0, 0]], [[1.0, 0.0, 0.0, 0.0]]))
    assert baked.adopted_joints[0].tolist() == [-1, 1, 2, 3]
    shares = {
        1: (1 / 2 + 1 / 8) / 1,
        2: (1 / 2 + 1 / 8) / 2,
        3: (1 / 8 + 1 / 32) / 4,
        4: (1 / 32 + 1 / 8) / 8,
    }
    slope = {joint: share / (25 / 32) for joint, share in shares.items()}
    assert baked.alpha[0] == pytest.approx([slope[1], 0.0, -slope[3]], abs=1e-7)
    assert baked.beta[0] == pytest.approx([0.0, slope[2], 0.0], abs=1e-7)
    assert findings.overflowing_vertices == 1


def test_only_slots_of_weight_zero_are_taken_and_a_repeated_joints_second_slot_is_not() -> None:
    baked, _ = bake_one(star([[9, 9, 0, 9]], [[0.5, 0.25, 0.0, 0.25]]))
    assert baked.adopted_joints[0].tolist() == [-1, -1, 1, -1]


def test_a_vertex_without_weight_adopts_nothing() -> None:
    baked, findings = bake_one(star([[9, 0, 0, 0]], [[0.0, 0.0, 0.0, 0.0]]))
    assert baked.adopted_joints[0].tolist() == [-1] * 4
    assert findings.weights.all_zero == 1
    assert (findings.overflowing_vertices, findings.lost) == (0, 0.0)  # more slots would not help


@pytest.mark.parametrize(
    "little",
    [
        [0.0] * 4,
        [1e-4, 2e-4, 0.0, 0.0],
        [2e-4] * 4,
        [-1.0, 5e-4, 0.0, 0.0],
        [1.0 - 5e-7, 1e-20, 1e-20, 0.0],  # its sum is valid by two weights that move nothing
    ],
)
def test_a_vertex_with_too_little_weight_to_adopt_leaves_nothing_out(little: list[float]) -> None:
    full, names = [0.25] * 4, [9] * 4
    enough = bake_one(star([names], [full]))[1]
    assert enough.overflowing_vertices == 1
    assert enough.lost > 0.0
    # A copy of the hub with little weight is the same point, which then may not adopt.
    for weights in ([little], [little, full], [full, little]):
        found = bake_one(star([names] * len(weights), weights))[1]
        assert (found.overflowing_vertices, found.lost) == (0, 0.0)


def test_a_vertex_of_only_negative_weights_adopts_nothing() -> None:
    # It counts as bound to slot 0's joint; a weight of 2⁻³⁰ beside negative ones would be the whole.
    baked, _ = bake_one(star([[9, 0, 0, 0]], [[-0.5, 0.0, 0.0, 0.0]]))
    assert baked.adopted_joints[0].tolist() == [-1] * 4


def test_slot_0_adopts_where_it_has_no_weight() -> None:
    baked, _ = bake_one(star([[0, 9, 0, 0]], [[0.0, 1.0, 0.0, 0.0]]))
    assert baked.adopted_joints[0].tolist() == [1, -1, 2, 3]


def test_a_joint_named_without_weight_moves_to_the_slot_its_gradient_deserves() -> None:
    baked, _ = bake_one(star([[9, 3, 1, 0]], [[1.0, 0.0, 0.0, 0.0]]))
    assert baked.adopted_joints[0].tolist() == [-1, 1, 2, 3]


def test_copies_adopt_the_same_joints_as_many_as_the_poorest_has_room_for() -> None:
    # One point three times over: three slots free, then one (its joint is split over three), then two.
    joints = [[9, 0, 0, 0], [9, 9, 9, 0], [0, 9, 9, 0]]
    weights = [[1.0, 0.0, 0.0, 0.0], [0.5, 0.25, 0.25, 0.0], [0.0, 0.5, 0.5, 0.0]]
    primitive = star(joints, weights)
    baked, findings = bake_one(primitive)
    assert baked.adopted_joints[:3].tolist() == [[-1, 1, -1, -1], [-1, -1, -1, 1], [1, -1, -1, -1]]
    assert findings.overflowing_vertices == 3
    # By hand, from the slopes above: of Σ = s1 + … + s4 + |∇w9|, the last three of the foreign are lost at
    # each copy, and ∇w9 is minus the sum of the others.
    slopes = np.array([[1 / 1, 0], [0, 1 / 2], [-1 / 4, 0], [0, -1 / 8]]) * np.array(
        [[5 / 8], [5 / 8], [5 / 32], [5 / 32]]
    )
    slopes /= 25 / 32
    hub = np.linalg.norm(slopes, axis=1)
    own = np.linalg.norm(slopes.sum(axis=0))
    lost_at_hub = 3 * hub[1:].sum()
    total_at_hub = 3 * (hub.sum() + own)
    vertices = brute_force([primitive])[0]
    corner_total = sum(v.magnitude(joint) for v in vertices[3:] for joint in v.gradients)
    assert findings.lost == pytest.approx(lost_at_hub / (total_at_hub + corner_total), rel=1e-9)


def test_dropping_adopts_nothing_and_counts_every_vertex_that_would() -> None:
    baked, findings = bake_one(
        star([[9, 0, 0, 0]], [[1.0, 0.0, 0.0, 0.0]]), bake_settings(neighbours=Neighbours.DROP)
    )
    assert not baked.adopts
    assert not baked.alpha.any()
    assert findings.adopting_vertices == 0
    # All five have foreign joints, and joint 0 pads every slot but is nobody's.
    assert findings.overflowing_vertices == 5
    assert 0.0 < findings.lost < 1.0


def test_a_joint_that_hardly_varies_takes_no_slot() -> None:
    # At the hub joint 4 has 1e-5 of its usual gradient where corner 4 is almost all joint 9.
    primitive = star([[9, 0, 0, 0]], [[1.0, 0.0, 0.0, 0.0]])
    weights, joints = primitive.weights.copy(), primitive.joints.copy()
    joints[1:, 1] = 9
    weights[2:, 0], weights[2:, 1] = 1e-5, 1.0 - 1e-5
    baked, findings = bake_one(replace(primitive, weights=weights, joints=joints))
    assert baked.adopted_joints[0].tolist() == [-1, 1, -1, -1]
    assert findings.overflowing_vertices == 0
    assert 0.0 < findings.lost < NEGLIGIBLE


def motley() -> SkinnedPrimitive:
    """Return a surface on which every vertex has joints of its own, and none to three slots free."""
    surface = analytic_surface(300, "random", seed=3).primitive
    rng = np.random.default_rng(3)
    count = len(surface.positions)
    weights = rng.random((count, 4)) * (np.arange(4) <= rng.integers(0, 4, (count, 1)))
    joints = rng.permuted(np.tile(np.arange(12), (count, 1)), axis=1)[:, :4]
    return replace(surface, joints=joints, weights=weights)


@pytest.mark.parametrize("block", [1, 7, 1000])
def test_the_size_of_a_block_changes_nothing(block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    primitives = [motley()]
    [(expected, numbers)] = bake_primitives(primitives, bake_settings())
    monkeypatch.setattr(slots, "BLOCK", block)
    [(found, own)] = bake_primitives(primitives, bake_settings())
    assert np.array_equal(found.alpha, expected.alpha)
    assert np.array_equal(found.beta, expected.beta)
    assert np.array_equal(found.adopted_joints, expected.adopted_joints)
    assert own._replace(lost=0.0, magnitude=0.0) == numbers._replace(lost=0.0, magnitude=0.0)
    assert own.lost == pytest.approx(numbers.lost, rel=1e-12)
