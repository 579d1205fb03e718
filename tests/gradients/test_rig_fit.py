"""Gradients fitted to a rig: held to a plain least-squares fit over small turns, and to what they promise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from skinbake.geometry.frames import frame_from_normal, unit_normals
from skinbake.geometry.rig import NO_PARENT, Rig
from skinbake.geometry.skinned import BakedPrimitive, Float64Array, SkinnedPrimitive
from skinbake.gradients.baker import BakeSettings, bake_mesh
from skinbake.gradients.surface import (
    BY_TANGENTS,
    DOUBT,
    EVEN,
    FAINT,
    MOST_DOUBT,
    SMOOTH,
    STIFFNESS,
    TOGETHER,
)
from skinbake.lighting.operator import GradientOperator, gradient_operator
from tests.gradients.tubes import BRANCHES, CHAIN, SETTINGS, corner_angles, tube, weighted_normals
from tests.support.kernels import use_numpy

TURN = 1e-5
"""The angle of a sampled turn, in radians."""

Normals = Callable[[Float64Array], Float64Array]


def fitted(primitive: SkinnedPrimitive, rig: Rig | None, settings: BakeSettings = SETTINGS) -> BakedPrimitive:
    ((baked, _),) = bake_mesh([primitive], settings, rig)
    return baked


@pytest.fixture(params=["loops", "numpy"])
def _kernel(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if request.param == "numpy":
        use_numpy(monkeypatch)


@pytest.mark.usefixtures("_kernel")
class TestOracle:
    """A generic solver, over turns of each joint about each axis, measured on the deformed mesh."""

    @pytest.mark.parametrize("parents", [BRANCHES[:4], CHAIN], ids=["branches", "chain"])
    @pytest.mark.parametrize("seed", [3, 4])
    def test_closed_form_is_the_least_squares_over_small_turns(
        self, seed: int, parents: Sequence[int]
    ) -> None:
        primitive, rig = tube(seed=seed, slots=len(parents), parents=parents)
        baked = fitted(primitive, rig)
        expected = sampled_fit(primitive, rig)
        for found, wanted in zip((baked.alpha, baked.beta), expected, strict=True):
            assert np.abs(found - wanted).max() < 1e-6 * np.abs(wanted).max()

    def test_a_joint_that_tilts_nothing_curls_with_its_chain(self) -> None:
        # The pivot of a joint lies on the normal of a vertex, and its turns tilt no tangent there.
        primitive, rig = tube(slots=len(CHAIN), parents=CHAIN)
        vertex = 20
        normal = unit_normals(primitive.normals)[vertex].astype(np.float64)
        rig.pivots[2] = primitive.positions[vertex] - normal
        baked = fitted(primitive, rig)
        expected = sampled_fit(primitive, rig)
        for found, wanted in zip((baked.alpha, baked.beta), expected, strict=True):
            assert np.abs(found - wanted)[vertex].max() < 1e-6 * np.abs(wanted).max()

    def test_it_is_not_the_gradient(self) -> None:
        primitive, rig = tube()
        assert np.abs(fitted(primitive, rig).alpha - fitted(primitive, None).alpha).max() > 0.05


@pytest.mark.usefixtures("_kernel")
def test_a_mesh_without_an_area_has_no_gradients() -> None:
    primitive, rig = tube()
    baked = fitted(replace(primitive, positions=np.zeros_like(primitive.positions)), rig)
    assert not baked.alpha.any()
    assert not baked.beta.any()


def sampled_fit(primitive: SkinnedPrimitive, rig: Rig) -> tuple[Float64Array, Float64Array]:
    """Return the α and β that a dense solver finds, vertex by vertex."""
    positions = primitive.positions.astype(np.float64)
    surface = fitted(primitive, None)
    n0 = unit_normals(primitive.normals)
    t0, b0 = (axis.astype(np.float64) for axis in frame_from_normal(n0))
    operator = gradient_operator([primitive], crease_angle_degrees=15.0)
    truths = (
        tangent_truth(operator, positions, n0.astype(np.float64), t0, b0),
        triangle_truth(operator, positions, n0.astype(np.float64)),
    )
    parts = [BY_TANGENTS, 1.0 - BY_TANGENTS]
    carried = carries(rig)
    samples = [(joint, axis) for joint in range(len(rig.parents)) for axis in np.eye(3)]
    rows = {"alpha": [], "beta": []}  # type: dict[str, list[tuple[Float64Array, Float64Array]]]
    for joint, axis in samples:
        ahead, back = (pose(primitive, rig, carried[joint], joint, axis, turn) for turn in (TURN, -TURN))
        for name, rest in (("alpha", t0), ("beta", b0)):
            # The tilt of the tangent without α, and of each α, along the mean of both true normals.
            slope, column = [], []
            for matrices, sign in ((ahead, 1.0), (back, -1.0)):
                deformed = np.einsum("vk,vkij,vj->vi", primitive.weights, matrices, homogeneous(positions))
                normal = np.average([truth(deformed) for truth in truths], axis=0, weights=parts)
                turned = np.einsum("vk,vkij,vj->vi", primitive.weights, matrices[..., :3], rest)
                moved = np.einsum("vkij,vj->vki", matrices, homogeneous(positions))
                levers = moved[:, 1:] - moved[:, :1]
                slope.append(sign * np.einsum("vi,vi->v", turned, normal))
                column.append(sign * np.einsum("vki,vi->vk", levers, normal))
            rows[name].append((sum(slope) / (2 * TURN), sum(column) / (2 * TURN)))
    presence = presences(primitive, operator)
    found, given, tilts = [], [], np.zeros(len(positions))
    for name, base in (("alpha", surface.alpha), ("beta", surface.beta)):
        whole = np.concatenate([-base.sum(axis=1, keepdims=True), base], axis=1).astype(np.float64)
        slopes = np.stack([row[0] for row in rows[name]], axis=1)
        columns = np.stack([row[1] for row in rows[name]], axis=1)
        found.append(solved(primitive, rig, carried, presence, whole, slopes, columns))
        given.append(base)
        tilts += squared_tilts(slopes + np.einsum("vsk,vk->vs", columns, base), columns)
    share = (tilts / (tilts + doubts(operator, positions) ** 2))[:, None]
    alpha, beta = (base + share * (fit - base) for base, fit in zip(given, found, strict=True))
    return alpha, beta


def doubts(operator: GradientOperator, positions: Float64Array) -> Float64Array:
    """Return the tilt of which a fit takes half, (V,): larger where the normals of the triangles agree."""
    triangles = operator.triangles.astype(np.int64)
    angles = corner_angles(positions, triangles)
    mean = np.linalg.norm(weighted_normals(positions, triangles, angles), axis=1)
    around = np.bincount(triangles.ravel(), angles.ravel(), len(positions))
    spread = 1.0 - mean / around
    return np.asarray([DOUBT * min(max((SMOOTH / one) ** 3, 1.0), MOST_DOUBT) for one in spread.tolist()])


def squared_tilts(tilts: Float64Array, columns: Float64Array) -> Float64Array:
    """Return what any change of the gradients can take off the tilts (V, samples): squared, and added up.

    The turns of a joint about three axes tilt a tangent by a vector, of which a change moves one direction.
    """
    found = np.zeros(len(tilts))
    for first in range(0, tilts.shape[1], 3):
        by_axis = columns[:, first : first + 3]
        slot = np.linalg.norm(by_axis, axis=1).argmax(axis=1)
        direction = by_axis[np.arange(len(tilts)), :, slot]
        length = np.linalg.norm(direction, axis=1)
        parts = length > 1e-9
        along = np.einsum("vs,vs->v", tilts[:, first : first + 3], direction)
        found[parts] += (along[parts] / length[parts]) ** 2
    return found


def presences(primitive: SkinnedPrimitive, operator: GradientOperator) -> Float64Array:
    """Return each slot's weight (V, K), plus its joint's share of the lengths of the weights' gradients."""
    joints, count = primitive.joints.astype(np.int64), len(primitive.joints)
    whole = np.zeros((count, joints.max() + 1))
    np.put_along_axis(whole, joints, primitive.weights, axis=1)
    axes = [operator.along(np.tile(axis, (count, 1))) @ whole for axis in np.eye(3)]
    lengths = np.linalg.norm(axes, axis=0)
    share: Float64Array = lengths / lengths.sum(axis=1, keepdims=True)
    return primitive.weights + np.take_along_axis(share, joints, axis=1)


