"""Gradients fitted to poses: held to a generic least-squares solver, and to what they promise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from skinbake import threads
from skinbake.geometry.frames import frame_from_normal, unit_normals
from skinbake.geometry.poses import random_rotations, rotation_matrices
from skinbake.geometry.rig import NO_PARENT, Rig
from skinbake.geometry.skinned import Float64Array, FloatArray, SkinnedPrimitive
from skinbake.gradients.baker import bake_primitives
from skinbake.gradients.fit_rules import EVEN
from skinbake.pose_fit.fit import POSE_STIFFNESS, FitPoses, fitted_to_poses, tilts
from skinbake.skinning.algorithms import Algorithm
from skinbake.skinning.rest import RestPrimitive
from skinbake.truth.fine import FineMesh
from skinbake.truth.operator import GradientOperator, true_operator
from skinbake.truth.truths import Truths
from tests.gradients.tubes import BRANCHES, SETTINGS, steepest_slopes, tube
from tests.support.replay import replay


def surface_of(primitive: SkinnedPrimitive, rig: Rig | None = None) -> RestPrimitive:
    """Return a primitive as it was baked, in float64."""
    ((result, _),) = bake_primitives([primitive], SETTINGS, rig)
    normals = unit_normals(primitive.normals)
    tangents, bitangents = (axis.astype(np.float64) for axis in frame_from_normal(normals))
    named = np.where(result.adopted_joints >= 0, result.adopted_joints, primitive.joints)
    weights = primitive.weights.astype(np.float64)
    return RestPrimitive(
        positions=primitive.positions.astype(np.float64),
        normals=normals.astype(np.float64),
        tangents=tangents,
        bitangents=bitangents,
        joints=named,
        weights=weights / weights.sum(axis=1, keepdims=True),
        alpha=result.alpha.astype(np.float64),
        beta=result.beta.astype(np.float64),
    )


def turned(rig: Rig, count: int, degrees: float, seed: int) -> Float64Array:
    """Return joint matrices (P, J, 4, 4) of random poses: each joint turned about its pivot."""
    return carried(rig, random_rotations((len(rig.parents), count), float(np.radians(degrees)), seed))


def swung(rig: Rig, at: Float64Array, angle: float = 0.6) -> Float64Array:
    """Return joint matrices of a clip at some times: each joint swings about an axis of its own."""
    random = np.random.default_rng(8)
    axes = random.normal(size=(len(rig.parents), 1, 3))
    axes /= np.linalg.norm(axes, axis=2, keepdims=True)
    halves = angle / 2.0 * np.sin(at[None] + random.uniform(0.0, 6.0, size=(len(axes), 1)))[..., None]
    return carried(rig, np.concatenate([np.cos(halves), np.sin(halves) * axes], axis=2))


def carried(rig: Rig, rotations: Float64Array) -> Float64Array:
    """Return joint matrices from the rotations (J, P, 4) of joints, after those of the joints above."""
    found = np.zeros((rotations.shape[1], len(rig.parents), 4, 4))
    for joint, parent in enumerate(rig.parents):
        own = np.zeros((len(found), 4, 4))
        own[:, :3, :3], own[:, 3, 3] = rotation_matrices(rotations[joint]), 1.0
        own[:, :3, 3] = rig.pivots[joint] - own[:, :3, :3] @ rig.pivots[joint]
        found[:, joint] = own if parent == NO_PARENT else found[:, parent] @ own
    return found


def even(matrices: Float64Array) -> list[FitPoses]:
    return [FitPoses(matrices, 1.0)]


def true_normals(
    operator: GradientOperator,
    surface: RestPrimitive,
    matrices: Float64Array,
    parts: Sequence[float] = (0.5, 0.1, 0.4),
) -> Float64Array:
    """Return the unit means (P, V, 3) of the truths by tangents, by triangles, and fine, by their parts."""
    truths = Truths.of(operator, [surface], len(matrices), fine=FineMesh.of(operator))
    assert truths.fine is not None
    placed = [
        replay(Algorithm.LBS_STANDARD, one, matrices).positions for one in (surface, truths.fine.points)
    ]
    deformed = [
        np.ascontiguousarray(positions.transpose(2, 1, 0), dtype=np.float64)
        for positions in (placed[0], np.concatenate(placed, axis=1))
    ]
    found: list[Float64Array] = []
    with threads.Threads(1) as one:
        for part, points in zip((truths, truths.fine.truths), deformed, strict=True):
            sums = part.sums(points, one)
            blocks = [part.normals(block.number, points, sums, None)[0] for block in part.vertex_blocks]
            found += list(np.concatenate(blocks, axis=2).transpose(0, 3, 2, 1))
    normals = np.tensordot(parts, np.stack(found), axes=1)
    return np.asarray(normals / np.linalg.norm(normals, axis=2, keepdims=True))


def test_no_gradient_changes_by_more_than_three_times_the_steepest_slope() -> None:
    for seed in range(4):
        primitive, rig = tube(parents=BRANCHES, seed=seed)
        rig.pivots[:] = primitive.positions[10]
        surface = surface_of(primitive, rig)
        ((alpha, beta),) = fitted_to_poses(
            true_operator([primitive]), [surface], even(turned(rig, 12, 25.0, seed))
        )
        change = np.stack([alpha - surface.alpha, beta - surface.beta], axis=2)
        assert (np.linalg.norm(change, axis=2) <= 3.0 * 1.0001 * steepest_slopes(primitive)[:, None]).all()
        assert np.abs(change).max() > 0.0


@pytest.mark.parametrize("angles", [(25.0,), (2.0, 40.0)])
def test_the_fit_is_that_of_a_generic_solver(angles: Sequence[float]) -> None:
    primitive, rig = tube(parents=BRANCHES)
    surface = surface_of(primitive, rig)
    groups = [FitPoses(turned(rig, 12, angle, 5), 0.9 - 0.8 * number) for number, angle in enumerate(angles)]
    operator = true_operator([primitive])
    ((alpha, beta),) = fitted_to_poses(operator, [surface], groups)
    written = [written_out(operator, surface, group) for group in groups]
    for along, (given, found) in enumerate(((surface.alpha, alpha), (surface.beta, beta))):
        for vertex in range(len(given)):
            rows = [row for group in written for row in group.rows(vertex, along)]
            columns, right = (np.concatenate(side) for side in zip(*rows, strict=True))
            wanted = np.linalg.lstsq(columns, right, rcond=None)[0]
            np.testing.assert_allclose(
                found[vertex] - given[vertex], wanted, rtol=1e-5, atol=1e-6 * abs(given).max()
            )
    assert abs(alpha - surface.alpha).max() > 0.05 * abs(surface.alpha).max()


@pytest.mark.parametrize("seed", range(4))
def test_only_vertices_of_several_joints_are_followed_through_the_poses(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rigid part asks for no true normal at all; beside a bending one, it changes nothing of it."""
    primitive, rig = tube(parents=BRANCHES)
    bending = surface_of(primitive, rig)
    joint = np.random.default_rng(seed).integers(0, len(rig.parents))
    alone = np.zeros_like(bending.weights)
    alone[:, 0] = 1.0
    none = np.zeros_like(bending.alpha)
    rigid = replace(bending, joints=np.full_like(bending.joints, joint), weights=alone, alpha=none, beta=none)
    asked: list[int] = []
    normals = Truths.normals

    def counting(self: Truths, block: int, *others: Any) -> Any:
        asked.append(block)
        return normals(self, block, *others)

    monkeypatch.setattr(Truths, "normals", counting)
    groups = even(turned(rig, 6, 30.0, seed))
    ((alpha, beta),) = fitted_to_poses(true_operator([primitive]), [rigid], groups)
    assert not asked
    assert not alpha.any() and not beta.any()
    apart = true_operator([primitive, replace(primitive, positions=primitive.positions + np.float32(100.0))])
    both = fitted_to_poses(apart, [bending, rigid], groups)
    assert asked
    ((alpha, beta),) = fitted_to_poses(true_operator([primitive]), [bending], groups)
    np.testing.assert_array_equal(both[0][0], alpha)
    np.testing.assert_array_equal(both[0][1], beta)
    assert not both[1][0].any() and not both[1][1].any()


