"""Many files in one call: the same with any runner, told in order, and safe from deaths and Ctrl-C."""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from benchmarks.skinned_grid import grid_of, write_grid
from skinbake import threads
from skinbake.choices import PoseKind
from skinbake.cli.console import Console
from skinbake.cli.progress import Progress
from skinbake.commands.bake import bake_file
from skinbake.errors import InputError, OutputError, Place, SkinbakeError
from skinbake.jobs import processes
from skinbake.jobs.file_work import FileWork
from skinbake.jobs.verify import Verify
from skinbake.jobs.work import InThisProcess, Job
from skinbake.measure.options import VerifyOptions
from skinbake.timing import Told, stage
from skinbake.truth.poses import PoseRequest
from tests.support.baking import bake_work
from tests.support.command_line import LINUX, document, invoke, run
from tests.support.models import FIXTURES, FOLDER, SHARED_BIN, sheet, write_model
from tests.support.schemas import BAKE, PROCESS_TIMINGS, TIMINGS, VERIFY, checked
from tests.support.signals import HEARING, NOHUP, OWNING


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture
def mixed(tmp_path: Path) -> Path:
    """Make a folder of all sorts: fixtures, files with warnings, without a skin, broken ones."""
    folder = tmp_path / "in"
    folder.mkdir()
    for name in (*FIXTURES, SHARED_BIN):
        shutil.copyfile(FOLDER / name, folder / name)
    (folder / "broken.glb").write_bytes(b"glTF, but no more than that")
    (folder / "text.gltf").write_text("hello", encoding="utf-8")
    write_model(folder / "half.glb", [sheet(), sheet(NORMAL=None)])
    write_model(folder / "bare.glb", [sheet(NORMAL=None)])
    return folder


def without_rate(stderr: str) -> str:
    """Return messages without the line that tells of time."""
    return "\n".join(line for line in stderr.splitlines() if "files/s" not in line)


@pytest.mark.slow
@pytest.mark.parametrize("options", [[], ["-v"], ["--json"], ["--encoding", "snorm16"]])
def test_bake_is_the_same_with_any_number_of_processes(
    options: list[str], mixed: Path, tmp_path: Path, workers: list[int]
) -> None:
    said, made = [], []
    for jobs in ("1", "2", "auto"):
        out = tmp_path / "out"
        result = invoke("bake", mixed, "--out-dir", out, "--jobs", jobs, *options)
        assert result.exit_code == 3
        said.append((result.stdout, without_rate(result.stderr)))
        made.append(contents(out))
        shutil.rmtree(out)
    assert workers == [2, threads.usable_cores()]
    assert said[0] == said[1] == said[2]
    assert made[0] == made[1] == made[2]
    assert set(made[0]) >= {*FIXTURES, "half.glb", "bare.glb"}


@pytest.mark.slow
def test_verify_is_the_same_with_any_number_of_processes(
    mixed: Path, tmp_path: Path, workers: list[int]
) -> None:
    invoke("bake", mixed, "--out-dir", tmp_path / "out")
    shutil.copyfile(mixed / "broken.glb", tmp_path / "out" / "broken.glb")
    options = ["--poses", "random:2", "--max-mean-error", "0.5"]
    said = [
        (result.exit_code, result.stdout, without_rate(result.stderr))
        for jobs in ("1", "2")
        for result in [invoke("verify", tmp_path / "out", "--jobs", jobs, *options)]
    ]
    assert workers == [2]
    assert said[0] == said[1]
    assert said[0][0] == 3


@pytest.mark.parametrize("jobs", [["--jobs", "4"], []])
def test_few_small_files_start_no_process(
    jobs: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*arguments: object) -> object:
        raise AssertionError("a process was started")

    monkeypatch.setattr(processes, "started", refused)
    models = [FOLDER / "seam.glb", FOLDER / "two_sets.glb"]
    assert invoke("bake", *models, "--out-dir", tmp_path, *jobs).exit_code == 0
    with pytest.raises(AssertionError, match="a process was started"):
        monkeypatch.setattr("skinbake.cli.runners.WORTHWHILE", 0.0)
        invoke("bake", *models, "--out-dir", tmp_path, "--jobs", "2")


