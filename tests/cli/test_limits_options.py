"""--max-memory, --timeout and --isolate: what a file may take, and what becomes of one that takes more."""

from __future__ import annotations

import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from skinbake.cli.console import Console
from skinbake.cli.inputs import expanded
from skinbake.cli.plan import Plan
from skinbake.cli.runners import memory_of_each
from skinbake.gltf.budget import machine_memory
from skinbake.options import BYTES
from tests.support.command_line import call, invoke, run
from tests.support.models import FOLDER, baked, crowd

SEAM, TUBE = FOLDER / "seam.glb", FOLDER / "bent_tube.glb"
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="needs the signals of POSIX")


@pytest.mark.parametrize(
    ("text", "size"),
    [("1", 1), ("1k", 1024), ("512M", 512 << 20), ("2G", 2 << 30), ("1.5GiB", 3 << 29), ("7 mb", 7 << 20)],
)
def test_sizes_are_read(text: str, size: int) -> None:
    assert BYTES.read(text) == size


@pytest.mark.parametrize("text", ["", "0", "M", "-1", "2X", "1e9", "nan", "0.1", "9" * 400])
def test_what_is_no_size_is_a_usage_error(text: str) -> None:
    result = invoke("inspect", SEAM, "--max-memory", text)
    assert result.exit_code == 2
    assert "expected a size in bytes, or like 512M or 2G, found " in result.stderr


@pytest.mark.parametrize(
    "command",
    [
        ["bake", SEAM, "--dry-run"],
        ["inspect", SEAM],
        ["verify", SEAM],
        ["strip", SEAM, "-o", "out.glb"],
    ],
)
def test_every_command_that_reads_takes_max_memory(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert invoke(*command, "--max-memory", "64M").exit_code == 0
    (tmp_path / "out.glb").unlink(missing_ok=True)
    result = invoke(*command, "--max-memory", "1k")
    assert result.exit_code == 3
    assert result.stderr.count("--max-memory") == 1
    assert f"error: {SEAM}: " in result.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("option", [["--timeout", "9"], ["--isolate"]])
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["bake", "-", "-o", "out.glb"], "needs files, not - for stdin or stdout"),
        (["bake", SEAM, "-o", "-"], "needs files, not - for stdin or stdout"),
        (["verify", "-"], "needs files, not - for stdin or stdout"),
        (["bake", SEAM, "--dry-run", "--dask", "tcp://h:1"], "controls processes of this machine"),
        (["verify", SEAM, "--dask", "tcp://h:1"], "controls processes of this machine"),
    ],
)
def test_what_cannot_be_another_process_s_work_is_refused(
    option: list[str], arguments: list[str], said: str
) -> None:
    result = invoke(*arguments, *option)
    assert result.exit_code == 2
    assert f"{option[0]} {said}" in result.stderr


def test_memory_is_shared_by_the_processes_that_there_are() -> None:
    (file,) = expanded(["a.glb"])
    for files, share in ((1, 4), (4, 4), (10, 10), (5000, 1000)):
        plan: Plan[Any] = Plan(
            command="bake", say=Console(0, color=False), jobs=1000, targets=[(file, None)] * files
        )
        assert memory_of_each(plan) == machine_memory() // share


@pytest.mark.parametrize("seconds", ["0", "-1", "nan", "inf"])
def test_a_time_that_is_none_is_refused(seconds: str) -> None:
    assert invoke("bake", SEAM, "--dry-run", "--timeout", seconds).exit_code == 2


@pytest.mark.slow
@POSIX
@pytest.mark.parametrize(
    "option",
    [
        ["--timeout", "60"],
        pytest.param(["--isolate"], marks=pytest.mark.slow),
        pytest.param(["--isolate", "--timeout", "60"], marks=pytest.mark.slow),
    ],
)
def test_limits_bake_the_same_bytes_in_a_process_of_their_own(option: list[str], tmp_path: Path) -> None:
    plain, other = tmp_path / "plain.glb", tmp_path / "other.glb"
    assert call("bake", TUBE, "-o", plain).returncode == 0
    result = run("bake", TUBE, "-o", other, *option)
    assert (result.returncode, result.stderr) == (0, b"")
    assert other.read_bytes() == plain.read_bytes()
    assert run("verify", other, *option).returncode == 0


@pytest.mark.slow
@POSIX
def test_a_file_that_takes_too_long_is_given_up_and_others_go_on(tmp_path: Path) -> None:
    slow, quick = tmp_path / "slow.glb", tmp_path / "quick.glb"
    baked(TUBE, slow)
    baked(SEAM, quick)
    result = run("verify", slow, quick, "--poses", "random:2000", "--timeout", "0.05", "--json")
    assert result.returncode == 3
    assert f"{slow}: not verified: it took longer than 0.05 s (--timeout)".encode() in result.stderr


@pytest.mark.slow
@POSIX
def test_a_bake_that_is_given_up_leaves_nothing(tmp_path: Path) -> None:
    """A buffer of many megabytes takes longer than a hundredth of a second to bake."""
    source = crowd(tmp_path / "in.glb", 400, 12)
    (tmp_path / "out").mkdir()
    result = run("bake", source, "-o", tmp_path / "out" / "out.glb", "--timeout", "0.01")
    assert result.returncode == 3
    assert b"not baked: it took longer than 0.01 s (--timeout)" in result.stderr
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.slow
@POSIX
def test_a_picture_that_is_given_up_leaves_nothing(tmp_path: Path) -> None:
    """No driver is needed: the time is over before the file is read."""
    result = run("render", TUBE, "-o", tmp_path / "out.png", "--timeout", "0.001")
    assert result.returncode == 3
    assert b"it took longer than 0.001 s (--timeout)" in result.stderr
    assert list(tmp_path.iterdir()) == []


@POSIX
@pytest.mark.slow
def test_the_folder_of_temporary_files_may_be_too_long_for_a_socket(tmp_path: Path) -> None:
    folder = tmp_path / ("t" * 100)
    folder.mkdir()
    result = run("inspect", SEAM, "--isolate", env={"TMPDIR": str(folder)})
    assert (result.returncode, result.stderr) == (0, b"")
    assert b"skinned primitive" in result.stdout


@pytest.mark.parametrize(
    ("command", "option"),
    [
        (["bake", "--dry-run"], ["--timeout", "9"]),
        (["verify"], ["--isolate"]),
        (["view", "-o", "page.html"], ["--timeout", "9"]),
    ],
)
def test_limits_that_need_another_process_are_refused_in_a_browser(
    command: list[str], option: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(sys, "platform", "emscripten")
    monkeypatch.chdir(tmp_path)
    result = invoke(*command, SEAM, *option)
    assert result.exit_code == 2
    assert f"{option[0]} is not available in a browser: it needs another process" in result.stderr


def test_a_browser_starts_no_thread_and_no_process(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def refuse(*_: object) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(sys, "platform", "emscripten")
    monkeypatch.setattr(threading.Thread, "start", refuse)
    monkeypatch.setattr("subprocess.Popen.__init__", refuse)
    several = ["--out-dir", str(tmp_path), "--jobs", "2", "--threads", "2"]
    assert invoke("bake", SEAM, TUBE, *several).exit_code == 0
