"""Fitted gradients: held to a plain least squares over poses and small turns, and to their promises."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from skinbake.geometry.frames import frame_from_normal, unit_normals
from skinbake.geometry.rig import NO_PARENT, Rig
from skinbake.geometry.skinned import BakedPrimitive, BoolArray, Float64Array, SkinnedPrimitive
from skinbake.gradients import fit, fit_rules, ring_turns
from skinbake.gradients.baker import BakeSettings, bake_primitives
from skinbake.truth.operator import GradientOperator, gradient_operator
from tests.gradients.tubes import BRANCHES, CHAIN, SETTINGS, bent, corner_angles, tube, weighted_normals
from tests.support.derivatives import derivatives
from tests.support.kernels import use_numpy

TURN = 1e-5
"""The angle of a sampled turn, in radians."""

STIFFNESS, ANGLE, TOGETHER, COLLAPSED, RAY, NARROW, SMALL = 0.25, 0.2, 10.0, 0.1, 1.5, 0.2, 0.02
"""The numbers of docs/reference/gradients.md, typed in: a constant of the fit that changes is noticed."""

Maps = Callable[..., Float64Array]


def fitted(primitive: SkinnedPrimitive, rig: Rig | None, settings: BakeSettings = SETTINGS) -> BakedPrimitive:
    ((baked, _),) = bake_primitives([primitive], settings, rig)
    return baked


def wider(primitive: SkinnedPrimitive, width: int, naming: int = 0) -> SkinnedPrimitive:
    """Return a primitive with empty slots up to ``width``, which name a joint."""
    more = (0, 0), (0, width - primitive.joints.shape[1])
    return primitive.with_influences(
        np.pad(primitive.joints, more, constant_values=naming), np.pad(primitive.weights, more)
    )


@dataclass(frozen=True)
class Case:
    """A tube: its seed, slots and parents of joints, and how its poses are turned, pulled and flattened."""

    seed: int
    slots: int
    parents: tuple[int, ...]
    bent: tuple[float, ...] = ()
    pulled: float = 0.0
    flat: float = 1.0

    def tube(self) -> tuple[SkinnedPrimitive, Rig]:
        primitive, rig = tube(seed=self.seed, slots=self.slots, parents=self.parents)
        for number, angle in enumerate(self.bent):
            rig = bent(rig, np.radians(angle), seed=5 + number)
        rig.poses[..., 3] += self.pulled * np.random.default_rng(1).normal(size=rig.poses.shape[:3])
        rig.poses[:, :, 0] *= self.flat
        return primitive, rig

    def difference(self) -> float:
        """Return how far the fit is from the dense solver's, relative to the largest number."""
        baked = fitted(*self.tube())
        pairs = zip((baked.alpha, baked.beta), expected(self), strict=True)
        return float(max(np.abs(found - wanted).max() / np.abs(wanted).max() for found, wanted in pairs))


RIGS = (BRANCHES[:4], CHAIN)
CASES = [
    *(Case(seed, slots, parents) for parents in RIGS for slots in (len(parents), 3) for seed in (3, 4)),
    *(Case(3, slots, parents, bent=(20.0,)) for parents in RIGS for slots in (len(parents), 3)),
    *(Case(3, 4, BRANCHES[:4], bent=(20.0, 60.0, -40.0), pulled=pulled) for pulled in (0.0, 1.0, 2.0)),
    Case(4, 4, BRANCHES[:4], bent=(30.0,) * 5, flat=0.0),
    Case(8, 4, BRANCHES[:4], bent=(160.0, 160.0)),
]
SAME = 4e-6
"""The difference that the sampled turns leave, and the pull that decides where nothing else does."""

FITTED = {"STIFFNESS", "TURN", "TOGETHER", "COLLAPSED", "SMALL"}


@cache
def expected(case: Case) -> tuple[Float64Array, Float64Array]:
    return sampled_fit(*case.tube())


