"""Whole compute passes, compiled and run over buffers as glTF lays them out, give what the replay gives.

WGSL runs on two implementations of WebGPU, GLSL and HLSL as SPIR-V of glslang and of DXC on lavapipe.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import skinbake
from fixtures.builder import AnyArray, JsonObject
from fixtures.make_fixtures import FOLDER
from skinbake.choices import Encoding, Frame, Language, Layout, Lighting, Method, Morphs, Stage
from skinbake.commands.shader import ShaderResult, shader
from skinbake.errors import ChoiceError
from skinbake.geometry.morphs import Differences, MorphTarget, MorphTargets
from skinbake.shaders.choices import ALGORITHMS, ShaderChoices, ShaderRequest
from skinbake.skinning.morphs import morphed
from skinbake.skinning.rest import Algorithm, RestPrimitive
from tests.shaders.combinations import label, motion_kind
from tests.shaders.judged import TOLERANCE, term_lengths
from tests.shaders.running import done
from tests.shaders.scenes import Scene, Wide, irregular
from tests.support import analytic, corpus, dxc, glslang, gltf_transform, opengl, webgpu
from tests.support.baked_files import REPOSITORY, Editable
from tests.support.command_line import invoke
from tests.support.gltf_reading import GltfFile, read
from tests.support.models import Change, Part, in_two_sets, sheet, tangents_along, write_model
from tests.support.replay import replay
from tests.support.whole_fields import shader_text

SIZES = {5121: 1, 5120: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
"""The bytes of glTF's component types."""

Single = npt.NDArray[np.float32]

WORKGROUP = 64
ABSENT = 0xFFFFFFFF
SCALE = 2.5
MOVES = np.array([0.7, -0.4, 0.3])
"""The weights of three morph targets; the second moves no normal, the third no position and no tangent."""


def case(method: Method = Method.LBS, lighting: Lighting = Lighting.ACCURATE, **others: Any) -> ShaderChoices:
    return ShaderChoices(Language.WGSL, method, lighting, stage=Stage.COMPUTE, **others)


CASES = [
    *(
        case(method, lighting, frame=frame)
        for (method, lighting), frame in zip(ALGORITHMS, [Frame.NORMAL, Frame.TANGENT] * 3, strict=True)
    ),
    case(influences=1),
    case(influences=8, frame=Frame.TANGENT),
    case(influences=7, mirrored_joints=True, cap=0.9),
    case(Method.DQS, Lighting.EXACT, scaled_joints=True, mirrored_joints=True, frame=Frame.TANGENT),
    case(encoding=Encoding.SNORM16, influences=8),
    case(encoding=Encoding.PACKED8, scale=SCALE, frame=Frame.TANGENT),
    case(layout=Layout.TEXCOORD, influences=8, frame=Frame.TANGENT),
    case(layout=Layout.CUSTOM, encoding=Encoding.PACKED8),
    case(morphs=Morphs.NORMAL),
    case(Method.DQS, Lighting.EXACT, morphs=Morphs.TANGENT, frame=Frame.TANGENT),
    case(morphs=Morphs.FRAMES, frame=Frame.TANGENT),
    case(morphs=Morphs.FRAMES_NORMAL),
]
"""Each algorithm, frame, count of sets, storage and kind of morph at least once."""


