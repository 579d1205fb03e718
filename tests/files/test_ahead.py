"""A large BIN chunk is written while its bake runs: with the same bytes, and nothing is left of a failure."""

from __future__ import annotations

import errno
import os
import signal
import stat
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from skinbake.commands import bake
from skinbake.commands.bake import bake_document
from skinbake.files.folders import beneath
from skinbake.files.temporary import Ahead
from skinbake.gltf.writing import output
from skinbake.threads import threads_limited
from tests.support import khronos
from tests.support.baking import bake_file
from tests.support.command_line import invoke
from tests.support.gltf_reading import read
from tests.support.models import FOLDER, copied, stripped

if sys.platform == "win32":
    pytest.skip("Windows removes no open file, so nothing is written ahead", allow_module_level=True)

SEAM = FOLDER / "seam.glb"
SOURCE_BINARY = read(SEAM).binary_chunk or b""
SPACING = 1 << 16


@pytest.fixture(autouse=True)
def _any_file_is_large(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr(output, "LARGE", 1)
    with threads_limited(2):
        yield


@pytest.fixture
def at_once(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the output of one thread, which writes nothing ahead."""
    path = tmp_path_factory.mktemp("at once") / "a.glb"
    with threads_limited(1):
        bake_file(SEAM, path)
    return path.read_bytes()


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[tuple[int, bytes]]:
    """Note the mode and the bytes of each temporary file in the folder when the kernel begins."""
    found: list[tuple[int, bytes]] = []
    begin = Ahead.begin
    begun: list[Ahead] = []

    def noted(self: Ahead, *arguments: Any) -> None:
        begin(self, *arguments)
        begun.append(self)

    def look(document: Any, options: Any) -> Any:
        for one in begun:
            one._thread.join()
        files = tmp_path.rglob(".skinbake-*.tmp")
        found.extend((stat.S_IMODE(path.stat().st_mode), path.read_bytes()) for path in files)
        return bake_document(document, options)

    monkeypatch.setattr(Ahead, "begin", noted)
    monkeypatch.setattr("skinbake.commands.bake.bake_document", look)
    return found


def temporaries(folder: Path) -> list[Path]:
    return list(folder.rglob("*.tmp"))


def test_the_chunk_is_in_a_temporary_file_before_the_kernel_runs(
    at_once: bytes, seen: list[tuple[int, bytes]], tmp_path: Path
) -> None:
    bake_file(SEAM, tmp_path / "a.glb")
    [(_, part)] = seen
    assert part == bytes(SPACING) + SOURCE_BINARY
    assert (tmp_path / "a.glb").read_bytes() == at_once
    assert at_once[SPACING:].startswith(SOURCE_BINARY)
    assert [path.name for path in tmp_path.iterdir()] == ["a.glb"]


def test_the_output_is_valid_and_strip_gives_the_source_back(tmp_path: Path) -> None:
    bake_file(SEAM, tmp_path / "a.glb")
    assert not khronos.new_findings(khronos.validate(SEAM), khronos.validate(tmp_path / "a.glb"))
    stripped(tmp_path / "a.glb", tmp_path / "b.glb")
    assert (tmp_path / "b.glb").read_bytes() == SEAM.read_bytes()


def test_a_bake_of_a_bake_has_the_same_bytes_and_is_written_ahead_too(
    at_once: bytes, seen: list[tuple[int, bytes]], tmp_path: Path
) -> None:
    bake_file(SEAM, tmp_path / "a.glb")
    bake_file(tmp_path / "a.glb", tmp_path / "b.glb")
    assert (tmp_path / "b.glb").read_bytes() == at_once
    assert len(seen) == 2


def test_a_small_file_is_written_at_once_without_room(
    seen: list[tuple[int, bytes]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(output, "LARGE", 1 << 24)
    bake_file(SEAM, tmp_path / "a.glb")
    assert seen == []
    assert (tmp_path / "a.glb").read_bytes().index(b"BIN\0") < SPACING // 2


@pytest.mark.parametrize("options", [{"dry_run": True}, {"compress": "meshopt"}])
def test_what_would_not_be_used_is_not_begun(
    options: dict[str, Any], seen: list[tuple[int, bytes]], tmp_path: Path
) -> None:
    bake_file(SEAM, tmp_path / "a.glb", **options)
    bake_file(SEAM, None)
    assert seen == []


def test_one_thread_and_no_sync_write_the_same_bytes_at_the_end(
    at_once: bytes, seen: list[tuple[int, bytes]], tmp_path: Path
) -> None:
    bake_file(SEAM, tmp_path / "a.glb", sync=False)
    with threads_limited(1):
        bake_file(SEAM, tmp_path / "b.glb")
    assert seen == []
    assert {path.read_bytes() for path in tmp_path.iterdir()} == {at_once}


def test_a_folder_that_does_not_exist_yet_is_made_at_the_end(
    at_once: bytes, seen: list[tuple[int, bytes]], tmp_path: Path
) -> None:
    bake_file(SEAM, tmp_path / "new" / "a.glb")
    assert seen == []
    assert (tmp_path / "new" / "a.glb").read_bytes() == at_once


def test_a_private_file_is_private_from_the_first_byte_on(
    seen: list[tuple[int, bytes]], tmp_path: Path
) -> None:
    path = copied("seam.glb", tmp_path)
    path.chmod(0o640)
    bake_file(path, path)
    assert [mode for mode, _ in seen] == [0o640]
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_a_file_in_place_is_what_it_was_until_the_end(
    at_once: bytes, seen: list[tuple[int, bytes]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    path, looking = copied("seam.glb", tmp_path), bake.bake_document

    def look(document: Any, options: Any) -> Any:
        found = looking(document, options)
        assert path.read_bytes() == SEAM.read_bytes()
        return found

    monkeypatch.setattr("skinbake.commands.bake.bake_document", look)
    bake_file(path, path)
    assert len(seen) == 1
    assert path.read_bytes() == at_once


def test_json_that_grows_more_than_foreseen_is_written_at_once(
    at_once: bytes, seen: list[tuple[int, bytes]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("skinbake.commands.bake.JSON_A_PRIMITIVE", 2 * SPACING)
    bake_file(SEAM, tmp_path / "a.glb")
    [(_, part)] = seen
    assert part == bytes(3 * SPACING) + SOURCE_BINARY
    assert (tmp_path / "a.glb").read_bytes() == at_once
    assert not temporaries(tmp_path)


@pytest.mark.parametrize("function", ["pwrite", "fsync"])
def test_a_disk_that_fails_first_and_then_works_gets_all_bytes_again(
    function: str, at_once: bytes, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    original, calls = getattr(os, function), []

    def failing(*arguments: Any) -> Any:
        calls.append(arguments)
        if len(calls) == 1:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return original(*arguments)

    monkeypatch.setattr(os, function, failing)
    bake_file(SEAM, tmp_path / "a.glb")
    assert calls
    assert (tmp_path / "a.glb").read_bytes() == at_once
    assert not temporaries(tmp_path)


def test_a_system_that_takes_a_part_of_the_bytes_gets_the_rest_too(
    at_once: bytes, seen: list[tuple[int, bytes]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    original = os.pwrite
    monkeypatch.setattr(os, "pwrite", lambda to, data, at: original(to, data[:1000], at))
    bake_file(SEAM, tmp_path / "a.glb")
    [(_, part)] = seen
    assert part == bytes(SPACING) + SOURCE_BINARY
    assert (tmp_path / "a.glb").read_bytes() == at_once


def test_a_folder_that_was_exchanged_meanwhile_gets_the_whole_file(
    at_once: bytes, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    folder = tmp_path / "out"
    folder.mkdir()

    def exchange(document: Any, options: Any) -> Any:
        folder.rename(tmp_path / "former")
        folder.mkdir()
        return bake_document(document, options)

    monkeypatch.setattr("skinbake.commands.bake.bake_document", exchange)
    bake_file(SEAM, folder / "a.glb")
    assert (folder / "a.glb").read_bytes() == at_once
    assert list((tmp_path / "former").iterdir()) == []


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError])
def test_of_a_bake_that_fails_nothing_is_left(
    error: type[BaseException], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fail(document: Any, options: Any) -> Any:
        assert len(temporaries(tmp_path)) == 1
        raise error

    path = copied("seam.glb", tmp_path)
    monkeypatch.setattr("skinbake.commands.bake.bake_document", fail)
    with pytest.raises(error):
        bake_file(path, path)
    assert [one.name for one in tmp_path.iterdir()] == ["seam.glb"]
    assert path.read_bytes() == SEAM.read_bytes()


def test_an_output_that_is_not_written_leaves_nothing(
    seen: list[tuple[int, bytes]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    result = invoke(
        "bake", FOLDER / "hard_edge.glb", "-o", tmp_path / "a.glb", "--leave-under", "100", "--threads", "2"
    )
    assert result.exit_code == 0
    assert len(seen) == 1
    assert not temporaries(tmp_path)


STOPPED = """
import os, sys
from pathlib import Path
from skinbake.cli.main import entry_point
from skinbake.commands import bake
from skinbake.gltf.writing import output
path, number = Path(sys.argv[1]), int(sys.argv[2])
def stop(document, options):
    print(len(list(path.parent.glob("*.tmp"))), flush=True)
    os.kill(os.getpid(), number)
output.LARGE, bake.bake_document = 1, stop
sys.argv = ["skinbake", "bake", str(path), "--in-place", "--threads", "2", "-q"]
entry_point()
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "code", "left"), [(signal.SIGKILL, -9, 1), (signal.SIGTERM, 143, 0), (signal.SIGINT, 130, 0)]
)
def test_a_process_that_is_stopped_in_the_kernel_leaves_the_source(
    number: int, code: int, left: int, at_once: bytes, tmp_path: Path
) -> None:
    """Only one that is killed leaves a temporary file, which the next run removes."""
    path = copied("seam.glb", tmp_path)
    command = [sys.executable, "-c", STOPPED, str(path), str(int(number))]
    process = subprocess.run(command, check=False, capture_output=True, text=True)
    assert (process.returncode, process.stdout) == (code, "1\n")
    assert path.read_bytes() == SEAM.read_bytes()
    assert len(temporaries(tmp_path)) == left
    bake_file(path, path)
    assert path.read_bytes() == at_once
    assert [one.name for one in tmp_path.iterdir()] == ["seam.glb"]


