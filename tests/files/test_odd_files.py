"""No command waits for what is not a regular file, or reads a file that is larger than memory."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from skinbake.errors import InputError
from skinbake.files.versions import version_of
from skinbake.jobs.state import HEADER
from tests.support.command_line import invoke
from tests.support.models import FOLDER, SHARED, SHARED_BIN, copied, edited

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="needs FIFOs, and devices to link to")


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(path.name)  # the whole path may be too long
    Path(path.name).replace(path)


def _sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(1 << 41)


def _linked_fifo(path: Path) -> None:
    os.mkfifo("there")
    path.symlink_to(Path("there").absolute())


KINDS: dict[str, Callable[[Path], object]] = {
    "fifo": os.mkfifo,
    "link to a fifo": _linked_fifo,
    "link to a device": lambda path: path.symlink_to("/dev/zero"),
    "link to a terminal": lambda path: path.symlink_to("/dev/ptmx"),
    "link to the kernel": lambda path: path.symlink_to("/proc/self/mem"),
    "socket": _socket,
    "folder": lambda path: path.mkdir(),
    "sparse": _sparse,
}

READ = {
    "bake": "bake {} -o out.glb",
    "bake in place": "bake {} --in-place",
    "bake beside others": "bake {} art/hero.gltf --out-dir out",
    "bake of what is not baked yet": "bake {} --out-dir out --skip-unchanged",
    "bake without writing": "bake {} --dry-run",
    "poses": "bake hero.glb -o out.glb --gradients fitted --fit-poses {}",
    "verify": "verify {}",
    "verify of what is not verified yet": "verify {} --skip-unchanged --state state",
    "inspect": "inspect {}",
    "strip": "strip {} -o out.glb",
    "strip in place": "strip {} --in-place",
    "view": "view {} -o page.html",
    "render": "render {} -o picture.png",
    "shader": "shader --lang glsl --for {}",
}


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Make a folder with models, which is the current one. What hangs fails."""

    def late(*_: object) -> None:
        raise TimeoutError("it hangs")

    monkeypatch.chdir(tmp_path)
    shutil.copyfile(FOLDER / "seam.glb", "hero.glb")
    copied(SHARED, tmp_path / "art").rename("art/hero.gltf")
    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(60)
    yield tmp_path
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def left() -> set[str]:
    return {path.name for path in Path().iterdir()}


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("command", READ)
def test_an_input_is_refused_at_once(command: str, kind: str) -> None:
    for name in ("x.glb", "x.gltf"):
        KINDS[kind](Path(name))
        before = left()
        try:
            result = invoke(*READ[command].format(name).split())
            code, said = result.exit_code, result.stderr
        except InputError as error:  # the process prints it
            code, said = 3, str(error)
        assert code == 3 or (code == 2 and kind == "folder"), said
        assert name in said
        assert left() - before <= {"out"}
        Path("there").unlink(missing_ok=True)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("which", ["buffers", "images"])
@pytest.mark.parametrize(
    "options",
    [
        "-o out/hero.gltf",
        *(pytest.param(one, marks=pytest.mark.slow) for one in ("-o out/hero.glb --pack", "--in-place")),
        "--out-dir out --skip-unchanged --depfile d",
    ],
)
def test_a_file_that_a_document_names_is_not_waited_for(options: str, which: str, kind: str) -> None:
    edited(SHARED, Path("art"), lambda content: content.update(images=[{"uri": "skin.png"}])).rename(
        "art/hero.gltf"
    )
    name = Path("art", SHARED_BIN if which == "buffers" else "skin.png")
    name.unlink(missing_ok=True)
    KINDS[kind](name)
    result = invoke("bake", "art/hero.gltf", *options.split())
    is_read = "pack" in options or "out" in options  # an image is packed, or copied beside the output
    assert (result.exit_code == 3) == (which == "buffers" or (kind == "sparse" and is_read))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", [".skinbake-copies.json", SHARED_BIN, ".skinbake-state.jsonl", "hero.gltf"])
def test_what_is_in_the_way_of_an_output_is_not_waited_for(name: str, kind: str) -> None:
    Path("out").mkdir()
    KINDS[kind](Path("out", name))
    result = invoke("bake", "art", "--out-dir", "out", "--skip-unchanged", "--max-memory", "300M")
    expected = {
        "hero.gltf": 0 if kind == "sparse" else 4,
        ".skinbake-state.jsonl": 2 if kind == "folder" else 0,
    }
    assert result.exit_code == expected.get(name, 0), result.stderr


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["skinbake.toml", "pyproject.toml", ".git"])
def test_a_configuration_that_nobody_named_is_not_waited_for(name: str, kind: str) -> None:
    KINDS[kind](Path(name))
    assert invoke("bake", "hero.glb", "-o", "out.glb").exit_code in {0, 2, 3}


def test_a_state_file_that_is_larger_than_memory_is_left_as_it_is() -> None:
    state = Path("state")
    state.write_bytes(HEADER)
    os.truncate(state, 1 << 41)
    result = invoke("bake", "hero.glb", "-o", "out.glb", "--skip-unchanged", "--state", "state")
    assert (result.exit_code, state.stat().st_size) == (0, 1 << 41)
    assert "it is left untouched" in result.stderr


@pytest.mark.parametrize("kind", KINDS)
def test_the_version_of_an_odd_file_is_known_without_opening_it(kind: str) -> None:
    KINDS[kind](Path("x"))
    assert version_of("x").digest is None
