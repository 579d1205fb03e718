"""Which copies of a vertex are one point of the surface."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pytest

from skinbake.geometry.skinned import IntArray, SkinnedPrimitive
from skinbake.gradients import by_numpy, kernel
from skinbake.gradients import weld as welding
from skinbake.gradients.influences import weight_field
from skinbake.gradients.surface import concatenate_fields
from skinbake.gradients.weld import weld
from skinbake.truth.mesh import weld_classes
from tests.support.baked_arrays import (
    AFRAME_HAND,
    BARBARIAN,
    CESIUM_MAN,
    ELF,
    FIXTURES,
    HAND_U8,
    MANNEQUINY,
    MANTIS,
    PBR_TEST,
    TREX,
    bake_one,
    meshes_of,
    path_of,
)
from tests.support.labels import as_met

MODELS = [
    CESIUM_MAN,
    MANNEQUINY,
    BARBARIAN,
    TREX,
    PBR_TEST,
    HAND_U8,
    ELF,
    MANTIS,
    AFRAME_HAND,
    "Robot/robot.glb",
    "BaseFemale/BaseFemale.glb",
    "Butterfly/animated_butterfly.glb",
    "spider-nonindexed.glb",
]
UP = (0.0, 0.0, 1.0)


def copies(
    *,
    positions: object = (0.0, 0.0, 0.0),
    normals: object = UP,
    joints: object = (0, 1, 2, 3),
    weights: object = (0.5, 0.5, 0.0, 0.0),
    dtype: type = np.float32,
) -> SkinnedPrimitive:
    """Return vertices that differ only in what is given by rows."""
    parts = [np.atleast_2d(np.asarray(part)) for part in (positions, normals, joints, weights)]
    count = max(len(part) for part in parts)
    at, along, bound, shares = (np.array(np.broadcast_to(part, (count, part.shape[1]))) for part in parts)
    return SkinnedPrimitive(
        at.astype(dtype),
        along.astype(dtype),
        None,
        bound.astype(np.int64),
        shares.astype(dtype),
        np.zeros((0, 3), dtype=np.int64),
    )


def tilted(*degrees: float) -> list[list[float]]:
    return [[math.sin(math.radians(angle)), 0.0, math.cos(math.radians(angle))] for angle in degrees]


def labels_of(primitives: Sequence[SkinnedPrimitive], crease: float = 15.0) -> IntArray:
    return weld(
        np.concatenate([part.positions for part in primitives]),
        np.concatenate([part.normals for part in primitives]),
        concatenate_fields([weight_field(part)[0] for part in primitives]),
        crease_angle=math.radians(crease),
    )


def classes(*primitives: SkinnedPrimitive, crease: float = 15.0) -> list[int]:
    labels = labels_of(primitives, crease)
    assert sorted(set(labels.tolist())) == list(range(len(set(labels.tolist()))))
    return as_met(labels)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*FIXTURES, *MODELS])
def test_the_classes_are_those_of_another_implementation(name: str) -> None:
    for primitives in meshes_of(path_of(name)).values():
        for crease in (15.0, 0.0, 60.0, 180.0):
            expected = weld_classes(primitives, crease_angle_degrees=crease)
            assert as_met(labels_of(primitives, crease)) == as_met(expected)


def test_uv_seams_weld_although_their_normals_and_the_sign_of_zero_differ() -> None:
    [part] = meshes_of(path_of("seam.glb"))[0]
    found = labels_of([part])
    # 17 columns of which one is doubled, 11 rows.
    assert (len(part.positions), len(set(found.tolist()))) == (198, 187)


def test_hard_edges_stay_apart() -> None:
    [part] = meshes_of(path_of("hard_edge.glb"))[0]
    assert len(set(labels_of([part]).tolist())) == len(part.positions) == 198
    assert len(set(labels_of([part], crease=91.0).tolist())) == 187


def test_equal_positions_weld_and_minus_zero_is_zero() -> None:
    positions = [[0, 0, 0], [-0.0, 0, -0.0], [0, 1e-30, 0], [0, 0, 1e-45]]
    assert classes(copies(positions=positions)) == [0, 0, 1, 2]
    assert as_met(kernel.label_equal_rows(np.array(positions, dtype=np.float32))) == [0, 0, 1, 2]


@pytest.mark.parametrize("sign", [1.0, -1.0, 0.0])
def test_minus_zero_in_a_normal_is_zero(sign: float) -> None:
    normals = [[0.0, 0.0, sign], [-0.0, -0.0, sign]]
    assert classes(copies(normals=normals), crease=0.0) == [0, 0]


@pytest.mark.parametrize(
    ("angles", "expected"),
    [
        ((0.0, 14.99), [0, 0]),
        ((0.0, 15.01), [0, 1]),
        ((0.0, 20.0, 10.0), [0, 0, 0]),
        ((0.0, 20.0, 40.0, 10.0, 100.0, 90.0), [0, 0, 1, 0, 2, 2]),
        # A chain from end to end whose links come last.
        ((0.0, 56.0, 42.0, 28.0, 14.0), [0, 0, 0, 0, 0]),
        ((0.0, 180.0), [0, 1]),
    ],
)
def test_normals_chain_up_to_the_crease_angle(angles: tuple[float, ...], expected: list[int]) -> None:
    assert classes(copies(normals=tilted(*angles))) == expected


@pytest.mark.parametrize("start", range(0, 24, 5))
def test_sides_that_meet_at_exactly_the_crease_angle_weld(start: int) -> None:
    # A prism of 24 sides: adjacent ones meet at 15°, the crease angle, up to rounding either way.
    normals = tilted(15.0 * start, 15.0 * (start + 1))
    assert classes(copies(normals=normals, dtype=np.float64)) == [0, 0]


def test_the_edges_of_a_prism_of_24_sides_weld_all_round() -> None:
    sides = np.arange(24)
    positions = np.repeat([[math.cos(a), math.sin(a), 0.0] for a in 2 * np.pi * sides / 24], 2, axis=0)
    half = math.radians(7.5)
    normals = [[math.cos(a + h), math.sin(a + h), 0.0] for a in 2 * np.pi * sides / 24 for h in (-half, half)]
    found = classes(copies(positions=positions, normals=normals, dtype=np.float64))
    assert found == np.repeat(sides, 2).tolist()


def test_sides_that_meet_at_more_than_the_crease_angle_do_not_weld() -> None:
    # 23 sides meet at 15.65°.
    assert classes(copies(normals=tilted(0.0, 360.0 / 23), dtype=np.float64)) == [0, 1]


@pytest.mark.parametrize(
    ("joints", "weights", "welds"),
    [
        ([[0, 1, 2, 3], [1, 0, 3, 2]], [[0.7, 0.3, 0, 0], [0.3, 0.7, 0, 0]], True),
        ([[0, 1, 2, 3], [0, 1, 9, 9]], [[0.7, 0.3, 0, 0], [0.7, 0.3, 0, 0]], True),
        ([[0, 1, 2, 3], [0, 1, 0, 1]], [[0.5, 0.5, 0, 0], [0.25, 0.375, 0.25, 0.125]], True),
        ([[0, 1, 2, 3], [0, 1, 2, 3]], [[0.75, 0.25, 0, 0], [1.5, 0.5, 0, 0]], True),
        ([[4, 1, 2, 3], [4, 2, 1, 3]], [[0, 0, 0, 0], [1, 0, 0, 0]], True),
        ([[0, 1, 2, 3], [0, 1, 2, 3]], [[0.7, 0.3, 0, 0], [0.6999, 0.3001, 0, 0]], False),
        ([[0, 1, 2, 3], [0, 2, 1, 3]], [[0.7, 0.3, 0, 0], [0.7, 0.3, 0, 0]], False),
        ([[0, 1, 2, 3], [1, 0, 2, 3]], [[0.7, 0.3, 0, 0], [0.7, 0.3, 0, 0]], False),
    ],
)
def test_influences_are_compared_whatever_the_order_of_their_slots(
    joints: object, weights: object, welds: bool
) -> None:
    assert (classes(copies(joints=joints, weights=weights)) == [0, 0]) == welds


def test_primitives_of_other_types_and_widths_weld() -> None:
    narrow = copies(positions=[[0.5, 0.25, 0.0], [1.0, 0.0, 0.0]], weights=[0.5, 0.25, 0.25, 0.0])
    wide = copies(
        positions=[[1.0, 0.0, 0.0], [0.5, 0.25, 0.0]],
        joints=[9, 9, 9, 9, 2, 1, 0, 9],
        weights=[0.0, 0.0, 0.0, 0.0, 0.25, 0.25, 0.5, 0.0],
        dtype=np.float64,
    )
    assert classes(narrow, wide) == [0, 1, 1, 0]


def test_primitives_are_gathered_across_their_border() -> None:
    parts = meshes_of(path_of("two_primitives.glb"))[0]
    found = labels_of(parts)
    split = len(parts[0].positions)
    shared = set(found[:split].tolist()) & set(found[split:].tolist())
    assert len(shared) == 11  # the rows of the sheet


def directions(count: int, seed: int) -> npt.NDArray[np.float64]:
    """Return unit vectors in five clusters that no chain of 5° joins, each a chain of its own."""
    rng = np.random.default_rng(seed)
    centres = np.concatenate([np.eye(3), -np.eye(3)[:2]])
    spread = centres[np.arange(count) % 5] + rng.uniform(-0.1, 0.1, (count, 3))
    lengths: npt.NDArray[np.float64] = np.linalg.norm(spread, axis=1, keepdims=True)
    return spread / lengths


@pytest.mark.parametrize("count", [welding.PAIRED_GROUP, welding.PAIRED_GROUP + 1, 500])
@pytest.mark.parametrize("crease", [2.0, 15.0])
def test_groups_of_every_size_weld_alike(count: int, crease: float) -> None:
    # Groups above PAIRED_GROUP grow step by step, smaller ones are compared pair by pair.
    part = copies(normals=directions(count, seed=count), dtype=np.float64)
    found = classes(part, crease=crease)
    assert found == as_met(weld_classes([part], crease_angle_degrees=crease))
    assert len(set(found)) == 5 if crease == 15.0 else len(set(found)) > 5


@pytest.mark.slow
@pytest.mark.parametrize(("count", "expected"), [(4096, 5), (4097, 4097)])
def test_points_of_very_many_normals_weld_equal_ones_only(count: int, expected: int) -> None:
    part = copies(normals=[*directions(count, seed=1), *directions(count, seed=1)], dtype=np.float64)
    found = classes(part)
    assert len(set(found)) == expected
    assert found[:count] == found[count:]
    assert found == as_met(weld_classes([part]))


def test_groups_of_several_sizes_beside_each_other_weld_as_if_alone() -> None:
    sizes = [1, 2, 3, 3, 40, 7, 45, 2]
    parts = [
        copies(positions=[float(place), 0.0, 0.0], normals=directions(size, seed=place), dtype=np.float64)
        for place, size in enumerate(sizes)
    ]
    together = labels_of(parts)
    start = 0
    seen: set[int] = set()
    for part, size in zip(parts, sizes, strict=True):
        own = together[start : start + size]
        assert as_met(own) == as_met(labels_of([part]))
        assert not seen & set(own.tolist())
        seen |= set(own.tolist())
        start += size


@pytest.mark.parametrize("crease", [0.0, 5.0, 15.0, 180.0])
@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_vertices_changes_no_class(crease: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = 600
    positions = rng.integers(0, 4, (count, 3)) * 0.25
    part = copies(
        positions=positions,
        normals=directions(count, seed=seed),
        joints=rng.permuted(np.tile([0, 1, 2, 3], (count, 1)), axis=1),
        weights=np.array([[0.5, 0.5, 0, 0], [0.5, 0.25, 0.25, 0]])[rng.integers(0, 2, count)],
    )
    order = rng.permutation(count)
    moved = copies(
        positions=part.positions[order],
        normals=part.normals[order],
        joints=part.joints[order],
        weights=part.weights[order],
    )
    found, expected = labels_of([moved], crease), labels_of([part], crease)
    assert len(set(expected.tolist())) > 64
    assert as_met(found) == as_met(expected[order])


def test_rows_of_one_hash_are_compared_in_full() -> None:
    first = np.random.default_rng(1).integers(0, 9, (200, 1)).astype(np.uint64)
    # The state before the last column is mixed into that column, so a column equal to it makes the hash 0.
    rows = np.hstack([first, by_numpy.row_hashes(first)[:, None]])
    assert set(by_numpy.row_hashes(rows).tolist()) == {0}
    expected = as_met(np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1))
    assert len(set(expected)) == 9
    assert as_met(by_numpy.label_equal_rows(rows)) == expected
    assert as_met(kernel.label_equal_rows(rows)) == expected


def test_a_welded_seam_bakes_as_if_it_had_never_been_cut() -> None:
    # The same quad as four and as six vertices, one weight at one corner: joint 1 falls off from (0, 0).
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32)
    weights = np.array([[0, 1, 0, 0], [0.5, 0.5, 0, 0], [1, 0, 0, 0], [0.75, 0.25, 0, 0]], dtype=np.float32)

    def quad(listed: list[int], triangles: list[list[int]]) -> SkinnedPrimitive:
        return SkinnedPrimitive(
            corners[listed],
            np.tile(np.array(UP, dtype=np.float32), (len(listed), 1)),
            None,
            np.tile([0, 1, 2, 3], (len(listed), 1)),
            weights[listed],
            np.array(triangles),
        )

    whole, _ = bake_one(quad([0, 1, 2, 3], [[0, 1, 2], [0, 2, 3]]))
    cut, _ = bake_one(quad([0, 1, 2, 0, 2, 3], [[0, 1, 2], [3, 4, 5]]))
    assert cut.alpha == pytest.approx(whole.alpha[[0, 1, 2, 0, 2, 3]], rel=1e-6)
    # Both triangles count the same at (0, 0); along x joint 1 falls by 1/2 in one and by 1/4 in the other.
    assert whole.alpha[0].tolist() == pytest.approx([-(0.5 + 0.25) / 2, 0.0, 0.0], rel=1e-6)
