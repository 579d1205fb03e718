"""What gltfpack, three.js and pygltflib do to a file before and after its bake, each of them really run.

docs/order.md has the table.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pygltflib
import pytest

from skinbake.choices import FrameChoice
from tests.measure.replay import accurate_normals, largest_angle
from tests.support import corpus, gltf_reading, gltf_transform
from tests.support.baked_files import CESIUM_MAN, Editable, baked, source, verify
from tests.support.command_line import invoke
from tests.support.models import bake
from tests.support.node import SUPPORT, require_node, run_program

REST = ("--poses", "rest")
Tool = Callable[[Path, Path], None]


def gltfpack(*options: str) -> Tool:
    def run(before: Path, after: Path) -> None:
        arguments = ("-i", str(before), "-o", str(after), *options)
        run_program("gltfpack", "../cli.js", *arguments, folder=after.parent)

    return run


def three(before: Path, after: Path) -> None:
    command = [require_node("three"), str(SUPPORT / "three_copy.mjs"), str(before), str(after)]
    subprocess.run(command, check=True, timeout=300)


def pygltflib_copy(before: Path, after: Path) -> None:
    pygltflib.GLTF2().load(str(before)).save(str(after))


TEN = [
    *("AFrameHands/leftHandLow.glb", "Alien/Alien_Scolitex.gltf", "BaseFemale/BaseFemale.glb", CESIUM_MAN),
    *("Mannequiny/mannequiny-0.3.0.glb", "RiggedFigure/RiggedFigure.gltf", "Robot/robot.glb"),
    *("Spider/gltf_spider_animated.gltf", "XRHand/hand_l.gltf", "hand_l-weights-u8.glb"),
]
MOVING = [
    *("AFrameHands/leftHandLow.glb", "Alien/Alien_Scolitex.gltf", "BathDay/bath_day.glb", CESIUM_MAN),
    *("Butterfly/animated_butterfly.glb", "Mannequiny/mannequiny-0.3.0.glb", "RiggedElf/RiggedElf.gltf"),
    *("RiggedFigure/RiggedFigure.gltf", "Robot/robot.glb", "RobotMantis/animated_robot_mantis.glb"),
]
"""Ten characters with clips that play correctives."""

UNCHANGED = {
    *(("Robot/robot.glb", "simplify"), ("BathDay/bath_day.glb", "draco")),
    *(("Spider/gltf_spider_animated.gltf", tool) for tool in ("draco", "meshopt", "simplify")),
}
"""Where these tools change nothing that counts; α and β of the spider are 0."""

PASSING = [
    *("copy", "dedup", "center", "instance", "flatten", "join", "dequantize", "resample", "sparse"),
    *("metalrough", "unlit", "palette", "weld", "unweld", "reorder", "tangents", "prune"),
]
FAILING = ["quantize", "draco", "meshopt", "simplify"]
OPTIMIZE = ("--compress", "false", "--simplify", "false", "--texture-compress", "false")
PACKS = [(), ("-noq",), ("-c",), ("-noq", "-kv")]


@pytest.mark.slow
@pytest.mark.parametrize(
    "tool",
    [*(gltfpack(*options) for options in PACKS), gltfpack("-si", "0.5"), three, pygltflib_copy],
    ids=[*(" ".join(("gltfpack", *options)) for options in PACKS), "gltfpack -si 0.5", "three", "pygltflib"],
)
@pytest.mark.parametrize("name", ["bent_tube.glb", "weights_u8.glb"])
def test_before_the_bake_each_may_run(tool: Tool, name: str, tmp_path: Path) -> None:
    tool(source(name), tmp_path / name)
    answer = verify(baked(tmp_path / name, tmp_path / "baked"), *REST)
    assert answer.exit_code == 0, answer.messages


@pytest.mark.slow
@pytest.mark.parametrize("options", PACKS)
def test_gltfpack_drops_a_bake_and_only_limits_fail(options: tuple[str, ...], tmp_path: Path) -> None:
    target = tmp_path / "packed.glb"
    gltfpack(*options)(baked(source("bent_tube.glb"), tmp_path), target)
    answer = verify(target, *REST)
    assert (answer.exit_code, [one["code"] for one in answer.file["warnings"]]) == (0, ["not-baked"])
    assert verify(target, *REST, "--require-baked").exit_code == 1
    assert verify(target, *REST, "--min-gain", "1.5").exit_code == 1


@pytest.mark.slow
def test_gltfpack_that_keeps_extras_leaves_a_note_without_a_bake(tmp_path: Path) -> None:
    target = tmp_path / "packed.glb"
    gltfpack("-noq", "-kv", "-ke")(baked(source("bent_tube.glb"), tmp_path), target)
    answer = verify(target, *REST)
    assert (answer.exit_code, answer.failed) == (1, ["structure"])
    assert {problem["code"] for problem in answer.problems("structure")} == {"attribute-missing"}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["foreign_joints.glb", "weights_u8.glb", "mirrored_tangent.glb"])
@pytest.mark.parametrize("tool", [three, pygltflib_copy])
def test_three_and_pygltflib_leave_a_bake_fresh(tool: Tool, name: str, tmp_path: Path) -> None:
    target = tmp_path / "copy.glb"
    tool(baked(source(name), tmp_path), target)
    assert "_SKINBAKE_ALPHA_0" in Editable(target).primitive()["attributes"]
    answer = verify(target, *REST)
    assert answer.exit_code == 0, answer.messages


@pytest.mark.slow
def test_three_divides_float_weights_by_their_sum(tmp_path: Path) -> None:
    """Its loader does, and the last bits change. α and β fit the weights that are in the file now."""
    target = tmp_path / "copy.glb"
    three(baked(source("bent_tube.glb"), tmp_path), target)
    answer = verify(target, *REST)
    assert answer.exit_code == 0, answer.messages
    assert [check["remark"] for check in answer.file["checks"] if check["name"] == "freshness"] == [
        "WEIGHTS changed since the bake, and α/β still fit"
    ]


def test_a_rigid_part_may_follow_another_joint(tmp_path: Path) -> None:
    """Its α and β are 0 with either joint. So the lighting is that of a bake of the edited file."""
    model = Editable(source("bent_tube.glb"))
    model.array("JOINTS_0")[:] = [0, 2, 0, 0]
    model.array("WEIGHTS_0")[:] = [1.0, 0.0, 0.0, 0.0]
    edited = Editable(baked(model.write(tmp_path / "rigid.glb"), tmp_path / "baked"))
    edited.array("WEIGHTS_0")[:, :2] = [0.0, 1.0]
    changed = edited.write(tmp_path / "edited.glb")
    answer = verify(changed, *REST)
    assert answer.exit_code == 0, answer.messages
    again = baked(changed, tmp_path / "again")
    assert largest_angle(accurate_normals(changed), accurate_normals(again)) < 0.01


def after_tools(path: Path, number: int) -> dict[str, Path]:
    """Run tools of docs/order.md that do not drop the metadata on a file. Return what each wrote.

    Every second of those that make a bake stale runs, and every third of the others, from number on: three
    characters in turn meet them all.
    """
    some = (*FAILING[number % 2 :: 2], *(*PASSING, "optimize", "pygltflib")[number % 3 :: 3])
    found = {tool: path.with_name(f"{tool}.glb") for tool in some}
    assert not any(
        gltf_transform.transform(
            [(path, target, tool) for tool, target in found.items() if tool in (*PASSING, *FAILING)]
        )
    )
    if "optimize" in found:
        process = gltf_transform.run(["optimize", path, found["optimize"], *OPTIMIZE])
        assert process.returncode == 0, process.stderr
    if "pygltflib" in found:
        pygltflib_copy(path, found["pygltflib"])
    return found


@pytest.mark.slow
@corpus.needed
@pytest.mark.parametrize(("number", "name"), list(enumerate(TEN)))
def test_characters_stay_fresh_after_tools_that_only_move_data(
    number: int, name: str, tmp_path: Path
) -> None:
    """docs/order.md lists these tools. A shader is made for what each of those that pass writes."""
    path = tmp_path / "baked.glb"
    assert bake(corpus.model(name), path, frame=FrameChoice.NORMAL).status == "baked"
    assert verify(path, *REST).exit_code == 0
    for tool, target in after_tools(path, number).items():
        answer = verify(target, *REST)
        is_stale = tool in FAILING and (name, tool) not in UNCHANGED
        assert answer.exit_code == is_stale, (tool, answer.messages)
        if is_stale:
            continue
        shader = invoke("shader", "--for", target, "--lang", "glsl", "-o", tmp_path / "skin.glsl")
        # No light reaches an unlit material, so there is no shader for it. The tool makes none.
        made_unlit = tool == "unlit" and gltf_reading.read(target).content.get("materials")
        assert (shader.exit_code == 0) == (not made_unlit), (tool, shader.stderr)


@pytest.mark.slow
@corpus.needed
@pytest.mark.parametrize(("number", "name"), list(enumerate(MOVING)))
def test_correctives_of_characters_stay_fresh_after_tools_that_only_move_data(
    number: int, name: str, tmp_path: Path
) -> None:
    path = tmp_path / "baked.glb"
    result = invoke("bake", corpus.model(name), "-o", path, "--correctives", "auto")
    assert result.exit_code == 0 and "corrective normal" in result.output, result.output
    for tool, target in after_tools(path, number).items():
        answer = verify(target, *REST)
        is_stale = tool in FAILING and (name, tool) not in UNCHANGED
        assert answer.exit_code == is_stale, (tool, answer.messages)
        codes = {one["code"] for one in answer.problems("freshness")}
        assert codes <= {"stale", "stale-clips"} and ("stale" in codes) == is_stale, (tool, codes)


@pytest.mark.slow
@pytest.mark.parametrize(
    "tool", [three, gltfpack(), gltfpack("-noq", "-kv", "-ke")], ids=["three", "gltfpack", "gltfpack -ke"]
)
def test_tools_that_drop_the_metadata_leave_correctives_as_no_bake(tool: Tool, tmp_path: Path) -> None:
    path, target = tmp_path / "baked.glb", tmp_path / "copy.glb"
    assert invoke("bake", source("bent_tube.glb"), "-o", path, "--correctives", "auto").exit_code == 0
    tool(path, target)
    answer = verify(target, *REST)
    assert (answer.exit_code, [one["code"] for one in answer.file["warnings"]]) == (0, ["not-baked"])


@pytest.mark.slow
@pytest.mark.parametrize("case", ["weld", "resample"])
def test_correctives_stay_fresh_after_a_tool_that_made_a_report(case: str, tmp_path: Path) -> None:
    path, target = tmp_path / "baked.glb", tmp_path / f"{case}.glb"
    given = corpus.case(f"turn4/{case}_after_correctives.glb")
    assert invoke("bake", given, "-o", path, "--correctives", "auto").exit_code == 0
    assert gltf_transform.transform([(path, target, case)]) == [""]
    assert verify(path).exit_code == 0
    answer = verify(target)
    assert answer.exit_code == 0, answer.messages


def submeshes(folder: Path) -> Path:
    """Write a tube as two primitives that share their vertices, in the order of their first use."""
    model = Editable(source("bent_tube.glb"))
    primitive = model.primitive()
    indices = model.stored(primitive["indices"]).reshape(-1)
    order = indices[np.sort(np.unique(indices, return_index=True)[1])]
    rank = np.empty(len(order), indices.dtype)
    rank[order] = np.arange(len(order))
    for accessor in primitive["attributes"].values():
        array = model.stored(accessor)
        array[:] = array[order]
    indices[:] = rank[indices]
    accessors = model.content["accessors"]
    first = accessors[primitive["indices"]]
    half = first["count"] // 6 * 3
    offset = first.get("byteOffset", 0) + half * indices.itemsize
    accessors.append({**first, "byteOffset": offset, "count": first["count"] - half})
    first["count"] = half
    second = {**primitive, "indices": len(accessors) - 1}
    model.content["meshes"][0]["primitives"].append(second)
    return model.write(folder / "submeshes.glb")


@pytest.mark.slow
@pytest.mark.parametrize("gradients", ["fitted", "surface"])
def test_submeshes_that_share_vertices_may_be_split(gradients: str, tmp_path: Path) -> None:
    """The indices of the first submesh keep their values, because of the order of the vertices."""
    path = baked(submeshes(tmp_path), tmp_path / "baked", gradients=gradients)
    target = tmp_path / "weld.glb"
    assert gltf_transform.transform([(path, target, "weld")]) == [""]
    answer = verify(target, *REST)
    assert answer.exit_code == 0, answer.messages
    before, after = (Editable(each) for each in (path, target))
    both = [each.stored(each.primitive()["indices"]).ravel().tolist() for each in (before, after)]
    assert both[0] == both[1]
    assert len(before.array("POSITION")) > len(after.array("POSITION"))
