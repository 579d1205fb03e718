"""Morph targets with numbers of their differential, skinned: against finite differences."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from skinbake.geometry.morphs import Differences, MorphTarget, MorphTargets
from skinbake.skinning.morphs import morphed
from skinbake.skinning.rest import Algorithm, RestPrimitive
from tests.support import analytic, morphing
from tests.support.analytic import Array
from tests.support.replay import replay

WEIGHTS = np.array([0.4, 0.7])
PAIRS = [("bulge", "jaw"), ("bend", "stretch"), ("twist", "inflate"), ("jaw", "bend")]


def rest_of(points: analytic.Sample) -> RestPrimitive:
    return RestPrimitive(
        positions=points.positions,
        normals=points.normals,
        tangents=points.tangents,
        bitangents=points.bitangents,
        joints=np.tile(np.arange(3), (len(points.u), 1)),
        weights=points.weights,
        alpha=points.alpha,
        beta=points.beta,
    )


def turned_frames(points: analytic.Sample, mirrored: bool) -> analytic.Sample:
    """The same points with t0 turned about n0 by an angle of each, and longer; b0 may change sides."""
    angles = np.linspace(0, 6, len(points.u))[:, None]
    tangents = 1.5 * (np.cos(angles) * points.tangents + np.sin(angles) * points.bitangents)
    side = -1.0 if mirrored else 1.0
    return replace(points, tangents=tangents, bitangents=side * np.cross(points.normals, tangents))


def target(points: analytic.Sample, displacement: morphing.Displacement) -> MorphTarget:
    """One target with all that a file can hold of it. The differential is that of finite differences."""
    frame = np.stack([points.tangents, points.bitangents, points.normals], axis=2)
    shape = morphing.morphed_surface(displacement, 1.0)
    images = morphing.images(points, shape, points.tangents, points.bitangents)
    parts = [
        np.linalg.solve(frame, (image - vector)[:, :, None])[:, :, 0]
        for image, vector in zip(images, (points.tangents, points.bitangents), strict=True)
    ]
    return MorphTarget(
        Differences.of(displacement(points.u, points.v)),
        Differences.of(morphing.normals(points, shape) - points.normals),
        in_plane=Differences.of(np.concatenate([parts[0][:, :2], parts[1][:, :2]], axis=1)),
        upward=Differences.of(np.stack([parts[0][:, 2], parts[1][:, 2]], axis=1)),
    )


def mixed_surface(names: tuple[str, str]) -> analytic.Surface:
    def surface(u: Array, v: Array) -> Array:
        moved = analytic.positions(u, v)
        for weight, name in zip(WEIGHTS, names, strict=True):
            moved = moved + weight * morphing.DISPLACEMENTS[name](u, v)
        return moved

    return surface


def lit(
    points: analytic.Sample, names: tuple[str, str], numbers: int, bend: str, algorithm: Algorithm
) -> Array:
    """The degrees between replayed normals and finite differences, under both targets, then skinned."""
    targets = MorphTargets(
        tuple(target(points, morphing.DISPLACEMENTS[name]) for name in names), numbers=numbers
    )
    moved = morphed(rest_of(points), targets, WEIGHTS)
    found = replay(algorithm, moved, analytic.joint_matrices(bend)[None]).normals[0]
    truth = morphing.true_normals(points, mixed_surface(names), bend)
    return analytic.degrees_between(found, truth)


def points() -> analytic.Sample:
    return analytic.sample(*analytic.grid(24, 16, jitter=0.3, seed=3))


@pytest.mark.slow
@pytest.mark.parametrize("names", PAIRS)
@pytest.mark.parametrize("bend", ["medium", "screw"])
@pytest.mark.parametrize("mirrored", [False, True])
def test_six_numbers_are_exact_under_two_targets_at_weights_between(
    names: tuple[str, str], bend: str, mirrored: bool
) -> None:
    turned = turned_frames(points(), mirrored)
    assert lit(turned, names, 6, bend, Algorithm.LBS_ACCURATE).max() < 1e-4
    # Where the pose turns the surface inside out, algorithm 2 divides by a negative determinant.
    direct = lit(turned, names, 6, bend, Algorithm.LBS_DIRECT)
    assert np.minimum(direct, 180 - direct).max() < 1e-4


def carried(points: analytic.Sample, surface: analytic.Surface, normals: Array, bend: str) -> Array:
    """cof(F) n of normals on the morphed surface: F takes its tangents to the skinned ones."""
    skinning = analytic.linear_blend(analytic.joint_matrices(bend))

    def skinned(u: Array, v: Array) -> Array:
        return skinning(surface(u, v), analytic.weights(u, v))

    frames, areas = [], []
    for shape in (surface, skinned):
        along, around = analytic.differences(points.u, points.v, shape)
        across = np.cross(along, around)
        areas.append(np.linalg.norm(across, axis=1))
        unit_across = across / np.sqrt(areas[0] * areas[-1])[:, None]
        frames.append(np.stack([along, around, unit_across], axis=2))
    f = frames[1] @ np.linalg.inv(frames[0])
    cofactors = np.linalg.det(f)[:, None, None] * np.swapaxes(np.linalg.inv(f), 1, 2)
    found: Array = np.einsum("vij,vj->vi", cofactors, normals)
    return found


def summed_normals(points: analytic.Sample, names: tuple[str, str]) -> Array:
    """NORMAL as a file has it under both targets: that of rest, and their differences at weight 1."""
    total = points.normals.copy()
    for weight, name in zip(WEIGHTS, names, strict=True):
        shape = morphing.morphed_surface(morphing.DISPLACEMENTS[name], 1.0)
        total += weight * (morphing.normals(points, shape) - points.normals)
    return morphing.unit(total)


@pytest.mark.slow
def test_four_numbers_err_as_normal_itself_does_between_weights() -> None:
    """Their error is that of the sum of NORMAL, carried by the exact map: in the mean over targets and bends.

    The rule by normal is worse in nearly all cases.
    """
    sample = points()
    more, better = [], []
    for names, bend in itertools.product(PAIRS, ("mild", "medium")):
        surface = mixed_surface(names)
        truth = morphing.true_normals(sample, surface, bend)
        own = analytic.degrees_between(carried(sample, surface, summed_normals(sample, names), bend), truth)
        found = lit(sample, names, 4, bend, Algorithm.LBS_ACCURATE).mean()
        more.append(found - own.mean())
        better.append(lit(sample, names, 0, bend, Algorithm.LBS_ACCURATE).mean() - found)
    assert np.mean(more) < 0.1
    assert sum(one < 0.1 for one in more) >= 7
    assert np.mean(better) > 0.5


def test_normals_by_four_numbers_stay_on_the_side_of_normal_with_the_handedness_of_rest() -> None:
    """A shader has no other handedness. Between weights NORMAL and the numbers may contradict each other."""
    sample = points()
    target = morphing.target(sample, morphing.bulge).targets[0]
    turned_over = target._replace(in_plane=Differences.of(np.tile([-1.6, 0.0, 0.0, 0.0], (len(sample.u), 1))))
    moved = morphed(rest_of(sample), MorphTargets((turned_over,), numbers=4), np.ones(1))
    np.testing.assert_array_equal(moved.handedness(), rest_of(sample).handedness())
    rule = morphed(rest_of(sample), MorphTargets((target,)), np.ones(1))
    np.testing.assert_array_equal(moved.tangents, rule.tangents)
    np.testing.assert_array_equal(moved.bitangents, rule.bitangents)


def test_four_numbers_are_exact_where_normal_is() -> None:
    sample = points()
    surface = morphing.morphed_surface(morphing.bulge, 1.0)
    moved = morphed(rest_of(sample), MorphTargets((target(sample, morphing.bulge),), numbers=4), np.ones(1))
    found = replay(Algorithm.LBS_ACCURATE, moved, analytic.joint_matrices("medium")[None]).normals[0]
    truth = morphing.true_normals(sample, surface, "medium")
    assert analytic.degrees_between(found, truth).max() < 1e-4


def test_at_weights_of_zero_nothing_changes_and_where_nothing_moves_the_frame_stays() -> None:
    sample = points()
    one = target(sample, morphing.bulge)
    rest = rest_of(sample)
    assert morphed(rest, MorphTargets((one,), numbers=6), np.zeros(1)) is rest
    still = MorphTarget(*(Differences(one.positions.rows[:0], one.positions.values[:0]),) * 3)
    moved = morphed(rest, MorphTargets((still,), numbers=6), np.ones(1))
    assert np.array_equal(moved.normals, rest.normals)
    assert np.array_equal(moved.tangents, rest.tangents)
