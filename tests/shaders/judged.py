"""Work for a shader to run, and how near its results must be to those of the replay."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from skinbake.choices import Lighting, Method
from skinbake.shaders.choices import ShaderChoices
from tests.shaders.combinations import ATTRIBUTES, label, motion_kind
from tests.shaders.running import Single, Wide, Work
from tests.shaders.scenes import Scene, irregular, with_hidden_joint

TOLERANCE = 1e-5


ROUNDING = 4 * float(np.finfo(np.float32).eps)
"""Of a position by one joint: a sum of four rounded terms."""


def term_lengths(choices: ShaderChoices, scene: Scene) -> Wide:
    """Return the length of what position, normal, tangent and bitangent are made of: (R, 4), float64.

    Position: the farthest that one of the joints takes p. Tangents: |t'| or |T t0|, whichever is longer,
    since t' = T t0 + a correction; and ROUNDING of the positions M[s] p whose differences, times α, make the
    correction, as a multiple of TOLERANCE. Normal: t' × b' is as wrong as the product of those. J⁻ᵀ n
    (algorithm 2) is |J⁻ᵀ n| times the same product over |t' × b'|, and once more for det J, which nears 0 in
    a fold, as a multiple of |T n0| |t'| |b'|.
    """
    choices, mapped = replace(choices, normal_map=False), choices.normal_map
    posed = scene.posed(choices, np.float64)
    plain = replace(choices, lighting=Lighting.STANDARD, cap=None, mirrored_joints=False, scaled_joints=False)
    blended = scene.posed(plain, np.float64)
    own, other = (np.linalg.norm(vectors, axis=2) for vectors in (posed, blended))
    farthest, steps = _reach(scene, choices.influences)
    if choices.method is Method.BLEND:
        # The derivatives of the blend weight times how far both methods are apart.
        steps = steps + np.tile(np.abs(scene.blend[:, 1:].T), len(scene.matrices)) * 2 * farthest
    longest = np.maximum(own, other)
    corrected = choices.lighting is not Lighting.STANDARD
    tangent, bitangent = longest[:, 2:].T + corrected * ROUNDING / TOLERANCE * steps
    if not corrected:
        normal = own[:, 1]
    elif choices.lighting is Lighting.DIRECT:
        crossed = np.cross(posed[:, 2], posed[:, 3])
        determinant = np.abs(np.einsum("ri,ri->r", blended[:, 1], crossed))
        normal = own[:, 1] * tangent * bitangent * other[:, 1] / determinant
    else:
        normal = tangent * bitangent
    if mapped:
        # The terms are |b'| |T n0|, |T n0| |t'| and |t'| |b'|. All are divided by |n'|, and multiplied by it.
        turned = replace(
            choices, lighting=Lighting.STANDARD, cap=None, mirrored_joints=False, scaled_joints=False
        )
        carried = np.linalg.norm(scene.posed(turned, np.float64)[:, 1], axis=1)
        ends = np.tile(np.linalg.norm(scene.rest(choices).tangents, axis=1), len(scene.matrices))
        ends *= np.repeat(scene.scale(choices), len(scene.positions))
        tangent = bitangent = normal + ends * carried * (tangent + bitangent)
    return np.stack([np.maximum(own[:, 0], farthest), normal, tangent, bitangent], axis=1)


def _reach(scene: Scene, influences: int) -> tuple[Wide, Wide]:
    """Return the farthest that a joint takes p (R,); Σ |α| and Σ |β| times how far joints reach (2, R)."""
    matrices = scene.matrices.astype(np.float64)
    moved = np.einsum("pjik,vk->pvji", matrices[:, :, :3, :3], scene.positions) + matrices[:, None, :, :3, 3]
    used = scene.joints[None, :, :influences]
    taken = np.take_along_axis(np.linalg.norm(moved, axis=3), used, axis=2)
    # A position is summed up from terms that may be as long as the joint's translation.
    sizes = taken + np.linalg.norm(matrices[:, :, :3, 3], axis=2)[:, used[0]]
    both = (sizes + sizes[:, :, :1])[:, :, 1:]
    steps = [np.abs(slots[None, :, : influences - 1]) * both for slots in (scene.alpha, scene.beta)]
    return taken.max(axis=2).ravel(), np.stack([step.sum(axis=2).ravel() for step in steps])


def assert_like_the_replay(choices: ShaderChoices, scene: Scene, found: Single) -> None:
    lengths = np.maximum(term_lengths(choices, scene), 1e-9)  # a joint of scale 0 gives vectors without any
    assert found.shape[0] == len(lengths)
    for dtype in (np.float32, np.float64):
        apart = np.linalg.norm(found - scene.posed(choices, dtype), axis=2) / lengths
        # Written so that NaN fails.
        wrong = ~(apart <= TOLERANCE)
        worst = dict(zip(ATTRIBUTES, np.nanmax(apart, axis=0), strict=True))
        assert not wrong.any(), f"{label(choices)}: {wrong.sum(axis=0)} rows differ by up to {worst}"


def irregular_work(every: Mapping[str, ShaderChoices]) -> Work:
    found = {}
    for name, choices in every.items():
        scene = irregular(choices.influences, stretches=motion_kind(choices) != "dqs")
        if choices.method is Method.BLEND and not choices.scaled_joints:
            scene = replace(scene, matrices=scene.matrices[:2])  # the third pose has another scale
        if choices.scaled_joints or (choices.method is Method.LBS and choices.normal_map):
            scene = with_hidden_joint(scene)
        found[name] = choices, scene
    return found
