"""A folder of programs for build tools: ``skinbake`` and ``python`` of this environment."""

from __future__ import annotations

import os
import shlex
import sys
from pathlib import Path

SKINBAKE = "from skinbake.cli.main import entry_point; entry_point()"


def environment_with_skinbake(folder: Path, **further: str) -> dict[str, str]:
    """Return an environment whose PATH begins with a ``skinbake`` of this Python, written into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    program = folder / "skinbake"
    program.write_text(f'#!/bin/sh\nexec {shlex.join([sys.executable, "-c", SKINBAKE])} "$@"\n')
    program.chmod(0o755)
    return {**os.environ, "PATH": f"{folder}{os.pathsep}{os.environ['PATH']}", **further}