def solved(
    primitive: SkinnedPrimitive,
    rig: Rig,
    carried: Float64Array,
    presence: Float64Array,
    base: Float64Array,
    slopes: Float64Array,
    columns: Float64Array,
) -> Float64Array:
    """Solve each vertex by numpy's lstsq, with rows for all pulls, for all slots but the first.

    The first slot takes minus the sum, so a row for all slots loses the first one's number from each other.
    """
    result = np.zeros((len(base), base.shape[1] - 1))
    # The chain of the test's rig has all its joints, one after the other.
    chains = [range(len(CHAIN))] if rig.parents.tolist() == list(CHAIN) else []
    for vertex, joints in enumerate(primitive.joints):
        levers = primitive.positions[vertex].astype(np.float64) - rig.pivots
        squares = (levers**2).sum(axis=1)
        parting = [joint for joint in range(len(levers)) if 0 < carried[joint, joints].sum() < len(joints)]
        pulls = [np.sqrt(STIFFNESS * squares[joint]) * carried[joint, joints] for joint in parting]
        more = EVEN + np.maximum((FAINT / presence[vertex]) ** 2, 1.0) - 1.0
        pulls += list(np.diag(np.sqrt(STIFFNESS * squares[parting].sum() * more)))
        matrix = [row[1:] - row[0] for row in pulls]
        right = [row @ base[vertex] for row in pulls]
        for chain in chains:
            curl = [joint for joint in chain if joint in parting]
            for axis in range(3 if len(curl) > 1 else 0):
                rows = [3 * joint + axis for joint in curl]
                matrix.append(np.sqrt(TOGETHER) * columns[vertex, rows].sum(axis=0))
                right.append(-np.sqrt(TOGETHER) * slopes[vertex, rows].sum())
        result[vertex] = np.linalg.lstsq(
            np.concatenate([columns[vertex], matrix]), np.concatenate([-slopes[vertex], right]), rcond=None
        )[0]
    return result


def carries(rig: Rig) -> Float64Array:
    """Return 1 at [j, i] where joint i is j or below it, found by walking up."""
    found = np.zeros((len(rig.parents),) * 2)
    for joint in range(len(rig.parents)):
        above = joint
        while above != NO_PARENT:
            found[above, joint] = 1.0
            above = int(rig.parents[above])
    return found


def homogeneous(points: Float64Array) -> Float64Array:
    return np.concatenate([points, np.ones((len(points), 1))], axis=1)


def pose(
    primitive: SkinnedPrimitive, rig: Rig, carried: Float64Array, joint: int, axis: Float64Array, turn: float
) -> Float64Array:
    """Return the matrices (V, K, 3, 4) of all slots if one joint turns, with all that it carries."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned = np.eye(3) + np.sin(turn) * cross + (1.0 - np.cos(turn)) * cross @ cross
    pivot = rig.pivots[joint]
    moved = np.concatenate([turned, (pivot - turned @ pivot)[:, None]], axis=1)
    still = np.eye(3, 4)
    return np.where(carried[primitive.joints][..., None, None] > 0.0, moved, still)


def tangent_truth(
    operator: GradientOperator, rest: Float64Array, n0: Float64Array, t0: Float64Array, b0: Float64Array
) -> Normals:
    """Return the normal that the derivatives of the positions carry along, not normalised to first order."""
    along, across = operator.along(t0), operator.along(b0)

    def columns(points: Float64Array, area: Float64Array | None) -> Float64Array:
        a, b = along @ points, across @ points
        c = np.cross(a, b)
        length = np.linalg.norm(c, axis=1)
        third = c / np.sqrt(length * (length if area is None else area))[:, None]
        return np.stack([a, b, third], axis=2)

    first = columns(rest, None)
    area = np.linalg.norm(np.cross(first[..., 0], first[..., 1]), axis=1)

    def normals(points: Float64Array) -> Float64Array:
        carried = np.linalg.inv(columns(points, area) @ np.linalg.inv(first))
        found: Float64Array = np.einsum("vji,vj->vi", carried, n0)
        return found

    return normals


def triangle_truth(operator: GradientOperator, rest: Float64Array, n0: Float64Array) -> Normals:
    """Return the authored normal with the change of the one weighted by the angles of the rest pose."""
    triangles = operator.triangles.astype(np.int64)
    angles = corner_angles(rest, triangles)
    first = weighted_normals(rest, triangles, angles)
    length = np.linalg.norm(first, axis=1, keepdims=True)

    def normals(points: Float64Array) -> Float64Array:
        tilt: Float64Array = (weighted_normals(points, triangles, angles) - first) / length
        return n0 + tilt

    return normals
