"""The effect of glTF-Transform's commands on a baked file, each of them really run.

====================================================  ====================================================
command                                               baked file afterwards
====================================================  ====================================================
copy, dedup, flatten, join, center, resample, sparse,
unlit, metalrough, partition, palette, instance       fresh
prune                                                 fresh; a bake for TANGENT fails where it drops TANGENT
reorder, weld, unweld, tangents                       fresh
simplify                                              stale
optimize, without compression                         stale, or no TANGENT any more
quantize                                              α/β no longer FLOAT; where they are left alone, stale
meshopt, draco; any of the first on a file in Draco   stale
====================================================  ====================================================
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support import corpus, gltf_transform
from tests.support.baked_files import CESIUM_MAN, Answer, Editable, baked, source, verify
from tests.support.command_line import invoke

FEW = ("--poses", "random:2", "--method", "lbs")
BAKE_LAST = "Bake last"
Transform = Callable[..., Answer]


@pytest.fixture(scope="module")
def transform(tmp_path_factory: pytest.TempPathFactory) -> Transform:
    """Return a function that bakes a model, runs glTF-Transform on it, and verifies what came out."""
    gltf_transform.require_node()
    bakes: dict[str, Path] = {}

    def run(name: str, command: str, *options: str, suffix: str = ".glb") -> Answer:
        if name not in bakes:
            bakes[name] = baked(source(name), tmp_path_factory.mktemp("baked"), gradients="surface")
        target = tmp_path_factory.mktemp(command) / f"out{suffix}"
        process = gltf_transform.run([command, bakes[name], target, *options])
        assert process.returncode == 0, process.stderr
        return verify(target, *FEW)

    return run


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [
        "copy",
        "prune",
        "dedup",
        "resample",
        "sparse",
        "unlit",
        "flatten",
        "join",
        "metalrough",
    ],
)
def test_what_leaves_the_geometry_alone_leaves_the_bake_fresh(transform: Transform, command: str) -> None:
    answer = transform("foreign_joints.glb", command)
    assert answer.exit_code == 0, answer.messages
    assert answer.failed == []


@pytest.mark.slow
def test_a_copy_as_separate_files_is_fresh(transform: Transform) -> None:
    assert transform("two_primitives.glb", "copy", suffix=".gltf").exit_code == 0


@pytest.mark.parametrize(
    "command", [pytest.param(command, marks=pytest.mark.slow) for command in ("reorder", "weld", "unweld")]
)
def test_vertices_in_another_order_are_told_from_damage(transform: Transform, command: str) -> None:
    """α and β travel with their vertices and still fit; only the digests are of another order."""
    answer = transform("bent_tube.glb", command)
    assert answer.exit_code == 0, answer.messages
    (remark,) = [check["remark"] for check in answer.file["checks"] if check["name"] == "freshness"]
    assert remark.startswith("POSITION, NORMAL, ")
    assert remark.endswith(" changed since the bake, and α/β still fit")


@pytest.mark.slow
def test_a_simplified_file_is_stale(transform: Transform) -> None:
    message = stale(transform("bent_tube.glb", "simplify", "--ratio", "0.5", "--error", "0.01"))
    assert "α/β are wrong at" in message
    assert "POSITION" in message


@pytest.mark.slow
def test_an_optimized_file_is_stale(transform: Transform) -> None:
    stale(transform("bent_tube.glb", "optimize", "--compress", "false", "--texture-compress", "false"))


@pytest.mark.slow
@pytest.mark.parametrize("command", ["prune", "optimize"])
def test_a_dropped_tangent_is_recognised(transform: Transform, command: str) -> None:
    options = ("--compress", "false", "--texture-compress", "false") if command == "optimize" else ()
    answer = transform("mirrored_tangent.glb", command, *options)
    (problem,) = answer.problems("structure")
    assert (answer.exit_code, problem["code"]) == (1, "frame")
    assert "TANGENT, which was removed" in problem["message"]
    assert BAKE_LAST in problem["message"]


@pytest.mark.slow
def test_quantised_attributes_are_recognised(transform: Transform) -> None:
    answer = transform("bent_tube.glb", "quantize")
    (problem,) = answer.problems("structure")
    assert (answer.exit_code, problem["code"]) == (1, "attribute-format")
    assert "probably quantised it after the bake" in problem["message"]
    assert BAKE_LAST in problem["message"]


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ["snorm16", "packed8"])
def test_dequantised_gradients_are_recognised(tmp_path: Path, encoding: str) -> None:
    gltf_transform.require_node()
    path, target = tmp_path / "baked.glb", tmp_path / "out.glb"
    assert invoke("bake", source("bent_tube.glb"), "-o", path, "--encoding", encoding).exit_code == 0
    assert gltf_transform.transform([(path, target, "dequantize")]) == [""]
    answer = verify(target, *FEW)
    (problem,) = answer.problems("structure")
    assert (answer.exit_code, problem["code"]) == (1, "attribute-format")
    assert "probably dequantised it after the bake" in problem["message"]


@pytest.mark.slow
@corpus.needed
def test_quantised_positions_are_stale(transform: Transform) -> None:
    """glTF-Transform leaves attributes with values beyond ±1 alone, so α and β stay FLOAT here."""
    message = stale(transform(CESIUM_MAN, "quantize"))
    assert "POSITION, NORMAL, JOINTS and WEIGHTS changed" in message


@pytest.mark.slow
@pytest.mark.parametrize("command", ["meshopt", "draco"])
def test_a_file_compressed_after_its_bake_is_stale(transform: Transform, command: str) -> None:
    assert "POSITION" in stale(transform("bent_tube.glb", command))


@pytest.mark.slow
@pytest.mark.parametrize("compression", ["draco", "meshopt"])
def test_a_copy_of_a_compressed_bake_is_stale_in_draco_alone(compression: str, tmp_path: Path) -> None:
    """The tool compresses both anew: Draco with its own number of bits, meshopt without loss."""
    compressed, copy = tmp_path / "compressed.glb", tmp_path / "copy.glb"
    (failure,) = gltf_transform.transform([(source("bent_tube.glb"), compressed, compression)])
    assert not failure
    (failure,) = gltf_transform.transform([(baked(compressed, tmp_path / "baked"), copy, "copy")])
    assert not failure
    answer = verify(copy, *FEW)
    if compression == "draco":
        assert BAKE_LAST in stale(answer)
    else:
        assert answer.exit_code == 0, answer.messages


@pytest.mark.slow
@pytest.mark.parametrize("command", ["quantize", "draco"])
def test_what_to_do_about_it_works(transform: Transform, tmp_path: Path, command: str) -> None:
    """Bake last: what the tool wrote, its old bake still in it, can be baked and is fresh again."""
    path = baked(source("foreign_joints.glb"), tmp_path)
    changed, folder = tmp_path / "changed.glb", tmp_path / "again"
    process = gltf_transform.run([command, path, changed])
    assert process.returncode == 0, process.stderr
    assert verify(changed, *FEW).exit_code == 1
    folder.mkdir()
    again = baked(changed, folder)
    assert verify(again, *FEW).exit_code == 0
    assert "_SKINBAKE_ALPHA_0" in Editable(again).primitive()["attributes"]


def stale(answer: Answer) -> str:
    (problem,) = answer.problems("freshness")
    assert (answer.exit_code, problem["code"]) == (1, "stale")
    message = str(problem["message"])
    assert BAKE_LAST in message
    return message
