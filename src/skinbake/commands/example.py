"""``skinbake example``: a small model to try the other commands on."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from skinbake.errors import OutputError, Place
from skinbake.files.urls import STDIO
from skinbake.files.writing import write_result

MODEL = Path(__file__).resolve().parents[1] / "example" / "arm.glb"
"""A tube of two joints that bends, with one animation: the fixture ``bent_tube.glb``."""


def write_example(target: str, *, sync: bool = True) -> int:
    """Write the model to a file, whole or not at all, or to stdout. Return its bytes.

    Raises OutputError if it cannot be written, or if another file has the name: it may be a user's own model.
    """
    data = MODEL.read_bytes()
    path = Path(target)
    if target == STDIO or not os.path.lexists(path):
        write_result([data], target, sync=sync)
    elif not _holds(path, data):
        raise OutputError("another file has this name already; give the example a new one", Place(target))
    return len(data)


def _holds(path: Path, data: bytes) -> bool:
    with suppress(OSError):  # a file that cannot be read is another one
        return path.is_file() and path.stat().st_size == len(data) and path.read_bytes() == data
    return False
