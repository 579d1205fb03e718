"""One process that calls C code again and again, and notes the seed that it is at where a crash leaves it."""

from __future__ import annotations

import argparse
import mmap
import struct
import sys
import time
from pathlib import Path

from fuzz.native import decoders, kernel, loops

KINDS = {"kernel": kernel.executions, "loops": loops.executions, "decoders": decoders.executions}
NOTE = struct.Struct("<QQ")
"""The content of the note: the seed at work, and the executions done."""


def main() -> int:
    """Work from a seed for some seconds, or through one seed only."""
    parser = argparse.ArgumentParser(prog="python -m fuzz.native.work", description=__doc__)
    parser.add_argument("kind", choices=list(KINDS))
    parser.add_argument("seed", type=int)
    parser.add_argument("--seconds", type=float, help="Without it the one seed is run.")
    parser.add_argument("--note", type=Path)
    given = parser.parse_args()
    work = KINDS[given.kind]
    if given.seconds is None:
        work(given.seed)
        return 0
    with given.note.open("r+b") as file, mmap.mmap(file.fileno(), NOTE.size) as note:
        seed, done, end = given.seed, 0, time.monotonic() + given.seconds
        while time.monotonic() < end:
            NOTE.pack_into(note, 0, seed, done)
            done += work(seed)
            seed += 1
        NOTE.pack_into(note, 0, seed, done)
    return 0


if __name__ == "__main__":
    sys.exit(main())
