"""The shader's morphed frames, compiled by two compilers and run: the float32 replay in another language."""

from __future__ import annotations

import copy
import importlib
import itertools
import re
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from click.testing import CliRunner

from skinbake.choices import Frame, FrameChoice, Language, Lighting, Method, Morphs
from skinbake.cli.main import main
from skinbake.commands.shader import shader
from skinbake.errors import ChoiceError
from skinbake.geometry.frames import frame_from_normal
from skinbake.geometry.morphs import (
    Differences,
    MorphTargets,
    carried_by_normal,
    carried_by_tangent,
    carried_in_plane,
    carried_in_space,
    morphed_normals,
    normals_of_frames,
)
from skinbake.geometry.skinned import Float32Array
from skinbake.shaders.choices import ALGORITHMS, ShaderChoices, ShaderRequest
from skinbake.skinning.morphs import morphed
from skinbake.skinning.rest import Algorithm, RestPrimitive
from tests.shaders.combinations import usage
from tests.support import analytic, glslang, morphing, opengl
from tests.support.analytic_rest import rest_primitive, sample
from tests.support.baked_files import Editable, baked, source
from tests.support.baking import bake_settings
from tests.support.morphed_files import morphed as with_targets
from tests.support.morphed_files import with_tangents
from tests.support.replay import replay
from tests.support.strictness import missing_tool
from tests.support.tools import required_program
from tests.support.whole_fields import shader_text

KINDS = [
    (Frame.NORMAL, Morphs.NORMAL),
    (Frame.TANGENT, Morphs.NORMAL),
    (Frame.TANGENT, Morphs.TANGENT),
    *((frame, morphs) for morphs in (Morphs.FRAMES, Morphs.FRAMES_NORMAL) for frame in Frame),
]


def choices(language: Language, frame: Frame, morphs: Morphs, **others: Any) -> ShaderChoices:
    return ShaderChoices(language, frame=frame, morphs=morphs, influences=3, **others)


# Run on whatever device there is

BODY = """
struct Row {{ data: array<vec4<f32>, {width}> }}
@group(0) @binding(0) var<storage, read> given: array<Row>;
@group(0) @binding(1) var<storage, read_write> found: array<Row>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {{
    if (id.x >= arrayLength(&given)) {{ return; }}
    let row = given[id.x].data;
    {code}
}}
"""

GLSL_BODY = """#version 450
layout(local_size_x = 64) in;
struct Row {{ vec4 data[{width}]; }};
layout(std430, binding = 0) readonly buffer Given {{ Row given[]; }};
layout(std430, binding = 1) buffer Found {{ Row found[]; }};
{text}
void main() {{
    uint id = gl_GlobalInvocationID.x;
    if (id >= given.length()) {{ return; }}
    vec4 row[{width}] = given[id].data;
    {code}
}}
"""

HLSL_BODY = """{text}
struct Row {{ float4 data[{width}]; }};
StructuredBuffer<Row> given : register(t0);
RWStructuredBuffer<Row> found : register(u1);
[numthreads(64, 1, 1)]
void main(uint3 place : SV_DispatchThreadID) {{
    uint id = place.x, count, size;
    given.GetDimensions(count, size);
    if (id >= count) return;
    float4 row[{width}] = given[id].data;
    {code}
}}
"""

WIDTH = 22


