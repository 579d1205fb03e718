"""The texts cost what ``skinbake cost`` says: their SPIR-V, counted, against the replay's count."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import pytest

from skinbake.choices import Frame, Language, Lighting, Method
from skinbake.shaders.choices import ShaderChoices
from skinbake.skinning.counting import multiply_adds
from skinbake.skinning.rest import Algorithm
from tests.shaders.combinations import FRAMES, INFLUENCES, combinations, glsl
from tests.shaders.spirv_counting import Module
from tests.support import glslang
from tests.support.whole_fields import shader_text

SHARE = 0.10


@cache
def counted(influences: int, frame: str) -> dict[int, int]:
    """Multiply-adds of the skinning function of each algorithm; building the frame and ∇w is not counted.

    Nor does the replay count those: bake's frame is the surface's, not the algorithm's.
    """
    several = [
        choices
        for choices in combinations(Language.GLSL)
        if (choices.influences, choices.frame) == (influences, frame)
    ]
    module = Module(glslang.disassembly(glslang.spirv(glsl(several, "450"))))
    return {choices.algorithm: module.multiply_adds(f"skinbake_{choices.stem}") for choices in several}


def table(frame: str) -> str:
    rows = ["algorithm: text/replay for N = 1 … 8"]
    for algorithm in Algorithm:
        pairs = [
            f"{counted(count, frame)[algorithm]}/{sum(multiply_adds(algorithm, count).values())}"
            for count in INFLUENCES
        ]
        rows.append(f"{int(algorithm)}: {'  '.join(pairs)}")
    return "\n".join(rows)


@pytest.mark.slow
@pytest.mark.parametrize(
    "frame", [FRAMES[0], *(pytest.param(frame, marks=pytest.mark.slow) for frame in FRAMES[1:])]
)
def test_costs_are_those_of_the_replay(frame: str) -> None:
    """Within a tenth; with one influence the mix is constant, and 5 and 6 leave out what comes to nothing."""
    for algorithm in Algorithm:
        for influences in INFLUENCES:
            found = counted(influences, frame)[algorithm]
            expected = sum(multiply_adds(algorithm, influences).values())
            assert found <= (1 + SHARE) * expected, table(frame)
            if influences > 1 or algorithm < Algorithm.DQS_ACCURATE:
                assert found >= (1 - SHARE) * expected, table(frame)


ON_GPU = {
    ("lbs_standard", "normal"): 69,
    ("lbs_standard", "normal tangent"): 78,
    ("lbs_standard", "normal tangent bitangent"): 96,
    ("lbs_accurate", "normal"): 144,
    ("lbs_accurate", "normal tangent bitangent"): 144,
}
"""The multiply-adds of docs/shaders.md: what is left for these outputs, beside the position.

