"""bake --leave-under: files with little to win stay as they are, and every later gate knows."""

from __future__ import annotations

import copy
import json
import re
from pathlib import Path

import jsonschema
import pytest
from pygltflib import GLTF2

from fixtures.builder import JsonObject
from skinbake import bake
from tests.support import khronos
from tests.support.command_line import invoke
from tests.support.gltf_reading import read
from tests.support.models import FOLDER, edited
from tests.support.schemas import BAKE, VERIFY

LITTLE, MUCH = "characters/RiggedSimple.gltf", "bent_tube.glb"
"""Models whose gains are about 1.0 and 25, both with standard lighting off by over 1°."""


def verified(*arguments: str | Path) -> tuple[int, list[JsonObject]]:
    """Return the exit code of verify, and the entries of its files."""
    result = invoke("verify", *arguments, "--json", "--samples", "8")
    document = json.loads(result.stdout)
    jsonschema.validate(document, VERIFY)
    return result.exit_code, document["files"]


def little_with(extras: object, folder: Path) -> Path:
    """Return a copy of the model with little to win, with extras of the asset."""
    content = json.loads((FOLDER / LITTLE).read_text(encoding="utf-8"))
    content["asset"]["extras"] = extras
    path = folder / "little.gltf"
    path.write_text(json.dumps(content, indent=2), encoding="utf-8")
    for buffer in content["buffers"]:
        if not buffer["uri"].startswith("data:"):
            (folder / buffer["uri"]).write_bytes((FOLDER / LITTLE).with_name(buffer["uri"]).read_bytes())
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of a file that was left and one that was baked."""
    models = FOLDER / LITTLE, FOLDER / MUCH
    result = invoke("bake", *models, "--out-dir", tmp_path / "out", "--leave-under", "1.2", "--json")
    assert result.exit_code == 0
    document = json.loads(result.stdout)
    jsonschema.validate(document, BAKE)
    little, much = document["files"]
    assert (little["status"], much["status"], much["left"]) == ("left", "baked", None)
    assert little["left"]["gain"] < 1.2 == little["left"]["under"]
    assert little["left"]["standard_error"] > 1.0
    return tmp_path / "out"


def test_a_file_that_was_left_differs_by_its_note_alone(folder: Path, tmp_path: Path) -> None:
    told = invoke("bake", FOLDER / LITTLE, "--leave-under", "1.2", "--dry-run").output
    assert re.search(r"left unbaked: gain 1\.\d\dx by the lower of two measurements, standard", told)
    [left] = folder.glob("*.gltf")
    before, after = read(FOLDER / LITTLE).content, copy.deepcopy(read(left).content)
    note = after["asset"].pop("extras")["skinbake"]
    assert after == before
    assert note["left"]["under"] == 1.2
    khronos.require_node()
    reports = khronos.validate_many([FOLDER / LITTLE, left])
    assert not khronos.new_findings(*reports.values())
    assert invoke("strip", left, "-o", tmp_path / "back.gltf").exit_code == 0
    assert (tmp_path / "back.gltf").read_bytes() == (FOLDER / LITTLE).read_bytes()


@pytest.mark.slow
def test_a_gate_passes_what_was_left_on_purpose(folder: Path) -> None:
    code, [left, much] = verified(folder, "--require-baked", "--min-gain", "1.2")
    assert code == 0
    assert (left["left"], left["passed"], much["left"]) == (True, True, False)
    assert left["normals_by_triangles"] is None
    several = invoke("verify", folder, "-v", "--samples", "2")
    assert "1 passed, 1 left unbaked" in several.stderr
    [alone] = folder.glob("*.gltf")
    told = invoke("verify", alone).stdout
    assert told.startswith(f"{alone}: left unbaked\n")
    assert "  left unbaked on purpose\n" in invoke("inspect", alone).stdout


@pytest.mark.slow
def test_a_gate_passes_a_file_without_normals_that_was_left(tmp_path: Path) -> None:
    fox, out = FOLDER / "characters/fox.glb", tmp_path / "out"
    assert invoke("bake", fox, "--out-dir", out, "--leave-under", "1.5", "--generate-normals").exit_code == 0
    code, (file,) = verified(out, "--min-gain", "1.5")
    assert (code, file["left"], file["warnings"]) == (0, True, [])
    assert verified(fox, "--min-gain", "1.5")[0] == 1


@pytest.mark.slow
def test_a_gate_fails_what_was_forgotten_or_gains_too_little(tmp_path: Path) -> None:
    code, [plain] = verified(FOLDER / LITTLE, "--min-gain", "1.2")
    assert (code, plain["left"]) == (1, False)
    invoke("bake", FOLDER / LITTLE, "-o", tmp_path / "little.gltf")
    code, _ = verified(tmp_path / "little.gltf", "--min-gain", "1.2")
    assert code == 1


@pytest.mark.slow
def test_a_gate_asks_no_gain_where_there_is_nothing_to_correct(tmp_path: Path) -> None:
    """Turns of at most 2 degrees leave nothing to correct, whatever the gain is."""
    invoke("bake", FOLDER / LITTLE, "-o", tmp_path / "little.gltf")
    model, poses = tmp_path / "little.gltf", ("--min-gain", "1.2", "--poses", "random:4")
    assert verified(model, *poses, "--angle", "2")[0] == 0
    assert verified(model, *poses, "--angle", "30")[0] == 1


@pytest.mark.slow
def test_a_bake_without_the_option_bakes_what_was_left(folder: Path, tmp_path: Path) -> None:
    [left] = folder.glob("*.gltf")
    for source, target in ((left, "again"), (FOLDER / LITTLE, "fresh")):
        assert invoke("bake", source, "-o", tmp_path / target / "little.gltf").exit_code == 0
    found, expected = (tmp_path / name / "little.gltf" for name in ("again", "fresh"))
    assert found.read_bytes() == expected.read_bytes()


def test_an_earlier_bake_is_undone_in_place(tmp_path: Path) -> None:
    model = tmp_path / "little.glb"
    assert invoke("bake", FOLDER / LITTLE, "-o", model).exit_code == 0
    assert invoke("bake", model, "--in-place", "--leave-under", "1.2").exit_code == 0
    content = read(model).content
    assert "skinbake" in content["asset"]["extras"]
    names = [name for mesh in content["meshes"] for one in mesh["primitives"] for name in one["attributes"]]
    assert not any(name.startswith("_SKINBAKE") or "ALPHA" in name for name in names)


@pytest.mark.slow
def test_a_run_that_skips_unchanged_files_skips_what_was_left(tmp_path: Path) -> None:
    options = (FOLDER / LITTLE, "--out-dir", tmp_path / "out", "--skip-unchanged", "--json")
    statuses = [
        json.loads(invoke("bake", *options, *more).stdout)["files"][0]["status"]
        for more in (["--leave-under", "1.2"], ["--leave-under", "1.2"], [], ["--leave-under", "0.5"])
    ]
    assert statuses == ["left", "up-to-date", "baked", "baked"]


@pytest.mark.parametrize("extras", [[1], "text", {"skinbake": "of another program"}])
def test_a_file_without_a_place_for_the_note_is_baked(tmp_path: Path, extras: object) -> None:
    path = little_with(extras, tmp_path)
    result = bake(path, tmp_path / "out.gltf", leave_under=1.2)
    assert result["status"] == "baked"


def test_a_file_whose_gain_cannot_be_measured_is_baked_and_says_so(tmp_path: Path) -> None:
    def broken(content: JsonObject) -> None:
        content["animations"][0]["channels"][0]["sampler"] = 99

    source = edited(MUCH, tmp_path, broken)
    result = bake(source, tmp_path / "out.glb", leave_under=1.2)
    assert result["status"] == "baked"
    [notice] = [one for one in result["warnings"] if one["code"] == "gain-unmeasured"]
    assert "sampler" in notice["message"]


def test_extras_of_the_asset_come_back(tmp_path: Path) -> None:
    for extras in ({}, {"by": "me"}):
        path = little_with(extras, tmp_path)
        assert bake(path, tmp_path / "left.gltf", leave_under=1.2)["status"] == "left"
        assert invoke("strip", tmp_path / "left.gltf", "-o", tmp_path / "back.gltf").exit_code == 0
        assert (tmp_path / "back.gltf").read_bytes() == path.read_bytes()


def test_a_model_in_memory_is_left_too() -> None:
    model = GLTF2().load(str(FOLDER / LITTLE))
    assert model is not None
    left = bake(model, leave_under=1.2)
    assert left.asset.extras["skinbake"]["left"]["under"] == 1.2