def run(language: Language, text: str, code: str, rows: Float32Array, folder: Path) -> Float32Array:
    """Run code on rows (V, at most WIDTH, 4): it reads ``row`` and writes ``OUT[i]``, (V, WIDTH, 4)."""
    try:
        wgpu = importlib.import_module("wgpu")
        compute = importlib.import_module("wgpu.utils.compute")
    except ImportError:
        missing_tool("wgpu is not installed")
    try:
        wgpu.gpu.request_adapter_sync()
    except RuntimeError:
        missing_tool("wgpu finds no device, not even a software one")
    given = np.zeros((len(rows), WIDTH, 4), np.float32)
    given[:, : rows.shape[1]] = rows
    if language is Language.WGSL:
        code = code.replace("OUT", "found[id.x].data")
        program: object = text + BODY.format(width=WIDTH, code=code)
    elif language is Language.HLSL:
        code = code.replace("OUT", "found[id].data")
        program = glslang.spirv_of_hlsl(HLSL_BODY.format(width=WIDTH, code=code, text=text))
    else:
        code = code.replace("OUT", "found[id].data")
        program = spirv(GLSL_BODY.format(width=WIDTH, code=code, text=text), "comp", folder)
    out = compute.compute_with_buffers({0: given}, {1: (given.size, "f")}, program, n=-(-len(rows) // 64))
    found: Float32Array = np.frombuffer(out[1], np.float32).reshape(given.shape)
    return found


def spirv(text: str, stage: str, folder: Path) -> bytes:
    validator = required_program("glslangValidator", "glslang-tools")
    (folder / f"shader.{stage}").write_text(text)
    command = [validator, "-V", f"shader.{stage}", "-o", "shader.spv"]
    result = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + text
    return (folder / "shader.spv").read_bytes()


def padded(*columns: npt.NDArray[Any]) -> Float32Array:
    """Rows of vectors (V, 3 or 4), one a vec4."""
    rows = np.stack([np.pad(c, ((0, 0), (0, 4 - c.shape[1]))) for c in columns], axis=1)
    return np.asarray(rows, dtype=np.float32)


def directions(count: int, seed: int) -> Float32Array:
    found = np.random.default_rng(seed).normal(size=(count, 3))
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True), dtype=np.float32)


FRAME = {
    Language.WGSL: "let frame = {call};",
    Language.GLSL: "skinbake_Frame frame = {call};",
    Language.HLSL: "skinbake_Frame frame = {call};",
}
WRITE = "OUT[0] = VEC4(frame.normal, frame.handedness); OUT[1] = VEC4(frame.tangent, 0.0); "
WRITE += "OUT[2] = VEC4(frame.bitangent, 0.0);"
WRITE_FRAME = {
    Language.WGSL: WRITE.replace("VEC4", "vec4<f32>"),
    Language.GLSL: WRITE.replace("VEC4", "vec4"),
    Language.HLSL: WRITE.replace("VEC4", "float4"),
}


@pytest.mark.slow
@pytest.mark.parametrize("language", Language)
def test_the_frame_that_follows_the_normal_is_the_replay_s(language: Language, tmp_path: Path) -> None:
    """Any two normals; then none of a length; then opposite ones, on both sides of the threshold."""
    n0, turned = directions(3000, 1), directions(3000, 2)
    differences = 1.7 * turned - n0
    differences[:10] = 0
    differences[10:20] = -n0[10:20]
    near = n0[20:220] * np.float32(-1) + np.linspace(0, 0.03, 200, dtype=np.float32)[:, None] * turned[20:220]
    differences[20:220] = near - n0[20:220]
    t0, b0 = frame_from_normal(n0)
    n, _ = morphed_normals(n0, differences)
    t, b = carried_by_normal(n0, (t0, b0), n)
    text = shader_text(choices(language, Frame.NORMAL, Morphs.NORMAL))
    code = FRAME[language].format(call="skinbake_morphed_frame(skinbake_frame(row[0].xyz), row[1].xyz)")
    found = run(language, text, code + WRITE_FRAME[language], padded(n0, n0 + differences), tmp_path)
    # Rounding counts up to 2 / |n0 + n| times: 200 at the threshold.
    s = np.linalg.norm(n0 + n, axis=1)
    clear = np.abs(s * s - 1e-4) > 1e-5
    tolerance = 1e-6 * np.maximum(1, 4 / np.maximum(s, 1e-2))[:, None]
    # A vector of rounding's length has any direction: those normals are the shader's own.
    clear[10:20] = np.linalg.norm(n0[10:20] + differences[10:20], axis=1) == 0
    assert clear.sum() > 2900
    for got, expected in ((found[:, 0, :3], n), (found[:, 1, :3], t), (found[:, 2, :3], b)):
        assert (np.abs(got - expected) <= tolerance)[clear].all()
    assert (found[:, 0, 3] == 1.0).all()
    # At rest the frame is that of rest, but for the normalisation's rounding.
    assert found[:10, 1, :3] == pytest.approx(t0[:10], abs=3e-7)


