"""inspect and strip: many files in one call, as bake and verify take them."""

from __future__ import annotations

import json
import shutil
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from skinbake.files import writing
from tests.support.command_line import document, invoke
from tests.support.gltf_reading import read
from tests.support.models import FIXTURES, FOLDER, SHARED_BIN, bake, rewritten
from tests.support.schemas import INSPECT, INSPECTED_FILES, STRIP, STRIPPED_FILES, checked


@pytest.fixture
def library(tmp_path: Path) -> Path:
    """Make a folder with a baked file, one that is not, a stale one, a broken one, and one without a skin."""
    folder = tmp_path / "art"
    (folder / "deep").mkdir(parents=True)
    bake(FOLDER / "two_primitives.glb", folder / "baked.glb")
    shutil.copyfile(FOLDER / "seam.glb", folder / "deep" / "plain.glb")
    bake(FOLDER / "seam.glb", folder / "stale.glb")
    stale = read(folder / "stale.glb")
    stale.content["meshes"][0]["primitives"][0]["extras"]["skinbake"]["digest"]["NORMAL"] = "0" * 32
    rewritten(stale, folder / "stale.glb")
    (folder / "broken.glb").write_bytes(b"glTF, but no more than that")
    (folder / "bare.gltf").write_text('{"asset": {"version": "2.0"}}', encoding="utf-8")
    return folder


@pytest.mark.parametrize(
    ("command", "code", "advice"),
    [
        ("inspect", 0, "run skinbake bake on its source"),
        ("bake", 3, "run skinbake bake on its source"),
        ("view", 3, "run skinbake bake on its source"),
        ("strip", 0, "its α/β have no metadata to undo them by: take its source"),
    ],
)
def test_a_bake_whose_metadata_another_tool_dropped_is_made_from_its_source(
    command: str, code: int, advice: str, tmp_path: Path
) -> None:
    bake(FOLDER / "seam.glb", tmp_path / "baked.glb")
    model = read(tmp_path / "baked.glb")
    del model.content["meshes"][0]["primitives"][0]["extras"]
    path = rewritten(model, tmp_path / "without.glb")
    name = "page.html" if command == "view" else "out.glb"
    target: list[str | Path] = [] if command == "inspect" else ["-o", tmp_path / name]
    result = invoke(command, path, *target)
    assert (result.exit_code, result.stderr.count(advice)) == (code, 1)


@pytest.mark.parametrize("command", ["bake", "strip"])
def test_the_bake_of_a_later_version_stays(command: str, tmp_path: Path) -> None:
    """What its metadata means is unknown, so nothing is undone by it."""
    bake(FOLDER / "seam.glb", tmp_path / "baked.glb")
    later = read(tmp_path / "baked.glb")
    later.content["meshes"][0]["primitives"][0]["extras"]["skinbake"]["version"] = 2
    rewritten(later, tmp_path / "later.glb")
    before = (tmp_path / "later.glb").read_bytes()
    for out in (["-o", tmp_path / "out.glb"], ["--in-place"]):
        result = invoke(command, tmp_path / "later.glb", *out)
        assert result.exit_code == 3
        assert (
            "primitive 0: its metadata has version 2, this skinbake reads 1: update skinbake" in result.stderr
        )
    assert not (tmp_path / "out.glb").exists()
    assert (tmp_path / "later.glb").read_bytes() == before
    told = invoke("inspect", tmp_path / "later.glb")
    assert "but its metadata has version 2, this skinbake reads 1: update skinbake" in told.stdout
    assert "up to date" not in told.stdout


@pytest.mark.parametrize("gradients", ["rig", "poses"])
def test_a_bake_of_gradients_that_no_bake_makes_is_damaged(gradients: str, tmp_path: Path) -> None:
    bake(FOLDER / "seam.glb", tmp_path / "baked.glb")
    model = read(tmp_path / "baked.glb")
    model.content["meshes"][0]["primitives"][0]["extras"]["skinbake"]["gradients"] = gradients
    damaged = rewritten(model, tmp_path / "damaged.glb")
    why = f"its metadata is damaged: \"gradients\" is '{gradients}'; run skinbake bake"
    assert why in invoke("verify", damaged).stderr
    told = invoke("inspect", damaged)
    assert f"but {why}" in told.stdout and why in told.stderr
    assert "up to date" not in told.stdout


