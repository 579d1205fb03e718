"""``skinbake example``: a small model to try the other commands on."""

from __future__ import annotations

from pathlib import Path

from skinbake.gltf.writing import write_file, write_stdout

MODEL = Path(__file__).resolve().parents[1] / "example" / "arm.glb"
"""A tube of two joints that bends, with one animation: the fixture ``bent_tube.glb``."""

STDIO = "-"


def write_example(target: str, *, sync: bool = True) -> int:
    """Write the model to a file, whole or not at all, or to stdout. Return its bytes. Raises OutputError."""
    data = MODEL.read_bytes()
    if target == STDIO:
        write_stdout([data])
    else:
        write_file([data], target, sync=sync)
    return len(data)