@pytest.fixture
def begun(tmp_path: Path) -> Callable[..., Ahead]:
    def make(*pieces: bytes) -> Ahead:
        one = Ahead(is_itself=False)
        one.begin(tmp_path / "a", tmp_path, 2, pieces)
        return one

    return make


def test_a_file_that_is_handed_over_is_not_removed(begun: Callable[..., Ahead], tmp_path: Path) -> None:
    first, second, third, last = b"ab", b"cde", b"fg", b"h"
    with begun(second, third) as one, beneath(str(tmp_path), ()) as folder:
        assert one.part(folder, [first, second, third, last]) == slice(1, 3)
        descriptor, name = one.handed_over()
        assert one.part(folder, [first, second, third, last]) is None
    os.close(descriptor)
    assert (tmp_path / name).read_bytes() == b"\0\0cdefg"


@pytest.mark.parametrize("pieces", [(b"ab", b"cde"), (b"a", b"cde", b"fg"), (b"ab", b"fg"), ()])
def test_pieces_or_places_that_differ_take_no_part(
    pieces: tuple[bytes, ...], begun: Callable[..., Ahead], tmp_path: Path
) -> None:
    """Equal bytes are not compared: pieces are known by identity."""
    known = {b"cde": b"cde", b"fg": b"fg"}
    with begun(known[b"cde"], known[b"fg"]) as one, beneath(str(tmp_path), ()) as folder:
        assert one.part(folder, [known.get(piece, piece) for piece in pieces]) is None
        assert list(tmp_path.iterdir()) == []