@pytest.mark.parametrize("name", ["bent_tube.glb", "two_primitives.glb"])
def test_a_bake_is_known_after_a_tool_has_written_1_as_1_0(name: str, tmp_path: Path) -> None:
    """As writers in languages without integers do, with every number of the file."""
    bake(FOLDER / name, tmp_path / "baked.glb")
    model = read(tmp_path / "baked.glb")
    content = json.loads(json.dumps(model.content), parse_int=float)
    floats = rewritten(replace(model, content=content), tmp_path / "floats.glb")
    assert '"version":1.0' in floats.read_bytes().decode("latin-1").replace(" ", "")
    assert invoke("verify", floats).exit_code == 0
    assert "up to date" in invoke("inspect", floats).stdout
    assert invoke("strip", floats, "-o", tmp_path / "stripped.glb").exit_code == 0
    source, found = read(FOLDER / name), read(tmp_path / "stripped.glb")
    assert found.content == source.content
    assert found.binary_chunk == source.binary_chunk
    assert invoke("bake", floats, "-o", tmp_path / "again.glb").exit_code == 0
    again, before = read(tmp_path / "again.glb"), read(tmp_path / "baked.glb")
    assert (again.content, again.binary_chunk) == (before.content, before.binary_chunk)


class TestInspect:
    def test_a_folder_has_a_line_for_each_file_and_the_worst_code(self, library: Path) -> None:
        result = invoke("inspect", library)
        assert result.exit_code == 3
        lines = dict(line.split(": ", 1) for line in result.stdout.splitlines())
        assert {Path(name).name: text.rsplit(", ", 1)[1] for name, text in lines.items()} == {
            "bare.gltf": "nothing to bake",
            "baked.glb": "baked",
            "plain.glb": "not baked",
            "stale.glb": "1 primitive changed since: bake again",
        }
        assert lines[str(library / "bare.gltf")].startswith("29 bytes, 0 meshes, 0 skins, 0 animations, 0 ")
        assert f"error: {library / 'broken.glb'}: " in result.stderr

    def test_verbose_shows_every_file_in_full(self, library: Path) -> None:
        alone = invoke("inspect", library / "baked.glb").stdout
        assert "attributes  POSITION" in alone
        assert alone in invoke("inspect", library, "-v").stdout

    @pytest.mark.slow
    def test_json_of_many_is_that_of_each(self, library: Path, workers: list[int]) -> None:
        found = checked(document(invoke("inspect", library, "--json")), INSPECTED_FILES)
        assert found["exit_code"] == 3
        assert [Path(file["input"]).name for file in found["files"]] == [
            "baked.glb",
            "bare.gltf",
            "broken.glb",
            "plain.glb",
            "stale.glb",
        ]
        for file in found["files"]:
            if file["error"] is None:
                one = checked(document(invoke("inspect", file["input"], "--json")), INSPECT)
                assert {**one, "error": None} == {"schema": "skinbake.inspect/1", **file}
        again = document(invoke("inspect", library, "--json", "--jobs", "2"))
        assert (again, workers) == (found, [2])

    @pytest.mark.slow
    def test_the_schema_depends_on_the_arguments_alone(self, tmp_path: Path) -> None:
        (tmp_path / "one").mkdir()
        path = tmp_path / "one" / "seam.glb"
        shutil.copyfile(FOLDER / "seam.glb", path)
        several = [[tmp_path / "one"], [tmp_path / "one" / "*.glb"], [path, path]]
        for arguments in several:
            checked(document(invoke("inspect", *arguments, "--json")), INSPECTED_FILES)
        checked(document(invoke("inspect", path, "--json")), INSPECT)
        assert invoke("inspect", tmp_path / "no.glb", "--json").stdout == ""
        nothing = checked(document(invoke("inspect", tmp_path / "*.glb", "--json")), INSPECTED_FILES)
        assert "no file that matches" in nothing["files"][0]["error"]["message"]

    def test_summary_and_timings(self, library: Path, tmp_path: Path) -> None:
        result = invoke("inspect", library, "--summary", tmp_path / "s.jsonl", "--timings", "--json")
        found = checked(document(result), INSPECTED_FILES)
        assert all(file["timings"].keys() <= {"read", "other"} for file in found["files"])
        *files, total = map(json.loads, (tmp_path / "s.jsonl").read_text(encoding="utf-8").splitlines())
        assert [file["input"] for file in files] == [file["input"] for file in found["files"]]
        assert {
            "kind": "total",
            "files": 5,
            "inspected": 4,
            "failed": 1,
            "exit_code": 3,
        }.items() <= total.items()


