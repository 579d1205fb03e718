"""Every HLSL text, compiled by glslang and by DXC, valid, and run on lavapipe, gives what the replay gives.

DXC compiles it to DXIL too, which cannot be run here. The tolerances are those of ``test_run``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from skinbake.choices import Encoding, Frame, Language, Layout, Lighting, Method
from skinbake.shaders.choices import BEST, ShaderChoices
from tests.shaders.awkward_frames import awkward_normals, different, expected
from tests.shaders.combinations import every_stored_and_morphed, every_text, fewer, hlsl, label
from tests.shaders.judged import assert_like_the_replay, irregular_work
from tests.shaders.rigid_joints import (
    assert_like_scaled_motions,
    assert_like_the_library,
    joint_matrices,
    stretched_matrices,
)
from tests.shaders.running import WORKGROUP, Single, done, run_hlsl
from tests.shaders.scenes import CHARACTERS, Scene
from tests.support import dxc, glslang, webgpu
from tests.support.whole_fields import shader_text

HLSL = Language.HLSL
COMPILERS = pytest.mark.parametrize("compiled", [glslang.spirv_of_hlsl, dxc.spirv], ids=["glslang", "dxc"])


@pytest.mark.slow
@COMPILERS
def test_every_combination(compiled: Callable[[str], bytes]) -> None:
    work = irregular_work(fewer(every_text(HLSL)))
    assert len(work) >= 30
    for name, found in run_hlsl(work, compiled).items():
        assert_like_the_replay(*work[name], found)


@pytest.mark.slow
@COMPILERS
def test_characters(compiled: Callable[[str], bytes], tmp_path: Path) -> None:
    work: dict[str, tuple[ShaderChoices, Scene]] = {}
    for character in CHARACTERS:
        scene = character.scene(tmp_path, 1)
        for method, lighting in BEST.items():
            choices = ShaderChoices(HLSL, method, lighting, character.influences, character.frame)
            # Linear blending takes no scale beforehand, and the joints of one character share one.
            choices = replace(choices, scaled_joints=method is Method.BLEND)
            work[f"{character.path} {label(choices)}"] = choices, scene
    for name, found in run_hlsl(work, compiled).items():
        assert_like_the_replay(*work[name], found)


@pytest.mark.slow
def test_every_storage_and_morph_compiles() -> None:
    """With two sets of influences in the tangent frame; dual quaternions read α and β in no other way."""
    stored = [c for c in every_stored_and_morphed(HLSL).values() if c.influences == 8 and c.method == "lbs"]
    every = [choices for choices in stored if choices.frame == Frame.TANGENT]
    assert len(every) == 11
    for choices in every:
        text = hlsl([choices, replace(choices, lighting=Lighting.DIRECT)])
        for compiled in (glslang.spirv_of_hlsl, dxc.spirv):
            assert glslang.invalid(compiled(text)) == "", label(choices)
        assert dxc.dxil(text).startswith(dxc.CONTAINER), label(choices)


COMPUTE = """
StructuredBuffer<float4x4> motions : register(t0);
RWStructuredBuffer<float4> results : register(u1);
[numthreads(64, 1, 1)]
void main(uint3 id : SV_DispatchThreadID) {{
    uint row = id.x, count, size;
    results.GetDimensions(count, size);
    if ({width} * row >= count) return;
    {code}
}}
"""


@dataclass(frozen=True, slots=True)
class Part:
    """Code for rows of sixteen floats: it reads motions[row] and writes ``width`` float4."""

    choices: ShaderChoices
    rows: Single
    width: int
    code: str

    def job(self, compiled: Callable[[str], bytes]) -> webgpu.Job:
        """Return the part as a compute shader and its buffers."""
        code = shader_text(self.choices) + COMPUTE.format(width=self.width, code=self.code)
        module, count = compiled(code), len(self.rows)
        return webgpu.Job(module, (self.rows.tobytes(),), 16 * self.width * count, -(-count // WORKGROUP))


STORED = np.random.default_rng(0).uniform(-1, 1, (100, 16)).astype(np.float32)
GIVEN = "float4x4 given = transpose(motions[row]);"
NAMES = ("normal", "tangent", "bitangent")


def parts() -> dict[str, Part]:
    """The functions that a scene does not reach, or not everywhere."""
    normals = np.pad(awkward_normals(), ((0, 0), (0, 13)))
    return {
        "frame": Part(
            ShaderChoices(HLSL),
            normals,
            3,
            f"{GIVEN} skinbake_Frame frame = skinbake_frame(given[0].xyz);"
            + "".join(f"results[3 * row + {n}] = float4(frame.{name}, 0.0);" for n, name in enumerate(NAMES)),
        ),
        "dual quaternion": Part(
            ShaderChoices(HLSL, Method.DQS, BEST[Method.DQS]),
            joint_matrices(),
            2,
            "float2x4 Q = skinbake_dual_quaternion(motions[row]);"
            "results[2 * row] = Q[0]; results[2 * row + 1] = Q[1];",
        ),
        "scaled motion": Part(
            ShaderChoices(HLSL, Method.DQS, BEST[Method.DQS], scaled_joints=True),
            stretched_matrices(),
            5,
            "skinbake_ScaledMotion Q = skinbake_scaled_motion(motions[row]);"
            "for (uint n = 0; n < 4; n++) results[5 * row + n] = Q.moved[n];"
            "results[5 * row + 4] = Q.turn;",
        ),
        "integers": Part(
            ShaderChoices(HLSL, influences=8, encoding=Encoding.PACKED8),
            STORED,
            2,
            f"{GIVEN} results[2 * row] = float4(skinbake_decoded(given[0], 2.5), 0.0);"
            "results[2 * row + 1] = skinbake_decoded_further(given[1], given[0], 2.5);",
        ),
        "pairs": Part(
            ShaderChoices(HLSL, layout=Layout.TEXCOORD),
            STORED,
            2,
            f"{GIVEN} results[2 * row] = float4(skinbake_alpha_0(given[0].xy, given[0].zw), 0.0);"
            "results[2 * row + 1] = float4(skinbake_beta_0(given[0].zw, given[1].xy), 0.0);",
        ),
    }


@pytest.mark.slow
@COMPILERS
def test_parts(compiled: Callable[[str], bytes]) -> None:
    """The frame has the bits of bake; α and β are those of the two formulas of the file format."""
    every = parts()
    answers = webgpu.answers(webgpu.NAGA, {name: part.job(compiled) for name, part in every.items()})
    found = {
        name: np.frombuffer(done(name, answer), np.float32).reshape(-1, every[name].width, 4)
        for name, answer in answers.items()
    }
    assert not different(found["frame"][:, :, :3], expected(awkward_normals())).any()
    assert_like_the_library(found["dual quaternion"].reshape(-1, 8), joint_matrices())
    assert_like_scaled_motions(found["scaled motion"].reshape(-1, 20), stretched_matrices())
    factor = 2.5 * STORED[:, 3:4].astype(np.float64) ** 2
    np.testing.assert_allclose(found["integers"][:, 0, :3], factor * STORED[:, :3], rtol=1e-6)
    np.testing.assert_allclose(found["integers"][:, 1], factor * STORED[:, 4:8], rtol=1e-6)
    assert (found["pairs"][:, 0, :3] == STORED[:, :3]).all()
    assert (found["pairs"][:, 1, :3] == STORED[:, 3:6]).all()


@pytest.mark.slow
@pytest.mark.parametrize("compiled", [glslang.spirv_of_hlsl, dxc.spirv, dxc.dxil])
def test_a_compiler_does_complain(compiled: Callable[[str], bytes]) -> None:
    good = hlsl([ShaderChoices(HLSL)])
    with pytest.raises(ValueError, match="skinbake_lost"):
        compiled(good.replace("skinbake_moved(M[0]", "skinbake_lost(M[0]"))
