"""A morphed and skinned analytic surface, against finite differences of the two together."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skinbake.geometry.frames import frame_from_normal
from skinbake.geometry.morphs import Differences, MorphTarget, MorphTargets
from skinbake.skinning.morphs import morphed
from skinbake.skinning.rest import Algorithm, RestPrimitive
from tests.support import analytic, morphing
from tests.support.analytic_rest import rest_primitive, sample, slots
from tests.support.replay import replay

EXACT_DEGREES = 1e-4
"""Steps of the differences, seen from the mildest to the strongest bend: they are near 1e-8."""


def errors(surface: RestPrimitive, truth: analytic.Array, bend: str, algorithm: Algorithm) -> analytic.Array:
    skinned = replay(algorithm, surface, analytic.joint_matrices(bend)[None])
    return analytic.degrees_between(skinned.normals[0], truth)


def with_image(surface: analytic.Sample, shape: analytic.Surface) -> RestPrimitive:
    """The morphed surface with the images of t0 and b0 under the morph's differential."""
    t, b = morphing.images(surface, shape, surface.tangents, surface.bitangents)
    return replace(
        rest_primitive(surface),
        positions=shape(surface.u, surface.v),
        normals=morphing.normals(surface, shape),
        tangents=t,
        bitangents=b,
    )


@pytest.mark.parametrize("bend", analytic.BENDS)
@pytest.mark.parametrize("name", morphing.DISPLACEMENTS)
def test_alpha_and_beta_of_the_rest_are_exact_under_the_differential_of_a_morph(name: str, bend: str) -> None:
    """The claim that everything here rests on: t, b are images of t0, b0; α, β are those without a morph."""
    surface = sample()
    shape = morphing.morphed_surface(morphing.DISPLACEMENTS[name], 0.7)
    truth = morphing.true_normals(surface, shape, bend)
    moved = with_image(surface, shape)
    assert errors(moved, truth, bend, Algorithm.LBS_ACCURATE).max() < EXACT_DEGREES


@pytest.mark.parametrize("name", morphing.DISPLACEMENTS)
def test_alpha_and_beta_of_the_rest_are_exact_under_morph_and_dual_quaternions(name: str) -> None:
    surface = sample()
    shape = morphing.morphed_surface(morphing.DISPLACEMENTS[name], 0.7)
    skinning = analytic.dual_quaternion_blend(analytic.joint_dual_quaternions("screw"), slots(surface)[:, 0])
    truth = analytic.skinned_normals(surface.u, surface.v, skinning, surface=shape)
    moved = with_image(surface, shape)
    assert errors(moved, truth, "screw", Algorithm.DQS_EXACT).max() < EXACT_DEGREES


# The mean error of accurate lighting against that of standard lighting, frames carried by normal and by
# tangent: the larger of two bends, measured and rounded up by a tenth. A frame that stays at rest, or is
# derived from the morphed normal anew, is over it in every row.
SHARES = {
    "bulge": (0.125, 0.172),
    "inflate": (0.192, 0.244),
    "bend": (0.493, 0.402),
    "jaw": (0.290, 0.135),
    "twist": (0.078, 0.246),
    "stretch": (0.251, 0.266),
    "mixture": (0.263, 0.252),
}


@pytest.mark.slow
@pytest.mark.parametrize("with_tangents", [False, True])
@pytest.mark.parametrize("name", morphing.DISPLACEMENTS)
def test_a_carried_frame_keeps_most_of_the_gain(name: str, with_tangents: bool) -> None:
    surface = sample()
    displacement = morphing.DISPLACEMENTS[name]
    target = morphing.target(surface, displacement, tangents=with_tangents)
    moved = morphed(rest_primitive(surface), target, np.array([1.0]))
    shape = morphing.morphed_surface(displacement, 1.0)
    assert moved.positions == pytest.approx(shape(surface.u, surface.v), abs=1e-14)
    assert moved.normals == pytest.approx(morphing.normals(surface, shape), abs=1e-12)
    for bend in ("medium", "strong"):
        truth = morphing.true_normals(surface, shape, bend)
        standard = errors(moved, truth, bend, Algorithm.LBS_STANDARD).mean()
        accurate = errors(moved, truth, bend, Algorithm.LBS_ACCURATE).mean()
        assert accurate < SHARES[name][with_tangents] * standard


