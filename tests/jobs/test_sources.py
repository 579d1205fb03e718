"""verify --sources: whether the outputs of a folder are of the sources as they are now."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from xml.etree import ElementTree

import jsonschema
import pytest
from click.testing import Result

from fixtures.builder import JsonObject
from tests.support.command_line import invoke
from tests.support.models import FOLDER, SHARED, SHARED_BIN
from tests.support.schemas import VERIFY

QUICK = ("--poses", "rest", "--method", "lbs")


@pytest.fixture
def art(tmp_path: Path) -> Path:
    """A folder of sources, baked into ``build`` beside it with the notes of --skip-unchanged."""
    folder = tmp_path / "art"
    (folder / "sub").mkdir(parents=True)
    for name, place in (("bent_tube.glb", "a.glb"), ("seam.glb", "sub/b.glb"), (SHARED, SHARED)):
        shutil.copyfile(FOLDER / name, folder / place)
    shutil.copyfile(FOLDER / SHARED_BIN, folder / SHARED_BIN)
    baked(folder)
    return folder


def baked(folder: Path, *options: str | Path) -> None:
    result = invoke(
        "bake", folder, "--out-dir", folder.with_name("build"), "--skip-unchanged", "-q", *options
    )
    assert result.exit_code == 0, result.output


def asked(folder: Path, *options: str | Path) -> Result:
    return invoke("verify", folder.with_name("build"), "--sources", folder, *QUICK, *options)


def codes(folder: Path, *options: str | Path) -> dict[str, list[str]]:
    """The codes of the problems of the check, by file, below the folder of both; of those that have any."""
    result = asked(folder, "--json", *options)
    document = json.loads(result.stdout)
    jsonschema.validate(document, VERIFY)
    found = {}
    for file in document["files"]:
        problems: list[JsonObject] = [
            problem for check in file["checks"] if check["name"] == "sources" for problem in check["problems"]
        ]
        if problems:
            found[Path(file["input"]).relative_to(folder.parent).as_posix()] = [p["code"] for p in problems]
    assert result.exit_code == document["exit_code"] == (1 if found else 0)
    return found


@pytest.mark.slow
def test_outputs_of_unchanged_sources_pass_wherever_the_notes_are(art: Path, tmp_path: Path) -> None:
    assert codes(art) == {}
    notes = art.with_name("build") / ".skinbake-state.jsonl"
    notes.rename(tmp_path / "notes.jsonl")
    baked(art, "--state", tmp_path / "notes.jsonl")
    assert codes(art, "--state", tmp_path / "notes.jsonl") == {}


@pytest.mark.slow
def test_times_do_not_count_but_bytes(art: Path) -> None:
    os.utime(art / "a.glb", (2e9, 2e9))
    assert codes(art) == {}


@pytest.mark.slow
def test_each_kind_of_difference_is_named_until_the_folder_is_baked_again(art: Path) -> None:
    build = art.with_name("build")
    shutil.copyfile(FOLDER / "hard_edge.glb", art / "a.glb")
    with (art / SHARED_BIN).open("ab") as file:
        file.write(b"x")
    (art / "sub/b.glb").unlink()
    shutil.copyfile(FOLDER / "bent_tube.glb", art / "new.glb")
    shutil.copyfile(build / "a.glb", build / "stray.glb")
    assert codes(art) == {
        "build/a.glb": ["source-changed"],
        f"build/{SHARED}": ["source-changed"],
        "build/sub/b.glb": ["source-gone"],
        "build/stray.glb": ["source-unknown"],
        "art/new.glb": ["output-missing"],
    }
    assert f"{SHARED_BIN} changed since its bake: run skinbake bake --skip-unchanged on" in asked(art).stderr
    baked(art)
    (build / "sub/b.glb").unlink()
    (build / "stray.glb").unlink()
    assert codes(art) == {}


@pytest.mark.slow
def test_an_output_that_was_removed_is_missing(art: Path) -> None:
    (art.with_name("build") / "a.glb").unlink()
    assert codes(art) == {"art/a.glb": ["output-missing"]}


@pytest.mark.slow
def test_files_that_were_left_or_cannot_be_baked_count_too(art: Path) -> None:
    shutil.copyfile(FOLDER / "bent_tube.glb", art / "left.glb")
    baked(art, "--leave-under", "999")
    assert codes(art) == {}
    shutil.copyfile(FOLDER / "seam.glb", art / "left.glb")
    assert codes(art) == {"build/left.glb": ["source-changed"]}


@pytest.mark.slow
def test_junit_has_a_case_of_each_file_and_skipped_files_are_checked(art: Path, tmp_path: Path) -> None:
    notes, report = tmp_path / "verified.jsonl", tmp_path / "report.xml"
    skip = ("--skip-unchanged", "--state", notes)
    assert asked(art, *skip).exit_code == 0
    shutil.copyfile(FOLDER / "hard_edge.glb", art / "a.glb")
    shutil.copyfile(FOLDER / "hard_edge.glb", art / "new.glb")
    result = asked(art, *skip, "--junit", report)
    assert result.exit_code == 1
    assert "passed before, up to date" in result.stdout
    cases = {
        (Path(case.get("classname", "")).name, case.get("name")): case.find("failure") is not None
        for case in ElementTree.parse(report).iter("testcase")
    }
    assert cases[("a.glb", "sources")] and cases[("new.glb", "sources")]
    assert not cases[("b.glb", "sources")]


@pytest.mark.parametrize("content", [None, b"", b"not a state file\n"])
def test_without_sound_notes_nothing_can_be_told(art: Path, content: bytes | None) -> None:
    notes = art.with_name("build") / ".skinbake-state.jsonl"
    notes.unlink()
    if content is not None:
        notes.write_bytes(content)
    result = asked(art)
    if content == b"":  # no bake was noted yet
        assert (result.exit_code, result.stderr.count("no record tells its source")) == (1, 3)
        return
    assert result.exit_code == 2
    assert "--sources needs the notes of bake --skip-unchanged" in result.stderr


def test_what_cannot_be_compared_is_a_usage_error(art: Path) -> None:
    file = art.with_name("build") / "a.glb"
    for arguments in (
        (file, "--sources", art),
        (file, file, "--sources", art),
        (art.with_name("build"), "--sources", art / "a.glb"),
        ("-", "--sources", art),
    ):
        assert invoke("verify", *arguments).exit_code == 2


@pytest.mark.slow
def test_a_forged_record_reads_no_file_elsewhere(art: Path, tmp_path: Path) -> None:
    """It names a file outside both folders, with its right digest."""
    other = tmp_path / "other.glb"
    shutil.copyfile(FOLDER / "bent_tube.glb", other)
    notes = art.with_name("build") / ".skinbake-state.jsonl"
    lines = notes.read_text("utf-8").splitlines()
    record = next(json.loads(line) for line in lines[1:] if json.loads(line)["from"].endswith("a.glb"))
    record["read"]["../other.glb"] = record["read"][record["from"]]
    notes.write_text("\n".join([*lines, json.dumps(record), ""]), "utf-8")
    assert codes(art) == {"build/a.glb": ["source-changed"]}
    assert codes(art, "--allow-outside", tmp_path) == {}