@pytest.mark.parametrize("value", ["-1", "many", "1.5", "", "257", "9" * 5000])
def test_jobs_is_a_number_or_auto(value: str) -> None:
    result = invoke("bake", FOLDER / "seam.glb", "--dry-run", "--jobs", value)
    assert result.exit_code == 2
    assert "expected a number of processes up to 256, or auto, found " in result.stderr


@pytest.mark.parametrize(
    "error",
    [
        InputError("it is broken", Place("a.glb", 1, "arm", 2, "POSITION")),
        OutputError("no space", Place("b.glb")),
        SkinbakeError("no place"),
    ],
)
def test_errors_survive_the_way_between_processes(error: SkinbakeError) -> None:
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is type(error)
    assert (str(copy), copy.message, copy.place) == (str(error), error.message, error.place)


@pytest.mark.slow
def test_results_and_verdicts_survive_it(mixed: Path, tmp_path: Path) -> None:
    bake = FileWork((bake_work(),), is_timed=True)
    verify = FileWork((Verify(VerifyOptions(poses=PoseRequest(PoseKind.RANDOM, 1))),), is_timed=True)
    for path in sorted(mixed.glob("*.gl*")):
        result = bake(Job(str(path), str(tmp_path / "out" / path.name)))
        verdict = verify(Job(str(tmp_path / "out" / path.name)))
        for found in (result, verdict):
            copy = pickle.loads(pickle.dumps(found))
            # Errors are equal by identity only.
            assert repr(copy) == repr(found)
    for work in (bake, verify):
        assert pickle.loads(pickle.dumps(work)) == work