The bitangent at rest is built from TANGENT, for 9, where an output needs it. The handedness is a number here.
"""


def on_gpu(stem: str, outputs: Sequence[str]) -> int:
    """Count what a compiler leaves of an algorithm with four influences, a frame of TANGENT, and outputs."""
    (choices,) = [
        choices
        for choices in combinations(Language.GLSL)
        if (choices.stem, choices.influences, choices.frame) == (stem, 4, Frame.TANGENT)
    ]
    gradients = ", alpha, beta" if choices.is_corrected else ""
    shader = [
        "#version 450",
        shader_text(choices),
        "in vec3 position, normal, alpha, beta; in vec4 tangent, weights;",
        "uniform Matrices { mat4 matrices[4]; };",
        *(f"out vec3 posed_{name};" for name in ("position", *outputs)),
        "void main() {",
        "mat4 M[4] = mat4[4](matrices[0], matrices[1], matrices[2], matrices[3]);",
        "skinbake_Frame frame = skinbake_frame(normal, tangent);",
        f"skinbake_Vertex v = skinbake_{stem}(position, frame, M, weights{gradients});",
        *(f"posed_{name} = v.{name};" for name in ("position", *outputs)),
        "}",
    ]
    module = glslang.optimised(glslang.spirv("\n".join(shader)))
    return Module(glslang.disassembly(module)).multiply_adds("main")


@pytest.mark.slow
@pytest.mark.parametrize(("stem", "outputs"), ON_GPU)
def test_a_gpu_runs_what_the_outputs_need(stem: str, outputs: str) -> None:
    assert on_gpu(stem, outputs.split()) == ON_GPU[stem, outputs]


EXPRESSIONS = {
    "a": 0,
    "-a": 0,
    "a + b": 3,
    "s * a": 3,
    "a * b": 3,
    "s * a + b": 3,
    "a - s * b": 3,
    "s * a + s * b": 6,
    "s * a + b + c": 6,
    "s * a + (b + c)": 6,
    "b + c + s * a": 6,
    "vec3(dot(a, b))": 3,
    "vec3(dot(a, b) + s)": 3,
    "vec3(dot(a, b) + s + s)": 4,
    "cross(a, b)": 6,
    "cross(a, b) + c": 6,
    "cross(a, b) + s * c": 9,
    "m * a": 9,
    "m * a + b": 9,
    "m[0]": 0,
    "(s * m) * a": 18,
    "(m + m) * a": 18,
    "outerProduct(a, b) * c": 18,
    "vec3(1.0 / s)": 1,
    "vec3(inversesqrt(s))": 1,
    "h * a": 0,
    "h * (s * a) + b": 3,
    "(s < 0.0 ? -1.0 : 1.0) * a": 0,
    "(s < 0.0 ? -2.0 : 1.0) * a": 3,
    "(s == 0.0 ? 1.0 : 1.0 / s) * a": 4,
    "2.0 * a": 3,
}


@pytest.mark.slow
def test_the_counter_counts() -> None:
    """Expressions over vec3 a, b, c, float s, mat3 m and a sign h, with their multiply-adds."""
    functions = [
        f"vec3 f{number}(vec3 a, vec3 b, vec3 c, float s, mat3 m, skinbake_Frame frame)"
        f"{{ float h = frame.handedness; return {expression}; }}"
        for number, expression in enumerate(EXPRESSIONS)
    ]
    frame = "struct skinbake_Frame { vec3 normal; vec3 tangent; vec3 bitangent; float handedness; };"
    given = "position, position, position, 0.0, mat3(0.0), rest"
    # A function that nothing calls does not reach SPIR-V.
    calls = [f"gl_Position.xyz += f{number}({given});" for number in range(len(EXPRESSIONS))]
    main = ["in vec3 position;", "void main() {", "skinbake_Frame rest;", *calls, "}"]
    shader = "\n".join(["#version 450", frame, *functions, *main])
    module = Module(glslang.disassembly(glslang.spirv(shader)))
    found = {expression: module.multiply_adds(f"f{number}") for number, expression in enumerate(EXPRESSIONS)}
    assert found == EXPRESSIONS


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "lighting", "scaled_joints", "cost"),
    [
        (Method.LBS, Lighting.ACCURATE, False, 21),
        (Method.DQS, Lighting.ACCURATE, False, 30),
        (Method.DQS, Lighting.EXACT, False, 30),
        (Method.DQS, Lighting.EXACT, True, 36),
    ],
)
def test_a_normal_map_adds_to_the_text_what_the_page_says(
    method: Method, lighting: Lighting, scaled_joints: bool, cost: int
) -> None:
    """The difference of two texts, each compiled and counted by itself.

    Where joints scale, n0 goes into the matrix with a 0 behind it: four products that a compiler drops.
    """
    counts = []
    for normal_map in (False, True):
        choices = ShaderChoices(
            Language.GLSL,
            method,
            lighting,
            frame=Frame.TANGENT,
            scaled_joints=scaled_joints,
            normal_map=normal_map,
        )
        module = Module(glslang.disassembly(glslang.spirv(glsl([choices], "450"))))
        counts.append(module.multiply_adds(f"skinbake_{choices.stem}"))
    assert counts[1] - counts[0] - (4 if scaled_joints else 0) == cost


@pytest.mark.slow
@pytest.mark.parametrize("influences", [2, 4, 8])
def test_joints_that_scale_cost_what_the_replay_counts(influences: int) -> None:
    """The text mixes the translations too, which nothing reads, and looks which joints turn: 17 N more."""
    choices = ShaderChoices(
        Language.GLSL, Method.DQS, Lighting.EXACT, influences, Frame.NORMAL, scaled_joints=True
    )
    module = Module(glslang.disassembly(glslang.spirv(glsl([choices], "450"))))
    found = module.multiply_adds("skinbake_dqs_scaled")
    expected = sum(multiply_adds(Algorithm.DQS_EXACT, influences, scaled_joints=True).values())
    assert found == pytest.approx(expected + 17 * influences, rel=SHARE)
