"""The truth *fine*: on surfaces whose deformed normals have a formula, and what it must return exactly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skinbake.geometry.skinned import Float64Array, SkinnedPrimitive
from skinbake.skinning.rest import Options, RestPrimitive
from skinbake.skinning.run import Skinning
from skinbake.threads import Threads
from skinbake.truth.areas import vertex_areas
from skinbake.truth.blending import BlendedPrimitive
from skinbake.truth.fine import FineMesh
from skinbake.truth.operator import gradient_operator
from skinbake.truth.truths import PosedSurface, Truths
from tests.support.triangle_truth import true_normals
from tests.support.whole_fields import angular_errors

Parameters = Float64Array
"""Two numbers in turns, (V, 2): around the surface, and along it."""

Surface = Callable[[Parameters], Float64Array]


def cylinder(at: Parameters) -> Float64Array:
    angle = 2.0 * np.pi * at[:, 0]
    return np.stack([np.cos(angle), np.sin(angle), 4.0 * at[:, 1]], axis=1)


def torus(at: Parameters) -> Float64Array:
    around, across = 2.0 * np.pi * at.T
    reach = 2.0 + 0.7 * np.cos(across)
    return np.stack([reach * np.cos(around), reach * np.sin(around), 0.7 * np.sin(across)], axis=1)


def sphere(at: Parameters) -> Float64Array:
    """A ball without its poles, where its parameters have none."""
    around, height = 2.0 * np.pi * at[:, 0], np.pi * (0.15 + 0.7 * at[:, 1])
    return np.stack(
        [np.sin(height) * np.cos(around), np.sin(height) * np.sin(around), -np.cos(height)], axis=1
    )


def weights(points: Float64Array) -> Float64Array:
    """Return the weights (V, 2) of two joints: smooth along an oblique axis."""
    second = 0.5 + 0.45 * np.sin(points @ [0.2, 0.1, 0.4])
    return np.stack([1.0 - second, second], axis=1)


BEND = np.tile(np.eye(4), (1, 2, 1, 1))
BEND[0, 1, :3, :3] = Rotation.from_rotvec([0.5, 0.6, -0.2]).as_matrix()
BEND[0, 1, :3, 3] = 0.3, -0.2, 0.4


def bent(surface: Surface, at: Parameters) -> Float64Array:
    points = surface(at)
    turned = np.einsum("jab,vb->jva", BEND[0, :, :3, :3], points) + BEND[0, :, None, :3, 3]
    return np.asarray(np.einsum("vj,jva->va", weights(points), turned))


def normals_of(placed: Callable[[Parameters], Float64Array], at: Parameters) -> Float64Array:
    """Return normals of any length, by differences in both parameters."""
    along = [(placed(at + step) - placed(at - step)) / 2e-5 for step in 1e-5 * np.eye(2)]
    return np.cross(along[0], along[1])


def mesh(surface: Surface, around: int, along: int) -> tuple[SkinnedPrimitive, Parameters]:
    """Return a grid of the surface that meets itself around, and at both ends has a border."""
    u, v = np.meshgrid(np.arange(around) / around, np.linspace(0.0, 1.0, along), indexing="ij")
    at = np.stack([u.ravel(), v.ravel()], axis=1)
    here = np.arange(around * along).reshape(around, along)
    after = np.roll(here, -1, axis=0)
    a, b, c, d = here[:, :-1], after[:, :-1], after[:, 1:], here[:, 1:]
    triangles = np.stack([a, b, c, a, c, d], axis=2).reshape(-1, 3)
    points = surface(at)
    joints = np.tile([0, 1], (len(points), 1))
    normals = normals_of(surface, at)
    return SkinnedPrimitive(points, normals, None, joints, weights(points), triangles), at


def rest_of(primitive: SkinnedPrimitive) -> RestPrimitive:
    zeros = np.zeros_like(primitive.positions)
    none = np.zeros((len(zeros), primitive.joints.shape[1] - 1))
    fields = primitive.positions, primitive.normals, zeros, zeros, primitive.joints, primitive.weights
    return RestPrimitive(*fields, none, none)


def fine_normals(
    primitive: SkinnedPrimitive, matrices: Float64Array, *, by_dqs: bool = False, before: Any = None
) -> Float64Array:
    """Return the truth *fine* (P, V, 3). before is the primitive from which morph targets made this one."""
    operator = gradient_operator([primitive if before is None else before])
    rest, poses = rest_of(primitive), slice(0, len(matrices))
    first = rest if before is None else rest_of(before)
    truths = Truths.of(operator, [first], len(matrices), fine=FineMesh.of(operator))
    if before is not None:
        truths = truths.moved([rest])
    assert truths.fine is not None
    placed = []
    for one in (rest, truths.fine.points):
        part = slice(0, len(one.positions))
        if by_dqs:
            ((skinning),) = Skinning.of_mesh([one], matrices, Options())
            placed.append(np.stack(skinning.positions(poses, part)).swapaxes(1, 2))
        else:
            placed.append(BlendedPrimitive(one, matrices, Options()).positions(poses, part))
    posed = PosedSurface.of(truths.fine.truths, np.concatenate(placed, axis=1), Threads(1))
    found = [posed.normals(block.number, None)[0][0] for block in truths.vertex_blocks]
    return np.concatenate(found, axis=1).transpose(2, 1, 0)


def mean_errors(surface: Surface, around: int, along: int) -> tuple[float, float]:
    """Return the mean errors by *fine* and by triangles on a bent surface, away from its border."""
    primitive, at = mesh(surface, around, along)
    expected = normals_of(lambda where: bent(surface, where), at)
    inside = (at[:, 1] > 0.0) & (at[:, 1] < 1.0)
    areas = np.where(inside, vertex_areas(primitive.positions, primitive.triangles), 0.0)
    found = fine_normals(primitive, BEND)[0], true_normals(primitive, bent(surface, at)[None])[0]
    one, other = (float(np.average(angular_errors(normals, expected), weights=areas)) for normals in found)
    return one, other


@pytest.mark.parametrize("surface", [cylinder, sphere, torus])
def test_on_bent_surfaces_it_is_nearer_to_the_formula_than_the_triangles_and_converges(
    surface: Surface,
) -> None:
    coarse, by_triangles = mean_errors(surface, 12, 9)
    finer, _ = mean_errors(surface, 24, 17)
    assert coarse < 0.3 * by_triangles
    assert finer < 0.4 * coarse
    assert by_triangles > 0.3


def test_with_weights_that_are_straight_only_the_rounding_of_the_mesh_is_left() -> None:
    """A prism of ten sides, its weights a linear function of the height: a sheared cylinder."""
    primitive, at = mesh(cylinder, 10, 4)
    matrices = np.tile(np.eye(4), (1, 2, 1, 1))
    matrices[0, 1, 0, 3] = 3.0
    second = at[:, 1]
    primitive = replace(primitive, weights=np.stack([1.0 - second, second], axis=1))
    angle = 2.0 * np.pi * at[:, 0]
    slope = -0.75 * np.cos(angle)
    expected = np.stack([np.cos(angle), np.sin(angle), slope], axis=1)
    inside = (at[:, 1] > 0.0) & (at[:, 1] < 1.0)
    assert angular_errors(fine_normals(primitive, matrices)[0], expected)[inside].max() < 0.2
    moved = (primitive.positions + second[:, None] * [3.0, 0.0, 0.0])[None]
    assert angular_errors(true_normals(primitive, moved)[0], expected)[inside].max() > 0.9


@pytest.mark.parametrize("by_dqs", [False, True])
def test_rigid_motions_turn_stored_normals_that_lean_too(by_dqs: bool) -> None:
    primitive, _ = mesh(torus, 12, 9)
    lean = np.random.default_rng(1).uniform(-0.4, 0.4, primitive.normals.shape)
    units = primitive.normals / np.linalg.norm(primitive.normals, axis=1, keepdims=True)
    primitive = replace(primitive, normals=units + lean)
    turn = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
    matrices = np.tile(np.eye(4), (2, 2, 1, 1))
    matrices[1, :, :3, :3], matrices[1, :, :3, 3] = turn, (1.0, 2.0, 3.0)
    found = fine_normals(primitive, matrices, by_dqs=by_dqs)
    assert angular_errors(found[0], primitive.normals).max() < 1e-4
    assert angular_errors(found[1], primitive.normals @ turn.T).max() < 1e-4


def test_axes_of_the_model_do_not_matter() -> None:
    primitive, _ = mesh(sphere, 12, 7)
    found = fine_normals(primitive, BEND)[0]
    for matrix in (np.eye(3)[[1, 2, 0]], np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]):
        turn = np.eye(4)
        turn[:3, :3] = matrix * np.linalg.det(matrix)
        around = turn[:3, :3].T
        model = replace(primitive, positions=primitive.positions @ around, normals=primitive.normals @ around)
        again = fine_normals(model, turn @ BEND @ np.linalg.inv(turn))[0]
        assert angular_errors(again, found @ around).max() < 1e-3


def test_morph_targets_act_before_the_mesh_is_rounded() -> None:
    """A ball morphed to a larger one: its fine mesh is that of the larger ball, and its normals are kept."""
    primitive, _ = mesh(sphere, 12, 7)
    larger = replace(primitive, positions=1.7 * primitive.positions)
    found = fine_normals(larger, BEND, before=primitive)
    assert angular_errors(found, fine_normals(larger, BEND)).max() < 1e-3


def test_an_edge_without_a_direction_is_straight_and_a_flat_corner_is_left_out() -> None:
    """Normals of zero, and one that lies along an edge: all other vertices keep their true normals."""
    primitive, _ = mesh(torus, 8, 6)
    normals = np.array(primitive.normals)
    normals[3] = 0.0
    normals[20] = primitive.positions[21] - primitive.positions[20]
    found = fine_normals(replace(primitive, normals=normals), BEND)[0]
    without = np.flatnonzero(~np.isfinite(found).all(axis=1))
    assert set(without) <= {3, 20}
    assert 3 in without


def test_triangles_that_share_an_edge_share_its_points() -> None:
    primitive, _ = mesh(torus, 8, 6)
    fine = FineMesh.of(gradient_operator([primitive]))
    edges = {tuple(edge) for one in primitive.triangles for edge in (one[[0, 1]], one[[1, 2]], one[[2, 0]])}
    assert len(fine.near) == len(edges | {(b, a) for a, b in edges}) == fine.size - len(primitive.positions)
    assert len(fine.triangles) == 3 * len(primitive.triangles)
