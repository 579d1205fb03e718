"""No document makes the program open or change what is outside: watched at the system call.

The watch is strace: what the kernel opened and changed, not what the program believes that it did.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.tools import required_program

REPOSITORY = Path(__file__).resolve().parents[2]
COUNT = 3_000

OPENS = ("open", "openat", "openat2", "creat")
CHANGES = (
    *("rename", "renameat", "renameat2", "mkdir", "mkdirat", "unlink", "unlinkat", "rmdir", "link", "linkat"),
    *("symlink", "symlinkat", "truncate", "chmod", "fchmodat", "chown", "fchownat", "utimensat", "mknod"),
)
RESULT = re.compile(r"= \d+<(?P<path>[^>]*)>$")
ARGUMENT = re.compile(r'(?:(?:\d+|AT_FDCWD)<(?P<folder>[^>]*)>, )?"(?P<name>(?:[^"\\]|\\.)*)"')


@pytest.fixture
def world(tmp_path: Path) -> Path:
    """Folders in and out with links that lead astray, and files outside that are worth stealing."""
    root = Path(os.path.realpath(tmp_path)) / "world"
    outside = root / "victim"
    for folder in (
        "in/models/x#",
        "in/models/x?",
        "in/models/tex",
        "in/tex",
        "in/a",
        "out/models",
        "victim/tex",
    ):
        (root / folder).mkdir(parents=True)
    for name in ("victim/secret.bin", "victim/a.png", "victim/tex/a.png", "secret.bin", "a.png", "a.bin"):
        (root / name).write_bytes(b"secret " * 10)
    for name in ("models/a.png", "models/tex/a.png", "models/x#/a.png", "tex/a.png", "a/a.png", "a.bin"):
        (root / "in" / name).write_bytes(b"image")
    for folder in ("in", "in/models", "in/tex", "in/models/tex", "in/a"):
        (root / folder / "link").symlink_to(outside / "secret.bin")
        (root / folder / "abs").symlink_to(outside)
    (root / "in" / "models" / "up").symlink_to("../..")
    (root / "in" / "up").symlink_to("..")
    # Links in the outputs, under names that the documents' files would have there.
    (root / "out" / "models" / "tex").symlink_to(outside / "tex")
    (root / "out" / "models" / "x#").symlink_to("../../victim")
    (root / "out" / "a").symlink_to(outside)
    return root


def watched(world: Path, count: int) -> Path:
    """Let the stranger work under the watch; return the log."""
    strace = required_program("strace")
    log = world.parent / "calls.log"
    calls = ",".join((*OPENS, *CHANGES))
    command = [
        strace,
        "-f",
        "-y",
        "-qq",
        "-s",
        "8192",
        "-e",
        f"trace=?{calls.replace(',', ',?')}",
        "-o",
        str(log),
    ]
    work = [sys.executable, "-m", "tests.outside.stranger", str(world), str(count)]
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [*command, *work], cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return log


def between(log: Path, mode: str) -> Iterator[str]:
    """Yield the calls that succeeded while one mode was at work."""
    inside = False
    with log.open(encoding="utf-8", errors="surrogateescape") as lines:
        for line in lines:
            if f"{mode}.ends" in line:
                return
            if f"{mode}.begins" in line:
                inside = True
            elif inside and not re.search(r"= -1 \w+ \(", line):
                yield line.rstrip("\n").partition(" ")[2].strip()


def paths(call: str) -> list[str]:
    """Return the paths that a call named, from the folders that its descriptors stand for."""
    return [
        os.path.normpath(Path(found["folder"] or "/", found["name"])) for found in ARGUMENT.finditer(call)
    ]


def is_below(path: str, *folders: Path) -> bool:
    return any(Path(path) == folder or Path(path).is_relative_to(folder) for folder in folders)


def snapshot(world: Path) -> dict[str, object]:
    """Return all outside the folders of work: contents, targets of links, and times."""
    found: dict[str, object] = {}
    for path in (world, *sorted(world.rglob("*"))):
        if is_below(str(path), world / "in", world / "out") or path.suffix in {".begins", ".ends"}:
            continue
        is_file = path.is_file() and not path.is_symlink()
        found[str(path)] = (path.read_bytes(), path.stat().st_mtime_ns) if is_file else path.is_symlink()
    return found


@pytest.mark.slow
def test_no_document_opens_or_changes_what_is_outside(world: Path) -> None:
    before = snapshot(world)
    log = watched(world, COUNT)
    assert snapshot(world) == before
    code = [Path(sys.prefix), Path(sys.base_prefix), REPOSITORY / "src", REPOSITORY / "tests"]
    for mode, root in (("named", world / "in" / "models"), ("tree", world / "in")):
        opened = changed = 0
        for call in between(log, mode):
            name = call.partition("(")[0]
            if name in OPENS:
                result = RESULT.search(call)
                assert result, call
                opened += 1
                is_written = re.search(r"O_(WRONLY|RDWR|CREAT|TRUNC)", call)
                folders = [world / "out"] if is_written else [root, world / "out", *code]
                if is_written and result["path"] == str(world / "in" / "models" / "m.gltf"):
                    continue  # the stranger's own document
                assert is_below(result["path"], *folders), (mode, call)
            else:
                changed += 1
                own = {str(world / "in" / "models" / "m.gltf")}
                assert all(is_below(path, world / "out") for path in paths(call) if path not in own), call
        assert opened > COUNT / 10  # the watch saw something
        assert changed > COUNT / 100


def test_the_watch_sees_what_is_opened_outside(world: Path) -> None:
    """A check that cannot fail is worth nothing: the same reading of a log with a theft in it."""
    log = world.parent / "log"
    theft = f'7 openat(3</x>, "a", O_RDONLY) = 4<{world}/victim/secret.bin>\n'
    log.write_text(f'7 open("{world}/named.begins") = 3</x>\n{theft}7 open("{world}/named.ends") = 3</x>\n')
    (call,) = between(log, "named")
    found = RESULT.search(call)
    assert found
    assert not is_below(found["path"], world / "in", world / "out")
    assert paths('renameat(3</a/b>, "x", 4</c>, "../d")') == ["/a/b/x", "/d"]
