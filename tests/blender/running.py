"""Blender in a process of its own: one run of ``in_blender.py``, whose results all tests share."""

from __future__ import annotations

import fcntl
import importlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from engines.blender.build import ADDON, build
from tests.support.corpus_folder import REPOSITORY
from tests.support.strictness import missing_tool

SCRIPT = Path(__file__).parent / "in_blender.py"
FOLDER = Path(os.environ.get("SKINBAKE_BLENDER", REPOSITORY / "build" / "blender"))
"""What `make setup-blender` made: a virtual environment with bpy, and the wheels of the libraries."""
TIMEOUT_SECONDS = 300


@dataclass(frozen=True)
class Session:
    """What one run of Blender said and left behind."""

    results: dict[str, Any]
    files: Path
    said: str
    """Its stdout and stderr."""


def addon_module(name: str) -> ModuleType:
    """Import a module of the add-on that needs no Blender."""
    package = sys.modules.setdefault("skinbake_addon", ModuleType("skinbake_addon"))
    package.__path__ = [str(ADDON)]  # so that its __init__.py, which needs Blender, is not run
    return importlib.import_module(f"skinbake_addon.{name}")


def require_blender() -> Path:
    """Return the Python that has bpy; else skip, or fail under SKINBAKE_STRICT=1."""
    python = FOLDER / "venv" / "bin" / "python"
    if not python.is_file() or not (FOLDER / "wheels").is_dir():
        missing_tool("Blender is not installed as a Python module: run `make setup-blender`")
    return python


def run_once(shared: Path, models: Sequence[Path]) -> Session:
    """Build the zip and run Blender, or wait until another process of this test run has done it."""
    python = require_blender()
    files, said = shared / "files", shared / "said.txt"
    shared.mkdir(exist_ok=True)
    with (shared / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not said.exists():
            files.mkdir()
            output = _run(python, shared, files, models)
            said.write_text(output, encoding="utf-8")
    results = json.loads((files / "results.json").read_text(encoding="utf-8"))
    return Session(results, files, said.read_text(encoding="utf-8"))


def _run(python: Path, shared: Path, files: Path, models: Sequence[Path]) -> str:
    version = subprocess.run(
        [python, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.strip()
    home = shared / "home"
    home.mkdir()
    process = subprocess.run(
        [python, SCRIPT, build(shared, version, FOLDER / "wheels"), files, *models],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=TIMEOUT_SECONDS,
        check=False,
        env={**outside_python(), "BLENDER_USER_RESOURCES": str(home)},
    )
    # The unpacked libraries take 170 MB, and pytest keeps the folders of three runs.
    shutil.rmtree(home)
    if process.returncode != 0:
        raise RuntimeError(process.stdout[-4000:])
    return process.stdout


def outside_python() -> dict[str, str]:
    """Return the environment without what would lead Blender's Python to the packages of the tests."""
    return {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "VIRTUAL_ENV"))}
