"""skinbake_dual_quaternion() against the library's conversion, for joints turned by any angle."""

from __future__ import annotations

import numpy as np
import pytest

from skinbake.choices import Language, Method
from skinbake.geometry.dual_quaternions import dual_quaternions_from_matrices
from skinbake.shaders.choices import BEST, ShaderChoices
from tests.shaders.running import WORKGROUP, Single, done
from tests.shaders.scenes import shader_order
from tests.support import opengl, webgpu
from tests.support.analytic import rotation_matrix
from tests.support.rigid_motions import matrices_from_dual_quaternions
from tests.support.whole_fields import shader_text

REACH = 3.0
"""The longest translation."""

# A rotation in float32 is one within 1e-7: its quaternion is off by as much, and the dual part by REACH times
# that. Measured: 2.2e-7 and 4.1e-7.
TOLERANCE = 1e-6


def joint_matrices() -> Single:
    """Rigid matrices, column by column, (R, 16): random ones, and turns of 0° and 180° round every axis."""
    rng = np.random.default_rng(0)
    axes = rng.normal(size=(2_000, 3))
    angles = rng.uniform(0, 2 * np.pi, len(axes))
    angles[:600:2], angles[1:600:2] = np.pi, 0.0
    axes[:6] = [[1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1], [1, 1, 1]]
    axes[600:700] = [1, -1, 0]
    angles[600:700] = np.pi * np.linspace(0.999, 1.001, 100)
    angles[[0, 2, 4, 6]] = np.pi
    # Nearly round one axis by nearly 180°: three of the four components are too small to divide by.
    nearly = slice(700, 1_000)
    axes[nearly] = np.repeat(np.eye(3), 100, axis=0) + rng.normal(scale=1e-3, size=(300, 3))
    angles[nearly] = np.pi + rng.normal(scale=1e-4, size=300)
    matrices = np.tile(np.eye(4), (len(axes), 1, 1))
    matrices[:, :3, :3] = [rotation_matrix(*pair) for pair in zip(axes, angles, strict=True)]
    directions = rng.normal(size=(len(axes), 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    matrices[:, :3, 3] = directions * rng.uniform(0, REACH, (len(axes), 1))
    return np.swapaxes(matrices, 1, 2).reshape(-1, 16).astype(np.float32)


def assert_like_the_library(found: Single, given: Single) -> None:
    """Up to the sign, which is the same motion; and the motion itself, given back as a matrix."""
    matrices = np.swapaxes(given.reshape(-1, 4, 4), 1, 2).astype(np.float64)
    wanted = shader_order(dual_quaternions_from_matrices(matrices)).astype(np.float64)
    sign = np.sign(np.sum(found[:, :4] * wanted[:, :4], axis=1, keepdims=True))
    apart = np.abs(sign * found - wanted)
    assert apart[:, :4].max() <= TOLERANCE
    assert apart[:, 4:].max() <= TOLERANCE * REACH
    scalars_first = found[:, [3, 0, 1, 2, 7, 4, 5, 6]]
    np.testing.assert_allclose(
        matrices_from_dual_quaternions(scalars_first), matrices, atol=4 * TOLERANCE * REACH
    )


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