class TestWhatIsSaidAtTheEnd:
    @pytest.mark.slow
    def test_failures_whose_lines_are_in_sight_are_told_once(self, mixed: Path, tmp_path: Path) -> None:
        lines = invoke("bake", mixed, "--out-dir", tmp_path / "out").stderr.splitlines()
        assert sum(str(mixed / "broken.glb") in line for line in lines) == 1
        assert sum(str(mixed / "text.gltf") in line for line in lines) == 1
        assert lines[-1].startswith("15 files: 12 baked, 1 unchanged, 2 failed, in ")

    @pytest.mark.slow
    def test_failures_of_many_files_are_listed_once_more(self, mixed: Path, tmp_path: Path) -> None:
        for number in range(6):
            shutil.copyfile(FOLDER / "seam.glb", mixed / f"more{number}.glb")
        result = invoke("bake", mixed, "--out-dir", tmp_path / "out")
        lines = result.stderr.splitlines()
        start = lines.index("2 of 21 files failed:")
        assert lines[start + 1].startswith(f"  {mixed / 'broken.glb'}: ")
        assert lines[start + 2].startswith(f"  {mixed / 'text.gltf'}: its JSON cannot be parsed")
        assert lines[start + 3].startswith("21 files: 18 baked, 1 unchanged, 2 failed, in ")
        assert len(lines) == start + 4

    @pytest.mark.slow
    def test_a_single_failure_is_not_listed_once_more(self, mixed: Path, tmp_path: Path) -> None:
        (mixed / "text.gltf").unlink()
        for number in range(7):
            shutil.copyfile(FOLDER / "seam.glb", mixed / f"more{number}.glb")
        result = invoke("bake", mixed, "--out-dir", tmp_path / "out")
        assert result.exit_code == 3
        assert "failed:" not in result.stderr

    @pytest.mark.slow
    def test_a_quiet_run_names_each_failure_once(self, mixed: Path, tmp_path: Path) -> None:
        lines = invoke("bake", mixed, "--out-dir", tmp_path / "out", "-q").stderr.splitlines()
        assert len(lines) == 2
        assert lines[0].startswith(f"error: {mixed / 'broken.glb'}: ")
        assert lines[1].startswith(f"error: {mixed / 'text.gltf'}: ")

    @pytest.mark.slow
    def test_checks_that_fail_are_listed_once_more(self, tmp_path: Path) -> None:
        invoke("bake", FOLDER / "seam.glb", FOLDER / "two_sets.glb", "--out-dir", tmp_path)
        result = invoke("verify", tmp_path, "--poses", "rest", "--min-gain", "1000", "--max-mean-error", "0")
        assert result.exit_code == 1
        assert "files failed:" not in result.stderr  # a few are told once
        for number in range(20):
            shutil.copyfile(tmp_path / "seam.glb", tmp_path / f"{number:02}.glb")
        result = invoke("verify", tmp_path, "--poses", "rest", "--min-gain", "1000", "--max-mean-error", "0")
        lines = result.stderr.splitlines()
        start = lines.index("22 of 22 files failed:")
        assert lines[start + 1].startswith(f"  {tmp_path / '00.glb'}: ")
        assert lines[start + 23].startswith("22 files: 22 failed, in ")

    def test_of_very_many_the_first_are_listed(self, tmp_path: Path) -> None:
        for number in range(130):
            (tmp_path / f"{number:03}.glb").touch()
        result = invoke("bake", tmp_path, "--dry-run")
        lines = result.stderr.splitlines()
        start = lines.index("130 of 130 files failed:")
        assert lines[start + 100].startswith(f"  {tmp_path / '099.glb'}: ")
        assert lines[start + 101] == "  … and 30 more"

    def test_a_few_that_went_well_need_no_word(self, tmp_path: Path) -> None:
        models = [FOLDER / "seam.glb", FOLDER / "two_sets.glb"]
        assert invoke("bake", *models, "--out-dir", tmp_path).stderr == ""
        assert "2 files: 2 baked, in " in invoke("bake", *models, "--out-dir", tmp_path, "-v").stderr

    @pytest.mark.slow
    def test_very_many_do(self, tmp_path: Path) -> None:
        for number in range(21):
            shutil.copyfile(FOLDER / "seam.glb", tmp_path / f"{number}.glb")
        assert "21 files: 21 baked, in " in invoke("bake", tmp_path, "--dry-run").stderr
        assert invoke("bake", tmp_path, "--dry-run", "-q").stderr == ""


COUNT = {"type": "integer", "minimum": 0}
SECONDS = {"type": "number", "minimum": 0}


def lines_schema(whole: dict[str, Any], schema: str, outcomes: list[str]) -> dict[str, Any]:
    """Return the schema of a summary's lines, of which a file's are made of the document's."""
    file = whole["properties"]["files"]["items"]
    heading = {"schema": {"const": schema}, "kind": {"const": "file"}}
    total = {
        "schema": {"const": schema},
        "kind": {"const": "total"},
        "exit_code": whole["properties"]["exit_code"],
        "files": COUNT,
        "seconds": SECONDS,
        **dict.fromkeys(outcomes, COUNT),
    }
    return {
        "oneOf": [
            {
                **file,
                "properties": heading | file["properties"],
                "required": ["schema", "kind", *file["required"]],
            },
            {
                "type": "object",
                "properties": total | {"timings": TIMINGS},
                "required": list(total),
                "additionalProperties": False,
            },
        ]
    }


BAKE_LINES = lines_schema(BAKE, "skinbake.bake/1", ["baked", "left", "unchanged", "up_to_date", "failed"])
VERIFY_LINES = lines_schema(VERIFY, "skinbake.verify/1", ["passed", "up_to_date", "failed"])


