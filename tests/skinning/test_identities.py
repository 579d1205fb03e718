"""Results that must not depend on the storage of a surface, and results that two algorithms share."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from skinbake.geometry.dual_quaternions import RigidMotions, rigid_motions
from skinbake.skinning import run
from skinbake.skinning.rest import Algorithm, Options, RestPrimitive
from skinbake.skinning.run import Skinning
from tests.support import analytic
from tests.support import replay as replaying
from tests.support.analytic_rest import poses, rest_primitive, sample, slots
from tests.support.replay import SkinnedSurface, replay

ACCURATE = [Algorithm.LBS_ACCURATE, Algorithm.DQS_ACCURATE, Algorithm.DQS_EXACT]
DUAL_QUATERNIONS = [Algorithm.DQS_STANDARD, Algorithm.DQS_ACCURATE, Algorithm.DQS_EXACT]
FIELDS = ("positions", "normals", "tangents", "bitangents")


def assert_same(found: SkinnedSurface, expected: SkinnedSurface, *, atol: float = 1e-12) -> None:
    for field in FIELDS:
        np.testing.assert_allclose(getattr(found, field), getattr(expected, field), atol=atol, err_msg=field)


def unit(vectors: np.ndarray) -> np.ndarray:
    directions: analytic.Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return directions


def test_algorithm_3_equals_algorithm_2() -> None:
    rest = rest_primitive(sample())
    accurate = replay(Algorithm.LBS_ACCURATE, rest, poses())
    direct = replay(Algorithm.LBS_DIRECT, rest, poses())
    for field in ("positions", "tangents", "bitangents"):
        np.testing.assert_allclose(getattr(accurate, field), getattr(direct, field), atol=1e-9)
    # In a fold the inverse transpose points the other way; test_against_differences pins where.
    side = np.sign(np.sum(accurate.normals * direct.normals, axis=-1, keepdims=True))
    np.testing.assert_allclose(unit(accurate.normals), side * unit(direct.normals), atol=1e-9)
    assert (side[:2] == 1).all()


def test_algorithm_2_takes_given_gradients_over_rebuilt_ones() -> None:
    surface = sample()
    rest = rest_primitive(surface)
    given = np.take_along_axis(surface.gradients, rest.joints[:, :, None], axis=1)
    assert_same(
        replay(Algorithm.LBS_DIRECT, replace(rest, gradients=given), poses()),
        replay(Algorithm.LBS_DIRECT, rest, poses()),
    )
    none = replay(Algorithm.LBS_DIRECT, replace(rest, gradients=np.zeros_like(given)), poses())
    standard = replay(Algorithm.LBS_STANDARD, rest, poses())
    np.testing.assert_allclose(none.tangents, standard.tangents, atol=1e-13)


@pytest.mark.parametrize("algorithm", Algorithm)
def test_a_single_joint_moves_the_frame_rigidly(algorithm: Algorithm) -> None:
    surface = sample()
    matrix = analytic.joint_matrices("strong")[2]
    rest = replace(
        rest_primitive(surface),
        joints=np.zeros((len(surface.u), 1), dtype=np.uint8),
        weights=np.ones((len(surface.u), 1)),
        alpha=np.zeros((len(surface.u), 0)),
        beta=np.zeros((len(surface.u), 0)),
    )
    skinned = replay(algorithm, rest, matrix[None, None])
    np.testing.assert_allclose(
        skinned.positions[0], surface.positions @ matrix[:3, :3].T + matrix[:3, 3], atol=1e-13
    )
    for name in ("normals", "tangents", "bitangents"):
        expected = getattr(surface, name) @ matrix[:3, :3].T
        np.testing.assert_allclose(getattr(skinned, name)[0], expected, atol=1e-13, err_msg=name)


@pytest.mark.parametrize("algorithm", Algorithm)
def test_eight_influences_say_the_same_as_three(algorithm: Algorithm) -> None:
    """Slots 3–5 halve those of slots 0–2, slot 6 and 7 are empty and point at joint 0."""
    rest = rest_primitive(sample())
    gradients = rest.weight_gradients()
    halved = np.concatenate([gradients / 2, gradients / 2, np.zeros_like(gradients[:, :2])], axis=1)
    eight = RestPrimitive(
        rest.positions,
        rest.normals,
        rest.tangents,
        rest.bitangents,
        np.concatenate([rest.joints, rest.joints, np.zeros_like(rest.joints[:, :2])], axis=1),
        np.concatenate([rest.weights / 2, rest.weights / 2, np.zeros_like(rest.weights[:, :2])], axis=1),
        np.einsum("vki,vi->vk", halved, rest.tangents)[:, 1:],
        np.einsum("vki,vi->vk", halved, rest.bitangents)[:, 1:],
    )
    assert_same(replay(algorithm, eight, poses()[:2]), replay(algorithm, rest, poses()[:2]), atol=1e-11)


@pytest.mark.parametrize("algorithm", Algorithm)
def test_the_order_of_slots_does_not_matter(algorithm: Algorithm) -> None:
    """For dual quaternions as long as all joints share a hemisphere, which they do in the mild bend."""
    surface = sample()
    mild = poses()[:1]
    by_joint = rest_primitive(surface, slots(surface, heaviest_first=False))
    assert_same(
        replay(algorithm, rest_primitive(surface), mild), replay(algorithm, by_joint, mild), atol=1e-11
    )


@pytest.mark.parametrize("algorithm", DUAL_QUATERNIONS)
def test_a_dual_quaternion_and_its_negative_are_the_same_motion(
    algorithm: Algorithm, monkeypatch: pytest.MonkeyPatch
) -> None:
    rest = rest_primitive(sample())
    expected = replay(algorithm, rest, poses())
    for joint in range(3):

        def negated(*args: Any, joint: int = joint, **options: Any) -> RigidMotions:
            motions = rigid_motions(*args, **options)
            motions.dual_quaternions[:, joint] *= -1
            return motions

        monkeypatch.setattr(run, "rigid_motions", negated)
        assert_same(replay(algorithm, rest, poses()), expected)


@pytest.mark.parametrize("algorithm", Algorithm)
def test_mirrored_tangents_light_alike(algorithm: Algorithm) -> None:
    rest = rest_primitive(sample())
    mirrored = replace(rest, bitangents=-rest.bitangents, beta=-rest.beta)
    expected = replay(algorithm, rest, poses())
    found = replay(algorithm, mirrored, poses())
    np.testing.assert_array_equal(mirrored.handedness(), -rest.handedness())
    np.testing.assert_allclose(found.normals, expected.normals, atol=1e-11)
    np.testing.assert_allclose(found.bitangents, -expected.bitangents, atol=1e-11)


@pytest.mark.parametrize("algorithm", Algorithm)
def test_a_uniform_scale_of_all_joints_scales_positions_and_turns_nothing(algorithm: Algorithm) -> None:
    rest = rest_primitive(sample())
    scaled = poses()
    scaled[:, :, :3] *= 0.01
    scaled[1, :, :3] *= 3
    expected = replay(algorithm, rest, poses())
    found = replay(algorithm, rest, scaled)
    factor = np.array([0.01, 0.03, 0.01, 0.01])[:, None, None]
    np.testing.assert_allclose(found.positions, factor * expected.positions, atol=1e-13)
    np.testing.assert_allclose(found.tangents, factor * expected.tangents, atol=1e-12)
    np.testing.assert_allclose(unit(found.normals), unit(expected.normals), atol=1e-9)


@pytest.mark.parametrize("algorithm", ACCURATE)
def test_scaling_the_mesh_scales_alpha_the_other_way(algorithm: Algorithm) -> None:
    rest = rest_primitive(sample())
    grown = replace(rest, positions=100 * rest.positions, alpha=rest.alpha / 100, beta=rest.beta / 100)
    matrices = poses()
    matrices[..., :3, 3] *= 100
    expected = replay(algorithm, rest, poses())
    found = replay(algorithm, grown, matrices)
    np.testing.assert_allclose(found.positions, 100 * expected.positions, atol=1e-10)
    np.testing.assert_allclose(found.normals, expected.normals, atol=1e-10)


@pytest.mark.parametrize("algorithm", Algorithm)
def test_float32_is_float64_rounded(algorithm: Algorithm) -> None:
    """Roundings of 6e-8 on values of a few units, some hundred of them in a row: 1e-4 bounds them."""
    rest = rest_primitive(sample())
    wide = replay(algorithm, rest, poses()[:2])
    narrow = replay(algorithm, rest, poses()[:2], dtype=np.float32)
    for field in FIELDS:
        assert getattr(narrow, field).dtype == np.float32
        np.testing.assert_allclose(getattr(narrow, field), getattr(wide, field), atol=1e-4)
    assert analytic.degrees_between(narrow.normals, wide.normals).max() < 0.01


@pytest.mark.parametrize("algorithm", Algorithm)
@pytest.mark.parametrize("cap", [None, 0.9])
def test_float32_is_never_widened_on_the_way(algorithm: Algorithm, cap: float | None) -> None:
    """A replay in float32 stands for what a shader computes."""
    rest, matrices = rest_primitive(sample()), poses()
    skinning = Skinning.of(
        rest,
        matrices,
        dual_quaternions=algorithm.uses_dual_quaternions,
        dtype=np.float32,
        options=Options(cap),
    )
    (vertex,) = skinning.run((algorithm,), slice(0, len(matrices)), slice(0, len(rest.positions)))
    vectors = vertex.position, vertex.normal, vertex.tangent, vertex.bitangent
    assert {component.dtype for vector in vectors for component in vector} == {np.dtype(np.float32)}


@pytest.mark.slow
@pytest.mark.parametrize("size", [8, 64, 8 * 1000, 1 << 20])
@pytest.mark.parametrize("algorithm", [Algorithm.LBS_ACCURATE, Algorithm.DQS_EXACT])
def test_the_size_of_a_block_changes_nothing(
    algorithm: Algorithm, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """480 vertices and 4 poses: single numbers, a part of a pose, two poses, everything at once."""
    rest = rest_primitive(sample())
    expected = replay(algorithm, rest, poses())
    monkeypatch.setattr(replaying, "BLOCK_BYTES", size)
    assert_same(replay(algorithm, rest, poses()), expected, atol=0)


def test_a_joint_without_weight_may_be_anything() -> None:
    """Padding slots often point at a root that is scaled."""
    rest = rest_primitive(sample())
    padded = replace(
        rest,
        joints=np.concatenate([rest.joints, np.full((len(rest.joints), 1), 3)], axis=1),
        weights=np.pad(rest.weights, ((0, 0), (0, 1))),
        alpha=np.pad(rest.alpha, ((0, 0), (0, 1))),
        beta=np.pad(rest.beta, ((0, 0), (0, 1))),
    )
    matrices = np.concatenate([poses(), np.tile(np.diag([5.0, 0.0, -1.0, 1.0]), (4, 1, 1, 1))], axis=1)
    assert_same(replay(Algorithm.DQS_EXACT, padded, matrices), replay(Algorithm.DQS_EXACT, rest, poses()))


def test_an_adopted_joint_without_weight_counts_by_its_derivative() -> None:
    rest = rest_primitive(sample(), slots(sample(), heaviest_first=False))
    weightless = replace(rest, weights=np.tile([1.0, 0.0, 0.0], (len(rest.weights), 1)))
    assert weightless.joints_in_use(4).tolist() == [True, True, True, False]
    pivot = replace(rest, weights=np.tile([0.0, 1.0, 0.0], (len(rest.weights), 1)))
    assert pivot.joints_in_use(4).tolist() == [True, True, True, False]
    flat = replace(weightless, alpha=np.zeros_like(rest.alpha), beta=np.zeros_like(rest.beta))
    assert flat.joints_in_use(4).tolist() == [True, False, False, False]
    flat.alpha[0, 0] = 1.0
    flat.joints[1, 0] = 3
    flat.weights[1] = 0.0
    # Vertex 1 has neither: its joints are not used, although vertex 0 has a derivative.
    assert flat.joints_in_use(4).tolist() == [True, True, False, False]


@pytest.mark.parametrize("algorithm", Algorithm)
def test_vertices_without_weight_stay_finite(algorithm: Algorithm) -> None:
    rest = rest_primitive(sample())
    empty = replace(rest, weights=np.zeros_like(rest.weights))
    skinned = replay(algorithm, empty, poses())
    assert all(np.isfinite(getattr(skinned, field)).all() for field in FIELDS)
    if algorithm.uses_dual_quaternions:
        expected = np.broadcast_to(rest.positions, skinned.positions.shape)
        np.testing.assert_allclose(skinned.positions, expected, atol=1e-13)


def test_a_flat_frame_counts_as_right_handed() -> None:
    rest = rest_primitive(sample())
    flat = replace(rest, bitangents=rest.tangents)
    assert (flat.handedness() == 1).all()


def test_no_poses_and_no_vertices_are_no_error() -> None:
    rest = rest_primitive(sample())
    assert replay(Algorithm.DQS_EXACT, rest, poses()[:0]).normals.shape == (0, len(rest.positions), 3)
    nothing = RestPrimitive(
        *(
            getattr(rest, name)[:0]
            for name in (
                "positions",
                "normals",
                "tangents",
                "bitangents",
                "joints",
                "weights",
                "alpha",
                "beta",
            )
        )
    )
    assert replay(Algorithm.LBS_ACCURATE, nothing, poses()).normals.shape == (4, 0, 3)
