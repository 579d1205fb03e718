from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import jsonschema
import numpy as np
import pytest
from click.testing import CliRunner, Result

from skinbake.cli.main import main
from tests.support.baked_files import Editable, baked, source
from tests.support.models import Part, sheet, write_model
from tests.support.schemas import VERIFY


def run(*arguments: str | Path, data: bytes | None = None) -> Result:
    result = CliRunner().invoke(main, ["verify", *map(str, arguments)], input=data)
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


@pytest.fixture
def good(tmp_path: Path) -> Path:
    """A file that passes. Its α and β grow and shrink with the mesh, whatever the rig does."""
    return baked(source("seam.glb"), tmp_path, gradients="surface")


@pytest.fixture
def bad(good: Path, tmp_path: Path) -> Path:
    """A file that was edited after its bake."""
    model = Editable(good)
    model.array("POSITION")[:] *= 2
    return model.write(tmp_path / "bad.glb")


def test_a_good_file_exits_0_and_a_bad_one_1(good: Path, bad: Path) -> None:
    passed, failed = run(good), run(bad)
    assert (passed.exit_code, passed.stderr) == (0, "")
    assert passed.stdout.splitlines()[0] == f"{good}: passed"
    assert failed.exit_code == 1
    assert failed.stdout.splitlines()[0] == f"{bad}: FAILED"
    assert failed.stderr.startswith(f'error: {bad}: mesh 0 "seam", primitive 0: POSITION changed')


def test_several_files_have_a_line_each_and_all_of_it_with_v(good: Path, bad: Path) -> None:
    lines = run(good, bad).stdout.splitlines()
    assert [line.split(", ")[0] for line in lines] == [f"{good}: passed", f"{bad}: FAILED (freshness)"]
    alone = run(good, "-v").stdout + run(bad, "-v").stdout
    assert run("-v", good, bad).stdout == alone
    assert len(alone.splitlines()) > 20


@pytest.mark.slow
def test_several_files_return_the_worst_code_and_all_are_told(good: Path, bad: Path, tmp_path: Path) -> None:
    gone, text = tmp_path / "gone.glb", tmp_path / "text.glb"
    text.write_text("nothing of a GLB")
    for files, code in (
        ([good, bad], 1),
        ([bad, good], 1),
        ([bad, gone, good], 3),
        ([gone, bad], 3),
        ([text, good], 3),
        ([good, good], 0),
    ):
        result = run("--json", *files, "--samples", "2")
        assert result.exit_code == code
        document = json.loads(result.stdout)
        assert [entry["input"] for entry in document["files"]] == [str(file) for file in files]
        jsonschema.validate(document, VERIFY)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("bent_tube.glb", ["--samples", "4"]),
        ("two_primitives.glb", ["--poses", "random:3", "--max-mean-error", "0.01"]),
        ("shared_accessors.gltf", ["--samples", "2", "--method", "dqs", "--truth", "tangents"]),
        ("foreign_joints.glb", ["--poses", "rest"]),
    ],
)
def test_json_is_pure_and_as_documented(tmp_path: Path, name: str, options: list[str]) -> None:
    path = baked(source(name), tmp_path)
    result = run("--json", *options, path)
    document = json.loads(result.stdout)
    jsonschema.validate(document, VERIFY)
    assert document["exit_code"] == result.exit_code
    for entry in document["files"][0]["primitives"]:
        for method, figures in entry["normals_by_tangents"].items():
            assert figures.keys() == document["files"][0]["normals_by_tangents"][method].keys()
    unbaked = run("--json", "--require-baked", source(name), tmp_path / "gone.glb")
    jsonschema.validate(json.loads(unbaked.stdout), VERIFY)
    assert unbaked.exit_code == 3


@pytest.mark.parametrize(
    ("parts", "advice"),
    [
        ([sheet()], "run skinbake bake"),
        ([sheet(NORMAL=None)], "run skinbake bake --generate-normals"),
        ([sheet(), sheet(NORMAL=None)], "run skinbake bake"),
        ([sheet(NORMAL=None), sheet(POSITION=None)], "run skinbake bake --generate-normals"),
        ([sheet(POSITION=None)], "nothing in it can be baked; --require-baked is for characters"),
    ],
)
def test_require_baked_advises_what_can_be_done(parts: list[Part], advice: str, tmp_path: Path) -> None:
    result = run("--require-baked", write_model(tmp_path / "plain.glb", parts))
    assert result.exit_code == 1
    assert result.stderr.endswith(f"nothing in it is baked: {advice}\n")


