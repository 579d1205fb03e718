"""The frame of NORMAL alone has the bits that bake computed, wherever the shader runs."""

from __future__ import annotations

import numpy as np
import pytest

from skinbake.choices import Language
from skinbake.shaders.choices import ShaderChoices
from tests.shaders.awkward_frames import awkward_normals, different, expected
from tests.shaders.running import WORKGROUP, done
from tests.support import opengl, webgpu
from tests.support.whole_fields import shader_text

OUTPUTS = ("normal", "tangent", "bitangent")


def test_the_normals_are_awkward() -> None:
    z = awkward_normals()[:, 2]
    assert (z == -1).any()
    assert (z == 1).any()
    assert ((z > -1) & (z < -1 + 1e-6)).any()
    assert ((z == 0) & np.signbit(z)).any()
    assert ((z == 0) & ~np.signbit(z)).any()


@pytest.mark.parametrize(
    "implementation", [pytest.param(webgpu.NAGA, marks=pytest.mark.slow), webgpu.TINT], ids=["naga", "tint"]
)
def test_wgsl_has_the_bits_of_bake(implementation: webgpu.Implementation) -> None:
    normals = awkward_normals()
    code = "\n".join(
        [
            shader_text(ShaderChoices(Language.WGSL)),
            "@group(0) @binding(0) var<storage, read> normals: array<vec4<f32>>;",
            "@group(0) @binding(1) var<storage, read_write> results: array<vec4<f32>>;",
            f"@compute @workgroup_size({WORKGROUP})",
            "fn main(@builtin(global_invocation_id) id: vec3<u32>) {",
            "if (id.x >= arrayLength(&normals)) { return; }",
            "let frame = skinbake_frame(normals[id.x].xyz);",
            *(f"results[3u * id.x + {n}u] = vec4<f32>(frame.{name}, 0.0);" for n, name in enumerate(OUTPUTS)),
            "}",
        ]
    )
    padded = np.pad(normals, ((0, 0), (0, 1)))
    job = webgpu.Job(code, (padded.tobytes(),), 48 * len(normals), -(-len(normals) // WORKGROUP))
    results = np.frombuffer(done("frame", webgpu.answers(implementation, {"": job})[""]), np.float32)
    assert not different(results.reshape(-1, 3, 4)[:, :, :3], expected(normals)).any()


@pytest.mark.parametrize(("kind", "version"), [("es", "300 es"), ("desktop", "330"), ("desktop", "450")])
def test_glsl_has_the_bits_of_bake(kind: str, version: str) -> None:
    normals = awkward_normals()
    shader = "\n".join(
        [
            f"#version {version}",
            *(["precision highp float;"] if kind == "es" else []),
            shader_text(ShaderChoices(Language.GLSL)),
            "in vec3 normal;",
            *(f"out vec3 frame_{name};" for name in OUTPUTS),
            "void main() {",
            "skinbake_Frame frame = skinbake_frame(normal);",
            *(f"frame_{name} = frame.{name};" for name in OUTPUTS),
            "gl_Position = vec4(normal, 1.0);",
            "}",
        ]
    )
    columns = np.pad(normals, ((0, 0), (0, 1)))
    outputs = [f"frame_{name}" for name in OUTPUTS]
    with opengl.context(kind) as context:
        results = context.run(shader, [("normal", "3f 4x1")], columns, outputs, 9)
    assert not different(results.reshape(-1, 3, 3), expected(normals)).any()