@pytest.mark.slow
@pytest.mark.parametrize("language", Language)
def test_the_frame_that_follows_the_tangent_is_the_replay_s(language: Language, tmp_path: Path) -> None:
    n0, n = directions(2000, 3), directions(2000, 4)
    t0 = np.cross(n0, directions(2000, 5)) + np.float32(0.001) * n0
    hand = np.where(np.arange(2000) % 2, 1, -1).astype(np.float32)
    b0 = np.cross(n0, t0) * hand[:, None]
    moved = t0 + directions(2000, 6) * np.float32(0.8)
    moved[:20] = 0.0005 * directions(20, 7)  # cancelled
    t, b = carried_by_tangent(n0, (t0, b0), n, moved, hand)
    text = shader_text(choices(language, Frame.TANGENT, Morphs.TANGENT))
    call = "skinbake_morphed_tangent_frame(skinbake_frame(row[0].xyz, row[1]), row[2].xyz, row[3].xyz)"
    code = FRAME[language].format(call=call) + WRITE_FRAME[language]
    rows = padded(n0, np.concatenate([t0, hand[:, None]], axis=1), n, moved)
    found = run(language, text, code, rows, tmp_path)
    length = np.linalg.norm(t, axis=1) / np.linalg.norm(t0, axis=1)
    clear = np.abs(length - 0.01) > 1e-3
    assert clear.sum() > 1980
    assert found[clear, 0, :3] == pytest.approx(n[clear], abs=1e-6)
    s = np.linalg.norm(n0 + n, axis=1)
    tolerance = 2e-6 * np.maximum(1, 4 / np.maximum(s, 1e-2))[:, None]
    for got, expected in ((found[:, 1, :3], t), (found[:, 2, :3], b)):
        assert (np.abs(got - expected) <= tolerance)[clear].all()
    assert np.array_equal(found[:, 0, 3], hand)


NUMBERS = """
in vec3 normal;
in vec4 tangent;
in vec3 turned;
in vec4 morph;
in vec2 morph_up;
out vec3 found_normal;
out vec3 found_tangent;
out vec3 found_bitangent;
void main()
{
    skinbake_Frame rest = skinbake_frame(normal, tangent);
    skinbake_Frame frame = CALL;
    found_normal = frame.normal;
    found_tangent = frame.tangent;
    found_bitangent = frame.bitangent;
    gl_Position = vec4(0.0);
}
"""


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["es", "desktop"])
@pytest.mark.parametrize("morphs", [Morphs.FRAMES, Morphs.FRAMES_NORMAL])
def test_opengl_moves_the_frame_by_numbers_as_the_replay_does(kind: str, morphs: Morphs) -> None:
    """Numbers of all sizes; at the first vertices none; normals at any angle to those at rest."""
    n0, turned = directions(2000, 11), directions(2000, 12)
    t0 = np.asarray(1.3 * np.cross(n0, directions(2000, 13)), dtype=np.float32)
    hand = np.where(np.arange(2000) % 2, 1, -1).astype(np.float32)
    b0 = np.cross(n0, t0) * hand[:, None]
    numbers = np.random.default_rng(14).normal(scale=0.6, size=(2000, 6)).astype(np.float32)
    numbers[:20] = 0
    m, up = numbers[:, :4], numbers[:, 4:]
    if morphs is Morphs.FRAMES:
        t, b = carried_in_space(n0, (t0, b0), m, up)
        n = normals_of_frames(n0, (t, b), hand, np.asarray(numbers.any(axis=1)))
        call = "skinbake_moved_frame(rest, morph, morph_up)"
    else:
        n = turned
        t, b = carried_in_plane(n0, (t0, b0), n, m)
        call = "skinbake_moved_frame_by_normal(rest, turned, morph)"
    text = shader_text(choices(Language.GLSL, Frame.TANGENT, morphs))
    version = "#version 300 es\nprecision highp float;\n" if kind == "es" else "#version 330\n"
    names = {"normal": 3, "tangent": 4, "turned": 3, "morph": 4, "morph_up": 2}
    with opengl.context(kind) as context:
        found = context.run(
            version + text + NUMBERS.replace("CALL", call),
            [(name, f"{size}f {4 * (4 - size)}x1".replace(" 0x1", "")) for name, size in names.items()],
            padded(n0, np.concatenate([t0, hand[:, None]], axis=1), turned, m, up),
            ["found_normal", "found_tangent", "found_bitangent"],
            9,
        )
    # Rounding counts most where t and b are nearly parallel, and where n is nearly at right angles to n0.
    area = np.linalg.norm(np.cross(t, b), axis=1)
    cosine = np.abs((n0 * turned).sum(axis=1))
    clear = (area > 1e-2) & (np.abs(cosine - 0.2) > 1e-4)
    assert clear.sum() > 1900
    for place, expected in enumerate((n, t, b)):
        assert found[clear, 3 * place : 3 * place + 3] == pytest.approx(expected[clear], rel=1e-4, abs=2e-4)


