"""A short slice of the fuzzer: fixed seeds over the fixtures, faults in one scene, sanitizers for seconds."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from fuzz.native.build import build, environment
from tests.support.tools import required_program

REPOSITORY = Path(__file__).resolve().parents[2]
SECONDS = 300


def run(folder: Path, *arguments: str) -> tuple[subprocess.CompletedProcess[str], list[dict[str, object]]]:
    """Run a part of the fuzzer as a process of its own; return it and the lines of its log."""
    log = folder / "log.jsonl"
    process = subprocess.run(
        [sys.executable, "-m", *arguments, "--log", str(log)],
        cwd=REPOSITORY,
        env={**os.environ, "SKINBAKE_CORPUS": str(folder / "none"), "PYTHONPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
        timeout=SECONDS,
        check=False,
    )
    lines = log.read_text(encoding="utf-8").splitlines() if log.exists() else []
    return process, [json.loads(line) for line in lines]


def require_compiler() -> None:
    required_program(os.environ.get("CC", "gcc"))


@pytest.mark.slow
def test_damaged_models_end_in_documented_ways(tmp_path: Path) -> None:
    """The same cases in every run: the seed, and the fixtures, which alone are damaged here."""
    process, lines = run(
        tmp_path, "fuzz", "--seed", "1", "--runs", "300", "--workers", "2", "--finds", str(tmp_path / "finds")
    )
    assert process.returncode == 0, process.stdout + process.stderr
    (line,) = lines
    assert (line["kind"], line["finds"]) == ("commands", {})
    assert isinstance(line["executions"], int)
    assert line["executions"] > 300  # the aimed cases too


@pytest.mark.skipif(sys.platform != "linux", reason="calls are caught by LD_PRELOAD")
@pytest.mark.slow
def test_faults_leave_the_old_bytes_or_the_new(tmp_path: Path) -> None:
    require_compiler()
    process, lines = run(
        tmp_path, "fuzz.faults", "--scene", "gltf with files", "--scene", "verify", "--every", "3"
    )
    assert process.returncode == 0, process.stdout + process.stderr
    (line,) = lines
    assert isinstance(line["executions"], int)
    assert line["executions"] > 30


@pytest.mark.skipif(sys.platform != "linux", reason="sanitizers are loaded by LD_PRELOAD")
@pytest.mark.slow
def test_the_compiled_loops_and_decoders_are_clean(tmp_path: Path) -> None:
    require_compiler()
    process, lines = run(
        tmp_path, "fuzz.native", "--minutes", "0.05", "--seed", "1", "--finds", str(tmp_path / "finds")
    )
    assert process.returncode == 0, process.stdout + process.stderr
    assert [line["kind"] for line in lines] == ["native kernel", "native loops", "native decoders"]
    assert all(isinstance(line["executions"], int) and line["executions"] > 0 for line in lines)


@pytest.mark.skipif(sys.platform != "linux", reason="sanitizers are loaded by LD_PRELOAD")
@pytest.mark.slow
@pytest.mark.parametrize("seed", [15])  # bits of a negative number were shifted
def test_former_finds_of_the_compiled_loops_stay_mended(seed: int) -> None:
    require_compiler()
    build()
    process = subprocess.run(
        [sys.executable, "-m", "fuzz.native.work", "kernel", str(seed)],
        env=environment(),
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr
