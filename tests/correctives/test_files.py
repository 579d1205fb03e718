"""Files with correctives: what is written, what stays, and what they draw."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.make_fixtures import FOLDER
from tests.correctives.models import SHEET, TUBE, mean_errors, parted, rewritten
from tests.support import corpus, gltf_reading, gltf_transform, khronos
from tests.support.baked_files import Editable, verify
from tests.support.command_line import invoke, run
from tests.support.played import weights_at


def bake(source: Path, target: Path, *options: str, code: int = 0) -> str:
    result = invoke("bake", source, "-o", target, "--correctives", *(options or ("auto",)))
    assert result.exit_code == code, result.output
    return result.output


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ["float32", "snorm16", "packed8"])
def test_normals_of_posed_triangles_are_nearer_than_those_of_standard_lighting(
    tmp_path: Path, encoding: str
) -> None:
    bake(corpus.character("CesiumMan/CesiumMan.glb"), tmp_path / "out.glb", "auto", "--encoding", encoding)
    for store in ("difference", "direction"):
        standard, corrected = mean_errors(tmp_path / "out.glb", 0, [0.13, 0.42, 0.71], store=store)
        assert corrected < 0.5 * standard


@pytest.mark.slow
@pytest.mark.parametrize("source", [TUBE, SHEET], ids=lambda path: path.stem)
@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_strip_gives_the_input_back_and_a_second_bake_changes_nothing(
    tmp_path: Path, source: Path, suffix: str
) -> None:
    given = tmp_path / f"in{suffix}"
    if suffix == ".glb":
        given.write_bytes(source.read_bytes())
    else:
        content = gltf_reading.read(source)
        (tmp_path / "in.bin").write_bytes(content.binary_chunk or b"")
        content.content["buffers"][0]["uri"] = "in.bin"
        given.write_text(json.dumps(content.content, indent=2))
    made, again, back = (tmp_path / f"{name}{suffix}" for name in ("made", "again/made", "back"))
    bake(given, made)
    bake(made, again)
    assert again.read_bytes() == made.read_bytes()
    assert invoke("strip", made, "-o", back).exit_code == 0
    assert back.read_bytes() == given.read_bytes()
    report = khronos.validate(made)
    before = khronos.validate(given)
    assert report["errors"] == before["errors"] and report["warnings"] == before["warnings"]


@pytest.mark.slow
def test_every_target_of_every_primitive_has_what_others_have(tmp_path: Path) -> None:
    bake(parted(tmp_path / "in.glb"), tmp_path / "out.glb", "3")
    file = gltf_reading.read(tmp_path / "out.glb")
    mesh = file.content["meshes"][0]
    assert [len(one["targets"]) for one in mesh["primitives"]] == [3, 3, 3]
    names = [set(target) for one in mesh["primitives"] for target in one["targets"]]
    assert all(one == {"POSITION", "NORMAL"} for one in names)
    nodes = [number for number, node in enumerate(file.content["nodes"]) if "skin" in node]
    assert len(nodes) == 2
    assert all(np.any(weights_at(file, 0, node, 0.4)) for node in nodes)
    invoke("strip", tmp_path / "out.glb", "-o", tmp_path / "back.glb")
    assert (tmp_path / "back.glb").read_bytes() == (tmp_path / "in.glb").read_bytes()
    assert mesh["weights"] == [0, 0, 0]
    assert mesh["extras"]["targetNames"] == [f"corrective normal {number}" for number in (1, 2, 3)]


@pytest.mark.slow
def test_targets_and_weights_of_the_file_come_first_and_keep_their_values(tmp_path: Path) -> None:
    bake(SHEET, tmp_path / "sheet.glb", "2")
    before, after = gltf_reading.read(SHEET), gltf_reading.read(tmp_path / "sheet.glb")
    for old, new in zip(before.primitive(0)["targets"], after.primitive(0)["targets"], strict=False):
        assert all(new[name] == number for name, number in old.items())
    own = len(before.primitive(0)["targets"])
    for clip in range(len(before.content["animations"])):
        for time in np.linspace(0, 1, 9):
            old, new = (
                weights_at(file, clip, node, time) for file in (before, after) for node in [_drawer(file)]
            )
            rest = before.content["meshes"][0].get("weights", [0.0] * own)
            assert new is not None
            assert new[:own] == pytest.approx(rest if old is None else old, abs=1e-6)


def _drawer(file: gltf_reading.GltfFile) -> int:
    return next(number for number, node in enumerate(file.content["nodes"]) if "skin" in node)


@pytest.mark.slow
def test_a_clip_that_is_left_out_plays_zeros(tmp_path: Path) -> None:
    source = corpus.model("RiggedElf/RiggedElf.gltf")
    names = [one["name"] for one in json.loads(source.read_text())["animations"]]
    bake(source, tmp_path / "elf.glb", "2", "--clips", names[0])
    file = gltf_reading.read(tmp_path / "elf.glb")
    node = _drawer(file)
    assert np.any(weights_at(file, 0, node, 0.3))
    for clip in range(1, len(names)):
        assert weights_at(file, clip, node, 0.3) == pytest.approx([0.0, 0.0])


def test_an_unknown_clip_is_an_error_with_the_known_ones(tmp_path: Path) -> None:
    assert "its clips are: " in bake(TUBE, tmp_path / "out.glb", "2", "--clips", "fly", code=3)
    assert not (tmp_path / "out.glb").exists()


@pytest.mark.slow
def test_a_file_has_one_kind_of_bake(tmp_path: Path) -> None:
    assert invoke("bake", TUBE, "-o", tmp_path / "gradients.glb").exit_code == 0
    said = bake(tmp_path / "gradients.glb", tmp_path / "out.glb", code=3)
    assert "it has α/β already" in said and "skinbake strip" in said
    bake(TUBE, tmp_path / "corrected.glb")
    result = invoke("bake", tmp_path / "corrected.glb", "-o", tmp_path / "out.glb")
    assert result.exit_code == 3 and "it has correctives already" in result.output
    assert not (tmp_path / "out.glb").exists()
    result = invoke("shader", "--lang", "glsl", "--for", tmp_path / "corrected.glb")
    assert result.exit_code == 3 and "its correctives need no shader" in result.stderr
    said = invoke("verify", tmp_path / "corrected.glb").stdout
    assert said.endswith("corrected.glb shows where.\n")


@pytest.mark.slow
@pytest.mark.parametrize("threads", ["1", "3"])
def test_bytes_do_not_depend_on_the_number_of_threads(tmp_path: Path, threads: str) -> None:
    bake(TUBE, tmp_path / "any.glb")
    bake(TUBE, tmp_path / "some.glb", "auto", "--threads", threads)
    assert (tmp_path / "some.glb").read_bytes() == (tmp_path / "any.glb").read_bytes()


@pytest.mark.parametrize(
    ("option", "words"),
    [
        (["--layout", "custom"], "contradicts"),
        (["--limit-influences", "4"], "contradicts"),
        (["--generate-normals"], "so store NORMAL in it first"),
        (["--compress", "none"], "so change it first"),
        (["--gradients", "surface"], "--corrective-aim gradients"),
    ],
)
def test_options_of_gradients_are_refused(tmp_path: Path, option: list[str], words: str) -> None:
    assert words in bake(TUBE, tmp_path / "out.glb", "auto", *option, code=2)


@pytest.mark.slow
@pytest.mark.parametrize(("least", "status"), [("1.2", "baked"), ("1e6", "left")])
def test_a_file_with_little_to_win_is_left_with_a_note(tmp_path: Path, least: str, status: str) -> None:
    target = tmp_path / "out.glb"
    bake(TUBE, target, "auto", "--leave-under", least)
    note = gltf_reading.read(target).content["asset"].get("extras", {}).get("skinbake", {})
    assert ("left" in str(note)) == (status == "left"), note
    answer = invoke("verify", target, "--min-gain", "2", "--json")
    assert answer.exit_code == 0, answer.output
    (file,) = json.loads(answer.stdout)["files"]
    assert file["left"] == (status == "left")
    bake(target, tmp_path / "again.glb")
    assert gltf_reading.read(tmp_path / "again.glb").primitive(0)["targets"]


def test_a_file_that_correctives_do_not_improve_is_left_too(tmp_path: Path) -> None:
    given = rewritten(TUBE, tmp_path / "still.glb", _still)
    bake(given, tmp_path / "out.glb", "auto", "--leave-under", "1.2")
    assert invoke("verify", tmp_path / "out.glb", "--min-gain", "2").exit_code == 0


def _still(content: Any) -> None:
    """Let the clip move the root alone."""
    for animation in content["animations"]:
        animation["channels"] = animation["channels"][:1]
        animation["channels"][0]["target"]["node"] = content["skins"][0]["joints"][0]


def test_clips_without_correctives_are_refused(tmp_path: Path) -> None:
    result = invoke("bake", TUBE, "-o", tmp_path / "out.glb", "--clips", "bend")
    assert result.exit_code == 2 and "--correctives auto" in result.output


@pytest.mark.slow
def test_a_file_that_another_tool_has_written_anew_is_fresh_and_can_be_stripped(tmp_path: Path) -> None:
    bake(SHEET, tmp_path / "made.glb")
    gltf_transform.require_node()
    assert gltf_transform.transform([(tmp_path / "made.glb", tmp_path / "other.glb", "copy")]) == [""]
    assert verify(tmp_path / "other.glb").failed == []
    result = invoke("strip", tmp_path / "other.glb", "-o", tmp_path / "back.glb")
    assert result.exit_code == 0, result.output
    before, after = gltf_reading.read(SHEET), gltf_reading.read(tmp_path / "back.glb")
    own = len(before.primitive(0)["targets"])
    assert len(after.primitive(0)["targets"]) == own
    for time in (0.1, 0.35, 0.8):
        old, new = (weights_at(file, 0, _drawer(file), time) for file in (before, after))
        rest = before.content["meshes"][0].get("weights", [0.0] * own)
        assert new == pytest.approx(rest if old is None else old, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    "damage",
    [
        {"primitives": 3, "channels": "x", "samplers": [[1]], "clips": 5, "former": {}, "required": 1},
        {"channels": [[0, 0, 99], [7, 7, 7], "x"], "samplers": [[0, -3], [9, 9]], "poses": [1]},
        {"targets": 30, "names": 4, "formerNames": 7},
        {
            "primitives": [{"filled": {"POSITION": [99, "a"]}, "digest": 4, "targets": []}],
            "poses": {"clips": 1},
        },
        {"poses": {"clips": 1, "fingerprint": "x"}},
        {"version": "1"},
        {"targets": -2},
    ],
)
def test_damaged_metadata_ends_in_an_answer(tmp_path: Path, damage: dict[str, Any]) -> None:
    bake(TUBE, tmp_path / "made.glb")

    def change(content: Any) -> None:
        content["meshes"][0]["extras"]["skinbake"].update(damage)

    path = rewritten(tmp_path / "made.glb", tmp_path / "damaged.glb", change)
    for command in (["verify"], ["inspect"], ["strip", "-o", tmp_path / "back.glb"]):
        result = invoke(*command, path)
        assert result.exit_code in {0, 1, 3}, result.output
        assert "failed where it should not" not in result.output


@pytest.mark.slow
def test_bytes_are_those_of_other_processors_too(tmp_path: Path) -> None:
    """BLAS, numpy and the C library choose other routines where a processor lacks instructions."""
    source = corpus.character("CesiumMan/CesiumMan.glb")
    bake(source, tmp_path / "here.glb")
    less = {
        "OPENBLAS_CORETYPE": "Prescott",
        "NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3 AVX512F",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F",
        "PYTHONWARNINGS": "ignore",
    }
    options: list[str | Path] = ["-o", tmp_path / "there.glb", "--correctives", "auto"]
    result = run("bake", source, *options, env=less)
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "there.glb").read_bytes() == (tmp_path / "here.glb").read_bytes()


def test_a_mesh_without_clips_gets_none_and_stays_as_it_is(tmp_path: Path) -> None:
    source = FOLDER / "two_primitives.glb"
    said = bake(source, tmp_path / "out.glb")
    assert "only clips play correctives" in said
    assert (tmp_path / "out.glb").read_bytes() == source.read_bytes()


def test_a_mesh_that_does_not_bend_gets_none_and_no_warning(tmp_path: Path) -> None:
    given = rewritten(TUBE, tmp_path / "still.glb", _still)
    result = invoke(
        "bake", given, "-o", tmp_path / "out.glb", "--correctives", "auto", "--json", "--warnings-as-errors"
    )
    assert result.exit_code == 0
    (file,) = json.loads(result.stdout)["files"]
    assert {one["code"] for one in file["warnings"]} == {"nothing-to-correct"}
    assert "warning: " not in result.stderr
    assert (tmp_path / "out.glb").read_bytes() == given.read_bytes()


@pytest.mark.slow
def test_rigid_meshes_beside_one_that_bends_cause_no_warning(tmp_path: Path) -> None:
    """Their normals are right already."""
    file = Editable(TUBE)
    rigid = copy.deepcopy(file.primitive())
    weights = np.zeros_like(file.array("WEIGHTS_0"), dtype=np.float32)
    weights[:, 0] = 1.0
    rigid["attributes"]["WEIGHTS_0"] = file.add(weights)
    file.content["meshes"].append({"name": "hat", "primitives": [rigid]})
    drawer = next(one for one in file.content["nodes"] if "skin" in one)
    for number in range(2):
        file.content["nodes"].append({**drawer, "mesh": 1, "name": f"hat {number}"})
        file.content["scenes"][0]["nodes"].append(len(file.content["nodes"]) - 1)
    given = file.write(tmp_path / "given.glb")
    arguments = ["--correctives", "auto", "--json", "--warnings-as-errors"]
    result = invoke("bake", given, "-o", tmp_path / "out.glb", *arguments)
    assert result.exit_code == 0
    (told,) = json.loads(result.stdout)["files"]
    assert [one["mesh"] for one in told["correctives"]] == [0]
    assert told["warnings"] == []


def test_a_file_without_clips_is_left_for_that_reason(tmp_path: Path) -> None:
    arguments = ["--correctives", "auto", "--leave-under", "1.2"]
    said = invoke("bake", FOLDER / "two_primitives.glb", "-o", tmp_path / "out.glb", *arguments).stdout
    assert "left unbaked: no clip moves its joints, and only clips play correctives" in said
    assert "gain" not in said
    assert invoke("verify", tmp_path / "out.glb", "--require-baked").exit_code == 0