@dataclass
class WrittenOut:
    """All rows of the least squares of a group of poses, vertex by vertex.

    tangents are t' and b' (2, P, V, 3), motions (2, slots, P, V, 3) what one more of α or β adds to them.
    """

    surface: RestPrimitive
    group: FitPoses
    normals: Float64Array
    tangents: Float64Array
    motions: Float64Array

    def rows(self, vertex: int, along: int) -> Iterator[tuple[Float64Array, Float64Array]]:
        """Yield columns (R, slots) and right sides (R,) for α or β of a vertex."""
        normals, tangents = self.normals[:, vertex], self.tangents[:, :, vertex]
        size = (tangents**2).sum(axis=(0, 2))
        tilts = np.einsum("tpi,pi->tp", tangents, normals)
        count = len(size)
        error = float(((tilts**2).sum(axis=0) / size).mean())
        scale = self.group.share / (error + np.radians(0.3) ** 2) / count
        root = np.sqrt(2.0 * scale / size)
        columns = self.motions[along, :, :, vertex].transpose(1, 2, 0)  # (P, 3, slots)
        slots = columns.shape[2]
        yield root[:, None] * np.einsum("pi,pis->ps", normals, columns), -root * tilts[along]
        moving = (np.sqrt(POSE_STIFFNESS) * root[:, None, None] * columns).reshape(-1, slots)
        yield moving, np.zeros(len(moving))
        pull = self.pull(vertex, root**2)
        yield np.diag(pull[1:]), np.zeros(slots)
        yield np.full((1, slots), pull[0]), np.zeros(1)

    def pull(self, vertex: int, weight: Float64Array) -> Float64Array:
        """Return by how much each joint is held at its gradient, the first slot's included."""
        surface = self.surface
        ends = self.group.joint_matrices[:, surface.joints[vertex], :3] @ np.append(
            surface.positions[vertex], 1.0
        )
        both = [np.append(-slots[vertex].sum(), slots[vertex]) for slots in (surface.alpha, surface.beta)]
        presence = surface.weights[vertex] + np.hypot(*both) / np.hypot(*both).sum()
        means = np.average(ends, axis=1, weights=presence)
        reach = weight @ np.average(((ends - means[:, None]) ** 2).sum(axis=2), axis=1, weights=presence)
        return np.full(len(presence), np.sqrt(EVEN * reach))