def test_a_rigid_target_with_tangents_is_exact_at_every_weight_about_one_axis() -> None:
    """D = I + w (R − I): the sum of differences is the image of t0, its length included."""
    surface = sample()
    turn = Rotation.from_rotvec([0.0, 0.0, 0.9]).as_matrix()
    flat = np.stack([np.array([0.0, 0.0, 1.0])] * len(surface.u))
    # A sheet in the plane of the rotation: n stays, t and b turn within the surface. No normal can tell.
    t0, b0 = frame_from_normal(flat.astype(np.float32))
    rest = replace(
        rest_primitive(surface), normals=flat, tangents=t0.astype(float), bitangents=b0.astype(float)
    )
    arms = surface.positions @ (turn - np.eye(3)).T
    differences = Differences.of(rest.tangents @ (turn - np.eye(3)).T)
    target = MorphTargets((MorphTarget(positions=Differences.of(arms), tangents=differences),), True)
    for weight in (0.3, 0.5, 1.0):
        moved = morphed(rest, target, np.array([weight]))
        image = np.eye(3) + weight * (turn - np.eye(3))
        assert moved.positions == pytest.approx(rest.positions @ image.T, abs=1e-14)
        assert moved.tangents == pytest.approx(rest.tangents @ image.T, abs=1e-14)
        assert moved.bitangents == pytest.approx(rest.bitangents @ image.T, abs=1e-14)


def test_without_weight_the_surface_is_the_same_object() -> None:
    surface = rest_primitive(sample())
    target = morphing.target(sample(), morphing.bulge)
    assert morphed(surface, target, np.array([0.0])) is surface


@pytest.mark.parametrize("with_tangents", [False, True])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_vertices_that_no_target_moves_stay_bit_for_bit(with_tangents: bool, dtype: type) -> None:
    surface = sample()
    full = morphing.target(surface, morphing.bulge, tangents=with_tangents).targets[0]
    half = len(surface.u) // 2

    def first_half(differences: Differences) -> Differences:
        kept = differences.rows < half
        return Differences(differences.rows[kept], differences.values[kept])

    target = MorphTarget(first_half(full.positions), first_half(full.normals), first_half(full.tangents))
    rest = rest_primitive(surface)
    moved = morphed(rest, MorphTargets((target,), with_tangents), np.array([0.8]), dtype=dtype)
    # b0 is n0 × t0 anew where TANGENT morphs: of the same bits only where that was computed in the same type.
    for name in ("positions", "normals", "tangents"):
        before, after = getattr(rest, name).astype(dtype), getattr(moved, name)
        assert after.dtype == dtype
        assert np.array_equal(after[half:], before[half:]), name
        assert not np.array_equal(after[:half], before[:half]), name
    assert moved.bitangents[half:] == pytest.approx(rest.bitangents[half:], abs=1e-6)


@pytest.mark.parametrize("with_tangents", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_float32_is_float64_rounded(with_tangents: bool) -> None:
    surface = sample()
    target = morphing.target(surface, morphing.mixture, tangents=with_tangents)
    rest = rest_primitive(surface)
    narrow, wide = (morphed(rest, target, np.array([0.6]), dtype=dtype) for dtype in (np.float32, np.float64))
    for field in fields(RestPrimitive):
        expected = getattr(wide, field.name)
        if expected is not None:
            assert getattr(narrow, field.name) == pytest.approx(expected, rel=1e-5, abs=2e-6), field.name


@pytest.mark.parametrize("with_tangents", [False, True])
@pytest.mark.parametrize("mirrored", [False, True])
def test_at_the_identity_the_normals_are_those_of_the_morph(with_tangents: bool, mirrored: bool) -> None:
    surface = sample()
    rest = rest_primitive(surface)
    if mirrored:
        rest = replace(rest, bitangents=-rest.bitangents, beta=-rest.beta)
    target = morphing.target(surface, morphing.jaw, tangents=with_tangents)
    moved = morphed(rest, target, np.array([0.4]))
    assert np.array_equal(moved.handedness(), rest.handedness())
    identity = np.tile(np.eye(4), (1, 3, 1, 1))
    for algorithm in Algorithm:
        skinned = replay(algorithm, moved, identity)
        assert analytic.degrees_between(skinned.normals[0], moved.normals).max() < 1e-6
        assert skinned.positions[0] == pytest.approx(moved.positions, abs=1e-12)


@pytest.mark.parametrize("with_tangents", [False, True])
def test_direct_equals_accurate_under_a_morph(with_tangents: bool) -> None:
    """Tangents that are not of length 1 need gradients in their dual basis."""
    surface = sample()
    target = morphing.target(surface, morphing.bend, tangents=with_tangents)
    moved = morphed(rest_primitive(surface), target, np.array([0.5]))
    lengths = np.linalg.norm(moved.tangents, axis=1)
    assert (lengths.min() < 0.98) == with_tangents
    matrices = analytic.joint_matrices("medium")[None]
    direct, accurate = (
        replay(algorithm, moved, matrices).normals[0]
        for algorithm in (Algorithm.LBS_DIRECT, Algorithm.LBS_ACCURATE)
    )
    # Folds turn J⁻ᵀ n to the other side of t' × b'.
    angle = analytic.degrees_between(direct, accurate)
    assert np.minimum(angle, 180 - angle).max() < 1e-6
