"""The commands of the pages, word for word: each page in an empty folder, from top to bottom.

A comment of HTML before a block says what a reader would have beside it (``with: hero.glb``, or
``with baked:``), or why it cannot run (``not run:``). Lines of a ``console`` block that do not begin
with ``$`` are what the commands print.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support.models import FOLDER, bake
from tests.support.node import SUPPORT, require_node

REPOSITORY = Path(__file__).resolve().parents[2]
PAGES = ("README.md", "docs/*.md", "docs/reference/*.md", "engines/*/README.md")
BLOCK = re.compile(
    r"^(?:<!-- (?P<note>(?:(?!-->).)*?) -->\n)?```(?P<kind>sh|console|bash)\n(?P<text>.*?)^```", re.S | re.M
)
TUBE = FOLDER / "bent_tube.glb"


@dataclass(frozen=True)
class Block:
    """Commands of a page, and the comment before them."""

    note: str
    text: str
    is_session: bool


def blocks(page: Path) -> Iterator[Block]:
    for found in BLOCK.finditer(page.read_text("utf-8")):
        yield Block(found["note"] or "", found["text"], found["kind"] == "console")


def pages() -> list[Path]:
    found = sorted({path for pattern in PAGES for path in REPOSITORY.glob(pattern)})
    return [page for page in found if any(blocks(page))]


def put_beside(note: str, folder: Path) -> None:
    kind, _, names = note.partition(": ")
    assert kind in {"", "with", "with baked"}, note
    for name in names.split():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        if kind == "with":
            shutil.copy(TUBE, folder / name)
        else:
            bake(TUBE, folder / name)


def run(commands: str, folder: Path) -> str:
    """Run a block as a shell does that stops at the first failure. Return what it prints."""
    tools = [Path(sys.executable).parent, SUPPORT / "node_modules" / ".bin"]
    path = os.pathsep.join([*map(str, tools), os.environ["PATH"]])
    environment = {name: value for name, value in os.environ.items() if not name.startswith("SKINBAKE_")}
    done = subprocess.run(
        ["bash", "-e", "-o", "pipefail", "-c", commands],
        cwd=folder,
        env={**environment, "PATH": path},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{commands}{done.stdout}"
    return done.stdout


def without_rounding(text: str) -> str:
    """Two machines round the last bits differently."""
    return re.sub(r"\de-\d+", "…", text)


@pytest.mark.slow
@pytest.mark.parametrize("page", pages(), ids=lambda page: page.relative_to(REPOSITORY).as_posix())
def test_the_commands_of_a_page_work_as_pasted(page: Path, tmp_path: Path) -> None:
    ran = 0
    for block in blocks(page):
        if block.note.startswith("not run: "):
            continue
        if "gltf-transform " in block.text:
            require_node("@gltf-transform/cli")
        put_beside(block.note, tmp_path)
        if block.is_session:
            steps = re.findall(r"^\$ (.*)\n((?:(?!\$ ).*\n)*)", block.text, re.M)
            assert "".join(f"$ {command}\n{said}" for command, said in steps) == block.text
            for command, said in steps:
                assert without_rounding(run(command, tmp_path)) == without_rounding(said)
        else:
            run(block.text, tmp_path)
        ran += 1
    if not ran:
        assert all(len(block.note) > len("not run: ") + 10 for block in blocks(page))


def test_the_readme_and_the_first_steps_are_followed_in_full() -> None:
    for name, skipped in (("README.md", 1), ("docs/five-minutes.md", 0)):
        found = list(blocks(REPOSITORY / name))
        assert len(found) >= 3
        assert sum(block.note.startswith("not run") for block in found) == skipped
        assert not any(block.note.startswith("with") for block in found)


def test_a_command_that_fails_is_seen(tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match="No such file"):
        run("cat missing.glb\ntrue\n", tmp_path)
