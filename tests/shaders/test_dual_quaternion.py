"""The functions that convert joint matrices against the library's, for joints turned by any angle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skinbake.choices import Language, Method
from skinbake.shaders.choices import BEST, ShaderChoices
from tests.shaders.rigid_joints import (
    assert_like_scaled_motions,
    assert_like_the_library,
    joint_matrices,
    stretched_matrices,
)
from tests.shaders.running import WORKGROUP, done
from tests.support import opengl, webgpu
from tests.support.whole_fields import shader_text

# A rotation in float32 is one within 1e-7: its quaternion is off by as much, and the dual part by REACH times
# that. Measured: 2.2e-7 and 4.1e-7.


@pytest.mark.parametrize(
    "implementation", [pytest.param(webgpu.NAGA, marks=pytest.mark.slow), webgpu.TINT], ids=["naga", "tint"]
)
def test_wgsl(implementation: webgpu.Implementation) -> None:
    given = joint_matrices()
    code = "\n".join(
        [
            shader_text(ShaderChoices(Language.WGSL, Method.DQS, BEST[Method.DQS])),
            "@group(0) @binding(0) var<storage, read> matrices: array<mat4x4<f32>>;",
            "@group(0) @binding(1) var<storage, read_write> results: array<mat2x4<f32>>;",
            f"@compute @workgroup_size({WORKGROUP})",
            "fn main(@builtin(global_invocation_id) id: vec3<u32>) {",
            "if (id.x >= arrayLength(&matrices)) { return; }",
            "results[id.x] = skinbake_dual_quaternion(matrices[id.x]);",
            "}",
        ]
    )
    job = webgpu.Job(code, (given.tobytes(),), 32 * len(given), -(-len(given) // WORKGROUP))
    results = done("dual quaternion", webgpu.answers(implementation, {"": job})[""])
    assert_like_the_library(np.frombuffer(results, np.float32).reshape(-1, 8), given)


@pytest.mark.parametrize(("kind", "version"), [("es", "300 es"), ("desktop", "330"), ("desktop", "450")])
def test_glsl(kind: str, version: str) -> None:
    given = joint_matrices()
    shader = "\n".join(
        [
            f"#version {version}",
            *(["precision highp float;"] if kind == "es" else []),
            shader_text(ShaderChoices(Language.GLSL, Method.DQS, BEST[Method.DQS])),
            *(f"in vec4 column_{number};" for number in range(4)),
            "out vec4 real;",
            "out vec4 dual;",
            "void main() {",
            "mat2x4 Q = skinbake_dual_quaternion(mat4(column_0, column_1, column_2, column_3));",
            "real = Q[0];",
            "dual = Q[1];",
            "gl_Position = real;",
            "}",
        ]
    )
    columns = [(f"column_{number}", "4f") for number in range(4)]
    with opengl.context(kind) as context:
        found = context.run(shader, columns, given.reshape(-1, 4, 4), ["real", "dual"], 8)
    assert_like_the_library(found, given)


SCALED = ShaderChoices(Language.WGSL, Method.DQS, BEST[Method.DQS], scaled_joints=True)


@pytest.mark.parametrize(
    "implementation", [pytest.param(webgpu.NAGA, marks=pytest.mark.slow), webgpu.TINT], ids=["naga", "tint"]
)
def test_scaled_motions_of_wgsl(implementation: webgpu.Implementation) -> None:
    given = stretched_matrices()
    code = "\n".join(
        [
            shader_text(SCALED),
            "@group(0) @binding(0) var<storage, read> matrices: array<mat4x4<f32>>;",
            "@group(0) @binding(1) var<storage, read_write> results: array<skinbake_ScaledMotion>;",
            f"@compute @workgroup_size({WORKGROUP})",
            "fn main(@builtin(global_invocation_id) id: vec3<u32>) {",
            "if (id.x >= arrayLength(&matrices)) { return; }",
            "results[id.x] = skinbake_scaled_motion(matrices[id.x]);",
            "}",
        ]
    )
    job = webgpu.Job(code, (given.tobytes(),), 80 * len(given), -(-len(given) // WORKGROUP))
    results = done("scaled motion", webgpu.answers(implementation, {"": job})[""])
    assert_like_scaled_motions(np.frombuffer(results, np.float32).reshape(-1, 20), given)


@pytest.mark.parametrize(("kind", "version"), [("es", "300 es"), ("desktop", "450")])
def test_scaled_motions_of_glsl(kind: str, version: str) -> None:
    given = stretched_matrices()
    outputs = [*(f"moved_{number}" for number in range(4)), "turn"]
    shader = "\n".join(
        [
            f"#version {version}",
            *(["precision highp float;"] if kind == "es" else []),
            shader_text(replace(SCALED, language=Language.GLSL)),
            *(f"in vec4 column_{number};" for number in range(4)),
            *(f"out vec4 {name};" for name in outputs),
            "void main() {",
            "skinbake_ScaledMotion Q = skinbake_scaled_motion(mat4(column_0, column_1, column_2, column_3));",
            *(f"{name} = Q.moved[{number}];" for number, name in enumerate(outputs[:4])),
            "turn = Q.turn;",
            "gl_Position = turn;",
            "}",
        ]
    )
    columns = [(f"column_{number}", "4f") for number in range(4)]
    with opengl.context(kind) as context:
        found = context.run(shader, columns, given.reshape(-1, 4, 4), outputs, 20)
    assert_like_scaled_motions(found, given)