def written_out(operator: GradientOperator, surface: RestPrimitive, group: FitPoses) -> WrittenOut:
    """Replay the surface, and again for each stored slot: what it adds is linear in α and β."""
    matrices = group.joint_matrices
    given = replay(Algorithm.LBS_ACCURATE, surface, matrices)
    motions: list[list[FloatArray]] = [[], []]
    for slot in range(surface.alpha.shape[1]):
        alpha, beta = surface.alpha.copy(), surface.beta.copy()
        alpha[:, slot] += 1.0
        beta[:, slot] += 1.0
        moved = replay(Algorithm.LBS_ACCURATE, replace(surface, alpha=alpha, beta=beta), matrices)
        motions[0].append(moved.tangents - given.tangents)
        motions[1].append(moved.bitangents - given.bitangents)
    return WrittenOut(
        surface,
        group,
        true_normals(operator, surface, matrices),
        np.stack([given.tangents, given.bitangents]).astype(np.float64),
        np.array(motions, dtype=np.float64),
    )


def test_the_fit_lights_a_clip_better_between_the_poses_that_it_saw() -> None:
    primitive, rig = tube()
    operator = true_operator([primitive])
    seen, held_back = np.linspace(0.0, 6.0, 13), np.linspace(0.25, 5.75, 12)
    surface, by_rig = surface_of(primitive), surface_of(primitive, rig)
    ((alpha, beta),) = fitted_to_poses(operator, [by_rig], even(swung(rig, seen)))
    by_poses = replace(by_rig, alpha=alpha, beta=beta)
    poses = even(swung(rig, held_back))
    usual, rigged, posed = (tilts(operator, [one], poses)[0].sum() for one in (surface, by_rig, by_poses))
    assert posed < 0.7 * rigged
    assert rigged < usual


def test_gentle_poses_count_by_their_share_beside_wide_ones() -> None:
    """By their squared errors alone, poses that bend ten times as far would count a hundred times as much."""
    primitive, rig = tube()
    operator, surface = true_operator([primitive]), surface_of(primitive, rig)
    gentle, wide = swung(rig, np.linspace(0.0, 6.0, 13), 0.06), turned(rig, 12, 60.0, 5)
    left = []
    for groups in ([FitPoses(gentle, 0.9), FitPoses(wide, 0.1)], even(np.concatenate([gentle, wide]))):
        ((alpha, beta),) = fitted_to_poses(operator, [surface], groups)
        fitted = replace(surface, alpha=alpha, beta=beta)
        left.append(tilts(operator, [fitted], even(gentle))[0].sum())
    assert left[0] < 0.8 * left[1]


def test_tilts_are_the_mean_squared_sines_of_both_tangents() -> None:
    primitive, rig = tube()
    surface, matrices = surface_of(primitive), turned(rig, 7, 30.0, 1)
    poses = even(matrices)
    operator = true_operator([primitive])
    normals = true_normals(operator, surface, matrices, (0.7, 0.3, 0.0))
    posed = replay(Algorithm.LBS_ACCURATE, surface, matrices)
    size = (posed.tangents**2).sum(axis=2) + (posed.bitangents**2).sum(axis=2)
    along = [np.einsum("pvi,pvi->pv", normals, axis) for axis in (posed.tangents, posed.bitangents)]
    np.testing.assert_allclose(
        tilts(operator, [surface], poses)[0], ((along[0] ** 2 + along[1] ** 2) / size).mean(axis=0), rtol=1e-6
    )