def surface_at(frame: str) -> tuple[RestPrimitive, analytic.Sample]:
    """The analytic surface in float32, with the frame that a file would give it."""
    points = sample()
    rest = rest_primitive(points)
    if frame == "normal":
        normals = rest.normals.astype(np.float32)
        t0, b0 = (vectors.astype(np.float64) for vectors in frame_from_normal(normals))
        order = rest.joints
        gradients = np.take_along_axis(points.gradients, order[:, :, None], axis=1)
        rest = replace(
            rest,
            normals=normals.astype(np.float64),
            tangents=t0,
            bitangents=b0,
            alpha=np.einsum("vki,vi->vk", gradients, t0)[:, 1:],
            beta=np.einsum("vki,vi->vk", gradients, b0)[:, 1:],
        )
    return rest, points


def numbers_of(points: analytic.Sample, rest: RestPrimitive, shape: analytic.Surface) -> list[Differences]:
    """The six numbers of the differential along the frame of the primitive, by finite differences."""
    vectors = [np.asarray(v, dtype=np.float64) for v in (rest.tangents, rest.bitangents)]
    images = morphing.images(points, shape, *vectors)
    basis = np.stack([*vectors, points.normals], axis=2)
    t, b = (
        np.linalg.solve(basis, (image - vector)[:, :, None])[:, :, 0]
        for image, vector in zip(images, vectors, strict=True)
    )
    in_plane = np.concatenate([t[:, :2], b[:, :2]], axis=1)
    return [Differences.of(in_plane), Differences.of(np.stack([t[:, 2], b[:, 2]], axis=1))]


def target_of(points: analytic.Sample, rest: RestPrimitive, morphs: Morphs) -> MorphTargets:
    """Return one target, with what a frame follows."""
    target = morphing.target(points, morphing.mixture, tangents=morphs is Morphs.TANGENT)
    if not morphs.moves_frame:
        return target
    in_plane, upward = numbers_of(points, rest, morphing.morphed_surface(morphing.mixture, 1.0))
    one = target.targets[0]._replace(in_plane=in_plane, upward=upward)
    return MorphTargets((one,), numbers=6 if morphs is Morphs.FRAMES else 4)


@pytest.mark.slow
@pytest.mark.parametrize(("frame", "morphs"), KINDS)
@pytest.mark.parametrize("lighting", [Lighting.DIRECT, Lighting.ACCURATE])
@pytest.mark.parametrize("language", Language)
def test_a_morphed_and_skinned_vertex_is_the_float32_replay_s(
    language: Language, lighting: Lighting, frame: Frame, morphs: Morphs, tmp_path: Path
) -> None:
    """From p + Δp, n + Δn, t + Δt to the skinned normal: the call that the header shows."""
    rest, points = surface_at(frame)
    target, weights = target_of(points, rest, morphs), np.array([0.7])
    matrices = analytic.joint_matrices("medium")
    algorithm = Algorithm(ALGORITHMS[Method.LBS, lighting])
    moved = morphed(rest, target, weights, dtype=np.float32)
    expected = replay(algorithm, moved, matrices[None], dtype=np.float32)
    text = shader_text(choices(language, frame, morphs, lighting=lighting))
    rows = rows_of(rest, rest.tangents, target, weights, matrices)
    found = run(language, text, call_of(language, text), rows, tmp_path)
    for place, name in enumerate(("positions", "normals", "tangents", "bitangents")):
        # float32 in another order: sums of a dozen terms, each up to 5 times as large as the result.
        values = getattr(expected, name)[0]
        got = found[:, place, :3]
        scale = np.linalg.norm(values, axis=1, keepdims=True)
        assert (np.abs(got - values) <= 2e-5 * np.maximum(scale, 1.0)).all(), name


