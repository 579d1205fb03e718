"""Run the wrapped texts on scenes: WGSL and HLSL by two compilers each, GLSL in two kinds of context."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from skinbake.choices import Method
from skinbake.shaders.choices import ShaderChoices
from tests.shaders.combinations import (
    ATTRIBUTES,
    GLSL_MOTIONS,
    Column,
    columns,
    glsl,
    hlsl,
    label,
    motion_kind,
    shared_columns,
    wgsl,
)
from tests.shaders.scenes import Scene
from tests.support import glslang, opengl, webgpu

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
            _matrices_beside(choices, scene),
        )
    return {
        name: np.frombuffer(done(name, answer), np.float32).reshape(-1, len(ATTRIBUTES), 4)[:, :, :3]
        for name, answer in webgpu.answers(implementation, jobs).items()
    }


def run_hlsl(work: Work, compiled: Callable[[str], bytes]) -> dict[str, Single]:
    """Return the same of HLSL, whose SPIR-V wgpu runs; fail where the SPIR-V is not valid.

    Texts for one scene that differ in nothing but the lighting share a shader: glslang starts slowly.
    """
    groups: dict[str, list[str]] = {}
    for name, (choices, scene) in work.items():
        alike = f"{choices.method} {motion_kind(choices)} {label(choices).partition('-')[2]} {id(scene)}"
        groups.setdefault(alike, []).append(name)
    jobs = {alike: _hlsl_job([work[name] for name in names], compiled) for alike, names in groups.items()}
    found: dict[str, Single] = {}
    for alike, answer in webgpu.answers(webgpu.NAGA, jobs).items():
        names = groups[alike]
        rows = np.frombuffer(done(alike, answer), np.float32).reshape(-1, len(names), len(ATTRIBUTES), 4)
        found |= {name: rows[:, at, :, :3] for at, name in enumerate(names)}
    return found


def _hlsl_job(pairs: Sequence[tuple[ShaderChoices, Scene]], compiled: Callable[[str], bytes]) -> webgpu.Job:
    several = [choices for choices, _ in pairs]
    module = compiled(hlsl(several))
    assert glslang.invalid(module) == "", label(several[0])
    widest, scene = max(pairs, key=lambda pair: len(columns(pair[0])))
    assert columns(widest) == shared_columns(several)
    given = scene.columns(widest)
    return webgpu.Job(
        module,
        (scene.motions(widest).tobytes(), given.tobytes()),
        len(several) * len(ATTRIBUTES) * 16 * len(given),
        -(-len(given) // WORKGROUP),
        _matrices_beside(widest, scene),
    )


def _matrices_beside(choices: ShaderChoices, scene: Scene) -> tuple[bytes, ...]:
    return (scene.columns_of_matrices().tobytes(),) if choices.method is Method.BLEND else ()


def done(name: str, answer: webgpu.Answer) -> bytes:
    """Return the results, or fail with what the compiler said."""
    assert not answer.complaint, f"{name}: {answer.complaint}"
    return answer.results


def run_glsl(context: opengl.Context, version: str, choices: ShaderChoices, scene: Scene) -> Single:
    """Return the same of one vertex shader, compiled as this version."""
    motions = scene.motions(choices)
    _, table = GLSL_MOTIONS[motion_kind(choices)]
    outputs = [f"posed_{attribute}" for attribute in ATTRIBUTES]
    found = context.run(
        glsl([choices], version, len(motions)),
        [moderngl_format(column) for column in columns(choices)],
        scene.columns(choices),
        outputs,
        3 * len(outputs),
        {
            table.capitalize(): motions,
            **({"Matrices": scene.columns_of_matrices()} if choices.method is Method.BLEND else {}),
        },
    )
    return found.reshape(-1, len(outputs), 3)


def moderngl_format(column: Column) -> tuple[str, str]:
    """Return a column's name and its sixteen bytes as moderngl describes them."""
    padding = f" {4 * (4 - column.size)}x1" if column.size < 4 else ""
    return column.name, f"{column.size}{'u' if column.is_integer else 'f'}{padding}"