def summary_of(path: Path, schema: dict[str, Any]) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Return the lines of the files, and the last line."""
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    for line in lines:
        jsonschema.validate(line, schema)
    assert [line["kind"] for line in lines] == ["file"] * (len(lines) - 1) + ["total"]
    return lines[:-1], lines[-1]


@pytest.mark.slow
class TestSummary:
    @pytest.mark.parametrize("jobs", ["1", "2"])
    def test_bake(self, jobs: str, mixed: Path, tmp_path: Path, workers: list[int]) -> None:
        summary = tmp_path / "s.jsonl"
        options = ["--jobs", jobs, "--json", "--summary", str(summary)]
        result = invoke("bake", mixed, "--out-dir", tmp_path / "out", *options)
        files, total = summary_of(summary, BAKE_LINES)
        for line in files:
            del line["schema"], line["kind"]
        assert files == document(result)["files"]
        counts = {key: total[key] for key in ("files", "baked", "unchanged", "up_to_date", "failed")}
        assert counts == {"files": 15, "baked": 12, "unchanged": 1, "up_to_date": 0, "failed": 2}
        assert total["exit_code"] == result.exit_code == 3

    def test_verify(self, tmp_path: Path) -> None:
        invoke("bake", FOLDER / "seam.glb", FOLDER / "two_sets.glb", "--out-dir", tmp_path)
        (tmp_path / "z.glb").touch()
        summary = tmp_path / "s.jsonl"
        result = invoke("verify", tmp_path, "--poses", "rest", "--json", "--summary", summary, "--timings")
        files, total = summary_of(summary, VERIFY_LINES)
        for line in files:
            del line["schema"], line["kind"]
        assert files == document(result)["files"]
        assert (total["files"], total["passed"], total["failed"]) == (3, 2, 1)

    def test_the_summary_grows_with_each_file(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        summary, seen = tmp_path / "s.jsonl", []

        def looking(*arguments: Any) -> Any:
            seen.append(summary.read_text(encoding="utf-8").count("\n"))
            return bake_file(*arguments)

        monkeypatch.setattr("skinbake.jobs.bake.bake_file", looking)
        models = [FOLDER / name for name in FIXTURES[:4]]
        invoke("bake", *models, "--dry-run", "--summary", summary)
        assert seen == [0, 1, 2, 3]

    def test_where_it_cannot_be_written_nothing_is_baked(self, tmp_path: Path) -> None:
        (tmp_path / "file").touch()
        process = run(
            "bake", FOLDER / "seam.glb", "--out-dir", tmp_path / "out", "--summary", tmp_path / "file" / "s"
        )
        assert process.returncode == 4
        assert b"cannot be written" in process.stderr
        assert not (tmp_path / "out").exists()

    @pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
    def test_a_full_disk_is_told_of_once_and_stops_no_bake(self, tmp_path: Path) -> None:
        models = [FOLDER / "seam.glb", FOLDER / "two_sets.glb"]
        process = run("bake", *models, "--out-dir", tmp_path, "--summary", "/dev/full")
        assert process.returncode == 4
        assert process.stderr.count(b"No space left") == 1
        assert sorted(contents(tmp_path)) == ["seam.glb", "two_sets.glb"]

    @pytest.mark.parametrize("option", ["--summary", "--state"])
    def test_a_report_does_not_take_the_name_of_a_model(self, option: str, tmp_path: Path) -> None:
        more = ["--skip-unchanged"] if option == "--state" else []
        result = invoke(
            "bake", FOLDER / "seam.glb", "-o", tmp_path / "a.glb", option, tmp_path / "b.glb", *more
        )
        assert result.exit_code == 2
        assert "is the name of a model" in result.stderr


class TestTimings:
    def test_timings_of_one_file(self, tmp_path: Path) -> None:
        result = invoke("bake", FOLDER / "seam.glb", "-o", tmp_path / "a.glb", "--timings", "--json")
        found = checked(document(result), BAKE)
        (file,) = found["files"]
        jsonschema.validate(file["timings"], TIMINGS)
        jsonschema.validate(found["timings"], PROCESS_TIMINGS)
        assert 0 < sum(file["timings"].values()) < found["timings"]["elapsed"]
        lines = result.stderr.splitlines()
        assert lines[0] == "seconds by stage:"
        assert [line.split()[0] for line in lines[1:]] == [
            *file["timings"],
            "together",
            "seconds",
            "start-up",
            "imports",
            "elapsed",
        ]

    def test_stages_are_those_that_were_recorded(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def staged(*arguments: Any) -> Any:
            with stage("sleeping"):
                time.sleep(0.03)
            return bake_file(*arguments)

        monkeypatch.setattr("skinbake.jobs.bake.bake_file", staged)
        models = [FOLDER / "seam.glb", FOLDER / "two_sets.glb"]
        result = invoke("bake", *models, "--out-dir", tmp_path, "--timings", "--json")
        for file in document(result)["files"]:
            assert file["timings"]["sleeping"] >= 0.03
            assert file["timings"]["other"] > 0
        assert "seconds by stage, summed over 2 files:" in result.stderr
        (line,) = [line for line in result.stderr.splitlines() if "sleeping" in line]
        assert float(line.split()[1]) >= 0.06

    @pytest.mark.slow
    def test_verify(self, tmp_path: Path) -> None:
        invoke("bake", FOLDER / "seam.glb", "-o", tmp_path / "a.glb")
        result = invoke("verify", tmp_path / "a.glb", "--poses", "rest", "--timings", "--json")
        found = document(result)
        jsonschema.validate(found, VERIFY)
        (file,) = found["files"]
        # It would be 0 if the stages had more time than the file took.
        assert file["timings"]["other"] > 0
        assert {"read", "poses", "figures"} < set(file["timings"])
        assert sum(file["timings"].values()) < found["timings"]["elapsed"]
        assert "seconds by stage:" in result.stderr

    def test_json_has_no_timings_unasked(self, tmp_path: Path) -> None:
        found = document(invoke("bake", FOLDER / "seam.glb", "-o", tmp_path / "a.glb", "--json"))
        assert "timings" not in found
        assert "timings" not in found["files"][0]


class Clock:
    """A clock that runs a second a look."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        self.now += 1.0
        return self.now


