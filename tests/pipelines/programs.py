"""A folder of programs for build tools: ``skinbake`` and ``python`` of this environment."""

from __future__ import annotations

import os
import shlex
import sys
from pathlib import Path

SKINBAKE = "from skinbake.cli.main import entry_point; entry_point()"


def environment_with_skinbake(folder: Path, **further: str) -> dict[str, str]:
    """Return an environment whose PATH begins with a ``skinbake`` of this Python, written into a folder.

    It ends with the programs that were installed beside this Python, such as Ninja.

    Each call adds the name of its command to the file ``calls`` beside the program.
    """
    folder.mkdir(parents=True, exist_ok=True)
    program = folder / "skinbake"
    python = shlex.join([sys.executable, "-c", SKINBAKE])
    program.write_text(f'#!/bin/sh\necho "$1" >>{shlex.quote(str(folder / "calls"))}\nexec {python} "$@"\n')
    program.chmod(0o755)
    path = os.pathsep.join([str(folder), os.environ["PATH"], str(Path(sys.executable).parent)])
    return {**os.environ, "PATH": path, **further}
