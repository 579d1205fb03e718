from __future__ import annotations

import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from skinbake.choices import Weighting
from skinbake.errors import InputError
from skinbake.geometry.skinned import Float64Array, SkinnedPrimitive
from skinbake.truth import mesh
from skinbake.truth.areas import vertex_areas
from skinbake.truth.operator import GradientOperator, expected_alpha_beta, gradient_operator
from tests.support.derivatives import derivatives
from tests.support.surfaces import (
    MILD,
    AnalyticSurface,
    Triangulation,
    analytic_surface,
    bends,
    flat_triangulation,
)
from tests.support.weight_field import weight_field
from tests.support.whole_fields import angular_errors

WEIGHTINGS = tuple(Weighting)


def patch(
    positions: object,
    triangles: object,
    *,
    normals: object = (0.0, 0.0, 1.0),
    joints: object = (0, 0, 0, 0),
    weights: object = (1.0, 0.0, 0.0, 0.0),
) -> SkinnedPrimitive:
    points = np.array(positions, dtype=np.float64).reshape(-1, 3)
    bound = np.array(np.broadcast_to(np.asarray(joints), (len(points), 4)))
    return SkinnedPrimitive(
        points,
        np.array(np.broadcast_to(np.asarray(normals, dtype=np.float64), points.shape)),
        None,
        bound,
        np.array(np.broadcast_to(np.asarray(weights, dtype=np.float64), bound.shape)),
        np.array(triangles, dtype=np.int64).reshape(-1, 3),
    )


def gradients(operator: GradientOperator, field: object) -> Float64Array:
    values = np.asarray(field, dtype=np.float64)
    return np.stack([axis @ values for axis in derivatives(operator)], axis=-1)


def alpha_beta(
    surface: AnalyticSurface, weighting: Weighting = Weighting.MAX
) -> tuple[Float64Array, Float64Array]:
    operator = gradient_operator([surface.primitive], weighting=weighting)
    frames = [(surface.tangents, surface.bitangents)]
    [(alpha, beta)] = expected_alpha_beta(operator, [surface.primitive], frames)
    return alpha[:, :3], beta[:, :3]


def accurate_normals(
    surface: AnalyticSurface, poses: Float64Array, alpha: Float64Array, beta: Float64Array
) -> Float64Array:
    """n' = t' × b' of linear blend skinning, with t' = T t + Σ α M p."""
    primitive = surface.primitive
    blended = np.einsum("vs,psij->pvij", primitive.weights[:, :3], poses[:, :, :3, :3])
    moved = np.einsum("psij,vj->pvsi", poses[:, :, :3, :3], primitive.positions) + poses[:, None, :, :3, 3]
    t = np.einsum("pvij,vj->pvi", blended, surface.tangents) + np.einsum("vs,pvsi->pvi", alpha, moved)
    b = np.einsum("pvij,vj->pvi", blended, surface.bitangents) + np.einsum("vs,pvsi->pvi", beta, moved)
    return np.cross(t, b)


def mean_error(
    count: int, triangulation: Triangulation, weighting: Weighting, seed: int
) -> tuple[float, int]:
    surface = analytic_surface(count, triangulation, seed=seed)
    poses = bends([MILD])
    normals = accurate_normals(surface, poses, *alpha_beta(surface, weighting))
    errors = angular_errors(normals, surface.exact_normals(poses))[0]
    areas = vertex_areas(surface.primitive.positions, surface.primitive.triangles)
    return float(np.average(errors, weights=areas)), len(areas)


# The analytic surface itself


def test_the_analytic_gradients_yield_the_normals_that_differences_yield() -> None:
    surface = analytic_surface(300, "irregular")
    poses = bends([MILD, 40.0])
    normals = accurate_normals(surface, poses, surface.alpha, surface.beta)
    assert angular_errors(normals, surface.exact_normals(poses)).max() < 1e-7


# Exactness


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_linear_weights_on_a_plane_are_exact(weighting: Weighting) -> None:
    flat, triangles = flat_triangulation(400, "random")
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    positions = np.column_stack([flat, np.zeros(len(flat))]) @ turn.T + [5.0, -3.0, 2.0]
    slopes = np.array([[0.05, 0.1], [-0.02, 0.1]])
    first, second = (flat @ slopes.T + [0.1, 0.2]).T
    weights = np.column_stack([1.0 - first - second, first, second, np.zeros(len(flat))])
    primitive = patch(positions, triangles, normals=turn[:, 2], joints=(4, 2, 7, 0), weights=weights)

    [(alpha, beta)] = expected_alpha_beta(
        gradient_operator([primitive], weighting=weighting),
        [primitive],
        [(np.tile(turn[:, 0], (len(flat), 1)), np.tile(turn[:, 1], (len(flat), 1)))],
    )

    # Random Delaunay triangles are slivers that magnify rounding: 2e-13, measured.
    assert np.abs(alpha - [*(-slopes.sum(axis=0)[:1]), *slopes[:, 0], 0.0]).max() < 2e-12
    assert np.abs(beta - [*(-slopes.sum(axis=0)[1:]), *slopes[:, 1], 0.0]).max() < 2e-12


@pytest.mark.parametrize(
    ("weighting", "share"), [("max", 4 / 5), ("angle", 2 / 3), ("area", 1 / 3), ("angle-area", 1 / 2)]
)
def test_each_weighting_averages_as_defined(weighting: Weighting, share: float) -> None:
    # At the first vertex: 1, π/2, 1, π/2 for the first triangle against 2/8, π/4, 2, π/2 for the second,
    # on which the field does not vary, and which counts all the same.
    primitive = patch([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-2, 2, 0]], [[0, 1, 2], [0, 2, 3]])
    found = gradients(gradient_operator([primitive], weighting=weighting), [0.0, 1.0, 0.0, 0.0])
    assert found[0] == pytest.approx([share, 0.0, 0.0], abs=1e-14)


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_gradients_of_normalised_weights_sum_to_zero(weighting: Weighting) -> None:
    alpha, beta = alpha_beta(analytic_surface(500, "random"), weighting)
    assert np.abs(alpha).max() > 0.1
    assert np.abs(alpha.sum(axis=1)).max() < 1e-11
    assert np.abs(beta.sum(axis=1)).max() < 1e-11


# Convergence and the choice of weights


@pytest.mark.parametrize(
    ("triangulation", "order"), [pytest.param("irregular", 1.5, marks=pytest.mark.slow), ("jittered", 1.8)]
)
def test_max_weights_converge(triangulation: Triangulation, order: float) -> None:
    # In the range of real characters. Ever finer, every average of triangle gradients falls back to order 1
    # where the stencils stay irregular: its error in a quadratic field is proportional to the edge length.
    coarse, fine = (
        [mean_error(count, triangulation, Weighting.MAX, seed) for seed in range(3)] for count in (700, 5600)
    )
    spacing = math.sqrt(np.mean([count for _, count in fine]) / np.mean([count for _, count in coarse]))
    drop = np.mean([error for error, _ in coarse]) / np.mean([error for error, _ in fine])
    assert math.log(drop) / math.log(spacing) >= order


@pytest.mark.parametrize(
    "count", [700, *(pytest.param(count, marks=pytest.mark.slow) for count in (1500, 3000))]
)
def test_max_weights_beat_angle_times_area_on_random_triangulations(count: int) -> None:
    best, published = (
        np.mean([mean_error(count, "random", weighting, seed)[0] for seed in range(3)])
        for weighting in (Weighting.MAX, Weighting.ANGLE_AREA)
    )
    assert best <= 0.6 * published


# Seams


def split_seam(
    primitive: SkinnedPrimitive, *, tilt_degrees: float
) -> tuple[SkinnedPrimitive, np.ndarray[tuple[int], np.dtype[np.int64]]]:
    """Give the triangles right of the middle their own copies of the vertices they share with the left."""
    centres = primitive.positions[primitive.triangles].mean(axis=1)
    right = centres[:, 0] > 2.0
    shared = np.intersect1d(primitive.triangles[right], primitive.triangles[~right])
    copy_of = np.arange(len(primitive.positions))
    copy_of[shared] = len(copy_of) + np.arange(len(shared))
    triangles = primitive.triangles.copy()
    triangles[right] = copy_of[triangles[right]]
    tilted = primitive.normals[shared] + math.tan(math.radians(tilt_degrees)) * _across(
        primitive.normals[shared]
    )
    order = [2, 0, 3, 1]
    split = SkinnedPrimitive(
        np.concatenate([primitive.positions, primitive.positions[shared]]),
        # Not unit vectors: lengths mean nothing here.
        np.concatenate([primitive.normals, 3.0 * tilted]),
        None,
        # The copies name their joints in another order, and weigh them by other sums.
        np.concatenate([primitive.joints, primitive.joints[shared][:, order]]),
        np.concatenate([primitive.weights, 0.5 * primitive.weights[shared][:, order]]),
        triangles,
    )
    return split, np.concatenate([np.arange(len(primitive.positions)), shared])


