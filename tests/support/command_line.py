"""Run the command line: in this process for speed, or as a process of its own where that matters."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from skinbake.cli.main import main

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="needs the signals of POSIX and /proc")


def invoke(*arguments: str | Path, env: Mapping[str, str] | None = None) -> Result:
    """Run ``skinbake`` in this process; what would be a traceback is raised."""
    result = CliRunner().invoke(main, [*map(str, arguments)], env=env, prog_name="skinbake")
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def call(*arguments: str | Path, env: Mapping[str, str] | None = None) -> subprocess.CompletedProcess[bytes]:
    """Run ``skinbake`` in this process, and return what ``run`` would."""
    result = invoke(*arguments, env=env)
    return subprocess.CompletedProcess(
        ["skinbake", *map(str, arguments)], result.exit_code, result.stdout_bytes, result.stderr_bytes
    )


def document(result: Result) -> Any:
    """Return the JSON on stdout, where nothing else may stand."""
    return json.loads(result.stdout)


def run(
    *arguments: str | Path,
    env: Mapping[str, str] | None = None,
    folder: Path | None = None,
    command: Sequence[str] = ("-m", "skinbake"),
    stdin: bytes = b"",
) -> subprocess.CompletedProcess[bytes]:
    """Run ``python -m skinbake``, or another command of Python, as a process of its own."""
    return subprocess.run(
        [sys.executable, *command, *map(str, arguments)],
        input=stdin,
        capture_output=True,
        env={**os.environ, **(env or {})},
        cwd=folder,
        timeout=60,
        check=False,
    )
