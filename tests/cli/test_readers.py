"""The reader of stdout may leave at any time: the exit code says so, in every command."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.command_line import run
from tests.support.models import FOLDER

if sys.platform == "win32":
    pytest.skip("needs the pipes of POSIX", allow_module_level=True)

SEAM = str(FOLDER / "seam.glb")
COMMANDS = [
    ["--help"],
    pytest.param(["--version"], marks=pytest.mark.slow),
    pytest.param(["bake", "--help"], marks=pytest.mark.slow),
    pytest.param(["bake", SEAM, "--dry-run"], marks=pytest.mark.slow),
    ["bake", SEAM, "-o", "-"],
    pytest.param(["bake", SEAM, SEAM, "--dry-run", "--jobs", "2"], marks=pytest.mark.slow),
    ["verify", SEAM, "--poses", "rest"],
    pytest.param(["shader", "--lang", "glsl", "--frame", "normal"], marks=pytest.mark.slow),
    ["inspect", SEAM],
    ["strip", SEAM, "-o", "-"],
]


def without_reader(*arguments: str, stream: str = "stdout") -> subprocess.CompletedProcess[bytes]:
    """Run a command whose stdout, or stderr, is a pipe without a reader."""
    reading, writing = os.pipe()
    os.close(reading)
    out, err = (writing, subprocess.PIPE) if stream == "stdout" else (subprocess.PIPE, writing)
    command = [sys.executable, "-m", "skinbake", *arguments]
    try:
        return subprocess.run(command, stdout=out, stderr=err, check=False, timeout=60)
    finally:
        os.close(writing)


@pytest.mark.slow
@pytest.mark.parametrize("arguments", COMMANDS, ids=lambda arguments: " ".join(arguments[:1] + arguments[2:]))
def test_a_reader_that_has_left_is_141(arguments: list[str]) -> None:
    process = without_reader(*arguments)
    assert process.returncode == 141, process.stderr
    assert b"Traceback" not in process.stderr
    assert b"error" not in process.stderr
    assert b"Exception ignored" not in process.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments", [["bake"], ["inspect", "missing.glb"], ["bake", "missing.glb", "--dry-run"]]
)
def test_nobody_reads_the_error_either(arguments: list[str]) -> None:
    assert without_reader(*arguments, stream="stderr").returncode == 141


def with_closed(streams: str, *command: str) -> subprocess.CompletedProcess[bytes]:
    """Run Python with some of its standard streams closed, like ``2>&-``."""
    shell = ["sh", "-c", f'exec "$@" {streams}', "sh", sys.executable, *command]
    return subprocess.run(shell, stdout=subprocess.PIPE, check=False, timeout=60)


@pytest.mark.slow
def test_long_work_needs_no_stderr(tmp_path: Path) -> None:
    for number in range(25):  # so many that progress would be shown at once
        (tmp_path / f"{number}.glb").touch()
    process = with_closed("2>&-", "-m", "skinbake", "verify", str(tmp_path), "--json")
    assert process.returncode == 3
    assert len(json.loads(process.stdout)["files"]) == 25


@pytest.mark.slow
def test_no_file_gets_the_number_of_a_closed_stream() -> None:
    code = (
        "import os, sys; from skinbake.cli.main import entry_point; sys.argv[1:] = ['--version']\n"
        "try: entry_point()\n"
        "except SystemExit: sys.exit(os.open(os.devnull, os.O_RDONLY) > 2)"
    )
    assert with_closed("<&- 2>&-", "-c", code).returncode == 1


@pytest.mark.slow
def test_what_was_begun_is_whole(tmp_path: Path) -> None:
    process = without_reader("bake", SEAM, "-o", str(tmp_path / "out.glb"))
    assert process.returncode == 141
    assert [path.name for path in tmp_path.iterdir()] == ["out.glb"]
    assert run("inspect", tmp_path / "out.glb").returncode == 0