def test_animations_are_meant_by_their_plural_too(tmp_path: Path) -> None:
    path = baked(source("bent_tube.glb"), tmp_path)
    options = ("--samples", "2", "--method", "lbs", "--json")
    found = [run("--poses", word, *options, path).stdout for word in ("animation", "animations")]
    assert json.loads(found[0])["files"][0]["poses"] == "2 poses of 1 clip (0.958 s)"
    assert found[0] == found[1]


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_a_bake_beside_broken_clips_is_measured_in_other_poses(number: float, tmp_path: Path) -> None:
    model = Editable(source("bent_tube.glb"))
    model.stored(model.content["animations"][0]["samplers"][0]["input"])[0] = number
    path = baked(model.write(tmp_path / "bent_tube.glb"), tmp_path / "baked")
    fault = 'clip "bend", node "tube_joint1": a time of its keys is not a finite number'
    warning = f"warning: {path}: its animations are broken, and are not played ({fault})"
    instead = ": random poses are measured in their place. Mend or remove the animations"
    for poses, words in (("animation", instead), ("random", ""), ("rest", "")):
        result = run("--poses", poses, "--method", "lbs", path)
        assert result.exit_code == 0
        assert result.stderr == f"{warning}{words}\n"


def test_samples_are_of_clips(good: Path) -> None:
    told = [
        json.loads(run("--json", good, *given).stdout)["files"][0]["poses"]
        for given in ([], ["--samples", "5"])
    ]
    assert told[0] == told[1]
    assert told[0].startswith("24 random poses")


def test_quiet_prints_errors_only(good: Path, bad: Path) -> None:
    assert run("-q", good).output == ""
    result = run("-q", bad)
    assert (result.exit_code, result.stdout) == (1, "")
    assert result.stderr.count("error:") == 1
    unbaked = run("-q", source("seam.glb"))
    assert (unbaked.exit_code, unbaked.output) == (0, "")
    assert "warning:" in run(source("seam.glb")).stderr
    # A script that asks for JSON gets it all the same.
    assert json.loads(run("-q", "--json", bad).stdout)["exit_code"] == 1


def test_text_says_not_baked_instead_of_passed(good: Path) -> None:
    plain = source("seam.glb")
    result = run(plain)
    assert result.exit_code == 0
    assert result.stdout.startswith(f"{plain}: not baked\n  There is no bake to judge. ")
    assert "passed" not in result.output
    several = run(plain, good, "--samples", "2", "-v")
    assert "2 files: 1 passed, 1 not baked" in several.stderr


def test_the_totals_count_files_that_cannot_be_read(good: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.glb"
    broken.write_bytes(good.read_bytes()[:40])
    result = run(good, broken, tmp_path / "gone.glb", "--poses", "rest", "-v")
    assert result.exit_code == 3
    assert "3 files: 1 passed, 2 failed, in " in result.stderr


def test_a_limit_says_that_a_file_is_not_baked(tmp_path: Path) -> None:
    plain = source("seam.glb")
    result = run(plain, "--min-gain", "1.5", "--junit", tmp_path / "report.xml")
    message = "it is not baked, so it cannot meet --min-gain: run skinbake bake first"
    assert result.exit_code == 1
    assert f"{plain}: FAILED" in result.stdout
    assert f"  limits  failed  {message}" in result.stdout
    assert f"error: {plain}: {message}" in result.stderr
    assert "warning" not in result.stderr
    suite = ElementTree.parse(tmp_path / "report.xml").getroot()[0]
    assert (suite.get("failures"), suite.get("skipped")) == ("1", "1")
    assert [case.get("name") for case in suite if case.find("failure") is not None] == ["limits"]
    assert [message in str(failure.get("message")) for failure in suite.iter("failure")] == [True]


def test_stdin_is_a_glb_called_dash(good: Path, bad: Path) -> None:
    assert run("-", data=good.read_bytes()).exit_code == 0
    result = run("--json", "-", data=bad.read_bytes())
    assert result.exit_code == 1
    assert json.loads(result.stdout)["files"][0]["input"] == "-"
    assert run("-", data=b"").exit_code == 3
    twice = run("-", "-", data=good.read_bytes())
    assert twice.exit_code == 2
    assert "stdin can be read only once" in twice.stderr


@pytest.mark.slow
def test_stdin_of_a_real_process(good: Path) -> None:
    process = subprocess.run(
        [sys.executable, "-m", "skinbake", "verify", "--json", "-"],
        input=good.read_bytes(),
        capture_output=True,
        check=False,
    )
    assert (process.returncode, process.stderr) == (0, b"")
    assert json.loads(process.stdout)["files"][0]["passed"] is True


def test_junit_is_written_beside_the_result(good: Path, bad: Path, tmp_path: Path) -> None:
    report = tmp_path / "report.xml"
    result = run("--junit", report, good, bad, tmp_path / "gone.glb")
    assert result.exit_code == 3
    root = ElementTree.parse(report).getroot()
    assert [suite.get("failures") for suite in root] == ["0", "1", "0"]
    assert [suite.get("errors") for suite in root] == ["0", "0", "1"]
    (failure,) = root.iter("failure")
    assert failure.text is not None
    assert "POSITION changed since its bake" in failure.text
    assert f"{good}: passed" in result.stdout
    assert json.loads(run("--json", "--junit", report, good).stdout)["exit_code"] == 0


def test_junit_that_cannot_be_written_exits_4(good: Path, bad: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    target = tmp_path / "file" / "folder.xml"
    for file in (good, bad):
        result = run("--junit", target, "--json", file)
        assert result.exit_code == 4
        assert f"error: {target}: cannot be written" in result.stderr
        assert json.loads(result.stdout)["exit_code"] == 4


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["hero.fbx"],
        ["--poses", "dance", "a.glb"],
        ["--poses", "random:0", "a.glb"],
        ["--poses", "random:x", "a.glb"],
        ["--poses", "random:", "a.glb"],
        ["--poses", "animations:2", "a.glb"],
        ["--poses", "rest:3", "a.glb"],
        ["--samples", "0", "a.glb"],
        ["--angle", "181", "a.glb"],
        ["--method", "ocs", "a.glb"],
        ["--baseline", "none", "a.glb"],
        ["--cap", "0", "a.glb"],
        ["--max-mean-error", "-1", "a.glb"],
    ],
)
def test_usage_errors_exit_2(arguments: list[str]) -> None:
    result = run(*arguments)
    assert result.exit_code == 2
    assert "Usage:" in result.stderr