def _across(normals: Float64Array) -> Float64Array:
    tangents: Float64Array = np.cross(normals, [0.0, 1.0, 0.0])
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    return tangents


def test_a_uv_seam_changes_nothing() -> None:
    whole = analytic_surface(300, "irregular").primitive
    split, original = split_seam(whole, tilt_degrees=14.9)
    assert len(split.positions) > len(whole.positions) + 10
    expected = gradients(gradient_operator([whole]), weight_field([whole]).toarray())
    found = gradients(gradient_operator([split]), weight_field([split]).toarray())
    assert np.abs(found - expected[original]).max() < 1e-10


def test_a_crease_does_not_weld() -> None:
    whole = analytic_surface(300, "irregular").primitive
    split, original = split_seam(whole, tilt_degrees=15.1)
    expected = gradients(gradient_operator([whole]), weight_field([whole]).toarray())
    found = gradients(gradient_operator([split]), weight_field([split]).toarray())
    wide = gradients(gradient_operator([split], crease_angle_degrees=16.0), weight_field([split]).toarray())
    assert np.abs(found - expected[original])[len(whole.positions) :].max() > 0.01
    assert np.abs(wide - expected[original]).max() < 1e-10


def test_each_side_of_a_hard_edge_has_the_gradient_of_its_own_triangles() -> None:
    # A floor and a wall that share the edge x = 0; the field is x on the floor and 3 z on the wall.
    floor = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    wall = [[0, 0, 0], [0, 1, 0], [0, 0, 1]]
    up, sideways = [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]
    primitive = patch(floor + wall, [[0, 1, 2], [3, 4, 5]], normals=[up] * 3 + [sideways] * 3)
    field = [0.0, 1.0, 0.0, 0.0, 0.0, 3.0]
    apart = gradients(gradient_operator([primitive]), field)
    assert apart == pytest.approx(np.array([[1.0, 0.0, 0.0]] * 3 + [[0.0, 0.0, 3.0]] * 3))
    joined = gradients(gradient_operator([primitive], crease_angle_degrees=90.0), field)
    assert joined[[0, 3]] == pytest.approx(np.array([[0.5, 0.0, 1.5]] * 2))


def test_primitives_of_one_mesh_weld_where_they_meet() -> None:
    whole = analytic_surface(300, "irregular").primitive
    right = whole.positions[whole.triangles].mean(axis=1)[:, 0] > 2.0
    # The first keeps all vertices, some of which only its neighbour uses; the second keeps its own,
    # renumbered, and has two sets of influences.
    used, numbers = np.unique(whole.triangles[right], return_inverse=True)
    second = SkinnedPrimitive(
        whole.positions[used],
        whole.normals[used],
        None,
        np.hstack([whole.joints[used], whole.joints[used]]),
        np.hstack([np.zeros((len(used), 4)), whole.weights[used]]),
        numbers.reshape(-1, 3).astype(np.uint16),
    )
    parts = [replace(whole, triangles=whole.triangles[~right].astype(np.uint32)), second]
    operator = gradient_operator(parts)
    expected = gradients(gradient_operator([whole]), weight_field([whole]).toarray())
    found = gradients(operator, weight_field(parts).toarray())
    assert operator.counts == (len(whole.positions), len(used))
    first_rows, second_rows = operator.slices
    assert np.abs(found[first_rows] - expected).max() < 1e-10
    assert np.abs(found[second_rows] - expected[used]).max() < 1e-10


@pytest.mark.parametrize("triangulation", ["random", "jittered"])
def test_each_triangles_gradient_solves_its_edges(triangulation: Triangulation) -> None:
    """Of a mesh whose triangles have no vertex in common, a row is a triangle's gradient and nothing else."""
    surface = analytic_surface(200, triangulation).primitive
    positions = surface.positions[surface.triangles].reshape(-1, 3).astype(np.float64)
    triangles = np.arange(len(positions)).reshape(-1, 3)
    apart = patch(positions, triangles, joints=np.arange(len(positions))[:, None] * [1, 0, 0, 0])
    field = np.random.default_rng(5).normal(size=len(positions))
    expected = np.empty((len(triangles), 3))
    for number, (origin, first, second) in enumerate(triangles):
        edges = positions[[first, second]] - positions[origin]
        rises = field[[first, second]] - field[origin]
        # The least of all solutions has no part along the normal.
        expected[number] = np.linalg.lstsq(edges, rises, rcond=None)[0]
    found = gradients(gradient_operator([apart]), field).reshape(-1, 3, 3)
    for corner in range(3):
        assert np.abs(found[:, corner] - expected).max() < 1e-9 * np.abs(expected).max()