def test_the_fit_follows_the_tangents_of_a_copy() -> None:
    """Turning t0 and b0 about the normal turns α and β, so that no seam of TANGENT shows."""
    primitive, rig = tube()
    surface, poses = surface_of(primitive, rig), even(turned(rig, 9, 30.0, 5))
    operator = true_operator([primitive])
    c, s = np.cos(0.7), np.sin(0.7)
    other = replace(
        surface,
        tangents=c * surface.tangents + s * surface.bitangents,
        bitangents=c * surface.bitangents - s * surface.tangents,
        alpha=c * surface.alpha + s * surface.beta,
        beta=c * surface.beta - s * surface.alpha,
    )
    ((alpha, beta),) = fitted_to_poses(operator, [surface], poses)
    ((turned_alpha, turned_beta),) = fitted_to_poses(operator, [other], poses)
    np.testing.assert_allclose(turned_alpha, c * alpha + s * beta, atol=1e-9)
    np.testing.assert_allclose(turned_beta, c * beta - s * alpha, atol=1e-9)


@pytest.mark.parametrize("count", [2, 3])
def test_the_fit_is_the_same_by_several_threads(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    primitive, rig = tube(rings=60, around=30)
    surface, poses = surface_of(primitive, rig), even(turned(rig, 9, 30.0, 5))
    operator = true_operator([primitive])
    found = []
    for number in (1, count):
        monkeypatch.setattr("skinbake.pose_fit.fit.thread_count", lambda number=number: number)
        found.append(fitted_to_poses(operator, [surface], poses)[0])
    assert found[0][0].tobytes() == found[1][0].tobytes()
    assert found[0][1].tobytes() == found[1][1].tobytes()


def test_slots_without_presence_stay_at_zero() -> None:
    """Padding names joint 0. As an unknown it would act at the end of a long lever."""
    primitive, rig = tube()
    surface = surface_of(primitive, rig)
    pad = np.zeros((len(surface.joints), 1))
    padded = replace(
        surface,
        joints=np.concatenate([surface.joints, pad.astype(surface.joints.dtype)], axis=1),
        weights=np.concatenate([surface.weights, pad], axis=1),
        alpha=np.concatenate([surface.alpha, pad], axis=1),
        beta=np.concatenate([surface.beta, pad], axis=1),
    )
    poses = even(turned(rig, 9, 30.0, 5))
    operator = true_operator([primitive])
    ((plain, _),) = fitted_to_poses(operator, [surface], poses)
    ((alpha, _),) = fitted_to_poses(operator, [padded], poses)
    assert not alpha[:, -1].any()
    np.testing.assert_allclose(alpha[:, :-1], plain, atol=1e-9)


def test_a_vertex_without_triangles_keeps_its_gradients() -> None:
    primitive, rig = tube()
    lonely = replace(
        primitive,
        triangles=primitive.triangles[(primitive.triangles != 5).all(axis=1)],
    )
    surface = replace(surface_of(primitive, rig))
    ((alpha, beta),) = fitted_to_poses(true_operator([lonely]), [surface], even(turned(rig, 9, 30.0, 5)))
    np.testing.assert_array_equal(alpha[5], surface.alpha[5])
    np.testing.assert_array_equal(beta[5], surface.beta[5])
    assert (alpha[6] != surface.alpha[6]).any()


@pytest.mark.parametrize("scale", [0.01, 100.0])
def test_a_common_scale_of_all_joints_changes_nothing(scale: float) -> None:
    primitive, rig = tube()
    surface, matrices = surface_of(primitive, rig), turned(rig, 9, 30.0, 5)
    operator = true_operator([primitive])
    ((alpha, _),) = fitted_to_poses(operator, [surface], even(matrices))
    ((scaled, _),) = fitted_to_poses(operator, [surface], even(np.diag([scale] * 3 + [1.0]) @ matrices))
    np.testing.assert_allclose(scaled, alpha, rtol=1e-7, atol=1e-10)


def test_mirrored_joints_are_fitted_as_their_mirror_images() -> None:
    primitive, rig = tube()
    surface, matrices = surface_of(primitive, rig), turned(rig, 9, 30.0, 5)
    operator = true_operator([primitive])
    ((alpha, _),) = fitted_to_poses(operator, [surface], even(matrices))
    ((mirrored, _),) = fitted_to_poses(operator, [surface], even(np.diag([-1.0, 1.0, 1.0, 1.0]) @ matrices))
    np.testing.assert_allclose(mirrored, alpha, rtol=1e-6, atol=1e-9)