class Clock:
    """A clock that runs a second a look, or stands still."""

    def __init__(self, step: float) -> None:
        self.now, self.step = 0.0, step

    def __call__(self) -> float:
        self.now += self.step
        return self.now


@pytest.fixture
def clocked(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Return a function that sets verify's clock."""

    def set_clock(step: float) -> None:
        monkeypatch.setattr("skinbake.cli.progress.time.monotonic", Clock(step))

    return set_clock


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make rich believe that stderr is a terminal."""
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.delenv("NO_COLOR", raising=False)


@pytest.mark.usefixtures("terminal")
def test_slow_work_shows_a_bar_on_stderr(good: Path, clocked: Callable[[float], None]) -> None:
    clocked(1000.0)
    result = run("--json", good)
    assert "100%" in result.stderr
    assert "seam.glb" in result.stderr
    assert json.loads(result.stdout)["exit_code"] == 0
    assert "100%" not in run("-q", good).stderr


@pytest.mark.usefixtures("terminal")
def test_quick_work_shows_none(good: Path, clocked: Callable[[float], None]) -> None:
    clocked(0.0)
    assert run(good).stderr == ""


def test_a_log_gets_no_bar(
    good: Path, clocked: Callable[[float], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    # A bar that shows nothing would still import rich, which takes a while.
    monkeypatch.setitem(sys.modules, "rich.progress", None)
    clocked(1000.0)
    assert run(good).stderr == ""


@pytest.mark.usefixtures("terminal")
def test_a_name_is_no_markup_for_the_bar(
    good: Path, tmp_path: Path, clocked: Callable[[float], None]
) -> None:
    odd = tmp_path / "[bold]hero.glb"
    odd.write_bytes(good.read_bytes())
    clocked(1000.0)
    result = run(odd)
    assert result.exit_code == 0
    assert "[bold]hero.glb" in result.stderr


@pytest.mark.slow
def test_odd_names_do_not_end_in_a_traceback(good: Path, tmp_path: Path) -> None:
    model = Editable(good)
    model.content["meshes"][0]["name"] = "lone \ud800 and \x1b[31m bell \x07"
    model.array("POSITION")[:] *= 2
    path, report = model.write(tmp_path / "odd.glb"), tmp_path / "report.xml"
    for options in (["--junit", str(report)], ["--json"]):
        process = subprocess.run(
            [sys.executable, "-m", "skinbake", "verify", *options, str(path)],
            capture_output=True,
            check=False,
            env={**os.environ, "PYTHONIOENCODING": "utf-8"},
        )
        assert process.returncode == 1, process.stderr
        assert b"Traceback" not in process.stderr
    ElementTree.parse(report)


def test_numbers_are_the_same_in_text_and_json(good: Path) -> None:
    text = run(good, "-v").stdout
    figures: dict[str, Any] = json.loads(run("--json", good).stdout)["files"][0]["normals_by_triangles"][
        "lbs"
    ]
    line = next(line for line in text.splitlines() if "LBS accurate" in line)
    shown = [f"{figures['accurate'][key]:.2f}" for key in ("mean", "p95", "p99", "max")]
    assert line.split()[2:6] == shown