def test_the_reach_is_what_the_rows_sum_up_to() -> None:
    operator = gradient_operator([analytic_surface(300, "irregular").primitive])
    expected = sum(np.abs(axis.toarray()).sum(axis=1) for axis in derivatives(operator))
    assert operator.reach() == pytest.approx(expected, rel=1e-12)


def test_rows_do_not_depend_on_the_blocks_they_are_made_in(monkeypatch: pytest.MonkeyPatch) -> None:
    surface = analytic_surface(300, "irregular")
    split, _ = split_seam(surface.primitive, tilt_degrees=5.0)
    whole = derivatives(gradient_operator([split]))[0].toarray()
    monkeypatch.setattr(mesh, "CORNERS", 20)
    operator = gradient_operator([split])
    assert len(operator.row_blocks()) > 50
    assert (derivatives(operator)[0].toarray() == whole).all()


# Data that real files hold


def test_lines_points_and_broken_vertices_are_ignored() -> None:
    sound = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    odd = [[2, 0, 0], [1e-6, 1e-17, 0], [np.nan, 0, 0], [9, 9, 9]]
    lines = [[0, 1, 3], [0, 1, 1], [2, 2, 2], [0, 1, 4], [0, 1, 5]]
    clean = gradient_operator([patch(sound, [[0, 1, 2]])])
    found = gradient_operator([patch(sound + odd, [[0, 1, 2], *lines])])
    field = [0.3, 0.9, -0.4]
    assert gradients(found, [*field, 7.0, 7.0, 7.0, 7.0])[:3].tolist() == gradients(clean, field).tolist()
    assert not gradients(found, [*field, 7.0, 7.0, 7.0, 7.0])[3:].any()


def test_a_mesh_without_sound_triangles_has_a_zero_operator() -> None:
    operator = gradient_operator([patch(np.zeros((3, 3)), [[0, 1, 2]]), patch(np.zeros((0, 3)), [])])
    assert operator.counts == (3, 0)
    assert gradients(operator, [1.0, 2.0, 3.0]).tolist() == np.zeros((3, 3)).tolist()


@pytest.mark.parametrize("index", [-1, 3])
def test_indices_outside_their_primitive_are_refused_before_libigl_sees_them(index: int) -> None:
    good = patch(np.eye(3), [[0, 1, 2]])
    with pytest.raises(InputError, match="primitive 1: indices"):
        gradient_operator([good, patch(np.eye(3), [[0, 1, index]])])


def test_an_unknown_weighting_is_refused() -> None:
    with pytest.raises(ValueError, match="nelson"):
        gradient_operator([patch(np.eye(3), [[0, 1, 2]])], weighting="nelson")  # type: ignore[arg-type]  # on purpose


def test_a_joint_in_two_slots_is_carried_by_the_first_that_has_weight() -> None:
    # Joint 5 weighs x; it stands in slots 1, 2 and 3, of which 1 has no weight.
    x = np.array([0.2, 0.6, 0.4])
    weights = np.column_stack([1.0 - x, np.zeros(3), x / 4.0, 3.0 * x / 4.0])
    positions = np.column_stack([x, [0.0, 0.0, 1.0], np.zeros(3)])
    primitive = patch(positions, [[0, 1, 2]], joints=(1, 5, 5, 5), weights=weights)
    operator = gradient_operator([primitive])
    along_x, along_y = np.tile([2.0, 0.0, 0.0], (3, 1)), np.tile([0.0, 1.0, 0.0], (3, 1))
    [(alpha, beta)] = expected_alpha_beta(operator, [primitive], [(along_x, along_y)])
    assert alpha == pytest.approx(np.tile([-2.0, 0.0, 2.0, 0.0], (3, 1)))
    assert beta == pytest.approx(np.zeros((3, 4)), abs=1e-14)