TEXEL = (0.36, -0.48, 0.8)


@pytest.mark.slow
@pytest.mark.parametrize(("frame", "morphs"), KINDS)
@pytest.mark.parametrize("language", Language)
def test_a_normal_map_follows_morph_targets_as_a_relief_does(
    language: Language, frame: Frame, morphs: Morphs, tmp_path: Path
) -> None:
    """The texel is a covector of the map whose columns are the images of unit t0 and b0, and T n."""
    rest, points = surface_at(frame)
    target, weights = target_of(points, rest, morphs), np.array([0.7])
    matrices = analytic.joint_matrices("medium")
    moved = morphed(rest, target, weights, dtype=np.float32)
    posed, carried = (
        replay(algorithm, moved, matrices[None])
        for algorithm in (Algorithm.LBS_ACCURATE, Algorithm.LBS_STANDARD)
    )
    # A morphed TANGENT has the length of a sum, which is no stretch.
    known = (moved if morphs is Morphs.TANGENT else rest).tangents
    size = np.linalg.norm(known, axis=1)[:, None]
    columns = np.stack([posed.tangents[0] / size, posed.bitangents[0] / size, carried.normals[0]], axis=2)
    # The texture follows TANGENT, which in the normal frame is at an angle of its own to t0.
    t = (
        rest.tangents
        if frame == Frame.TANGENT
        else rest.tangents + 0.6 * rest.bitangents + 0.1 * rest.normals
    )
    t0, b0, n0 = (
        v / np.linalg.norm(v, axis=1)[:, None] for v in (rest.tangents, rest.bitangents, rest.normals)
    )
    along = t / np.linalg.norm(t, axis=1)[:, None]
    across = np.cross(n0, along) / np.linalg.norm(np.cross(n0, along), axis=1)[:, None]
    drawn = TEXEL[0] * along + TEXEL[1] * across + TEXEL[2] * n0
    parts = np.stack([(drawn * v).sum(axis=1) for v in (t0, b0, n0)], axis=1)
    inverse = np.linalg.inv(columns).swapaxes(1, 2)
    wanted = np.einsum("vij,vj->vi", inverse, parts)
    wanted *= (np.linalg.det(columns) * size[:, 0] ** 2)[:, None]
    text = shader_text(choices(language, frame, morphs, normal_map=True))
    found = run(
        language, text, call_of(language, text), rows_of(rest, t, target, weights, matrices), tmp_path
    )[:, 4, :3]
    scale = np.linalg.norm(wanted, axis=1, keepdims=True)
    assert (np.abs(found - wanted) <= 5e-5 * np.maximum(scale, 1.0)).all()


def rows_of(
    rest: RestPrimitive,
    tangents: npt.NDArray[Any],
    target: MorphTargets,
    weights: npt.NDArray[Any],
    matrices: npt.NDArray[Any],
) -> Float32Array:
    """Return what ``call_of`` reads: attributes, sums over targets, and joints. tangents (V, 3): TANGENT."""
    count = len(rest.positions)
    sums = [target.summed(kind, weights, count) for kind in ("positions", "normals", "tangents")]
    numbers = [target.summed("in_plane", weights, count), target.summed("upward", weights, count)]
    added = [
        array + by for array, by in zip((rest.positions, rest.normals, rest.tangents), sums, strict=True)
    ]
    joints = matrices[rest.joints].transpose(0, 1, 3, 2).reshape(count, 12, 4)
    return np.concatenate(
        [
            padded(rest.normals, np.pad(tangents, ((0, 0), (0, 1)), constant_values=1.0), *added),
            padded(rest.weights, rest.alpha, rest.beta, *numbers),
            joints.astype(np.float32),
        ],
        axis=1,
    )


