"""The truth by triangles: against libigl's angle-weighted normals, and what it must return exactly."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import igl
import numpy as np
import pytest

from skinbake.geometry.skinned import Float64Array, SkinnedPrimitive
from skinbake.truth.areas import vertex_areas
from skinbake.truth.operator import gradient_operator
from skinbake.truth.truths import vertex_normals
from tests.support.surfaces import MILD, STRONG, analytic_surface, bends
from tests.support.triangle_truth import true_normals
from tests.support.whole_fields import angular_errors

POSES = bends([MILD, STRONG, 60.0])


def by_libigl(positions: Float64Array, triangles: Any) -> Float64Array:
    angle_weighted = igl.PER_VERTEX_NORMALS_WEIGHTING_TYPE_ANGLE
    found: Float64Array = igl.per_vertex_normals(positions, triangles.astype(np.int64), angle_weighted)
    return found


def authored(normals: Any) -> Float64Array:
    """Normals that no surface has: tilted by up to 40°, of any length."""
    rng = np.random.default_rng(4)
    tilted = normals + rng.uniform(-0.5, 0.5, normals.shape)
    return np.asarray(tilted * rng.uniform(0.1, 9.0, (len(tilted), 1)))


@pytest.mark.parametrize("triangulation", ["random", "irregular"])
def test_normals_of_the_surface_stay_normals_of_the_surface(triangulation: Any) -> None:
    surface = analytic_surface(500, triangulation)
    primitive, deformed = surface.primitive, surface.deformed(POSES)
    at_rest = by_libigl(primitive.positions.astype(np.float64), primitive.triangles)
    found = true_normals(primitive, deformed, at_rest)
    expected = np.stack([by_libigl(one, primitive.triangles) for one in deformed])
    errors = angular_errors(found, expected)
    # Where a strong bend folds the mesh, its tangents turn over, and the normal is on their side.
    folded = errors > 90.0
    assert np.where(folded, 180.0 - errors, errors).max() < 1e-5
    assert not folded[0].any() and folded.mean() < 0.01
    assert angular_errors(found[0], found[2]).max() > 10.0


def test_at_rest_it_returns_the_stored_normals_authored_ones_included() -> None:
    primitive = analytic_surface(400, "random").primitive
    for n0 in (primitive.normals.astype(np.float64), authored(primitive.normals)):
        found = true_normals(primitive, primitive.positions[None].astype(np.float64), n0)
        assert angular_errors(found[0], n0).max() < 1e-6
        assert np.abs(np.linalg.norm(found, axis=2) - 1.0).max() < 1e-12


def test_a_stretched_plane_carries_leaning_normals_as_covectors() -> None:
    """On a flat grid the map is known: S in the plane, √det S across it. n0 goes to its inverse transpose."""
    x, y = np.meshgrid(np.linspace(0.0, 1.0, 6), np.linspace(0.0, 2.0, 7), indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    points[:, :2] += np.random.default_rng(5).uniform(-0.04, 0.04, (len(points), 2))
    corners = np.arange(42).reshape(6, 7)
    a, b, c, d = corners[:-1, :-1], corners[1:, :-1], corners[1:, 1:], corners[:-1, 1:]
    triangles = np.stack([a, b, c, a, c, d], axis=2).reshape(-1, 3)
    joints, weights = np.zeros((42, 4), np.int64), np.tile([1.0, 0.0, 0.0, 0.0], (42, 1))
    lean = np.random.default_rng(6).uniform(-1.2, 1.2, (42, 2))
    n0 = np.concatenate([lean, np.ones((42, 1))], axis=1)
    grid = SkinnedPrimitive(points, n0, None, joints, weights, triangles)
    turn = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    plane = np.array([[1.7, 0.6], [-0.3, 0.5]])
    carry = np.zeros((3, 3))
    carry[:2, :2], carry[2, 2] = plane, np.sqrt(np.linalg.det(plane))
    carry = turn @ carry
    found = true_normals(grid, (points @ carry.T)[None])[0]
    assert angular_errors(found, n0 @ np.linalg.inv(carry)).max() < 1e-6


def test_axes_of_the_model_do_not_matter() -> None:
    surface = analytic_surface(500, "random")
    primitive, deformed = surface.primitive, surface.deformed(bends([STRONG]))
    n0 = authored(primitive.normals)
    found = true_normals(primitive, deformed, n0)[0]
    for matrix in (np.eye(3)[[1, 2, 0]], np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]):
        turn = matrix * np.linalg.det(matrix)
        turned = replace(primitive, positions=primitive.positions @ turn.T)
        again = true_normals(turned, deformed @ turn.T, n0 @ turn.T)[0]
        assert angular_errors(again, found @ turn.T).max() < 1e-3


@pytest.mark.parametrize("scale", [1.0, 0.01, 300.0])
def test_rigid_motion_and_uniform_scale_rotate_authored_normals(scale: float) -> None:
    primitive = analytic_surface(400, "random").primitive
    n0 = authored(primitive.normals)
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    moved = np.asarray(scale * (primitive.positions @ turn.T)[None] + 2.0, dtype=np.float64)
    found = true_normals(primitive, moved, n0)
    assert angular_errors(found[0], n0 @ turn.T).max() < 1e-6


def test_a_mirror_keeps_normals_outside() -> None:
    primitive = analytic_surface(400, "irregular").primitive
    mirror = np.diag([1.0, -1.0, 1.0])
    n0 = authored(primitive.normals)
    mirrored = primitive.positions[None].astype(np.float64) @ mirror
    sides = -np.ones((1, len(n0)))
    assert angular_errors(true_normals(primitive, mirrored, n0, sides)[0], n0 @ mirror).max() < 1e-6


@pytest.mark.slow
def test_truth_by_triangles_converges_to_the_normals_of_the_skinned_surface() -> None:
    means = []
    for count in (700, 5600):
        surface = analytic_surface(count, "irregular")
        poses = bends([MILD])
        found = true_normals(surface.primitive, surface.deformed(poses))
        areas = vertex_areas(surface.primitive.positions, surface.primitive.triangles)
        errors = angular_errors(found, surface.exact_normals(poses))[0]
        means.append(np.average(errors, weights=areas))
    assert means[1] < 0.5 * means[0]
    assert means[1] < 0.2


def roof(angle: float) -> SkinnedPrimitive:
    """Two squares that meet at an edge, whose vertices each has by itself, with its own flat normal."""
    half = np.radians(angle) / 2.0
    slope = np.array([np.cos(half), 0.0, -np.sin(half)])
    edge = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    right, left = edge + slope, edge + slope * [-1.0, 1.0, 1.0]
    positions = np.concatenate([edge, right, edge, left])
    up = np.array([np.sin(half), 0.0, np.cos(half)])
    normals = np.concatenate([np.tile(up, (4, 1)), np.tile(up * [-1.0, 1.0, 1.0], (4, 1))])
    triangles = np.array([[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6]])
    joints, weights = np.zeros((8, 4), np.int64), np.tile([1.0, 0.0, 0.0, 0.0], (8, 1))
    return SkinnedPrimitive(positions, normals, None, joints, weights, triangles)


def test_hard_edges_stay_hard() -> None:
    """Bent about its edge, each side turns for itself; where copies are one point, they keep their mean.

    Then each copy leans from the mean by half the roof's angle, in a plane that the bend narrows by c. Its
    slope, a covector, grows by 1 / c, beside a normal that shrinks by 1 / √c.
    """
    for angle, joined in ((60.0, False), (10.0, True)):
        half, after = np.radians(angle) / 2.0, np.radians(angle + 20.0) / 2.0
        lean = np.degrees(np.arctan(np.tan(half) * np.sqrt(np.cos(half) / np.cos(after))) - half)
        primitive = roof(angle)
        bent = roof(angle + 20.0)
        found = true_normals(primitive, bent.positions[None].astype(np.float64))[0]
        turned = angular_errors(found, primitive.normals)
        on_edge = [0, 1, 4, 5]
        assert turned[on_edge] == pytest.approx([lean if joined else 10.0] * 4, abs=1e-6)
        assert turned[[2, 3, 6, 7]] == pytest.approx([10.0] * 4, abs=1e-6)


def test_flat_and_broken_triangles_add_nothing() -> None:
    primitive = analytic_surface(200, "jittered").primitive
    rest = primitive.positions.astype(np.float64)
    line, broken = rest.copy(), rest.copy()
    first = primitive.triangles[0]
    line[first[2]] = 0.5 * (line[first[0]] + line[first[1]])
    broken[first[0]] = np.nan
    operator = gradient_operator([primitive])
    only = primitive.triangles[:1]
    alone = gradient_operator([replace(primitive, triangles=only)])
    for positions in (line, broken, np.zeros_like(rest)):
        posed = np.ascontiguousarray(positions.T[:, :, None])
        assert not vertex_normals(alone, posed).any()
        assert np.isfinite(vertex_normals(operator, posed)).all()
    assert vertex_normals(alone, np.ascontiguousarray(rest.T[:, :, None])).any()


def test_triangles_that_cancel_out_leave_no_normal() -> None:
    """With each triangle there twice, once for each side, the rest of the sum is rounding."""
    primitive = analytic_surface(200, "jittered").primitive
    triangles = primitive.triangles
    once, both = triangles[:40], np.concatenate([triangles[40:], triangles[40:, [1, 0, 2]]])
    doubled = replace(primitive, triangles=np.concatenate([once, both]))
    found = true_normals(doubled, primitive.positions[None].astype(np.float64))[0]
    lit, cancelled = np.unique(once), np.setdiff1d(both, once)
    assert np.isnan(found[cancelled]).all() and len(cancelled) > 50
    assert angular_errors(found[lit], primitive.normals[lit]).max() < 1e-6
