"""Changes without effect: the unit of length, the place of the mesh, and every order of its lists."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from skinbake.geometry.skinned import BakedPrimitive, Float64Array, SkinnedPrimitive
from skinbake.gradients.baker import BakeFindings, bake_primitives
from tests.support.baked_arrays import (
    AFRAME_HAND,
    BARBARIAN,
    CESIUM_MAN,
    ELF,
    HAND_U8,
    MANTIS,
    PBR_TEST,
    TREX,
    by_joint,
    joint_count,
    meshes_of,
    path_of,
    reslotted,
    shuffled,
)
from tests.support.baking import bake_settings
from tests.support.surfaces import analytic_surface
from tests.support.whole_fields import rest_frame

SURFACES = ["random", "irregular"]
FILES = [
    "seam.glb",
    "hard_edge.glb",
    "two_primitives.glb",
    "two_sets.glb",
    "mirrored_tangent.glb",
    "foreign_joints.glb",
    CESIUM_MAN,
    BARBARIAN,
    TREX,
    PBR_TEST,
    HAND_U8,
    ELF,
    MANTIS,
    AFRAME_HAND,
]
MESHES = SURFACES + FILES

Outcomes = list[tuple[BakedPrimitive, BakeFindings]]

# Sums in another order differ in float64's last digits, which float32 hides except where it rounds the other
# way: 6e-8 of a value. Minus the sum of up to seven of them is what slot 0 has.
TOLERANCE = 1e-6


@cache
def mesh(name: str) -> tuple[SkinnedPrimitive, ...]:
    """Return the primitives of the largest mesh of a file, or of an analytic surface."""
    if name == "random":
        return (_with_tangents("random"),)
    if name == "irregular":
        return (analytic_surface(400, "irregular", seed=11).primitive,)
    found = meshes_of(path_of(name)).values()
    return tuple(max(found, key=lambda primitives: sum(len(part.positions) for part in primitives)))


def _with_tangents(name: str) -> SkinnedPrimitive:
    surface = analytic_surface(400, "random", seed=12)
    handedness = np.where(surface.parameters[:, :1] < 2.0, -1.0, 1.0)
    return replace(surface.primitive, tangents=np.concatenate([surface.tangents, handedness], axis=1))


@cache
def baked(name: str) -> Outcomes:
    return bake_primitives(mesh(name), bake_settings())


def tables(primitives: Sequence[SkinnedPrimitive], outcomes: Outcomes) -> list[npt.NDArray[np.float64]]:
    """Return (α, β) by joint of each primitive, (V, J, 2)."""
    joints = joint_count(primitives)
    return [
        np.stack(by_joint(primitive, outcome, joints), axis=-1)
        for primitive, (outcome, _) in zip(primitives, outcomes, strict=True)
    ]


def tangential_gradients(primitives: Sequence[SkinnedPrimitive], outcomes: Outcomes) -> list[Float64Array]:
    """Return α t0 + β b0 by joint, (V, J, 3): what no choice of frame changes."""
    result = []
    for primitive, (outcome, _), table in zip(
        primitives, outcomes, tables(primitives, outcomes), strict=True
    ):
        frame = rest_frame(primitive, outcome.frame)
        result.append(table[:, :, :1] * frame.tangents[:, None] + table[:, :, 1:] * frame.bitangents[:, None])
    return result


def deviation(found: Sequence[Float64Array], expected: Sequence[Float64Array]) -> float:
    """Return the largest difference relative to the mesh's largest value."""
    largest = max(np.abs(values).max() for values in expected)
    assert largest > 0
    return float(max(np.abs(a - b).max() for a, b in zip(found, expected, strict=True)) / largest)


def rotated(vectors: npt.NDArray[np.floating], turn: Float64Array) -> Float64Array:
    """Rotate row by row with the same operations, so that equal vectors stay equal bit by bit."""
    x, y, z = vectors.astype(np.float64).T
    return np.stack([row[0] * x + row[1] * y + row[2] * z for row in turn], axis=1)


def random_rotation(seed: int) -> Float64Array:
    turn: Float64Array = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    turn[:, 0] *= np.sign(np.linalg.det(turn))
    return turn


