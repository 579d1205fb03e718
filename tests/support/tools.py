"""Programs of other projects that tests run."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

from tests.support.strictness import missing_tool


def required_program(name: str, package: str = "") -> str:
    """Return the path of a program beside Python or in PATH; else skip, or fail under SKINBAKE_STRICT=1.

    The reason names the Debian package that has the program, if it is told.
    """
    folders = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)])
    hint = f" (Debian package {package})" if package else ""
    return shutil.which(name, path=folders) or missing_tool(f"{name} is not installed{hint}")
