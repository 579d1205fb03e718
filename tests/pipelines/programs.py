"""A folder of programs for build tools: ``skinbake`` and ``python`` of this environment."""

from __future__ import annotations

import os
import shlex
import sys
from pathlib import Path

SKINBAKE = 'from skinbake.__main__ import run\n\nif __name__ == "__main__":\n    run()\n'


def environment_with_skinbake(folder: Path, **further: str) -> dict[str, str]:
    """Return an environment whose PATH begins with a ``skinbake`` of this Python, written into a folder.

    The program is a script of Python, as pip installs one: its own folder is searched for modules, not the
    current one. PATH ends with the programs that were installed beside this Python, such as Ninja.

    Each call adds the name of its command to the file ``calls`` beside the program.
    """
    folder.mkdir(parents=True, exist_ok=True)
    script = folder / "start.py"
    script.write_text(SKINBAKE)
    calls = shlex.quote(str(folder / "calls"))
    programs = {
        "skinbake": f'echo "$1" >>{calls}\nexec {shlex.join([sys.executable, str(script)])} "$@"\n',
        "python": f'exec {shlex.quote(sys.executable)} "$@"\n',
    }
    for name, text in programs.items():
        if not (program := folder / name).exists():
            program.write_text(f"#!/bin/sh\n{text}")
            program.chmod(0o755)
    path = os.pathsep.join([str(folder), os.environ["PATH"], str(Path(sys.executable).parent)])
    return {**os.environ, "PATH": path, **further}