def change(monkeypatch: pytest.MonkeyPatch, name: str, factor: float) -> None:
    """Multiply a constant of the fit, wherever the loops and the definition read it."""
    value = factor * getattr(fit_rules, name)
    for module in (fit_rules, fit, ring_turns):
        if hasattr(module, name):
            monkeypatch.setattr(module, name, value)


@pytest.fixture(params=["loops", "numpy"])
def _kernel(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if request.param == "numpy":
        use_numpy(monkeypatch)


@pytest.mark.usefixtures("_kernel")
class TestOracle:
    """A generic solver, over turns of each joint about each axis, measured on the deformed mesh."""

    @pytest.mark.slow
    @pytest.mark.parametrize("case", CASES, ids=str)
    def test_closed_form_is_the_least_squares_over_small_turns(self, case: Case) -> None:
        assert case.difference() < SAME

    @pytest.mark.parametrize("factor", [0.95, pytest.param(1.05, marks=pytest.mark.slow)])
    @pytest.mark.parametrize("name", sorted(FITTED))
    def test_a_constant_that_changes_by_five_percent_is_noticed(
        self, name: str, factor: float, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        change(monkeypatch, name, factor)
        assert any(case.difference() > 2.0 * SAME for case in CASES)

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

    def test_the_fit_is_not_the_gradient(self) -> None:
        primitive, rig = tube()
        assert np.abs(fitted(primitive, rig).alpha - fitted(primitive, None).alpha).max() > 0.05


@pytest.mark.usefixtures("_kernel")
class TestPoses:
    def test_a_motion_of_all_joints_together_does_not_change_the_fit(self) -> None:
        primitive, rig = bent_tube()
        moved = np.array([[0.0, -3.0, 0.0, 5.0], [3.0, 0.0, 0.0, -1.0], [0.0, 0.0, 3.0, 2.0]])
        there = moved[:, :3] @ rig.poses
        there[..., 3] += moved[:, 3]
        here, elsewhere = (fitted(primitive, each) for each in (rig, replace(rig, poses=there)))
        assert np.abs(here.alpha - fitted(primitive, without_poses(rig)).alpha).max() > 0.02
        assert np.abs(here.alpha - elsewhere.alpha).max() < 1e-5
        assert np.abs(here.beta - elsewhere.beta).max() < 1e-5

    def test_a_parent_that_mirrors_all_joints_changes_no_bit(self) -> None:
        primitive, rig = bent_tube()
        mirrored = rig.poses.copy()
        mirrored[:, :, 0] *= -1.0
        here, there = (fitted(primitive, each) for each in (rig, replace(rig, poses=mirrored)))
        assert np.array_equal(here.alpha, there.alpha)
        assert np.array_equal(here.beta, there.beta)

    @pytest.mark.parametrize("far", [0.0, 1e300, np.nan, np.inf])
    def test_a_pose_that_leaves_no_surface_does_not_count(self, far: float) -> None:
        primitive, rig = tube()
        random = np.random.default_rng(1)
        torn = np.tile(np.eye(3, 4), (1, len(rig.parents), 1, 1))
        torn[..., :3] *= far > 0.0
        torn[..., 3] = far * random.normal(size=(1, len(rig.parents), 3))
        plain, posed = (fitted(primitive, each) for each in (rig, replace(rig, poses=torn)))
        assert np.array_equal(plain.alpha, posed.alpha)
        assert np.array_equal(plain.beta, posed.beta)

    def test_poses_count_as_their_mean(self) -> None:
        primitive, rig = bent_tube()
        once, often = (fitted(primitive, replace(rig, poses=rig.poses.repeat(n, axis=0))) for n in (1, 7))
        assert once.alpha == pytest.approx(often.alpha, abs=1e-6)

    def test_a_joint_without_a_matrix_matters_only_where_it_is(self) -> None:
        primitive, rig = tube(slots=2)
        rig = bent(rig, np.radians(20.0))
        lacking = rig.poses.copy()
        lacking[:, 3] = np.nan
        whole, part, none = (
            fitted(primitive, each).alpha for each in (rig, replace(rig, poses=lacking), without_poses(rig))
        )
        has = (primitive.joints == 3).any(axis=1)
        around = np.zeros(len(has), dtype=np.bool_)
        for triangle in primitive.triangles:
            around[triangle] |= has[triangle].any()
        assert around.any()
        assert not around.all()
        assert np.array_equal(part[around], none[around])
        assert np.array_equal(part[~around], whole[~around])

    def test_a_joint_without_a_matrix_may_stand_in_an_empty_slot(self) -> None:
        primitive, rig = tube(slots=2)
        rig = bent(rig, np.radians(20.0))
        rig.poses[:, 3] = np.nan
        zeros, threes = (fitted(wider(primitive, 4, naming=joint), rig).alpha for joint in (0, 3))
        assert np.abs(zeros - fitted(wider(primitive, 4), without_poses(rig)).alpha).max() > 0.01
        assert np.array_equal(zeros, threes)

    @pytest.mark.parametrize("width", [4, 8])
    def test_a_surface_whose_weights_do_not_change_needs_no_gradients(self, width: int) -> None:
        primitive, rig = bent_tube()
        random = np.random.default_rng(1)
        leaning = primitive.normals + 0.3 * random.normal(size=primitive.normals.shape).astype(np.float32)
        primitive = replace(primitive, normals=leaning)
        same = primitive.with_influences(
            np.tile(np.arange(4, dtype=np.uint16), (len(leaning), 1)),
            np.tile([0.5, 0.25, 0.25, 0.0], (len(leaning), 1)),
        )
        baked = fitted(wider(same, width), rig)
        assert not baked.alpha.any()
        assert not baked.beta.any()

    def test_a_joint_that_is_very_far_away_leaves_numbers(self) -> None:
        primitive, rig = bent_tube()
        rig.poses[:, 3, :, 3] += 1e9
        order = np.argsort(primitive.joints, axis=1)
        weights = np.take_along_axis(primitive.weights, order, axis=1)
        weights[:, :3] *= (1.0 - 2.0**-9) / weights[:, :3].sum(axis=1, keepdims=True)
        weights[:, 3] = 2.0**-9
        joints = np.take_along_axis(primitive.joints, order, axis=1)
        baked = fitted(primitive.with_influences(joints, weights), rig)
        assert np.isfinite(baked.alpha).all()
        assert baked.alpha.any()


def bent_tube() -> tuple[SkinnedPrimitive, Rig]:
    primitive, rig = tube()
    return primitive, bent(rig, np.radians(20.0))


def without_poses(rig: Rig) -> Rig:
    return replace(rig, poses=rig.poses[:0])


@pytest.mark.slow
@pytest.mark.usefixtures("_kernel")
@pytest.mark.parametrize("corners", [3, 4, 6])
def test_rings_whose_normal_lies_in_their_triangles_keep_the_gradient(corners: int) -> None:
    """Fans, nearly flat, whose rims run to and fro, so that the normals of their triangles nearly cancel."""
    kept, times = changes_of_fans(corners)
    assert np.array_equal(kept, areas_of_fans(corners) <= NARROW)
    assert 0.1 < kept.mean() < 0.9
    assert (times <= 10.0).all()


@pytest.mark.slow
@pytest.mark.usefixtures("_kernel")
@pytest.mark.parametrize("factor", [0.95, 1.05])
def test_rings_notice_a_narrower_or_wider_limit(factor: float, monkeypatch: pytest.MonkeyPatch) -> None:
    change(monkeypatch, "NARROW", factor)
    fans_differ = [(changes_of_fans(n)[0] != (areas_of_fans(n) <= NARROW)).any() for n in (3, 4, 6)]
    assert any(fans_differ)


def changes_of_fans(corners: int) -> tuple[BoolArray, Float64Array]:
    """Return which hubs keep their gradient, and how many times as long the fit makes that of each."""
    whole, rig = beside_each_other(fans(corners))
    hubs = np.arange(len(fans(corners))) * (corners + 1)
    plain, fit = (fitted(whole, one) for one in (None, rig))
    gradient, found = (np.hstack([one.alpha, one.beta])[hubs] for one in (plain, fit))
    times = np.linalg.norm(found, axis=1) / np.linalg.norm(gradient, axis=1)
    return (found == gradient).all(axis=1), times


@cache
def fans(corners: int) -> list[SkinnedPrimitive]:
    return [folded_fan(corners, seed) for seed in range(200)]


@cache
def areas_of_fans(corners: int) -> Float64Array:
    return np.array([area_between_derivatives(fan) for fan in fans(corners)])


def folded_fan(corners: int, seed: int) -> SkinnedPrimitive:
    """Return triangles around vertex 0 in no order, with the sum of their unit normals by angle."""
    random = np.random.default_rng(seed)
    angles, lengths = random.uniform(0.0, 2.0 * np.pi, corners), random.uniform(0.5, 2.0, corners)
    height = random.choice([0.02, 0.1, 0.5]) * random.normal(size=corners)
    rim = np.stack([lengths * np.cos(angles), lengths * np.sin(angles), height], axis=1)
    points = np.concatenate([np.zeros((1, 3)), rim]) @ np.linalg.qr(random.normal(size=(3, 3)))[0]
    beside = np.roll(np.arange(1, corners + 1), -1)
    triangles = np.stack([np.zeros(corners, dtype=np.int64), np.arange(1, corners + 1), beside], axis=1)
    normals = weighted_normals(points, triangles, corner_angles(points, triangles))
    weights = random.random((corners + 1, 4)) + 0.05
    return SkinnedPrimitive(
        positions=points.astype(np.float32),
        normals=np.tile(normals[0], (corners + 1, 1)).astype(np.float32),
        tangents=None,
        joints=np.tile(np.arange(4, dtype=np.uint16), (corners + 1, 1)),
        weights=weights / weights.sum(axis=1, keepdims=True),
        triangles=triangles.astype(np.uint32),
    )


def beside_each_other(parts: Sequence[SkinnedPrimitive]) -> tuple[SkinnedPrimitive, Rig]:
    """Return primitives of one size in a row, as one of them, and a rig with far pivots."""
    size = len(parts[0].positions)
    places = np.zeros((len(parts), 3), dtype=np.float32)
    places[:, 0] = 8.0 * np.arange(len(parts))
    whole = replace(
        parts[0],
        positions=np.concatenate([one.positions + place for one, place in zip(parts, places, strict=True)]),
        normals=np.concatenate([one.normals for one in parts]),
        joints=np.concatenate([one.joints for one in parts]),
        weights=np.concatenate([one.weights for one in parts]),
        triangles=np.concatenate([one.triangles + size * number for number, one in enumerate(parts)]),
    )
    return whole, Rig(np.array(CHAIN[:4], dtype=np.int32), np.diag([900.0, 800.0, 700.0, 600.0])[:, :3])


def area_between_derivatives(fan: SkinnedPrimitive) -> float:
    """Return the length of the cross product of the derivatives of the positions along both tangents."""
    by_axis = root_derivatives(fan)[:, 0] @ fan.positions.astype(np.float64)
    along, across = (axis[0] @ by_axis for axis in frame_from_normal(unit_normals(fan.normals)))
    return float(np.linalg.norm(np.cross(along, across)))


@pytest.mark.usefixtures("_kernel")
def test_a_mesh_without_an_area_has_no_gradients() -> None:
    primitive, rig = tube()
    baked = fitted(replace(primitive, positions=np.zeros_like(primitive.positions)), rig)
    assert not baked.alpha.any()
    assert not baked.beta.any()


def sampled_fit(primitive: SkinnedPrimitive, rig: Rig) -> tuple[Float64Array, Float64Array]:
    """Return the α and β that a dense solver finds, vertex by vertex."""
    positions = primitive.positions.astype(np.float64)
    n0 = unit_normals(primitive.normals)
    t0, b0 = (axis.astype(np.float64) for axis in frame_from_normal(n0))
    operator = gradient_operator([primitive], crease_angle_degrees=15.0)
    maps = maps_of_derivatives(root_derivatives(primitive), positions, t0, b0)

    def true_normals(points: Float64Array, sides: float | Float64Array = 1.0) -> Float64Array:
        """Return the normals that the map carries along, not normalised to first order."""
        inverse = np.linalg.inv(maps(points, sides))
        carried: Float64Array = np.einsum("vji,vj->vi", inverse, n0.astype(np.float64))
        return carried

    carried = carries(rig)
    samples = [(joint, axis) for joint in range(len(rig.parents)) for axis in np.eye(3)]
    rows: dict[str, list[list[Float64Array]]] = {"alpha": [], "beta": []}
    for joint, axis in samples:
        ahead, back = (pose(primitive, rig, carried[joint], joint, axis, turn) for turn in (TURN, -TURN))
        for name, rest in (("alpha", t0), ("beta", b0)):
            # The tilt of the tangent without α, and of each α, along the true normal.
            slope, column = [], []
            for matrices, sign in ((ahead, 1.0), (back, -1.0)):
                deformed = np.einsum("vk,vkij,vj->vi", primitive.weights, matrices, homogeneous(positions))
                normal = true_normals(deformed)
                turned = np.einsum("vk,vkij,vj->vi", primitive.weights, matrices[..., :3], rest)
                moved = np.einsum("vkij,vj->vki", matrices, homogeneous(positions))
                levers = moved[:, 1:] - moved[:, :1]
                slope.append(sign * np.einsum("vi,vi->v", turned, normal))
                column.append(sign * np.einsum("vki,vi->vk", levers, normal))
            rows[name].append([sum(parts) / (2 * TURN) for parts in (slope, column)])
    whole = gradients_of_joints(primitive, operator)
    along = [np.einsum("vji,vi->vj", whole, axis) for axis in (t0, b0)]
    own = [np.take_along_axis(each, primitive.joints.astype(np.int64), axis=1) for each in along]
    for each in own:  # what no slot holds goes to the first one, as in the shader
        each[:, 0] = -each[:, 1:].sum(axis=1)
    in_poses = [rows_of_pose(primitive, rig, pose, maps, (t0, b0), own, true_normals) for pose in rig.poses]
    fits, systems = [], []
    for tangent, name in enumerate(("alpha", "beta")):
        slopes, columns = (ANGLE * np.stack(parts, axis=1) for parts in zip(*rows[name], strict=True))
        poses = [each[tangent] for each in in_poses]
        fit, rows_of_tilts = solved(primitive, rig, carried, own[tangent], slopes, columns, poses)
        fits.append(fit)
        systems.append(rows_of_tilts)
    found = without_small_changes(fits, own)
    rays = np.add(*map(rays_along, found, systems))
    share = np.clip(np.minimum(RAY * rays[0] / rays[1], 2.0 * RAY * rays[2] / rays[3]), 0.0, 1.0)[:, None]
    return share * found[0], share * found[1]


class Tilts(NamedTuple):
    """How far α (K − 1,) of a vertex tilts its tangents, and should: matrix α and right, N times.

    The first ones, as many as turns, are by turns.
    """

    matrix: Float64Array
    right: Float64Array
    turns: int


@dataclass(frozen=True)
class InPose:
    """The tilt of a tangent in a pose, with its weight.

    slopes (V,) are those without α. Each unit of a slot's α adds rises (V, K), and moves the tangent by moves
    (V, K, 3).
    """

    slopes: Float64Array
    rises: Float64Array
    moves: Float64Array


def rows_of_pose(
    primitive: SkinnedPrimitive,
    rig: Rig,
    pose: Float64Array,
    maps: Maps,
    frame: tuple[Float64Array, Float64Array],
    own: Sequence[Float64Array],
    true_normals: Maps,
) -> list[InPose]:
    """Return the rows of a pose for α and for β. own (V, K) are the surface's gradients, of each."""
    points = homogeneous(primitive.positions.astype(np.float64))
    matrices = pose[primitive.joints]
    moved = np.einsum("vkij,vj->vki", matrices, points)
    deformed = np.einsum("vk,vki->vi", primitive.weights, moved)
    blended = np.einsum("vk,vkij->vij", primitive.weights, matrices[..., :3])
    sides = np.where(np.linalg.det(blended) < 0.0, -1.0, 1.0)
    normals = true_normals(deformed, sides[:, None])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    turned = [np.einsum("vk,vkij,vj->vi", primitive.weights, matrices[..., :3], each) for each in frame]
    whole = [base + np.einsum("vk,vki->vi", each, moved) for base, each in zip(turned, own, strict=True)]
    rigid = np.einsum("vk,vkij->v", primitive.weights, np.square(matrices[..., :3])) / 3.0
    lengths = np.maximum(np.square(whole).sum(axis=(0, 2)), 2.0 * COLLAPSED * rigid)
    weight = np.sqrt(2.0 / lengths / len(rig.poses))
    moves = weight[:, None, None] * (moved - deformed[:, None])
    rises = np.einsum("vki,vi->vk", moves, normals)
    return [InPose(weight * np.einsum("vi,vi->v", base, normals), rises, moves) for base in turned]


def root_derivatives(primitive: SkinnedPrimitive) -> Float64Array:
    """Return the derivatives (3, V, V) of a function at each vertex by its value at each: a weighted mean.

    A triangle has the gradient that a plane through its three values has. At a corner of the angle θ between
    edges of lengths a and b it weighs sin θ / √(a b).
    """
    count = len(primitive.positions)
    sums, weights = np.zeros((3, count, count)), np.zeros(count)
    for triangle in primitive.triangles.astype(np.int64):
        for corner in range(3):
            here, *others = np.roll(triangle, -corner)
            edges = (primitive.positions[others] - primitive.positions[here]).astype(np.float64)
            lengths = np.linalg.norm(edges, axis=1)
            cosine = edges[0] @ edges[1] / lengths.prod()
            weight = np.sqrt((1.0 - cosine**2) / lengths.prod())
            gradient = np.linalg.pinv(edges)
            sums[:, here, others] += weight * gradient
            sums[:, here, here] -= weight * gradient.sum(axis=1)
            weights[here] += weight
    found: Float64Array = sums / weights[:, None]
    return found


def gradients_of_joints(primitive: SkinnedPrimitive, operator: GradientOperator) -> Float64Array:
    """Return the gradients (V, J, 3) of the weights of all joints."""
    joints, count = primitive.joints.astype(np.int64), len(primitive.joints)
    whole = np.zeros((count, joints.max() + 1))
    np.put_along_axis(whole, joints, primitive.weights, axis=1)
    return np.stack([axis @ whole for axis in derivatives(operator)], axis=2)


def solved(
    primitive: SkinnedPrimitive,
    rig: Rig,
    carried: Float64Array,
    base: Float64Array,
    slopes: Float64Array,
    columns: Float64Array,
    poses: Sequence[InPose],
) -> tuple[Float64Array, list[Tilts]]:
    """Solve each vertex by numpy's lstsq, with rows for all pulls, for all slots but the first.

    The first slot takes minus the sum, so a row for all slots loses the first one's number from each other.
    Return the tilts of each vertex too.
    """
    result, systems = np.zeros((len(base), base.shape[1] - 1)), []
    # The chain of the test's rig has all its joints, one after the other.
    chains = [range(len(CHAIN))] if rig.parents.tolist() == list(CHAIN) else []
    for vertex, joints in enumerate(primitive.joints):
        levers = primitive.positions[vertex].astype(np.float64) - rig.pivots
        squares = (levers**2).sum(axis=1)
        parting = [joint for joint in range(len(levers)) if 0 < carried[joint, joints].sum() < len(joints)]
        turns = [3 * joint + axis for joint in parting for axis in range(3)]
        tilts, right = list(columns[vertex, turns]), list(-slopes[vertex, turns])
        for chain in chains:
            curl = [joint for joint in chain if joint in parting]
            for axis in range(3 if len(curl) > 1 else 0):
                rows = [3 * joint + axis for joint in curl]
                tilts.append(np.sqrt(TOGETHER) * columns[vertex, rows].sum(axis=0))
                right.append(-np.sqrt(TOGETHER) * slopes[vertex, rows].sum())
        pulls = [ANGLE * np.sqrt(squares[joint]) * carried[joint, joints] for joint in parting]
        count = len(tilts)
        for posed in poses:
            tilts.append(posed.rises[vertex, 1:] - posed.rises[vertex, 0])
            right.append(-posed.slopes[vertex])
            pulls += list(posed.moves[vertex].T)
        pulled = np.sqrt(STIFFNESS) * np.array([row[1:] - row[0] for row in pulls])
        wanted = np.sqrt(STIFFNESS) * np.array([row @ base[vertex] for row in pulls])
        matrix, right_side = np.array(tilts), np.array(right)
        result[vertex] = np.linalg.lstsq(
            np.concatenate([matrix, pulled]), np.concatenate([right_side, wanted]), rcond=None
        )[0]
        systems.append(Tilts(matrix, right_side, count))
    return result, systems


def without_small_changes(fits: Sequence[Float64Array], own: Sequence[Float64Array]) -> list[Float64Array]:
    """Return α and β of which changes far below the gradient are dropped, vertex by vertex.

    fits have all slots but the first, and own, the gradients of the surface, all.
    """
    found = [np.zeros_like(fit) for fit in fits]
    for vertex in range(len(own[0])):
        changes = [fit[vertex] - base[vertex, 1:] for fit, base in zip(fits, own, strict=True)]
        last = [-each.sum() for each in changes]
        change = max(np.hypot(*pair) for pair in [last, *zip(*changes, strict=True)])
        gradient = max(np.hypot(*pair) for pair in zip(*(base[vertex] for base in own), strict=True))
        kept = 1.0 / (1.0 + (SMALL * gradient / change) ** 2) if change else 0.0
        for one, base, moved in zip(found, own, changes, strict=True):
            one[vertex] = base[vertex, 1:] + kept * moved
    return found


def rays_along(fit: Float64Array, systems: Sequence[Tilts]) -> Float64Array:
    """Return A and B (4, V), by which the summed squared tilt of s α is E0 − 2 s A + s² B.

    Those of poses and turns are first, and then those of turns alone.
    """
    rays = np.zeros((4, len(fit)))
    for vertex, (matrix, right, turns) in enumerate(systems):
        along = matrix @ fit[vertex]
        for number, part in enumerate((slice(None), slice(turns))):
            rays[2 * number :][:2, vertex] = along[part] @ right[part], along[part] @ along[part]
    return rays


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


def maps_of_derivatives(
    derivatives: Float64Array, rest: Float64Array, t0: Float64Array, b0: Float64Array
) -> Maps:
    """Return what maps the derivatives of the positions, and the vector across, to the deformed ones."""
    along, across = (np.einsum("ui,iuv->uv", axis, derivatives) for axis in (t0, b0))

    def columns(
        points: Float64Array, area: Float64Array | None, sides: float | Float64Array = 1.0
    ) -> Float64Array:
        a, b = along @ points, across @ points
        c = sides * np.cross(a, b)
        length = np.linalg.norm(c, axis=1)
        third = c / np.sqrt(length * (length if area is None else area))[:, None]
        return np.stack([a, b, third], axis=2)

    first = columns(rest, None)
    area = np.linalg.norm(np.cross(first[..., 0], first[..., 1]), axis=1)

    def maps(points: Float64Array, sides: float | Float64Array) -> Float64Array:
        found: Float64Array = columns(points, area, sides) @ np.linalg.inv(first)
        return found

    return maps
