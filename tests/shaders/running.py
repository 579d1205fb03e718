"""Run the wrapped texts on scenes: WGSL by two compilers, GLSL in two kinds of context."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from skinbake.choices import Method
from skinbake.shaders.choices import ShaderChoices
from tests.shaders.combinations import ATTRIBUTES, Column, columns, glsl, wgsl
from tests.shaders.scenes import Scene
from tests.support import opengl, webgpu

Single = npt.NDArray[np.float32]
Wide = npt.NDArray[np.float64]
Work = Mapping[str, tuple[ShaderChoices, Scene]]
"""Shaders and what they skin, by a name of the caller's."""

WORKGROUP = 64


def run_wgsl(implementation: webgpu.Implementation, work: Work) -> dict[str, Single]:
    """Return posed position, normal, tangent and bitangent of every vertex in every pose, (R, 4, 3)."""
    jobs = {}
    for name, (choices, scene) in work.items():
        given = scene.columns(choices)
        jobs[name] = webgpu.Job(
            wgsl(choices),
            (scene.motions(choices).tobytes(), given.tobytes()),
            len(ATTRIBUTES) * 16 * len(given),
            -(-len(given) // WORKGROUP),
        )
    return {
        name: np.frombuffer(done(name, answer), np.float32).reshape(-1, len(ATTRIBUTES), 4)[:, :, :3]
        for name, answer in webgpu.answers(implementation, jobs).items()
    }


def done(name: str, answer: webgpu.Answer) -> bytes:
    """Return the results, or fail with what the compiler said."""
    assert not answer.complaint, f"{name}: {answer.complaint}"
    return answer.results


def run_glsl(context: opengl.Context, version: str, choices: ShaderChoices, scene: Scene) -> Single:
    """Return the same of one vertex shader, compiled as this version."""
    motions = scene.motions(choices)
    block = "Matrices" if choices.method is Method.LBS else "Quaternions"
    outputs = [f"posed_{attribute}" for attribute in ATTRIBUTES]
    found = context.run(
        glsl([choices], version, len(motions)),
        [moderngl_format(column) for column in columns(choices)],
        scene.columns(choices),
        outputs,
        3 * len(outputs),
        {block: motions},
    )
    return found.reshape(-1, len(outputs), 3)


def moderngl_format(column: Column) -> tuple[str, str]:
    """Return a column's name and its sixteen bytes as moderngl describes them."""
    padding = f" {4 * (4 - column.size)}x1" if column.size < 4 else ""
    return column.name, f"{column.size}{'u' if column.is_integer else 'f'}{padding}"