class TestProgress:
    @pytest.fixture(autouse=True)
    def slow(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("skinbake.cli.progress.time", type("Time", (), {"monotonic": Clock()}))

    @pytest.fixture
    def terminal(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("TTY_COMPATIBLE", "1")
        monkeypatch.setenv("FORCE_COLOR", "1")
        monkeypatch.delenv("NO_COLOR", raising=False)

    @pytest.mark.slow
    @pytest.mark.usefixtures("terminal")
    @pytest.mark.parametrize("command", ["bake", "verify"])
    def test_a_terminal_gets_a_bar(self, command: str, tmp_path: Path) -> None:
        models = [FOLDER / name for name in FIXTURES]
        options = ["--dry-run"] if command == "bake" else ["--poses", "rest"]
        result = invoke(command, *models, *options, "--color", "never")
        assert f"{len(models)}/{len(models)}" in result.stderr
        assert "/s" in result.stderr
        # Results are where they would be without a bar.
        plain = invoke(command, *models, *options, "-q")
        assert plain.stderr == ""
        assert next(line for line in result.stdout.splitlines() if ".gl" in line).startswith(str(models[0]))
        assert result.stdout.count("dry run" if command == "bake" else ", run skinbake bake\n") == len(models)

    def test_a_log_gets_nothing(self, tmp_path: Path) -> None:
        models = [FOLDER / name for name in FIXTURES if name != "foreign_joints.glb"]
        assert without_rate(invoke("bake", *models, "--dry-run").stderr) == ""

    @pytest.mark.slow
    def test_a_talkative_log_gets_a_line_now_and_then(self, tmp_path: Path) -> None:
        for number in range(30):
            shutil.copyfile(FOLDER / "seam.glb", tmp_path / f"{number:02}.glb")
        result = invoke("bake", tmp_path, "--dry-run", "-v")
        lines = [line for line in result.stderr.splitlines() if line.startswith("files: ")]
        last = "files: 29 of 30, 0.967/s, 1 s left"
        assert lines == ["files: 9 of 30, 0.9/s, 23 s left", "files: 19 of 30, 0.95/s, 12 s left", last]

    def test_a_file_counts_as_done_before_the_slow_ones_in_front_of_it(
        self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        events: list[tuple[str, str]] = []

        def backwards(self: Any, work: Any, jobs: Any) -> Generator[tuple[int, Any], None, None]:
            for number in reversed(range(len(jobs))):
                yield number, work(jobs[number])

        monkeypatch.setattr(InThisProcess, "run", backwards)
        monkeypatch.setattr(Progress, "finish", lambda self, source: events.append(("done", source)))
        monkeypatch.setattr(
            Console, "written", lambda self, line: events.append(("told", line.split(" ")[0]))
        )
        names = [str(tmp_path / f"{name}.glb") for name in "abc"]
        for name in names:
            shutil.copyfile(FOLDER / "seam.glb", name)
        assert invoke("bake", *names, "--dry-run").exit_code == 0
        assert events == [*(("done", name) for name in reversed(names)), *(("told", name) for name in names)]

    @pytest.mark.usefixtures("terminal")
    def test_a_bar_in_the_first_tick_of_the_clock_has_no_rate(
        self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.setattr("skinbake.cli.progress.time", type("Time", (), {"monotonic": lambda: 5.0}))
        with Progress(Console(0, color=False), 3, at_once=True):
            picture = capsys.readouterr().err
        assert "0/3" in picture
        assert "/s" not in picture

    @pytest.mark.usefixtures("terminal")
    def test_only_files_in_work_have_a_bar(self, capsys: pytest.CaptureFixture[str]) -> None:
        said: list[str] = []
        with Progress(Console(0, color=False), 3) as bar:
            bar.hear(Told("slow.glb", "rig", 1, 9))
            bar.hear(Told("quick.glb", "rig", 8, 9))
            assert "quick.glb" in capsys.readouterr().err
            bar.finish("quick.glb")
            picture = capsys.readouterr().err
            bar.print(lambda: said.append("slow.glb: baked"))
            assert said, "it does not wait for another file"
        assert "1/3" in picture
        assert "slow.glb" in picture
        assert "quick.glb" not in picture.rpartition("1/3")[2]

    @pytest.mark.usefixtures("terminal")
    @pytest.mark.parametrize(
        ("files", "rows"),
        [
            (1, ["hero.glb", "hero.glb: rig", None, "hero.glb", "hero.glb: write"]),
            (2, [*[None] * 3, "hero.glb", None]),
        ],
    )
    def test_each_stage_of_a_single_file_is_drawn_at_once_and_so_is_every_end(
        self,
        files: int,
        rows: list[str | None],
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        """The clock stands still, so no other picture is due."""
        monkeypatch.setattr("skinbake.cli.progress.time", type("Time", (), {"monotonic": lambda: 5.0}))
        found = []
        with Progress(Console(0, color=False), files, at_once=True) as bar:
            bar.hear(Told("art/hero.glb", "read"))
            capsys.readouterr()
            for told in ((), ("rig",), ("rig", 1, 9), ("rig", 9, 9), ("write",)):
                bar.hear(Told("art/hero.glb", *told))
                row = re.search(r"hero\.glb(: *\w*)?", capsys.readouterr().err)
                found.append(row and row[0])
        assert found == rows


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Bake a grid whose verification is long, so that its progress is shown at once."""
    folder = tmp_path_factory.mktemp("large")
    write_grid(folder / "grid.glb", grid_of(10_000))
    assert invoke("bake", folder / "grid.glb", "-o", folder / "large.glb").exit_code == 0
    return folder / "large.glb"


@LINUX
class TestTerminal:
    """The text on a terminal of a process of its own, from the first second on."""

    def shown(self, *arguments: str | Path) -> list[tuple[float, str]]:
        """Return what a terminal gets on stderr, with the seconds since the start of the process."""
        leader, follower = os.openpty()
        environment = {**os.environ, "TERM": "xterm", "COLUMNS": "120"}
        start, found = time.monotonic(), []
        command = [sys.executable, "-m", "skinbake", *map(str, arguments)]
        process = subprocess.Popen(command, stderr=follower, stdout=subprocess.DEVNULL, env=environment)
        os.close(follower)
        with contextlib.suppress(OSError):  # Linux says EIO where the process has closed its end
            while text := os.read(leader, 100_000):
                found.append((time.monotonic() - start, text.decode()))
        os.close(leader)
        assert process.wait() == 0, found
        return found

    @pytest.mark.slow
    def test_a_long_verify_tells_each_stage_and_its_poses(self, large: Path) -> None:
        found = self.shown("verify", large, "--method", "lbs", "--poses", "random:40")
        text = "".join(part for _, part in found)
        for stage_name in ("gradient operator", "freshness"):
            assert f"large.glb: {stage_name}" in text
        assert "40/40" in text
        # The first picture comes before any long stage is over.
        assert text.index("large.glb") < text.index("large.glb: gradient operator")

    @pytest.mark.slow
    @pytest.mark.parametrize("jobs", ["1", "2"])
    def test_each_of_many_files_has_its_own_line(self, jobs: str, large: Path, tmp_path: Path) -> None:
        names = [f"{letter}.glb" for letter in "abcdefgh"]
        for name in names[:2]:
            shutil.copyfile(large, tmp_path / name)
        for name in names[2:]:
            shutil.copyfile(FOLDER / "seam.glb", tmp_path / name)
        baked = [tmp_path / name for name in names[2:]]
        assert invoke("bake", *baked, "--in-place").exit_code == 0
        found = self.shown("verify", tmp_path, "--method", "lbs", "--poses", "random:1500", "--jobs", jobs)
        text = "".join(part for _, part in found)
        assert "0/8" in text
        assert "8/8" in text
        assert "a.glb" in text
        assert "8 files: 8 passed" in text, "eight files have totals"


FILES = 99
"""Enough for workers to be started."""


@pytest.fixture(scope="module")
def grids(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make files of 2,500 vertices in three folders."""
    root = tmp_path_factory.mktemp("grids")
    write_grid(root / "grid.glb", grid_of(2500))
    data = (root / "grid.glb").read_bytes()
    (root / "grid.glb").unlink()
    for number in range(FILES):
        path = root / f"d{number % 3}" / f"{number:02}.glb"
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)
    return root


def wait_for(condition: Callable[[], Any], seconds: float = 60.0) -> Any:
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, "it did not come about"
        time.sleep(0.005)
    return found


def group(pgid: int) -> dict[int, int]:
    """Return the living processes of a group, each with its parent."""
    found = {}
    for entry in Path("/proc").iterdir():
        if not entry.name.isdecimal():
            continue
        try:
            fields = (entry / "stat").read_text(errors="replace").rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[2]) == pgid and fields[0] != "Z":
            found[int(entry.name)] = int(fields[1])
    return found


def workers_of(pgid: int) -> list[int]:
    """Return the workers: grandchildren of the command."""
    members = group(pgid)
    return [pid for pid, parent in members.items() if members.get(parent) == pgid]


@pytest.fixture
def running(grids: Path, tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    """Start bakes of the grids into out/, in a process group of their own; kill what is left at the end."""
    started = []

    def start(*options: str, by: str = HEARING) -> subprocess.Popen[bytes]:
        command = ["-m", "skinbake", "bake", str(grids), "--out-dir", str(tmp_path / "out"), "--jobs", "2"]
        process = subprocess.Popen(
            [sys.executable, "-c", by, *command, *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()


def made(folder: Path) -> list[Path]:
    return list(folder.glob("*/*.glb"))


@pytest.mark.slow
@LINUX
@pytest.mark.parametrize(
    ("whom", "number", "code"),
    [
        ("group", signal.SIGINT, 130),
        ("command", signal.SIGTERM, 143),
        pytest.param("command", signal.SIGINT, 130, marks=pytest.mark.slow),
        pytest.param("group", signal.SIGTERM, 143, marks=pytest.mark.slow),
        pytest.param("group", signal.SIGHUP, 129, marks=pytest.mark.slow),
        pytest.param("command", signal.SIGHUP, 129, marks=pytest.mark.slow),
    ],
)
def test_an_interrupt_ends_all_and_leaves_whole_files_only(
    number: signal.Signals,
    code: int,
    whom: str,
    running: Callable[..., subprocess.Popen[bytes]],
    grids: Path,
    tmp_path: Path,
) -> None:
    process = running()
    wait_for(lambda: len(made(tmp_path / "out")) >= 3)
    (os.killpg if whom == "group" else os.kill)(process.pid, number)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == code, errors
    assert b"Traceback" not in errors
    assert b"interrupted after " in errors
    wait_for(lambda: not group(process.pid), 10)
    done = made(tmp_path / "out")
    assert 3 <= len(done) < FILES
    # Nothing else is there, and what is there is whole: the same bytes as from a bake by itself.
    everything = [path for path in (tmp_path / "out").rglob("*") if path.is_file()]
    assert sorted(everything) == sorted(done)
    expected = tmp_path / "one.glb"
    invoke("bake", grids / "d0" / "00.glb", "-o", expected)
    assert {path.read_bytes() for path in done} == {expected.read_bytes()}


@pytest.mark.slow
@LINUX
@pytest.mark.parametrize("jobs", ["1", "2"])
def test_a_terminal_that_is_closed_ends_all(jobs: str, grids: Path, tmp_path: Path) -> None:
    leader, follower = os.openpty()
    command = ["-m", "skinbake", "bake", str(grids), "--out-dir", str(tmp_path / "out"), "--jobs", jobs]
    process = subprocess.Popen(
        [sys.executable, "-c", OWNING, *command],
        stdin=follower,
        stdout=follower,
        stderr=follower,
        start_new_session=True,
    )
    os.close(follower)
    while len(made(tmp_path / "out")) < 3:
        os.read(leader, 100_000)
    os.close(leader)
    assert process.wait(30) == 129
    wait_for(lambda: not group(process.pid), 10)
    assert 3 <= len(made(tmp_path / "out")) < FILES
    assert [path.name for path in (tmp_path / "out").rglob(".*")] == []


@pytest.mark.slow
@LINUX
def test_the_end_of_a_terminal_may_be_ignored(
    running: Callable[..., subprocess.Popen[bytes]], tmp_path: Path
) -> None:
    process = running("--json", by=NOHUP)
    wait_for(lambda: made(tmp_path / "out"))
    os.killpg(process.pid, signal.SIGHUP)
    out, errors = process.communicate(timeout=120)
    assert (process.returncode, errors.count(b"Traceback")) == (0, 0), errors
    assert [file["status"] for file in json.loads(out)["files"]] == ["baked"] * FILES


@pytest.mark.slow
@LINUX
def test_a_killed_worker_costs_no_file(
    running: Callable[..., subprocess.Popen[bytes]], tmp_path: Path
) -> None:
    process = running("--json")
    wait_for(lambda: made(tmp_path / "out"))
    victim = wait_for(lambda: workers_of(process.pid))[0]
    os.kill(victim, signal.SIGKILL)
    out, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    assert [file["status"] for file in json.loads(out)["files"]] == ["baked"] * FILES
    assert len(made(tmp_path / "out")) == FILES
    assert victim not in group(process.pid)


@pytest.mark.slow
@LINUX
def test_a_command_that_is_killed_leaves_no_worker_behind(
    running: Callable[..., subprocess.Popen[bytes]], tmp_path: Path
) -> None:
    process = running()
    wait_for(lambda: made(tmp_path / "out"))
    assert workers_of(process.pid)
    process.kill()
    process.communicate(timeout=30)
    wait_for(lambda: not group(process.pid), 20)
    # Each worker has brought the file that it was at to its end.
    assert [path.name for path in (tmp_path / "out").rglob(".*")] == []