def call_of(language: Language, text: str) -> str:
    """Return the code of the header's usage, between reading its names and writing its result."""
    lines = [line for line in usage(text) if not line.startswith("//")]
    assert len(lines) - ("map" in lines[-1]) in ((3, 5) if language is Language.HLSL else (3,))
    if language is Language.WGSL:
        before = (
            "let normal = row[0].xyz; let tangent = row[1]; let morphed_position = row[2].xyz;"
            "let morphed_normal = row[3].xyz; let morphed_tangent = row[4].xyz; let weights_0 = row[5];"
            "let alpha_0 = row[6].xyz; let beta_0 = row[7].xyz;"
            "let morph = row[8]; let morph_up = row[9].xy;"
            "let M = array<mat4x4<f32>, 3>("
            + ", ".join(
                f"mat4x4<f32>({', '.join(f'row[{10 + 4 * m + c}]' for c in range(4))})" for m in range(3)
            )
            + ");"
        )
        vector = "vec4<f32>"
    else:
        before = (
            "vec3 normal = row[0].xyz; vec4 tangent = row[1]; vec3 morphed_position = row[2].xyz;"
            "vec3 morphed_normal = row[3].xyz; vec3 morphed_tangent = row[4].xyz; vec4 weights_0 = row[5];"
            "vec3 alpha_0 = row[6].xyz; vec3 beta_0 = row[7].xyz;"
            "vec4 morph = row[8]; vec2 morph_up = row[9].xy; mat4 M[3];"
            + "".join(
                f"M[{m}] = mat4({', '.join(f'row[{10 + 4 * m + c}]' for c in range(4))});" for m in range(3)
            )
        )
        vector = "vec4"
    if language is Language.HLSL:
        before = re.sub(r"\bmat4\(([^)]*)\)", r"transpose(float4x4(\1))", before)
        before, vector = before.replace("mat4 M", "float4x4 M").replace("vec", "float"), "float4"
    after = "".join(
        f"OUT[{place}] = {vector}(v.{name}, 0.0);"
        for place, name in enumerate(("position", "normal", "tangent", "bitangent"))
    )
    if "map" in lines[-1]:
        given = "map.normal, map.cotangent, map.cobitangent"
        texel = f"{vector.replace('4', '3')}{TEXEL}"
        after += f"OUT[4] = {vector}(length(v.normal) * skinbake_mapped_normal({texel}, {given}), 0.0);"
    return "\n".join([before, *lines, after])


# Compiled for every choice