@dataclass(frozen=True)
class Pass:
    """One dispatch: its buffers, and the vectors (V, 4, 3) that it should give with their tolerances."""

    draw: bytes
    geometry: bytes
    joints: bytes
    targets: bytes
    expected: Wide
    lengths: Wide

    def job(self, code: str | bytes) -> webgpu.Job:
        count = len(self.expected)
        further = (self.targets,) if self.targets else ()
        given = self.draw, self.geometry, self.joints
        # A row more than there are vertices, which the pass must leave alone.
        return webgpu.Job(code, given, POSED.stride * (count + 1), -(-count // WORKGROUP), further)


@dataclass(frozen=True)
class Posed:
    """Where the results go, in bytes."""

    stride: int
    position: int
    normal: int
    tangent: int


POSED = Posed(stride=52, position=4, normal=20, tangent=36)


class Geometry:
    """A buffer as glTF has it: some attributes interleaved, with gaps that hold NaN, others one by one."""

    def __init__(self) -> None:
        self.data = bytearray(b"\xff" * 12)

    def add(self, *columns: npt.NDArray[Any], gap: int = 0) -> list[tuple[int, int]]:
        """Interleave columns (V, C) of any type. Return offset and stride of each in bytes."""
        rows = [np.ascontiguousarray(column).view(np.uint8).reshape(len(column), -1) for column in columns]
        rows = [np.pad(row, ((0, 0), (0, -row.shape[1] % 4)), constant_values=255) for row in rows]
        stride, start = sum(row.shape[1] for row in rows) + gap, len(self.data)
        starts = start + np.cumsum([0, *(row.shape[1] for row in rows)])[:-1]
        filler = np.full((len(rows[0]), gap), 255, np.uint8)
        self.data += np.concatenate([*rows, filler], axis=1).tobytes()
        return [(int(at), stride) for at in starts]


def stored(choices: ShaderChoices, scene: Scene, rng: np.random.Generator) -> tuple[Scene, dict[str, Any]]:
    """Return attributes of α and β by the names of the pass, and the scene with the values that they mean."""
    count, width = len(scene.positions), 4 * choices.influence_sets
    kinds = {"alpha": scene.alpha, "beta": scene.beta}
    if not choices.reads_gradients:
        return scene, {}
    found: dict[str, Any] = {}
    means: dict[str, Single] = {}
    if choices.decodes:
        limit, kind = (127, np.int8) if choices.encoding == Encoding.PACKED8 else (32767, np.int16)
        for name in kinds:
            # Integers of all sizes, and the one below the least that normalised values have.
            whole = rng.integers(-limit - 1, limit + 1, (count, width)).astype(kind)
            whole[0] = -limit - 1
            values = np.maximum(whole.astype(np.float64) / limit, -1.0)
            means[name] = (SCALE * values[:, 3:4] ** 2 * np.delete(values, 3, axis=1)).astype(np.float32)
            for number in range(choices.influence_sets):
                found[f"stored_{name}_{number}"] = whole[:, 4 * number : 4 * number + 4]
        means = {name: values[:, : choices.influences - 1] for name, values in means.items()}
        return replace(scene, alpha=means["alpha"], beta=means["beta"]), found
    padded = {
        name: np.pad(values, ((0, 0), (0, width - 1 - values.shape[1]))) for name, values in kinds.items()
    }
    if choices.assembles:
        row = np.concatenate([padded["alpha"], padded["beta"]], axis=1)
        return scene, {f"texcoord_{n + 1}": row[:, 2 * n : 2 * n + 2] for n in range(width - 1)}
    for name, values in padded.items():
        starts = [0, *range(3, width - 1, 4)]
        for number, start in enumerate(starts):
            found[f"{name}_{number}"] = values[:, start : start + (4 if number else 3)]
    return scene, found


def moved(choices: ShaderChoices, scene: Scene, rng: np.random.Generator) -> tuple[RestPrimitive, list[Any]]:
    """Return the primitive under morph targets, and by target the differences of each attribute, or None.

    The attributes are those of a target of the pass. The choices say which of them the frame follows.
    """
    count, kind = len(scene.positions), choices.morphs
    held: list[list[Any]] = [
        [rng.normal(scale=0.2, size=(count, size)).astype(np.float32) for size in (3, 3, 3, 4, 2)]
        for _ in MOVES
    ]
    held[1][1] = held[2][0] = held[2][2] = held[2][3] = held[2][4] = None
    reads = (True, kind is not Morphs.FRAMES, kind is Morphs.TANGENT, kind.moves_frame, kind is Morphs.FRAMES)
    targets = tuple(
        MorphTarget(
            *(
                Differences.of(np.zeros((count, size), np.float32) if one is None or not is_read else one)
                for one, size, is_read in zip(target, (3, 3, 3, 4, 2), reads, strict=True)
            )
        )
        for target in held
    )
    numbers = {Morphs.FRAMES: 6, Morphs.FRAMES_NORMAL: 4}.get(kind, 0)
    every = MorphTargets(targets, kind is Morphs.TANGENT, numbers)
    return morphed(scene.rest(choices), every, MOVES, dtype=np.float32), held


def pass_of(choices: ShaderChoices, number: int) -> Pass:
    """Make the pass of a case. The types of joints and weights and the pose differ from case to case."""
    rng = np.random.default_rng(number)
    scene = irregular(choices.influences, stretches=motion_kind(choices) != "dqs")
    pose = 2 if motion_kind(choices) == "dqs" else (0, 1, 3, 4)[number % 4] if choices.crosses else 0
    if choices.influences == 7:
        pose = 4  # mirrors
    joint_type, top = (np.uint8, np.uint16, np.uint32)[number // 2 % 3], (0, 255, 65535)[number % 3]
    count, width = len(scene.positions), 4 * choices.influence_sets
    weights: npt.NDArray[Any] = scene.weights.copy()
    if top:
        weights = np.round(scene.weights * top).astype(np.uint8 if top == 255 else np.uint16)
        scene = replace(scene, weights=(weights / top).astype(np.float32))
    # A vertex without any weight is bound to the joint of slot 0.
    weights[1], scene = 0, replace(scene, weights=scene.weights.copy())
    scene.weights[1] = np.eye(choices.influences)[0]
    scene, slopes = stored(choices, scene, rng)
    wide = {"joints": scene.joints.astype(joint_type), "weights": weights}
    sets = {
        f"{name}_{n}": np.pad(one, ((0, 0), (0, width - one.shape[1])))[:, 4 * n : 4 * n + 4]
        for name, one in wide.items()
        for n in range(choices.influence_sets)
    }
    geometry, places = Geometry(), dict[str, tuple[int, int]]()
    # NORMAL has any length in files, and one of 0 stands for (0, 0, 1).
    lengths = rng.uniform(0.03, 30.0, (count, 1)).astype(np.float32)
    lengths[0] = 0.0
    scene = replace(scene, normals=scene.normals.copy())
    scene.normals[0] = 0.0, 0.0, 1.0
    rest = {"position": scene.positions, "normal": scene.normals * lengths}
    rest |= {"tangent": scene.tangents} if choices.frame == Frame.TANGENT else {}
    places |= dict(zip(rest, geometry.add(*rest.values(), gap=8), strict=True))
    for name, column in {**sets, **slopes}.items():
        [places[name]] = geometry.add(column, gap=4 * (number % 2))
    # Morph targets
    targets, primitive = b"", scene.rest(choices)
    if choices.morphs is not Morphs.NONE:
        primitive, held = moved(choices, scene, rng)
        for weight, target in zip(MOVES, held, strict=True):
            ends = [(ABSENT, 0) if one is None else geometry.add(one)[0] for one in target]
            targets += np.float32(weight).tobytes() + bytes(4) + np.array(ends, np.uint32).tobytes()
    # The numbers of the primitive, in the order of the text
    numbers = {
        "vertices": count,
        "targets": len(targets) // 48,
        "joint_size": np.dtype(joint_type).itemsize,
        "weight_size": weights.dtype.itemsize,
        "posed_stride": POSED.stride,
        "posed_position": POSED.position,
        "posed_normal": POSED.normal,
        "posed_tangent": ABSENT if number == 0 else POSED.tangent,
    }
    scales = {"scale": SCALE, "joint_scale": scene.scale(choices)[pose]}
    assert members(choices) == [*numbers, *scales, *places]
    draw = np.array([*numbers.values()], np.uint32).tobytes() + np.array([*scales.values()], "f4").tobytes()
    draw += np.array([*places.values()], np.uint32).tobytes()
    draw += bytes(-len(draw) % 16)
    # What it should give
    matrices = scene.matrices[pose : pose + 1]
    found = replay(Algorithm(choices.algorithm), primitive, matrices, cap=choices.cap)
    vectors = [found.positions, found.normals, found.tangents, found.bitangents]
    expected = np.stack([one[0].astype(np.float64) for one in vectors], axis=1)
    if choices.mirrored_joints:
        expected[:, 1] *= np.sign(np.linalg.det(matrices[0, :, :3, :3].astype(np.float64)))[
            scene.joints[:, :1]
        ]
    vertex = replace(choices, stage=Stage.VERTEX, morphs=Morphs.NONE)
    here = replace(scene, matrices=matrices, positions=primitive.positions.astype(np.float32))
    joints = replace(scene, matrices=matrices).motions(vertex).tobytes()
    return Pass(draw, bytes(geometry.data), joints, targets, expected, term_lengths(vertex, here))


def members(choices: ShaderChoices) -> list[str]:
    """Return the numbers of a primitive in the order of the text, the same in all languages."""
    found = []
    for language, start in (
        (Language.WGSL, "struct skinbake_Draw {"),
        (Language.GLSL, "uniform skinbake_Draw {"),
        (Language.HLSL, "cbuffer skinbake_Draw : register(b0) {"),
    ):
        text = shader_text(replace(choices, language=language))
        block = text.partition(start)[2].partition("}")[0]
        words = re.findall(r"\w+(?=:)|\w+(?=;)", block)
        found.append([word.removeprefix("skinbake_draw_") for word in words])
    assert found[0] == found[1] == found[2]
    return found[0]


def spirv_of_glsl(text: str) -> bytes:
    return glslang.spirv(text, "comp")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("language", "compiled", "implementation"),
    [
        (Language.WGSL, None, webgpu.NAGA),
        (Language.WGSL, None, webgpu.TINT),
        (Language.GLSL, spirv_of_glsl, webgpu.NAGA),
        (Language.HLSL, glslang.spirv_of_hlsl, webgpu.NAGA),
        (Language.HLSL, dxc.spirv, webgpu.NAGA),
    ],
    ids=["wgsl-naga", "wgsl-tint", "glsl", "hlsl-glslang", "hlsl-dxc"],
)
def test_a_pass_gives_what_the_replay_gives(
    language: Language, compiled: Callable[[str], bytes] | None, implementation: webgpu.Implementation
) -> None:
    passes = {f"{number} {label(choices)}": pass_of(choices, number) for number, choices in enumerate(CASES)}
    jobs = {}
    for (name, one), choices in zip(passes.items(), CASES, strict=True):
        text = shader_text(replace(choices, language=language))
        module = compiled(text) if compiled else b""
        assert not module or glslang.invalid(module) == "", name
        jobs[name] = one.job(module or text)
    answers = webgpu.answers(implementation, jobs)
    for number, (name, one) in enumerate(passes.items()):
        assert_like_the_replay(name, done(name, answers[name]), one, leaves_out_tangents=number == 0)


@pytest.mark.slow
def test_a_pass_compiles_for_direct3d() -> None:
    for choices in CASES:
        text = shader_text(replace(choices, language=Language.HLSL))
        assert dxc.dxil(text).startswith(dxc.CONTAINER), label(choices)


@pytest.mark.slow
def test_a_pass_in_opengl_gives_what_the_replay_gives() -> None:
    with opengl.context("desktop") as context:
        for number, choices in enumerate(CASES):
            one = pass_of(choices, number)
            text, job = shader_text(replace(choices, language=Language.GLSL)), one.job("")
            # Its own comments come before the version, which Mesa takes as well.
            storage: list[bytes | int] = [*job.buffers[1:], job.result_bytes, *job.further]
            found = context.compute(text, job.buffers[0], storage, job.workgroups)
            assert_like_the_replay(label(choices), found, one, leaves_out_tangents=number == 0)


BINDING = {
    Language.GLSL: r"\bbinding = (\d)",
    Language.WGSL: r"@binding\((\d)\)",
    Language.HLSL: r"register\(\w(\d)\)",
}


@pytest.mark.parametrize("choices", CASES, ids=label)
def test_the_page_explains_the_bindings_and_the_numbers_of_the_pass(choices: ShaderChoices) -> None:
    page = (REPOSITORY / "docs" / "shaders.md").read_text("utf-8")
    assert re.search(r"has four\s+bindings, five with morph targets", page)
    for language, pattern in BINDING.items():
        text = shader_text(replace(choices, language=language))
        expected = "01234" if choices.morphs is not Morphs.NONE else "0123"
        assert re.findall(pattern, text) == list(expected)
    table = page.partition("| field of `skinbake_Draw`")[2].partition("\n\n")[0]
    first = [name for row in table.splitlines()[2:] for name in re.findall(r"`(\w+)`", row.split("|")[1])]
    numbers = members(choices)
    assert first[:10] == numbers[:10]
    assert {re.sub(r"\d+$", "0", name) for name in numbers[10:]} <= set(first[10:])
    if choices.morphs is not Morphs.NONE:
        told = page.partition("An entry of `skinbake_Target`")[2].partition("\n\n")[0]
        target = shader_text(choices).partition("struct skinbake_Target {")[2].partition("}")[0]
        assert re.findall(r"(\w+): vec2<u32>", target) == re.findall(r"`(\w+)`", told)[1:]


def assert_the_normals_of(path: Path) -> None:
    """Check that one text of --for reads the file's own bytes, and gives ``skinbake.normals`` everywhere."""
    made = shader(ShaderRequest(Language.WGSL, stage=Stage.COMPUTE), str(path))
    assert made.notices == ()
    everything = {str(number): posed for number, posed in enumerate(skinbake.normals(path))}
    jobs = {name: over_file(read(path), posed, made) for name, posed in everything.items()}
    for name, answer in webgpu.answers(webgpu.NAGA, jobs).items():
        posed = everything[name]
        found = np.frombuffer(done(name, answer), np.float32).reshape(-1, 6)
        assert np.abs(found[:, :3] - posed.positions).max() < 1e-5
        assert analytic.degrees_between(found[:, 3:], posed.normals["accurate"]).max() < 0.02


def over_file(file: GltfFile, posed: skinbake.PosedNormals, made: ShaderResult) -> webgpu.Job:
    """Return the dispatch for one primitive in a pose, over the buffer of its file."""
    primitive = file.content["meshes"][posed.mesh]["primitives"][posed.primitive]

    def place(accessor: int) -> tuple[int, int]:
        found = file.content["accessors"][accessor]
        view = file.content["bufferViews"][found["bufferView"]]
        packed = SIZES[found["componentType"]] * int(found["type"][-1])
        return view.get("byteOffset", 0) + found.get("byteOffset", 0), view.get("byteStride", packed)

    accessors = {key.lower().removeprefix("_skinbake_"): one for key, one in primitive["attributes"].items()}
    sizes = {
        kind: SIZES[file.content["accessors"][accessors[kind]]["componentType"]]
        for kind in ("joints_0", "weights_0")
    }
    targets = b""
    for weight, target in zip(posed.morph_weights, primitive.get("targets", []), strict=True):
        names = ("POSITION", "NORMAL", "TANGENT", "_SKINBAKE_MORPH", "_SKINBAKE_MORPH_UP")
        ends = [place(target[key]) if key in target else (ABSENT, 0) for key in names]
        targets += np.float32(weight).tobytes() + bytes(4) + np.array(ends, np.uint32).tobytes()
    count = len(posed.positions)
    numbers = {
        **{"vertices": count, "targets": len(posed.morph_weights)},
        **{"joint_size": sizes["joints_0"], "weight_size": sizes["weights_0"]},
        **{"posed_stride": 24, "posed_position": 0, "posed_normal": 12, "posed_tangent": ABSENT},
    }
    draw = np.array([*numbers.values()], np.uint32).tobytes() + np.array([0.0, 1.0], np.float32).tobytes()
    for member in members(made.choices)[10:]:
        draw += np.array(place(accessors[member.removeprefix("stored_")]), np.uint32).tobytes()
    joints = posed.joint_matrices.transpose(0, 2, 1).astype(np.float32).tobytes()
    further = (targets,) if made.choices.morphs is not Morphs.NONE else ()
    given = draw + bytes(-len(draw) % 16), file.buffer(0), joints
    return webgpu.Job(made.text, given, 24 * count, -(-count // WORKGROUP), further)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("bent_tube.glb", {}),
        ("weights_u8.glb", {"encoding": "packed8"}),
        ("two_sets.glb", {"encoding": "snorm16"}),
        ("morphed_sheet.glb", {"morph_frames": True}),
    ],
)
def test_a_pass_over_the_buffer_of_a_file_gives_its_normals(
    name: str, options: dict[str, Any], tmp_path: Path
) -> None:
    path = tmp_path / name
    skinbake.bake(FOLDER / name, path, **options)
    assert_the_normals_of(path)


def in_a_mesh_of_its_own(content: JsonObject) -> None:
    """Move the second primitive of a model into a second mesh, with a node and the same skin."""
    body = content["nodes"][content["scenes"][0]["nodes"][0]]
    content["meshes"].append({"name": "eye", "primitives": [content["meshes"][0]["primitives"].pop()]})
    content["nodes"].append({"name": "eye", "mesh": 1, "skin": body["skin"]})
    content["scenes"][0]["nodes"].append(len(content["nodes"]) - 1)


def leaning(part: Part) -> dict[str, AnyArray]:
    tangents = tangents_along(part)
    tangents[:, :3] += part.attributes["NORMAL"]
    return {"TANGENT": tangents}


ALONG = {"TANGENT": tangents_along(sheet())}
KINDS: dict[str, tuple[list[Part], str]] = {
    "TANGENT on one primitive": ([sheet(), sheet(**ALONG)], "--frame normal"),
    "TANGENT that leans on one primitive": ([sheet(**leaning(sheet())), sheet(**ALONG)], "--frame normal"),
    "one and two sets of influences": ([sheet(), in_two_sets(sheet())], "--limit-influences 4"),
    "both": ([in_two_sets(sheet()), sheet(**ALONG)], "--frame normal --limit-influences 4"),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "change"),
    [("", None), ("--encoding packed8", in_a_mesh_of_its_own), ("--layout texcoord", in_a_mesh_of_its_own)],
)
@pytest.mark.parametrize("kind", KINDS)
def test_the_bake_that_the_error_names_gives_one_shader_for_all_primitives(
    kind: str, options: str, change: Change | None, tmp_path: Path
) -> None:
    parts, expected = KINDS[kind]
    source, target = write_model(tmp_path / "several.glb", parts, change=change), tmp_path / "baked.glb"
    assert invoke("bake", source, "-o", target, *options.split()).exit_code == 0
    refused = invoke("shader", "--lang", "glsl", "--for", target)
    assert refused.exit_code == 3
    [command] = re.findall(r"run skinbake (.*?), with the other options as before", refused.stderr)
    assert command == f"bake {expected}"
    assert invoke(*command.split(), *options.split(), source, "-o", target).exit_code == 0
    for language in ("glsl", "wgsl", "hlsl"):
        result = invoke("shader", "--lang", language, "--for", target)
        assert (result.exit_code, "shader-not-for" in result.stderr) == (0, False), result.stderr
    assert_the_normals_of(target)


@corpus.needed
@pytest.mark.slow
def test_an_avatar_with_tangent_on_one_mesh_gets_one_shader_in_place(tmp_path: Path) -> None:
    path = tmp_path / "avatar.glb"
    source = corpus.require_corpus() / "cases" / "turn4" / "tangent_on_one_mesh.glb"
    assert invoke("bake", source, "-o", path).exit_code == 0
    refused = invoke("shader", "--lang", "glsl", "--for", path)
    [command] = re.findall(r"run skinbake (.*?), with", refused.stderr)
    assert invoke(*command.split(), "--in-place", path).exit_code == 0
    assert_the_normals_of(path)


@pytest.mark.parametrize(
    ("name", "options", "told"),
    [
        ("bent_tube.glb", {}, ""),
        ("weights_u8.glb", {"encoding": "packed8"}, ""),
        ("bent_tube.glb", {"compress": "meshopt"}, "EXT_meshopt_compression"),
        ("bent_tube.glb", {"compress": "draco"}, "KHR_draco_mesh_compression"),
    ],
)
def test_what_no_pass_can_read_as_it_is_in_the_file_is_told(
    name: str, options: dict[str, Any], told: str, tmp_path: Path
) -> None:
    skinbake.bake(FOLDER / name, tmp_path / name, **options)
    made = shader(ShaderRequest(Language.HLSL, stage=Stage.COMPUTE), str(tmp_path / name))
    messages = [notice.message for notice in made.notices if notice.code == "pass-reads-plain"]
    assert len(messages) == bool(told)
    assert all(f"has others ({told})" in message for message in messages)
    assert not shader(ShaderRequest(Language.HLSL), str(tmp_path / name)).notices


def test_a_sparse_attribute_of_a_pass_is_told(tmp_path: Path) -> None:
    path = tmp_path / "tube.glb"
    skinbake.bake(FOLDER / "bent_tube.glb", path)
    file = Editable(path)
    accessors, primitive = file.content["accessors"], file.content["meshes"][0]["primitives"][0]
    number = primitive["attributes"]["_SKINBAKE_ALPHA_0"]
    accessors[number]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": accessors[primitive["indices"]]["bufferView"], "componentType": 5123},
        "values": {"bufferView": accessors[number]["bufferView"]},
    }
    request = ShaderRequest(Language.HLSL, stage=Stage.COMPUTE)
    [told] = [one.message for one in shader(request, str(file.write(path))).notices]
    assert "(sparse _SKINBAKE_ALPHA_0)" in told


