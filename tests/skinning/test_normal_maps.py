"""Mapped normals against a relief that is displaced along n0, skinned, and differentiated numerically."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skinbake.skinning.components import PosedVertex
from skinbake.skinning.counting import multiply_adds
from skinbake.skinning.normal_maps import engine_mapped_normal, in_frame, mapped_normal
from skinbake.skinning.rest import Algorithm, RestPrimitive
from tests.support import analytic
from tests.support.analytic_rest import rest_primitive, sample, slots
from tests.support.replay import SkinnedSurface, replay

EXACT = [Algorithm.LBS_ACCURATE, Algorithm.DQS_EXACT]
ALL = [*EXACT, Algorithm.DQS_ACCURATE]
STEP = 1e-5
DEGREES = 1e-3
"""Differences with steps of 1e-5 leave 1e-4° at folds."""


def texels(count: int, degrees: float = 25.0) -> np.ndarray:
    """Normals (V, 3) of one tilt in directions all around."""
    turn, tilt = np.arange(count) * 2.4, np.radians(degrees)
    return np.stack(
        [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.full(count, np.cos(tilt))], axis=1
    )


def relief_normals(
    surface: analytic.Sample, frame: RestPrimitive, texel: np.ndarray, skinned: analytic.Skinning
) -> np.ndarray:
    """Return the unit normals (V, 3) of a skinned relief, of which the texels are the normals at rest.

    The relief is x + h n0, with h = 0 at the vertex and the slopes that tilt n0 into the texel. Its tangents
    are differences of skinned points: along u and v of the surface, each with the height of the relief there.
    """
    t, b = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (frame.tangents, frame.bitangents))
    slope = -(texel[:, :1] * t + texel[:, 1:2] * b) / texel[:, 2:]

    def at(du: float, dv: float) -> np.ndarray:
        along, around = analytic.derivatives(surface.u, surface.v)
        height = np.sum(slope * (along * du + around * dv), axis=1, keepdims=True)
        u, v = surface.u + du, surface.v + dv
        return skinned(analytic.positions(u, v) + height * surface.normals, analytic.weights(u, v))

    along, around = at(STEP, 0) - at(-STEP, 0), at(0, STEP) - at(0, -STEP)
    normal = np.cross(around, along)
    unit: np.ndarray = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    return unit


def skinning_of(algorithm: Algorithm, bend: str, joints: np.ndarray) -> analytic.Skinning:
    if algorithm.uses_dual_quaternions:
        return analytic.dual_quaternion_blend(analytic.joint_dual_quaternions(bend), joints[:, 0])
    return analytic.linear_blend(analytic.joint_matrices(bend))


def mapped(rest: RestPrimitive, skinned: SkinnedSurface, texel: np.ndarray, scale: float = 1.0) -> np.ndarray:
    """Return the mapped normals (V, 3) of the first pose; scale is that of dual quaternions."""
    assert skinned.cotangents is not None
    assert skinned.cobitangents is not None
    posed = PosedVertex(
        *(
            tuple(vectors[0].T)
            for vectors in (
                skinned.positions,
                skinned.normals,
                skinned.tangents,
                skinned.bitangents,
                skinned.cotangents,
                skinned.cobitangents,
            )
        )
    )
    length = scale * np.linalg.norm(rest.tangents, axis=1)
    return np.stack(mapped_normal(posed, length, tuple(texel.T)), axis=1)


def turned(rest: RestPrimitive, degrees: float, length: float = 1.0, hand: float = 1.0) -> RestPrimitive:
    """Return the primitive in a frame turned about n0, of another length, and mirrored if hand is −1."""
    c, s = np.cos(np.radians(degrees)) * length, np.sin(np.radians(degrees)) * length
    return replace(
        rest,
        tangents=c * rest.tangents + s * rest.bitangents,
        bitangents=hand * (c * rest.bitangents - s * rest.tangents),
        alpha=c * rest.alpha + s * rest.beta,
        beta=hand * (c * rest.beta - s * rest.alpha),
    )


@pytest.mark.parametrize("bend", analytic.BENDS)
@pytest.mark.parametrize("algorithm", EXACT)
def test_mapped_normals_are_those_of_the_relief(algorithm: Algorithm, bend: str) -> None:
    surface = sample()
    joints = slots(surface)
    rest = rest_primitive(surface, joints)
    skinned = replay(algorithm, rest, analytic.joint_matrices(bend)[None], normal_map=True)
    texel = texels(len(surface.u))
    expected = relief_normals(surface, rest, texel, skinning_of(algorithm, bend, joints))
    assert analytic.degrees_between(mapped(rest, skinned, texel), expected).max() < DEGREES


@pytest.mark.parametrize(("degrees", "length", "hand"), [(0, 1, -1), (70, 1, 1), (130, 0.4, -1), (10, 3, 1)])
@pytest.mark.parametrize("algorithm", ALL)
def test_mapped_normals_follow_a_frame_of_any_turn_length_and_hand(
    algorithm: Algorithm, degrees: float, length: float, hand: float
) -> None:
    """Algorithm 5 takes no true derivative: it is compared with itself in the plain frame."""
    surface = sample()
    joints = slots(surface)
    rest = turned(rest_primitive(surface, joints), degrees, length, hand)
    skinned = replay(algorithm, rest, analytic.joint_matrices("medium")[None], normal_map=True)
    texel = texels(len(surface.u))
    found = mapped(rest, skinned, texel)
    if algorithm in EXACT:
        expected = relief_normals(surface, rest, texel, skinning_of(algorithm, "medium", joints))
        assert analytic.degrees_between(found, expected).max() < DEGREES
    plain = rest_primitive(surface, joints)
    t, b = (v / length for v in (rest.tangents, rest.bitangents))
    at_rest = texel[:, :1] * t + texel[:, 1:2] * b + texel[:, 2:] * surface.normals
    parts = in_frame(
        tuple(at_rest.T), *(tuple(v.T) for v in (plain.tangents, plain.bitangents, plain.normals))
    )
    other = mapped(
        plain,
        replay(algorithm, plain, analytic.joint_matrices("medium")[None], normal_map=True),
        np.stack(parts, axis=1),
    )
    assert analytic.degrees_between(found, other).max() < 1e-6


@pytest.mark.parametrize("algorithm", ALL)
def test_uniform_scale_of_the_joints_leaves_mapped_normals(algorithm: Algorithm) -> None:
    surface = sample()
    rest = rest_primitive(surface)
    texel = texels(len(surface.u))
    matrices = analytic.joint_matrices("medium")[None]
    small = np.diag([0.01, 0.01, 0.01, 1.0]) @ matrices
    scale = 0.01 if algorithm.uses_dual_quaternions else 1.0
    found = mapped(rest, replay(algorithm, rest, small, normal_map=True), texel, scale)
    expected = mapped(rest, replay(algorithm, rest, matrices, normal_map=True), texel)
    assert analytic.degrees_between(found, expected).max() < 1e-6


def test_mirrored_joints_mirror_the_mapped_normals() -> None:
    """The mirror image of a relief has the mirrored normals; all three columns take the joint's sign."""
    surface = sample()
    rest = rest_primitive(surface)
    texel = texels(len(surface.u))
    matrices = analytic.joint_matrices("medium")[None]
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    found = -mapped(rest, replay(Algorithm.LBS_ACCURATE, rest, mirror @ matrices, normal_map=True), texel)
    expected = mapped(rest, replay(Algorithm.LBS_ACCURATE, rest, matrices, normal_map=True), texel)
    assert analytic.degrees_between(found, expected @ mirror[:3, :3]).max() < 1e-6


