from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from skinbake.geometry.skinned import Float64Array
from skinbake.truth.areas import vertex_areas
from skinbake.truth.normals import RestFrames
from skinbake.truth.operator import gradient_operator
from skinbake.truth.truths import rest_frames
from tests.support import whole_fields
from tests.support.derivatives import derivative_along
from tests.support.surfaces import MILD, STRONG, AnalyticSurface, Triangulation, analytic_surface, bends
from tests.support.whole_fields import angular_errors, reference_normals

NEARLY_A_LINE = np.array([[1.0, 0.5, 0.2], [0.0, 1e-9, 0.0], [0.0, 0.0, 1e-9]])


def at_rest(surface: AnalyticSurface, normals: Float64Array | None = None) -> RestFrames:
    primitive = surface.primitive
    used = primitive.normals if normals is None else normals
    operator = gradient_operator([primitive])
    return rest_frames(operator, primitive.positions, used, surface.tangents, surface.bitangents)


def authored(surface: AnalyticSurface) -> Float64Array:
    """Normals that no surface has: tilted by up to 40°, of any length."""
    rng = np.random.default_rng(4)
    tilted = surface.primitive.normals + rng.uniform(-0.5, 0.5, surface.primitive.normals.shape)
    return tilted * rng.uniform(0.1, 9.0, (len(tilted), 1))


def rotation(seed: int) -> Float64Array:
    turn: Float64Array = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    return turn


def mean_errors(count: int, triangulation: Triangulation, seed: int) -> tuple[Float64Array, int]:
    surface = analytic_surface(count, triangulation, seed=seed)
    poses = bends([MILD, STRONG])
    normals, valid = reference_normals(at_rest(surface), surface.deformed(poses))
    assert valid.all()
    areas = vertex_areas(surface.primitive.positions, surface.primitive.triangles)
    errors = angular_errors(normals, surface.exact_normals(poses))
    return np.average(errors, axis=1, weights=areas), len(areas)


def test_at_rest_it_returns_the_stored_normals_authored_ones_included() -> None:
    surface = analytic_surface(400, "random")
    for n0 in (surface.primitive.normals.astype(np.float64), authored(surface)):
        normals, valid = reference_normals(at_rest(surface, n0), surface.primitive.positions[None])
        assert valid.all()
        assert angular_errors(normals[0], n0).max() < 1e-6
        assert np.abs(np.linalg.norm(normals, axis=2) - 1.0).max() < 1e-12


@pytest.mark.parametrize("scale", [1.0, 0.01, 300.0])
def test_rigid_motion_and_uniform_scale_rotate_the_normals(scale: float) -> None:
    surface = analytic_surface(400, "random")
    n0 = authored(surface)
    moved = np.stack([scale * surface.primitive.positions @ rotation(seed).T + 2.0 for seed in range(3)])
    normals, _ = reference_normals(at_rest(surface, n0), moved)
    for seed in range(3):
        assert angular_errors(normals[seed], n0 @ rotation(seed).T).max() < 1e-6
    assert np.abs(np.linalg.norm(normals, axis=2) - 1.0).max() < 1e-12


def test_an_affine_map_acts_by_its_cofactors() -> None:
    surface = analytic_surface(400, "irregular")
    matrix = np.array([[1.0, 0.4, 0.2], [0.0, 0.3, -0.5], [0.1, 0.0, 2.0]])
    # The operator's own surface normals: for others F only extends the map by convention, off the surface.
    operator = gradient_operator([surface.primitive])
    tangents = [
        derivative_along(operator, axis) @ surface.primitive.positions
        for axis in (surface.tangents, surface.bitangents)
    ]
    n0 = np.cross(*tangents)
    normals, _ = reference_normals(at_rest(surface, n0), (surface.primitive.positions @ matrix.T)[None])
    assert angular_errors(normals[0], n0 @ np.linalg.inv(matrix)).max() < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("triangulation", "order"), [pytest.param("irregular", 1.4, marks=pytest.mark.slow), ("jittered", 1.8)]
)
def test_truth_by_tangents_converges_to_the_normals_of_the_skinned_surface(
    triangulation: Triangulation, order: float
) -> None:
    coarse, fine = ([mean_errors(count, triangulation, seed) for seed in range(3)] for count in (700, 5600))
    spacing = math.sqrt(sum(count for _, count in fine) / sum(count for _, count in coarse))
    drop = sum(error for error, _ in coarse) / sum(error for error, _ in fine)
    assert (np.log(drop) / math.log(spacing) >= order).all()
    # Under the mild bend; plain skinned normals stay at 1.7°.
    assert all(error[0] < 0.05 for error, _ in fine)


def test_poses_are_independent_of_the_blocks_they_are_computed_in(monkeypatch: pytest.MonkeyPatch) -> None:
    surface = analytic_surface(200, "irregular")
    deformed = surface.deformed(bends(np.linspace(-20.0, 40.0, 7).tolist())).astype(np.float32)
    together, _ = reference_normals(at_rest(surface), deformed)
    monkeypatch.setattr(whole_fields, "BLOCK", 3 * deformed.shape[1])
    apart, _ = reference_normals(at_rest(surface), deformed)
    assert together.shape == deformed.shape
    assert np.abs(together - apart).max() < 1e-12
    assert angular_errors(together[0], together[-1]).max() > 1.0


def test_vertices_without_a_frame_are_masked_and_nan() -> None:
    surface = analytic_surface(200, "jittered")
    n0 = surface.primitive.normals.astype(np.float64)
    n0[3], n0[5] = 0.0, np.nan
    surface.tangents[7] = surface.bitangents[7]
    surface.tangents[9] = surface.bitangents[9] + 1e-9 * surface.tangents[9]
    rest = at_rest(surface, n0)
    normals, valid = reference_normals(rest, surface.primitive.positions[None])
    assert (rest.valid == valid[0]).all()
    assert np.flatnonzero(~valid[0]).tolist() == [3, 5, 7, 9]
    assert (np.isnan(normals).all(axis=2) == ~valid).all()


def test_a_collapsed_rest_pose_has_no_reference_in_any_other() -> None:
    surface = analytic_surface(200, "jittered")
    collapsed = replace(surface.primitive, positions=surface.primitive.positions @ NEARLY_A_LINE.T)
    # The operator is that of the sound mesh: of this one, libigl would see no triangle.
    rest = rest_frames(
        gradient_operator([surface.primitive]),
        collapsed.positions,
        collapsed.normals,
        surface.tangents,
        surface.bitangents,
    )
    normals, valid = reference_normals(rest, surface.deformed(bends([MILD])))
    assert not valid.any()
    assert np.isnan(normals).all()


def test_a_pose_that_collapses_the_surface_is_masked_and_no_other() -> None:
    surface = analytic_surface(200, "jittered")
    rest = surface.primitive.positions.astype(np.float64)
    one_broken = rest.copy()
    one_broken[0, 2] = np.nan
    collapsed = [np.full_like(rest, 4.0), rest * [1.0, 0.0, 0.0], rest @ NEARLY_A_LINE.T]
    normals, valid = reference_normals(at_rest(surface), np.stack([rest, one_broken, *collapsed]))
    assert valid[0].all()
    assert not valid[1, 0]
    assert valid[1, -1]
    assert not valid[2:].any()
    assert (np.isnan(normals).all(axis=2) == ~valid).all()