@pytest.mark.slow
def test_quantised_attributes_of_a_pass_are_told(tmp_path: Path) -> None:
    small, path = tmp_path / "small.glb", tmp_path / "tube.glb"
    assert gltf_transform.run(["quantize", FOLDER / "bent_tube.glb", small]).returncode == 0
    skinbake.bake(small, path)
    [told] = shader(ShaderRequest(Language.HLSL, stage=Stage.COMPUTE), str(path)).notices
    assert "(quantised NORMAL, quantised POSITION)" in told.message


def assert_like_the_replay(name: str, results: bytes, given: Pass, *, leaves_out_tangents: bool) -> None:
    rows = np.frombuffer(results, np.float32).reshape(-1, POSED.stride // 4)
    touched = np.zeros(rows.shape, np.bool_)
    for start, size in ((POSED.position, 3), (POSED.normal, 3), (POSED.tangent, 4)):
        if not (leaves_out_tangents and start == POSED.tangent):
            touched[:-1, start // 4 : start // 4 + size] = True
    assert not rows[~touched].any(), f"{name}: it writes what it should not"
    position, normal, tangent = (
        rows[:-1, start // 4 :][:, :3] for start in (POSED.position, POSED.normal, POSED.tangent)
    )
    tolerances = TOLERANCE * given.lengths
    # Written so that NaN fails.
    apart = np.linalg.norm(position - given.expected[:, 0], axis=1)
    assert (apart <= tolerances[:, 0]).all(), f"{name}: a position is off by {np.nanmax(apart)}"
    for at, found in ((1, normal), (2, tangent)):
        if at == 2 and leaves_out_tangents:
            continue
        own = np.linalg.norm(given.expected[:, at], axis=1, keepdims=True)
        apart = np.linalg.norm(found - given.expected[:, at] / own, axis=1)
        allowed = 2 * tolerances[:, at] / own[:, 0] + TOLERANCE
        assert (apart <= allowed).all(), f"{name}: vector {at} is off by {np.nanmax(apart / allowed)} times"
    if not leaves_out_tangents:
        _, n, t, b = given.expected.transpose(1, 0, 2)
        sides = np.einsum("vi,vi->v", np.cross(t, b), n)
        clear = np.abs(sides) > 1e-3 * np.linalg.norm(t, axis=1) * np.linalg.norm(b, axis=1) * np.linalg.norm(
            n, axis=1
        )
        assert (rows[:-1, POSED.tangent // 4 + 3][clear] == np.sign(sides[clear])).all(), name


@pytest.mark.slow
def test_the_cases_have_what_they_are_for() -> None:
    assert {choices.algorithm for choices in CASES} == {1, 2, 3, 4, 5, 6}
    assert {choices.influence_sets for choices in CASES} == {1, 2}
    given: Mapping[str, Pass] = {str(n): pass_of(one, n) for n, one in enumerate(CASES)}
    frames = {
        np.sign(
            np.einsum("vi,vi->v", np.cross(one.expected[:, 2], one.expected[:, 3]), one.expected[:, 1])
        ).min()
        for one in given.values()
    }
    assert frames == {-1.0, 1.0}


@pytest.mark.parametrize(
    ("others", "message"),
    [
        ({"normal_map": True}, "stage='compute' contradicts normal_map"),
        ({"target": "three"}, "stage='compute' needs target='plain', not three"),
    ],
)
def test_what_no_pass_does_is_refused(others: dict[str, Any], message: str) -> None:
    with pytest.raises(ChoiceError) as caught:
        case(**others)
    assert str(caught.value) == message