@pytest.mark.parametrize(
    "version", [*(pytest.param(old, marks=pytest.mark.slow) for old in ("300 es", "330")), "450"]
)
def test_every_algorithm_compiles_as_glsl(version: str, tmp_path: Path) -> None:
    validator = required_program("glslangValidator", "glslang-tools")
    files = []
    for (method, lighting), (frame, morphs) in itertools.product(ALGORITHMS, KINDS):
        text = shader_text(choices(Language.GLSL, frame, morphs, method=method, lighting=lighting))
        path = tmp_path / f"{method}_{lighting}_{frame}_{morphs}.vert"
        precision = "precision highp float;\n" if "es" in version else ""
        path.write_text(f"#version {version}\n{precision}{text}{text}void main() {{}}\n")
        files.append(str(path))
    result = subprocess.run([validator, *files], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout


def test_without_morph_targets_the_text_has_nothing_of_them() -> None:
    for language in Language:
        assert "morph" not in shader_text(ShaderChoices(language))


# The command


def for_file(path: Path, language: Language = Language.GLSL, **request: Any) -> ShaderChoices:
    return shader(ShaderRequest(language=language, **request), str(path)).choices


def test_a_file_says_what_its_frames_follow(tmp_path: Path) -> None:
    plain = baked(source("mirrored_tangent.glb"), tmp_path)
    assert for_file(plain).morphs is Morphs.NONE
    moved = with_targets(plain, tmp_path / "moved.glb")
    assert for_file(moved).morphs is Morphs.NORMAL
    assert for_file(moved, morphs=Morphs.NONE).morphs is Morphs.NONE
    assert for_file(moved, morphs=Morphs.TANGENT).morphs is Morphs.TANGENT
    turned = with_tangents(moved, 0.2)
    assert for_file(turned).morphs is Morphs.TANGENT
    assert for_file(turned, morphs=Morphs.NORMAL).morphs is Morphs.NORMAL


def test_targets_of_tangents_do_not_matter_to_the_normal_frame(tmp_path: Path) -> None:
    path = baked(source("mirrored_tangent.glb"), tmp_path, bake_settings(frame=FrameChoice.NORMAL))
    assert for_file(with_tangents(with_targets(path, tmp_path / "moved.glb"), 0.2)).morphs is Morphs.NORMAL


def test_the_command_line_in_the_header_writes_the_text_again() -> None:
    arguments = ["shader", "--lang", "wgsl", "--frame", "tangent", "--morphs", "tangent"]
    first = CliRunner().invoke(main, arguments)
    assert first.exit_code == 0, first.output
    command = next(line for line in first.stdout.splitlines() if "skinbake shader" in line)
    again = CliRunner().invoke(main, command.split()[2:])
    assert again.stdout == first.stdout
    assert "skinbake_morphed_tangent_frame" in first.stdout


def test_morphed_tangents_need_the_tangent_frame() -> None:
    with pytest.raises(ChoiceError, match="morphs='tangent' needs frame='tangent'"):
        ShaderChoices(Language.GLSL, frame=Frame.NORMAL, morphs=Morphs.TANGENT)
    result = CliRunner().invoke(
        main, ["shader", "--lang", "glsl", "--frame", "normal", "--morphs", "tangent"]
    )
    assert result.exit_code == 2


def test_a_file_with_numbers_of_the_differential_is_read_by_them(tmp_path: Path) -> None:
    moved = with_targets(source("mirrored_tangent.glb"), tmp_path / "moved.glb")
    four = baked(moved, tmp_path, morph_frames=True)
    assert for_file(four).morphs is Morphs.FRAMES_NORMAL
    assert "_SKINBAKE_MORPH of the targets" in shader(ShaderRequest(language=Language.GLSL), str(four)).text
    assert for_file(four, morphs=Morphs.NORMAL).morphs is Morphs.NORMAL
    assert for_file(four, normal_map=True).morphs is Morphs.FRAMES_NORMAL
    assert for_file(four, target="bevy", language=Language.WGSL).morphs is Morphs.NORMAL
    with pytest.raises(ChoiceError, match="no place for the numbers"):
        for_file(four, target="bevy", language=Language.WGSL, morphs=Morphs.FRAMES_NORMAL)


@pytest.mark.parametrize(
    ("target", "language", "names"),
    [("playcanvas", Language.GLSL, True), ("bevy", Language.WGSL, True), ("three", Language.GLSL, False)],
)
def test_an_engine_that_reads_no_numbers_is_named_where_targets_have_no_normal(
    tmp_path: Path, target: str, language: Language, names: bool
) -> None:
    moved = with_targets(source("mirrored_tangent.glb"), tmp_path / "moved.glb")
    file, four = Editable(moved), baked(moved, tmp_path, morph_frames=True)
    for one in file.primitive()["targets"]:
        del one["NORMAL"]
    six = baked(file.write(tmp_path / "six.glb"), tmp_path, morph_frames=True)
    found = [shader(ShaderRequest(language, target=target), str(path)).notices for path in (six, four)]
    assert [[one.code for one in notices] for notices in found] == [["morph-frames-unread"] * names, []]
    if names:
        assert "bake with --morph-normals too" in found[0][0].message


def test_one_text_does_not_serve_targets_of_four_and_of_six_numbers(tmp_path: Path) -> None:
    file = Editable(with_targets(source("mirrored_tangent.glb"), tmp_path / "moved.glb"))
    primitives = file.content["meshes"][0]["primitives"]
    primitives.append(copy.deepcopy(primitives[0]))
    for one in primitives[1]["targets"]:
        del one["NORMAL"]
    both = baked(file.write(tmp_path / "both.glb"), tmp_path, morph_frames=True)
    notices = shader(ShaderRequest(Language.GLSL), str(both)).notices
    assert [one.code for one in notices] == ["morph-frames-unread"] * 2
    for one, wanted in zip(notices, ("frames-normal", "frames"), strict=True):
        assert one.message.endswith(f"write another text for it with --morphs {wanted}")
        assert not shader(ShaderRequest(Language.GLSL, morphs=Morphs(wanted)), str(both)).notices
