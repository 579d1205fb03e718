"""Work on documents that name what they should not: run by ``test_outside`` under a watch on system calls.

Usage: ``python -m tests.outside.stranger WORLD COUNT``. The world is what ``test_outside.build`` made.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path

from skinbake.commands.inspect import inspect_file
from skinbake.commands.strip import strip_file
from skinbake.commands.verify import verify_file
from skinbake.errors import SkinbakeError
from skinbake.files.bounds import Bounds, Within
from skinbake.jobs import state
from skinbake.measure.options import VerifyOptions
from tests.outside.names import likely_uris, uris
from tests.support.baking import bake_file

A_DOCUMENT = 5
DATA = "data:application/octet-stream;base64,AAAA"


def names(count: int) -> Iterator[str]:
    """Yield URIs of both grammars, one after the other."""
    for one, other in zip(uris(count // 2), likely_uris(count - count // 2), strict=True):
        yield one
        yield other


def write(path: Path, found: list[str], *, with_buffers: bool) -> None:
    """Write a document whose images, and buffers, have these URIs."""
    first = found[-1] if with_buffers else DATA
    content = {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": first, "byteLength": 3}, {"uri": DATA, "byteLength": 3}],
        "images": [{"uri": uri} for uri in found[: len(found) - with_buffers]],
    }
    path.write_text(json.dumps(content), encoding="utf-8")


def work(source: Path, target: Path, within: Within) -> None:
    """Do with one document all that reads or writes what it names."""
    state.seen(str(source), within.bounds)
    for command in (
        lambda: bake_file(str(source), str(target), within=within),
        lambda: verify_file(str(source), VerifyOptions(), bounds=within.bounds),
        lambda: inspect_file(str(source), within.bounds),
        lambda: strip_file(str(source), str(target.with_name("stripped.gltf")), within=within),
    ):
        with suppress(SkinbakeError):  # a refusal opens nothing outside either
            command()


def main() -> None:
    """Work through all documents, named by themselves and as parts of a tree, marking where each begins."""
    world, count = Path(sys.argv[1]), int(sys.argv[2])
    source = world / "in" / "models" / "m.gltf"
    modes = {
        "named": Within(),
        "tree": Within(Bounds(str(world / "in")), str(world / "out")),
    }
    write(source, ["a.png"], with_buffers=False)
    for within in modes.values():  # all that is imported late
        work(source, world / "out" / "models" / "m.gltf", within)
    for mode, within in modes.items():
        found = names(count // 2)
        (world / f"{mode}.begins").touch()
        number = 0
        while batch := list(islice(found, A_DOCUMENT)):
            number += 1
            source.unlink()
            write(source, batch, with_buffers=number % 2 == 0)
            suffix = (".glb", ".gltf")[number % 4 // 2]
            work(source, world / "out" / "models" / f"m{suffix}", within)
        (world / f"{mode}.ends").touch()


if __name__ == "__main__":
    main()