class TestStrip:
    @pytest.mark.slow
    def test_a_folder_comes_back_as_it_was(self, tmp_path: Path) -> None:
        inputs = [FOLDER / name for name in FIXTURES]
        assert invoke("bake", *inputs, "--out-dir", tmp_path / "baked").exit_code == 0
        result = invoke("strip", tmp_path / "baked", "--out-dir", tmp_path / "back", "--json")
        found = checked(document(result), STRIPPED_FILES)
        assert {file["status"] for file in found["files"]} == {"stripped"}
        assert len(found["files"]) == len(FIXTURES)
        for name in (*FIXTURES, SHARED_BIN):
            if not name.endswith(".gltf"):
                assert (tmp_path / "back" / name).read_bytes() == (FOLDER / name).read_bytes()

    def test_a_bad_file_does_not_stop_the_others(self, library: Path, tmp_path: Path) -> None:
        result = invoke("strip", library / "**" / "*.glb", "--out-dir", tmp_path / "out")
        assert result.exit_code == 3
        out = tmp_path / "out"
        assert result.stdout.splitlines() == [
            f"{library / 'baked.glb'} -> {out / 'baked.glb'}: stripped 2 primitives",
            f"{library / 'deep' / 'plain.glb'} -> {out / 'deep' / 'plain.glb'}: unchanged",
            f"{library / 'stale.glb'} -> {out / 'stale.glb'}: stripped 1 primitive",
        ]
        found = checked(
            document(invoke("strip", library / "*.glb", "--out-dir", out, "--json")), STRIPPED_FILES
        )
        assert [file["status"] for file in found["files"]] == ["stripped", "failed", "stripped"]
        one = checked(document(invoke("strip", library / "baked.glb", "-o", out / "a.glb", "--json")), STRIP)
        assert one["primitives"] == 2

    def test_in_place(self, library: Path) -> None:
        plain = library / "deep" / "plain.glb"
        untouched = plain.stat()
        assert invoke("strip", library / "**" / "*a*.glb", "--in-place").exit_code == 0
        assert (library / "baked.glb").read_bytes() == (FOLDER / "two_primitives.glb").read_bytes()
        assert (plain.stat().st_mtime_ns, plain.stat().st_ino) == (untouched.st_mtime_ns, untouched.st_ino)

    def test_in_place_does_not_replace_a_file_that_was_saved_meanwhile(
        self, library: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        path, prepare = library / "baked.glb", writing.write_files

        def save_first(*arguments: Any, **options: Any) -> None:
            path.write_bytes(path.read_bytes() + bytes(4 + time.time_ns() % 4))
            prepare(*arguments, **options)

        monkeypatch.setattr("skinbake.gltf.writing.output.write_files", save_first)
        result = invoke("strip", path, "--in-place")
        assert result.exit_code == 4
        assert path.read_bytes()[:4] == b"glTF"
        assert b"_SKINBAKE_ALPHA_0" in path.read_bytes()

    def test_outputs_that_would_meet_are_a_usage_error(self, library: Path, tmp_path: Path) -> None:
        result = invoke("strip", library / "baked.glb", FOLDER / "seam.glb", "-o", tmp_path / "a.glb")
        assert result.exit_code == 2
        result = invoke("strip", library, "--out-dir", library)
        assert result.exit_code == 2
        assert "use --in-place" in result.stderr
