"""A file that an option names is never an input, an output, or another option's: by identity."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.command_line import invoke
from tests.support.models import FOLDER as MODELS
from tests.support.models import SHARED, SHARED_BIN, bake, copied

Link = Callable[[Path, Path], object]


LINKS: dict[str, Link] = {
    "symbolic": lambda file, name: name.symlink_to(file),
    "hard": os.link,
}


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def model(tmp_path: Path) -> Path:
    return copied("seam.glb", tmp_path)


@pytest.mark.parametrize("kind", LINKS)
@pytest.mark.parametrize(
    "arguments",
    [
        ["verify", "{model}", "--junit", "{link}"],
        ["verify", "{model}", "--summary", "{link}"],
        ["verify", "{model}", "--skip-unchanged", "--state", "{link}"],
        ["bake", "{model}", "--dry-run", "--summary", "{link}"],
        ["bake", "{model}", "--out-dir", "{out}", "--summary", "{link}"],
        ["bake", "{folder}", "--in-place", "--skip-unchanged", "--state", "{link}"],
    ],
)
def test_a_report_that_is_an_input_is_refused(
    arguments: list[str], kind: str, model: Path, tmp_path: Path
) -> None:
    link = tmp_path / "report.txt"
    LINKS[kind](model, link)
    before = contents(tmp_path)
    places = {"model": model, "link": link, "folder": tmp_path, "out": tmp_path / "out"}
    result = invoke(*(argument.format_map(places) for argument in arguments))
    assert result.exit_code == 2
    assert "is an input" in result.stderr or "is the name of a model" in result.stderr
    assert contents(tmp_path) == before


@pytest.mark.parametrize("option", ["--junit", "--summary"])
def test_the_model_itself_is_refused(option: str, model: Path) -> None:
    before = model.read_bytes()
    result = invoke("verify", model, option, model)
    assert (result.exit_code, model.read_bytes()) == (2, before)


@pytest.mark.parametrize("kind", LINKS)
@pytest.mark.parametrize("command", ["bake", "strip", "shader"])
def test_a_report_that_is_an_output_by_another_name_is_refused(
    command: str, kind: str, model: Path, tmp_path: Path
) -> None:
    baked = tmp_path / "baked.glb"
    bake(model, baked)
    link = tmp_path / "link.glb"
    LINKS[kind](baked, link)
    before = contents(tmp_path)
    arguments: dict[str, list[str | Path]] = {
        "bake": ["bake", baked, "-o", link],
        "strip": ["strip", baked, "-o", link],
        "shader": ["shader", "--lang", "glsl", "--for", baked, "-o", link],
    }
    assert invoke(*arguments[command]).exit_code == 2
    assert contents(tmp_path) == before


@pytest.mark.parametrize("kind", LINKS)
@pytest.mark.parametrize(
    "arguments",
    [
        ["shader", "--lang", "glsl", "--for", "{model}", "-o", "{link}"],
        ["verify", "{model}", "--junit", "{link}"],
        ["verify", "{model}", "--summary", "{link}"],
        ["bake", "{model}", "--dry-run", "--summary", "{link}"],
    ],
)
def test_a_file_that_an_input_consists_of_is_refused(arguments: list[str], kind: str, tmp_path: Path) -> None:
    source = copied(SHARED, tmp_path / "in")
    baked = source.with_name("baked.gltf")
    bake(source, baked)
    link = tmp_path / "report.txt"
    LINKS[kind](source.parent / SHARED_BIN, link)
    before = contents(tmp_path)
    result = invoke(*(argument.format(model=baked, link=link) for argument in arguments))
    assert result.exit_code == 2, result.stderr
    assert contents(tmp_path) == before


@pytest.mark.parametrize("linked", [False, True])
def test_two_options_cannot_have_one_file(linked: bool, model: Path, tmp_path: Path) -> None:
    first = second = tmp_path / "report"
    if linked:
        second = tmp_path / "other"
        second.symlink_to(first)
    result = invoke("verify", model, "--junit", first, "--summary", second)
    assert result.exit_code == 2
    assert "is the file of --junit" in result.stderr
    assert not first.exists()


@pytest.mark.parametrize("option", ["--junit", "--html", "--summary", "--dump-normals"])
def test_a_report_needs_the_name_of_a_file(option: str, model: Path, tmp_path: Path) -> None:
    for name, reason in (
        ("", f"{option}: the name is empty; is a variable of your script not set?"),
        ("-", f"{option} needs the name of a file, not -; stdout has other text already"),
        (str(tmp_path), f"{tmp_path} is a folder: name the file"),
        (f"{tmp_path}/new/", f"{tmp_path}/new/ is a folder: name the file"),
    ):
        result = invoke("verify", model, option, name)
        assert result.exit_code == 2
        assert result.stderr.endswith(f"Error: {reason}\n")
    assert not (tmp_path / "new").exists()


def test_a_link_to_the_output_is_no_summary(model: Path, tmp_path: Path) -> None:
    (tmp_path / "log").symlink_to("out.glb")
    result = invoke("bake", model, "-o", tmp_path / "out.glb", "--summary", tmp_path / "log")
    assert result.exit_code == 2
    assert not (tmp_path / "out.glb").exists()


def test_earlier_reports_are_replaced_and_streams_are_written(model: Path, tmp_path: Path) -> None:
    junit, summary = tmp_path / "a.xml", tmp_path / "a.jsonl"
    (tmp_path / "empty").touch()
    for _ in range(2):
        result = invoke("verify", model, "--poses", "rest", "--junit", junit, "--summary", summary)
        assert result.exit_code == 0
    assert junit.read_text(encoding="utf-8").count("<testsuites") == 1
    assert [json.loads(line)["kind"] for line in summary.read_text("utf-8").splitlines()] == ["file", "total"]
    result = invoke("verify", model, "--poses", "rest", "--junit", os.devnull, "--summary", os.devnull)
    assert result.exit_code == 0
    assert invoke("verify", model, "--poses", "rest", "--junit", tmp_path / "empty").exit_code == 0


def test_a_report_is_written_whole_or_not_at_all(model: Path, tmp_path: Path) -> None:
    junit = tmp_path / "a.xml"
    junit.write_text("<testsuites/>", encoding="utf-8")
    inode = junit.stat().st_ino
    assert invoke("verify", model, "--poses", "rest", "--junit", junit, "--no-sync").exit_code == 0
    assert junit.stat().st_ino != inode  # renamed into place
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.xml", "seam.glb"]


@pytest.mark.parametrize("kind", ["fitted", "surface"])
def test_inspect_names_the_kind_of_gradients(tmp_path: Path, kind: str) -> None:
    target = tmp_path / "tube.glb"
    assert invoke("bake", MODELS / "bent_tube.glb", "-o", target, "-q", "--gradients", kind).exit_code == 0
    assert f", gradients {kind}, frame from normal, " in invoke("inspect", target).stdout


@pytest.mark.slow
def test_verify_says_which_reports_it_has_written(model: Path, tmp_path: Path) -> None:
    page, junit, summary = (tmp_path / f"report.{suffix}" for suffix in ("html", "xml", "jsonl"))
    reports: list[str | Path] = ["--html", page, "--junit", junit, "--summary", summary]
    command = ["verify", model, "--poses", "rest", *reports]
    lines = [f"{junit}: written", f"{page}: written", f"{summary}: written"]
    assert invoke(*command).stdout.splitlines()[-3:] == lines
    assert invoke(*command, "-q").output == ""
    assert "input" in json.loads(invoke(*command, "--json").stdout)["files"][0]
    several = invoke(*command, copied("bent_tube.glb", tmp_path))
    lines[1] = f"{page}: written, its pages in {tmp_path / 'report'}"
    assert several.stdout.splitlines()[-3:] == lines
    (tmp_path / "broken.glb").touch()
    alone = invoke("verify", tmp_path / "broken.glb", "--html", page)
    assert alone.stdout.splitlines()[-1] == f"{page}: written", "an index without pages"


def test_a_report_that_was_not_written_is_not_said_to_be(model: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    names = [tmp_path / "file" / f"report.{suffix}" for suffix in ("html", "xml")]
    result = invoke("verify", model, "--poses", "rest", "--html", names[0], "--junit", names[1])
    assert result.exit_code == 4
    assert "written" not in result.stdout


@pytest.mark.parametrize("command", [["bake", "-o"], ["strip", "-o"], ["inspect"]])
def test_every_command_says_that_the_summary_was_written(
    command: list[str], model: Path, tmp_path: Path
) -> None:
    baked, summary = tmp_path / "baked.glb", tmp_path / "summary.jsonl"
    bake(model, baked)
    output = [tmp_path / "out.glb"] if command[1:] else []
    result = invoke(command[0], baked, *command[1:], *output, "--summary", summary)
    assert result.stdout.splitlines()[-1] == f"{summary}: written"
