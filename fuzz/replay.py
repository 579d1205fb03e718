"""Run one kept case again: ``python -m fuzz.replay fuzz/finds/NAME``; 1 where it still is what it was.

``--small`` cuts the case down first: files that it does not need, and members of the model's JSON.
``--unpack DIR`` writes the files of the case, to run it by hand.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from fuzz.batches import keep, preload
from fuzz.cases import Case, load
from fuzz.models import glb
from fuzz.running import Find, Runner, parts


def main() -> int:
    """Replay as the command line says."""
    parser = argparse.ArgumentParser(prog="python -m fuzz.replay", description=__doc__)
    parser.add_argument("case", type=Path)
    parser.add_argument("--small", action="store_true")
    parser.add_argument("--unpack", type=Path, metavar="DIR")
    given = parser.parse_args()
    folder = given.case.resolve()
    case = load(folder)
    print(f"skinbake {' '.join(case.arguments)}   # {case.about}")
    if given.unpack:
        _unpack(case, given.unpack)
        return 0
    preload()
    with tempfile.TemporaryDirectory() as root:
        runner = Runner(Path(root))
        outcome, finds = runner.run(case)
        for find in finds:
            print(f"{find.kind}: {find.key}\n{find.text}")
        print(f"exit code {outcome.code}\n{outcome.stderr}", end="")
        if given.small and finds:
            small = smaller(case, finds[0], lambda candidate: runner.run(candidate)[1])
            keep(folder.parent, small, replace(finds[0], key=f"{finds[0].key} small"))
            print(f"cut down from {_size(case)} to {_size(small)} bytes")
        os.chdir("/")
    return 1 if finds else 0


def _size(case: Case) -> int:
    return sum(map(len, case.files.values()))


def _unpack(case: Case, folder: Path) -> None:
    for name, data in case.files.items():
        path = folder / "in" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    for name, target in case.links.items():
        (folder / "in" / name).symlink_to(target)
    (folder / "out").mkdir(parents=True, exist_ok=True)


def smaller(case: Case, find: Find, judge: Callable[[Case], list[Find]]) -> Case:
    """Return the case without all that its find does not need, as far as single steps tell."""

    def still(candidate: Case) -> bool:
        return any((other.kind, other.key) == (find.kind, find.key) for other in judge(candidate))

    for name in list(case.files):
        lighter = replace(case, files={key: data for key, data in case.files.items() if key != name})
        case = lighter if still(lighter) else case
    for name, data in list(case.files.items()):
        taken = _taken_apart(data)
        if taken is not None:
            case = _smaller_json(case, name, taken, still)
    return case


def _taken_apart(data: bytes) -> tuple[Any, Callable[[Any], bytes]] | None:
    """Return the JSON of a model, and how to put another into its place."""
    try:
        if data[:4] == b"glTF":
            content, binary = parts(data)
            return content, lambda changed: glb(json.dumps(changed).encode(), binary)
        return json.loads(data), lambda changed: json.dumps(changed).encode()
    except (ValueError, IndexError, OverflowError):
        return None


def _smaller_json(
    case: Case, name: str, taken: tuple[Any, Callable[[Any], bytes]], still: Callable[[Case], bool]
) -> Case:
    """Drop members of objects, deepest last, and the ends of arrays, as long as the find is still there."""
    content, packed = taken
    for container, key in list(_members(content)):
        if isinstance(container, dict) and key not in container:
            continue
        if isinstance(container, list) and key != len(container) - 1:
            continue
        value = container.pop(key)
        candidate = replace(case, files={**case.files, name: packed(content)})
        if still(candidate):
            case = candidate
        elif isinstance(container, dict):
            container[key] = value
        else:
            container.append(value)
    return case


def _members(value: Any) -> Iterator[tuple[Any, Any]]:
    keys = (
        list(value)
        if isinstance(value, dict)
        else list(reversed(range(len(value))))
        if isinstance(value, list)
        else []
    )
    for key in keys:
        yield value, key
    for inner in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from _members(inner)


if __name__ == "__main__":
    sys.exit(main())