@pytest.mark.parametrize("algorithm", ALL)
def test_mapped_normals_at_rest_are_the_engine_s(algorithm: Algorithm) -> None:
    """A TANGENT that leans from n0, of any length and hand, too: what an engine draws passes through."""
    surface = sample()
    rest = rest_primitive(surface)
    count = len(surface.u)
    texel = texels(count)
    rng = np.random.default_rng(4)
    tangent = rng.normal(size=(count, 3)) + surface.normals * 0.3
    hand = rng.choice([-1.0, 1.0], count)
    drawn = engine_mapped_normal(tuple(surface.normals.T), tuple(tangent.T), hand, tuple(texel.T))
    parts = in_frame(drawn, *(tuple(v.T) for v in (rest.tangents, rest.bitangents, rest.normals)))
    skinned = replay(algorithm, rest, np.tile(np.eye(4), (1, 3, 1, 1)), normal_map=True)
    found = mapped(rest, skinned, np.stack(parts, axis=1))
    assert analytic.degrees_between(found, np.stack(drawn, axis=1)).max() < 1e-6


def test_the_engine_s_frame_loses_what_the_cofactors_keep() -> None:
    surface = sample()
    rest = rest_primitive(surface)
    texel = texels(len(surface.u))
    skinned = replay(Algorithm.LBS_ACCURATE, rest, analytic.joint_matrices("mild")[None])
    expected = relief_normals(
        surface, rest, texel, skinning_of(Algorithm.LBS_ACCURATE, "mild", slots(surface))
    )
    normal, tangent = tuple(skinned.normals[0].T), tuple(skinned.tangents[0].T)
    engine = np.stack(engine_mapped_normal(normal, tangent, np.ones(len(surface.u)), tuple(texel.T)), axis=1)
    assert analytic.degrees_between(engine, expected).mean() > 1


@pytest.mark.parametrize("influences", [1, 4, 8])
@pytest.mark.parametrize(("algorithm", "carried"), [(3, 9), (5, 18), (6, 18)])
def test_a_normal_map_adds_two_cross_products_and_the_carried_normal(
    algorithm: int, carried: int, influences: int
) -> None:
    """T n0 is a product of a matrix, 9, or a rotation, 18."""
    plain = multiply_adds(Algorithm(algorithm), influences)
    found = multiply_adds(Algorithm(algorithm), influences, normal_map=True)
    assert list(found.values()) == [*plain.values(), carried, 6, 6]
