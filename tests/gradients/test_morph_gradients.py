"""The differential of morph targets on meshes of analytic surfaces, against finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from skinbake.geometry.morphs import Differences
from skinbake.geometry.skinned import BoolArray, IntArray
from skinbake.gradients.morph_gradients import MorphSurface
from tests.support import analytic, morphing
from tests.support.characters import angles


def tube_mesh(rows: int) -> tuple[analytic.Sample, IntArray, IntArray, BoolArray]:
    """The analytic tube as a mesh: samples, triangles, weld classes (its seam is welded), inner vertices."""
    columns = 2 * rows
    u, v = np.meshgrid(np.linspace(0.2, 2.8, rows), np.linspace(0, 2 * np.pi, columns + 1), indexing="ij")
    numbers = np.arange(u.size).reshape(u.shape)
    a, b, c, d = numbers[:-1, :-1], numbers[1:, :-1], numbers[1:, 1:], numbers[:-1, 1:]
    triangles = np.concatenate(
        [np.stack([a, d, b], -1).reshape(-1, 3), np.stack([b, d, c], -1).reshape(-1, 3)]
    )
    classes = numbers.copy()
    classes[:, -1] = classes[:, 0]
    _, classes = np.unique(classes.ravel(), return_inverse=True)
    inner = np.zeros(u.shape, dtype=np.bool_)
    inner[1:-1] = True
    return analytic.sample(u.ravel(), v.ravel()), triangles, classes, inner.ravel()


def surface_of(sample: analytic.Sample, triangles: IntArray, classes: IntArray) -> MorphSurface:
    return MorphSurface.of(
        sample.positions,
        triangles,
        classes,
        sample.normals,
        (sample.tangents, sample.bitangents),
        weighting="max",
    )


@pytest.mark.parametrize("name", ["bulge", "inflate", "bend", "jaw", "twist", "stretch"])
def test_normals_of_a_target_come_near_those_of_the_morphed_surface(name: str) -> None:
    """A mesh of twice the vertices each way is at least 2.5 times nearer: the rest is its coarseness."""
    errors, turns = [], []
    for rows in (24, 48):
        sample, triangles, classes, inner = tube_mesh(rows)
        displacement = morphing.DISPLACEMENTS[name]
        surface = surface_of(sample, triangles, classes)
        change = surface.differential(Differences.of(displacement(sample.u, sample.v)))
        found = sample.normals.copy()
        found[change.rows] = surface.normals_at(change)
        truth = morphing.normals(sample, morphing.morphed_surface(displacement, 1.0))
        errors.append(angles(found[inner], truth[inner]).mean())
        turns.append(angles(sample.normals[inner], truth[inner]).mean())
    assert errors[1] < 0.2
    assert errors[1] < errors[0] / 2.5
    assert errors[0] < turns[0] / 10


@pytest.mark.parametrize("name", ["bulge", "inflate", "bend", "jaw", "twist", "stretch"])
def test_derivatives_along_the_frame_come_near_those_of_the_displacement(name: str) -> None:
    sample, triangles, classes, inner = tube_mesh(48)
    displacement = morphing.DISPLACEMENTS[name]
    change = surface_of(sample, triangles, classes).differential(
        Differences.of(displacement(sample.u, sample.v))
    )
    images = morphing.images(
        sample, morphing.morphed_surface(displacement, 1.0), sample.tangents, sample.bitangents
    )
    rest = sample.tangents, sample.bitangents
    for found, image, vector in zip((change.along_t, change.along_b), images, rest, strict=True):
        dense = np.zeros_like(vector)
        dense[change.rows] = found
        error = np.linalg.norm(dense - (image - vector), axis=1)[inner]
        assert error.mean() < 0.01


def test_a_rigid_turn_turns_normals_that_lean_from_their_triangles_too() -> None:
    sample, triangles, classes, _ = tube_mesh(12)
    leaning = sample.normals + 0.4 * sample.tangents
    surface = MorphSurface.of(
        sample.positions, triangles, classes, leaning, (sample.tangents, sample.bitangents), weighting="max"
    )
    cosine, sine = np.cos(1.1), np.sin(1.1)
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    change = surface.differential(Differences.of(sample.positions @ turn.T - sample.positions))
    expected = morphing.unit(leaning) @ turn.T
    assert angles(surface.normals_at(change), expected[change.rows]).max() < 1e-5


def test_vertices_around_what_moves_turn_and_no_others() -> None:
    sample, triangles, classes, _ = tube_mesh(12)
    moved = np.zeros((len(sample.u), 3))
    moved[100] = [0.1, 0.2, 0.0]
    change = surface_of(sample, triangles, classes).differential(Differences.of(moved))
    near = np.unique(triangles[(triangles == 100).any(axis=1)])
    assert set(change.rows) == set(np.flatnonzero(np.isin(classes, classes[near])))


def test_a_target_that_flattens_the_surface_leaves_its_normals() -> None:
    sample, triangles, classes, _ = tube_mesh(12)
    surface = surface_of(sample, triangles, classes)
    change = surface.differential(Differences.of(-sample.positions))
    assert surface.normals_at(change) == pytest.approx(sample.normals[change.rows], abs=1e-12)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_six_numbers_are_the_parts_of_the_derivatives_along_the_frame(side: float) -> None:
    sample, triangles, classes, _ = tube_mesh(12)
    frame = 2.5 * sample.tangents, side * 2.5 * sample.bitangents
    surface = MorphSurface.of(sample.positions, triangles, classes, sample.normals, frame, weighting="max")
    change = surface.differential(Differences.of(morphing.twist(sample.u, sample.v)))
    numbers = surface.numbers_of(change)
    t0, b0, n0 = (vectors[change.rows] for vectors in (*frame, sample.normals))
    along_t = t0 * numbers[:, :1] + b0 * numbers[:, 1:2] + n0 * numbers[:, 4:5]
    along_b = t0 * numbers[:, 2:3] + b0 * numbers[:, 3:4] + n0 * numbers[:, 5:]
    assert along_t == pytest.approx(change.along_t, abs=1e-12)
    assert along_b == pytest.approx(change.along_b, abs=1e-12)