@pytest.mark.parametrize("name", MESHES)
def test_scaling_by_a_power_of_two_scales_every_bit_of_alpha_inversely(name: str) -> None:
    # Only exponents change, so nothing may be rounded or decided otherwise.
    for exponent in (-10, 7):
        scale = 2.0**exponent
        larger = [replace(part, positions=part.positions * scale) for part in mesh(name)]
        for (found, found_numbers), (expected, numbers) in zip(
            bake_primitives(larger, bake_settings()), baked(name), strict=True
        ):
            assert np.array_equal(found.alpha * np.float32(scale), expected.alpha)
            assert np.array_equal(found.beta * np.float32(scale), expected.beta)
            assert np.array_equal(found.adopted_joints, expected.adopted_joints)
            assert found_numbers._replace(magnitude=0.0) == numbers._replace(magnitude=0.0)


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("seed", [1, 2])
def test_scaling_by_any_factor_scales_alpha_inversely(name: str, seed: int) -> None:
    scale = float(10.0 ** np.random.default_rng(seed).uniform(-4.0, 4.0))
    primitives = mesh(name)
    larger = [replace(part, positions=part.positions * scale) for part in primitives]
    outcomes = bake_primitives(larger, bake_settings())
    found = [table * scale for table in tables(larger, outcomes)]
    assert deviation(found, tables(primitives, baked(name))) < TOLERANCE


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("seed", [3, 4])
def test_a_rigid_motion_turns_the_gradients_with_the_mesh(name: str, seed: int) -> None:
    turn = random_rotation(seed)
    primitives = mesh(name)
    extent = max(np.abs(part.positions).max() for part in primitives)
    shift = np.random.default_rng(seed).uniform(-extent, extent, 3)
    moved = [
        replace(
            part,
            positions=rotated(part.positions, turn) + shift,
            normals=rotated(part.normals, turn),
            tangents=None
            if part.tangents is None
            else np.column_stack([rotated(part.tangents[:, :3], turn), part.tangents[:, 3]]),
        )
        for part in primitives
    ]
    outcomes = bake_primitives(moved, bake_settings())
    found = tangential_gradients(moved, outcomes)
    expected = [
        np.stack([rotated(joint, turn) for joint in np.moveaxis(values, 1, 0)], axis=1)
        for values in tangential_gradients(primitives, baked(name))
    ]
    assert deviation(found, expected) < TOLERANCE
    if all(outcome.frame == "tangent" for outcome, _ in outcomes):
        # A frame that turns with the mesh sees no difference at all.
        assert deviation(tables(moved, outcomes), tables(primitives, baked(name))) < TOLERANCE


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("seed", [5, 6])
def test_the_order_of_vertices_and_triangles_changes_nothing(name: str, seed: int) -> None:
    primitives = mesh(name)
    moved, orders, _ = zip(*(shuffled(part, seed) for part in primitives), strict=True)
    outcomes = bake_primitives(moved, bake_settings())
    expected = [table[order] for table, order in zip(tables(primitives, baked(name)), orders, strict=True)]
    assert deviation(tables(moved, outcomes), expected) < TOLERANCE
    for (_, found), (_, numbers) in zip(outcomes, baked(name), strict=True):
        assert found._replace(lost=0.0, magnitude=0.0) == numbers._replace(lost=0.0, magnitude=0.0)
        assert found.lost == pytest.approx(numbers.lost, abs=1e-12)


@pytest.mark.parametrize("name", ["two_primitives.glb", BARBARIAN])
def test_the_order_of_primitives_changes_nothing(name: str) -> None:
    reverse = bake_primitives(mesh(name)[::-1], bake_settings())[::-1]
    for (found, _), (expected, _) in zip(reverse, baked(name), strict=True):
        largest = np.abs(expected.alpha).max()
        assert np.abs(found.alpha - expected.alpha).max() <= TOLERANCE * largest
        assert np.array_equal(found.adopted_joints, expected.adopted_joints)


@pytest.mark.parametrize("name", MESHES)
def test_the_order_of_slots_changes_no_joints_gradient(name: str) -> None:
    primitives = mesh(name)
    moved = [reslotted(part, 7) for part in primitives]
    outcomes = bake_primitives(moved, bake_settings())
    pairs = zip(primitives, moved, outcomes, baked(name), strict=True)
    for table, other, (part, turned, (found, numbers), (expected, own)) in zip(
        tables(primitives, baked(name)), tables(moved, outcomes), pairs, strict=True
    ):
        # What no slot holds falls to slot 0's joint, which is another one now: leave both out.
        differs = np.abs(table - other).max(axis=2)
        rows = np.arange(len(differs))
        differs[rows, _first(part, expected)] = 0.0
        differs[rows, _first(turned, found)] = 0.0
        assert differs.max() <= TOLERANCE * np.abs(table).max()
        assert [sorted(set(row)) for row in found.adopted_joints.tolist()] == [
            sorted(set(row)) for row in expected.adopted_joints.tolist()
        ]
        assert numbers.adopting_vertices == own.adopting_vertices
        assert numbers.overflowing_vertices == own.overflowing_vertices
        assert numbers.weights == own.weights


def _first(primitive: SkinnedPrimitive, outcome: BakedPrimitive) -> npt.NDArray[np.int64]:
    adopted = outcome.adopted_joints[:, 0]
    return np.where(adopted >= 0, adopted, primitive.joints[:, 0].astype(np.int64))


@pytest.mark.parametrize("layout", [np.asfortranarray, lambda rows: np.repeat(rows, 2, axis=0)[::2]])
def test_the_layout_of_arrays_in_memory_changes_nothing(
    layout: Callable[[npt.NDArray[Any]], npt.NDArray[Any]],
) -> None:
    [part] = mesh("random")
    fields = ("positions", "normals", "tangents", "joints", "weights", "triangles")
    changed: dict[str, Any] = {field: layout(getattr(part, field)) for field in fields}
    other = replace(part, **changed)
    [(found, _)] = bake_primitives([other], bake_settings())
    [(expected, _)] = baked("random")
    assert np.array_equal(found.alpha, expected.alpha)
    assert np.array_equal(found.beta, expected.beta)
