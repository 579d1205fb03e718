"""What gltfpack, three.js and pygltflib do to a file before and after its bake, each of them really run.

docs/order.md has the table.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pygltflib
import pytest

from tests.lighting.replay import accurate_normals, largest_angle
from tests.support.baked_files import Editable, baked, source, verify
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
    """Its loader does, and the last bits change. verify cannot tell what the weights were."""
    target = tmp_path / "copy.glb"
    three(baked(source("bent_tube.glb"), tmp_path), target)
    answer = verify(target, *REST)
    (problem,) = answer.problems("freshness")
    assert (answer.exit_code, problem["code"]) == (1, "stale")
    assert problem["message"].startswith("WEIGHTS changed since its bake, and α/β still fit")
    assert "divided by their sum, which the loader of three.js does" in problem["message"]


@pytest.mark.parametrize(("given", "divided"), [([0.0, 1.0], True), ([0.5, 0.0], False)])
def test_fitting_alpha_and_beta_do_not_prove_the_weights(
    given: list[float], divided: bool, tmp_path: Path
) -> None:
    """A rigid part that follows another joint has the same α and β, 0, and is lit 53° from what it was."""
    model = Editable(source("bent_tube.glb"))
    model.array("JOINTS_0")[:] = [0, 2, 0, 0]
    model.array("WEIGHTS_0")[:] = [1.0, 0.0, 0.0, 0.0]
    original = baked(model.write(tmp_path / "rigid.glb"), tmp_path / "baked")
    edited = Editable(original)
    edited.array("WEIGHTS_0")[:, :2] = given
    changed = edited.write(tmp_path / "edited.glb")
    answer = verify(changed, *REST)
    (problem,) = answer.problems("freshness")
    assert problem["message"].startswith("WEIGHTS changed since its bake, and α/β still fit")
    assert ("its weights edited, or divided" in problem["message"]) == divided
    moved = largest_angle(accurate_normals(changed), accurate_normals(original))
    assert (moved > 1.0) == divided
