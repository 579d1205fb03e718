"""The text for normal maps: the engine's own pixels at rest, its cost, and when it is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skinbake.choices import Frame, Language, Lighting, Method
from skinbake.errors import ChoiceError
from skinbake.shaders.choices import ShaderChoices
from skinbake.skinning.counting import multiply_adds
from skinbake.skinning.rest import Algorithm
from tests.shaders.combinations import glsl
from tests.shaders.spirv_counting import Module
from tests.support import analytic, glslang, opengl
from tests.support.whole_fields import shader_text

MAPPED = ShaderChoices(Language.GLSL, Method.LBS, Lighting.ACCURATE, frame=Frame.TANGENT, normal_map=True)
TEXEL = (0.3, -0.28, 0.912)
CORNERS = 3


def unit(vectors: np.ndarray) -> np.ndarray:
    found: np.ndarray = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return found


def corners(hand: float) -> tuple[np.ndarray, np.ndarray]:
    """Normals (3, 3) that differ by 60° over each edge, and TANGENT (3, 4) at right angles to them."""
    turns = np.radians([0, 120, 240])
    ring = np.stack([np.cos(turns), np.sin(turns), np.zeros(3)], axis=1)
    lean = np.arcsin(0.5 / np.sin(np.radians(60)))
    normals = np.sin(lean) * ring + np.cos(lean) * np.array([0, 0, 1.0])
    tangents = unit(np.cross(normals, [0.2, 0.9, 0.3]))
    return normals, np.column_stack([tangents, np.full(3, hand)])


def pixels_of_the_engine(normals: np.ndarray, tangents: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Return what three.js draws: t, b and n of length 1 at the vertices, and again at the pixel."""
    bitangents = unit(np.cross(normals, tangents[:, :3])) * tangents[:, 3:]
    t, b, n = (unit(shares @ vectors) for vectors in (tangents[:, :3], bitangents, normals))
    return TEXEL[0] * t + TEXEL[1] * b + TEXEL[2] * n


@pytest.mark.parametrize("hand", [1.0, -1.0])
@pytest.mark.parametrize("frame", [Frame.TANGENT, Frame.NORMAL])
@pytest.mark.parametrize("method", [Method.LBS, Method.DQS])
def test_pixels_at_rest_are_the_engine_s_own(method: Method, frame: Frame, hand: float) -> None:
    """Between vertices, too, whose normals differ by 60°: raw vectors would be 3° off there."""
    lighting = Lighting.ACCURATE if method is Method.LBS else Lighting.EXACT
    choices = replace(MAPPED, method=method, lighting=lighting, frame=frame)
    normals, tangents = corners(hand)
    np.testing.assert_allclose(analytic.degrees_between(normals[0], normals[1:]), 60)
    at_rest = "mat4(1.0)" if method is Method.LBS else "mat2x4(vec4(0, 0, 0, 1), vec4(0))"
    kind, letter = ("mat4", "M") if method is Method.LBS else ("mat2x4", "Q")
    rest = "normal, tangent" if frame == Frame.TANGENT else "normal"
    own = "" if frame == Frame.TANGENT else ", tangent"
    shader = "\n".join(
        [
            "#version 300 es",
            "precision highp float;",
            shader_text(choices),
            "in vec3 shares;",
            "out vec3 mapped;",
            "skinbake_NormalMap at(vec3 normal, vec4 tangent) {",
            f"skinbake_Frame frame = skinbake_frame({rest});",
            f"{kind} {letter}[4] = {kind}[4]({', '.join([at_rest] * 4)});",
            f"skinbake_Vertex v = skinbake_{choices.stem}(vec3(0.3, 2.0, 1.0), frame, {letter}, vec4(0.25),",
            "vec3(3.0, 1.0, -2.0), vec3(1.0, 0.0, 4.0));",
            f"return skinbake_normal_map(v, frame{own});",
            "}",
            "void main() {",
            "vec3 n = vec3(0.0); vec4 t = vec4(0.0), b = vec4(0.0);",
            *(
                f"{{ skinbake_NormalMap m = at(vec3{tuple(normal)}, vec4{tuple(tangent)});"
                f"n += shares[{number}] * m.normal; t += shares[{number}] * m.cotangent;"
                f"b += shares[{number}] * m.cobitangent; }}"
                for number, (normal, tangent) in enumerate(
                    zip(normals.tolist(), tangents.tolist(), strict=True)
                )
            ),
            f"mapped = skinbake_mapped_normal(vec3{TEXEL}, n, t, b);",
            "gl_Position = vec4(0.0);",
            "}",
        ]
    )
    shares = np.random.default_rng(1).dirichlet(np.ones(CORNERS), 500).astype(np.float32)
    with opengl.context("es") as context:
        found = context.run(shader, [("shares", "3f")], shares, ["mapped"], 3, {}).reshape(-1, 3)
    expected = pixels_of_the_engine(normals, tangents, shares.astype(np.float64))
    assert analytic.degrees_between(found, expected).max() < 1e-3
    raw = shares @ (TEXEL[0] * tangents[:, :3] + TEXEL[2] * normals)
    raw += TEXEL[1] * shares @ (np.cross(normals, tangents[:, :3]) * hand)
    assert analytic.degrees_between(raw, expected).max() > 2


@pytest.mark.parametrize(
    ("method", "lighting"),
    [(Method.LBS, Lighting.DIRECT), (Method.LBS, Lighting.STANDARD), (Method.DQS, Lighting.STANDARD)],
)
def test_lighting_without_derivatives_has_no_normal_map(method: Method, lighting: Lighting) -> None:
    with pytest.raises(ChoiceError) as caught:
        replace(MAPPED, method=method, lighting=lighting)
    assert caught.value.option == "normal_map"


@pytest.mark.slow
@pytest.mark.parametrize("frame", [Frame.TANGENT, Frame.NORMAL])
@pytest.mark.parametrize(
    ("method", "lighting"),
    [(Method.LBS, Lighting.ACCURATE), (Method.DQS, Lighting.ACCURATE), (Method.DQS, Lighting.EXACT)],
)
def test_cotangents_cost_what_the_replay_says(method: Method, lighting: Lighting, frame: Frame) -> None:
    """In SPIR-V, at four influences: 21 by linear blending, 30 by dual quaternions."""
    pair = [
        replace(MAPPED, method=method, lighting=lighting, frame=frame, normal_map=asked)
        for asked in (False, True)
    ]
    plain, mapped = (
        Module(glslang.disassembly(glslang.spirv(glsl([one], "450")))).multiply_adds(f"skinbake_{one.stem}")
        for one in pair
    )
    algorithm = Algorithm(pair[0].algorithm)
    costs = [sum(multiply_adds(algorithm, 4, normal_map=asked).values()) for asked in (False, True)]
    assert costs[1] - costs[0] == (21 if method is Method.LBS else 30)
    assert mapped - plain == pytest.approx(costs[1] - costs[0], abs=3)