def test_a_slot_without_weight_gets_the_gradient_of_the_joint_it_names() -> None:
    # The second vertex alone is moved by joint 3; the first names it in a free slot twice.
    joints = [[0, 3, 3, 3], [3, 0, 0, 0], [0, 1, 2, 3]]
    primitive = patch([[0, 0, 0], [2, 0, 0], [0, 1, 0]], [[0, 1, 2]], joints=joints)
    frame = np.tile([1.0, 0.0, 0.0], (3, 1))
    [(alpha, _)] = expected_alpha_beta(gradient_operator([primitive]), [primitive], [(frame, frame)])
    assert alpha == pytest.approx(
        np.array([[-0.5, 0.5, 0.0, 0.0], [0.5, -0.5, 0.0, 0.0], [-0.5, 0.0, 0.0, 0.5]])
    )


# Invariance


@pytest.mark.slow
def test_very_many_slots_take_little_memory() -> None:
    """64 sets that repeat one: tables of all pairs of slots, or of slots by entries, would take 200 MB."""
    surface = analytic_surface(1500, "random")
    few = surface.primitive
    alpha, beta = alpha_beta(surface)
    many = few.with_influences(np.tile(few.joints, (1, 64)), np.tile(few.weights, (1, 64)) / 64.0)
    operator = gradient_operator([few])
    tracemalloc.start()
    [found] = expected_alpha_beta(operator, [many], [(surface.tangents, surface.bitangents)])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 6 * found[0].nbytes + 2 * found[1].nbytes + 64e6
    for wide, narrow in zip(found, (alpha, beta), strict=True):
        width = narrow.shape[1]
        np.testing.assert_allclose(wide[:, :width], narrow, rtol=1e-9, atol=1e-9)
        assert not wide[:, few.joints.shape[1] :].any()


def test_the_order_of_vertices_and_triangles_changes_nothing() -> None:
    surface = analytic_surface(300, "irregular")
    split, _ = split_seam(surface.primitive, tilt_degrees=5.0)
    rng = np.random.default_rng(8)
    order, shuffled = rng.permutation(len(split.positions)), rng.permutation(len(split.triangles))
    triangles = np.roll(np.argsort(order)[split.triangles[shuffled]], 1, axis=1)
    other = SkinnedPrimitive(
        split.positions[order],
        split.normals[order],
        None,
        split.joints[order],
        split.weights[order],
        triangles,
    )
    expected = gradients(gradient_operator([split]), weight_field([split]).toarray())
    found = gradients(gradient_operator([other]), weight_field([other]).toarray())
    assert np.abs(found - expected[order]).max() < 1e-10


@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize("scale", [1e-4, 1000.0])
def test_scaling_the_mesh_scales_gradients_inversely(scale: float, weighting: Weighting) -> None:
    surface = analytic_surface(300, "irregular")
    larger = replace(surface.primitive, positions=surface.primitive.positions * scale)
    alpha, _ = alpha_beta(surface, weighting)
    scaled, _ = alpha_beta(replace(surface, primitive=larger), weighting)
    assert np.abs(scaled * scale - alpha).max() < 1e-9


def test_welding_is_claimed_by_what_its_rows_repeat() -> None:
    """A fan whose triangles have each a copy of its centre: every copy gets a row as long as the rim."""
    claimed: list[int] = []
    count = 50
    angles = 2 * np.pi * np.arange(count + 1) / (count + 1)
    rim = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    positions = np.concatenate([np.zeros((count, 3)), rim])
    triangles = np.stack([np.arange(count), count + np.arange(count), count + 1 + np.arange(count)], axis=1)
    weights = np.tile([1.0, 0, 0, 0], (len(positions), 1))
    normals = np.tile([0.0, 0, 1], (len(positions), 1))
    joints = np.zeros((len(positions), 4), np.int64)
    fan = SkinnedPrimitive(positions, normals, None, joints, weights, triangles.astype(np.uint32))
    operator = gradient_operator([fan], claim=claimed.append)
    assert derivatives(operator)[0].nnz > count * count
    assert sum(claimed) > 3 * 12 * count * count
    apart = SkinnedPrimitive(
        positions[count:],
        normals[count:],
        None,
        joints[count:],
        weights[count:],
        np.array([[0, 1, 20]], np.uint32),
    )
    claimed.clear()
    gradient_operator([apart], claim=claimed.append)
    assert sum(claimed) == 0
