"""Writing is whole or not at all: whatever fails, nothing is left behind and the old file is intact."""

from __future__ import annotations

import ctypes
import errno
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import pytest

from skinbake.commands.strip import strip_file
from skinbake.errors import InputError, OutputError
from skinbake.files import Bytes, folders, replacing
from skinbake.files.bounds import BoundedPath
from skinbake.files.writing import has_content
from skinbake.gltf.document import read_document
from skinbake.gltf.writing import beside
from skinbake.gltf.writing.output import plan_output
from tests.support.baking import bake_file
from tests.support.command_line import LINUX
from tests.support.gltf_reading import read
from tests.support.models import FOLDER, SHARED, SHARED_BIN, bake, copied, edited

if sys.platform == "win32":
    pytest.skip("needs the modes, links and limits of POSIX", allow_module_level=True)

Tree = dict[str, bytes | str | None]
CAPABILITIES_3, CAP_DAC_OVERRIDE = 0x20080522, 1  # linux/capability.h


def tree(folder: Path) -> Tree:
    """Return everything below a folder: bytes of files, targets of links, None for folders."""
    found: Tree = {}
    for path in folder.rglob("*"):
        name = path.relative_to(folder).as_posix()
        if path.is_symlink():
            found[name] = f"-> {path.readlink()}"
        else:
            found[name] = path.read_bytes() if path.is_file() else None
    return found


def write(source: Path, target: Path) -> OutputError:
    """Bake into a target that cannot be written, and return the error."""
    with pytest.raises(OutputError) as raised:
        bake_file(str(source), str(target))
    return raised.value


@contextmanager
def bound_by_modes() -> Iterator[None]:
    """Take from the superuser the right to write into any folder, in this thread, for a while."""
    if os.geteuid() != 0:
        yield
        return
    if sys.platform != "linux":
        pytest.skip("the superuser may write into any folder")
    libc = ctypes.CDLL(None)
    header = (ctypes.c_uint32 * 2)(CAPABILITIES_3, 0)
    rights = (ctypes.c_uint32 * 6)()
    assert libc.capget(header, rights) == 0
    usual, rights[0] = rights[0], rights[0] & ~(1 << CAP_DAC_OVERRIDE)
    assert libc.capset(header, rights) == 0
    try:
        yield
    finally:
        rights[0] = usual
        assert libc.capset(header, rights) == 0


@contextmanager
def failing(name: str, call: int, error: BaseException) -> Iterator[list[tuple[Any, ...]]]:
    """Let the n-th call of a function of ``os`` raise; yield the arguments of all calls."""
    original: Callable[..., Any] = getattr(os, name)
    calls: list[tuple[Any, ...]] = []

    def wrapped(*arguments: Any, **options: Any) -> Any:
        if name == "open" and not arguments[1] & os.O_CREAT:  # inputs and folders are opened too
            return original(*arguments, **options)
        calls.append(arguments)
        if len(calls) == call:
            raise error
        return original(*arguments, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, name, wrapped)
        yield calls


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A .gltf with a .bin and an image in a folder, all of which another folder will need."""
    path = edited(SHARED, tmp_path / "in", lambda content: content.update(images=[{"uri": "tex/deep/a.png"}]))
    (path.parent / "tex" / "deep").mkdir(parents=True)
    (path.parent / "tex" / "deep" / "a.png").write_bytes(b"image")
    return path


@pytest.fixture
def target(tmp_path: Path) -> Path:
    """An existing file where the result goes, with a neighbour."""
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "model.gltf").write_bytes(b"the old file")
    (tmp_path / "out" / "neighbour.txt").write_bytes(b"of no concern")
    return tmp_path / "out" / "model.gltf"


NO_SPACE = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


NAMING = [("link", 1), ("link", 2), ("link", 3), ("replace", 1)]
"""The calls that give files their names: those beside the document replace nothing."""


class TestFailures:
    @pytest.mark.parametrize(("function", "call"), NAMING)
    def test_a_rename_that_fails_leaves_everything_as_it_was(
        self, source: Path, target: Path, function: str, call: int
    ) -> None:
        before = tree(target.parent.parent)
        with failing(function, call, NO_SPACE) as calls:
            error = write(source, target)
        assert len(calls) == call
        assert str(error) == f"{target}: cannot be written: No space left on device"
        assert tree(target.parent.parent) == before

    @pytest.mark.parametrize("call", [1, 2, 3, 4])
    def test_a_file_that_cannot_be_made_leaves_everything_as_it_was(
        self, source: Path, target: Path, call: int
    ) -> None:
        before = tree(target.parent.parent)
        with failing("open", call, NO_SPACE) as calls:
            write(source, target)
        assert len(calls) == call
        assert tree(target.parent.parent) == before

    def test_a_folder_that_cannot_be_made_leaves_everything_as_it_was(
        self, source: Path, target: Path
    ) -> None:
        before = tree(target.parent.parent)
        with failing("mkdir", 2, NO_SPACE):
            write(source, target)
        assert tree(target.parent.parent) == before

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("function", "call"),
        [*NAMING, ("open", 1), ("open", 2), ("mkdir", 1), ("mkdir", 2), *(("fsync", n) for n in range(1, 5))],
    )
    def test_an_interrupt_leaves_nothing(self, source: Path, target: Path, function: str, call: int) -> None:
        before = tree(target.parent.parent)
        with failing(function, call, KeyboardInterrupt()), pytest.raises(KeyboardInterrupt):
            bake_file(str(source), str(target))
        assert tree(target.parent.parent) == before

    def test_an_interrupt_between_two_names_waits_for_both(
        self, source: Path, target: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """A file beside a target may be beside another target too, just finished by another process."""
        bake(source, target)
        whole = tree(target.parent)
        link = os.link

        def interrupted(*arguments: Any, **options: Any) -> None:
            link(*arguments, **options)
            signal.raise_signal(signal.SIGINT)

        monkeypatch.setattr(os, "link", interrupted)
        again = tmp_path / "again" / target.name
        again.parent.mkdir()
        with pytest.raises(KeyboardInterrupt):
            bake(source, again)
        assert tree(again.parent) == {k: v for k, v in whole.items() if k != "neighbour.txt"}

    @pytest.mark.slow
    @pytest.mark.parametrize("limit", [100, 2000, 10_000])
    def test_a_full_disk_leaves_everything_as_it_was(self, source: Path, target: Path, limit: int) -> None:
        """A real limit on the size of files: writes stop midway in the .bin or in the JSON."""
        before = tree(target.parent.parent)
        script = (
            "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv.pop(1)),) * 2); "
            "from skinbake.cli.main import entry_point; entry_point()"
        )
        process = subprocess.run(
            [sys.executable, "-B", "-c", script, str(limit), "bake", str(source), "-o", str(target)],
            capture_output=True,
            text=True,
            check=False,
        )
        assert process.returncode == 4, process.stderr
        assert "cannot be written: File too large" in process.stderr
        assert tree(target.parent.parent) == before

    def test_strip_fails_as_cleanly(self, tmp_path: Path, target: Path) -> None:
        baked = tmp_path / "baked.glb"
        bake(FOLDER / "seam.glb", baked)
        before = tree(tmp_path)
        with failing("replace", 1, NO_SPACE), pytest.raises(OutputError, match="No space left"):
            strip_file(str(baked), str(target.with_suffix(".glb")))
        assert tree(tmp_path) == before

    @pytest.mark.parametrize("way", ["exchange", "rename"])
    def test_in_place_the_input_survives(
        self, way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        path = copied("seam.glb", tmp_path)
        before = tree(tmp_path)

        def exchange(folder: int, one: str, other: str) -> None:
            raise NO_SPACE

        call = exchange if way == "exchange" else None
        monkeypatch.setattr(replacing, "exchange_call", lambda: call)
        with failing("replace", 1, NO_SPACE):
            write(path, path)
        assert tree(tmp_path) == before


def test_a_plan_that_is_made_again_keeps_to_the_same_folder(tmp_path: Path) -> None:
    document = read_document(str(FOLDER / SHARED))
    first = plan_output(document, str(tmp_path / "sub" / "a.gltf"), root=str(tmp_path))
    assert first.again is not None
    second = first.again()
    assert first.root == second.root == tmp_path
    assert first.files.keys() == second.files.keys()


class TestTargets:
    def test_a_folder_in_the_way_is_refused(self, tmp_path: Path) -> None:
        (tmp_path / "model.glb").mkdir()
        assert "is not a regular file" in str(write(FOLDER / "seam.glb", tmp_path / "model.glb"))

    def test_missing_folders_are_made(self, tmp_path: Path) -> None:
        bake(FOLDER / "seam.glb", tmp_path / "new" / "deep" / "model.glb")
        assert list(tree(tmp_path)) == ["new", "new/deep", "new/deep/model.glb"]

    def test_folders_that_were_made_go_if_the_write_fails(self, tmp_path: Path) -> None:
        with failing("fsync", 1, NO_SPACE):
            write(FOLDER / "seam.glb", tmp_path / "new" / "deep" / "model.glb")
        assert tree(tmp_path) == {}

    def test_a_link_that_leads_nowhere_may_be_a_folder_to_make(self, tmp_path: Path) -> None:
        (tmp_path / "link").symlink_to("there")
        bake(FOLDER / "seam.glb", tmp_path / "link" / "model.glb")
        assert (tmp_path / "there" / "model.glb").is_file()

    def test_a_file_for_a_folder_is_refused(self, tmp_path: Path) -> None:
        (tmp_path / "file").write_bytes(b"x")
        error = write(FOLDER / "seam.glb", tmp_path / "file" / "model.glb")
        assert str(error) == f"{tmp_path}/file/model.glb: {tmp_path}/file is a file, not a folder"
        assert "Not a directory" in str(write(FOLDER / "seam.glb", tmp_path / "file" / "deep" / "model.glb"))
        assert tree(tmp_path) == {"file": b"x"}

    def test_a_name_too_long_for_the_disk_is_an_output_error(self, tmp_path: Path) -> None:
        write(FOLDER / "seam.glb", tmp_path / ("x" * 300 + ".glb"))
        assert tree(tmp_path) == {}

    def test_a_read_only_file_is_not_replaced(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        target = tmp_path / "model.glb"
        target.write_bytes(b"old")
        target.chmod(0o444)
        # The superuser may write anything: then only the answer of access() can say no.
        monkeypatch.setattr(os, "access", lambda path, mode: False)
        assert "read-only" in str(write(FOLDER / "seam.glb", target))
        assert target.read_bytes() == b"old"

    def test_a_read_only_folder_is_an_output_error(self, tmp_path: Path) -> None:
        folder = tmp_path / "locked"
        folder.mkdir()
        folder.chmod(0o555)
        try:
            with bound_by_modes():
                assert "Permission denied" in str(write(FOLDER / "seam.glb", folder / "model.glb"))
            assert tree(folder) == {}
        finally:
            folder.chmod(0o755)

    @LINUX
    def test_a_file_system_that_takes_no_files_is_an_output_error(self) -> None:
        write(FOLDER / "seam.glb", Path("/proc/self/model.glb"))

    def test_an_image_that_cannot_be_read_is_an_output_error(
        self, source: Path, target: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        before = tree(target.parent)
        original = folders.open_beneath

        def open_beneath(file: BoundedPath) -> int:
            if file.name.endswith(".png"):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
            return original(file)

        monkeypatch.setattr("skinbake.gltf.resources.open_beneath", open_beneath)
        assert "a.png: cannot be copied: Permission denied" in str(write(source, target))
        assert tree(target.parent) == before

    @pytest.mark.parametrize(("count", "more"), [(2, ""), (3, ""), (4, ", …")])
    def test_the_first_three_missing_images_are_named(self, count: int, more: str, tmp_path: Path) -> None:
        names = [f"{number}.png" for number in range(count)]

        def change(content: Any) -> None:
            content["images"] = [{"uri": name} for name in names]

        notices = bake_file(
            str(edited("seam.glb", tmp_path, change)), str(tmp_path / "out" / "a.glb")
        ).notices
        message = (
            f"{count} files that it names are missing and cannot be copied: {', '.join(names[:3])}{more}"
        )
        assert [one.message for one in notices if one.code == "file-missing"] == [message]

    @pytest.mark.parametrize(("count", "images"), [(1, "1 image is"), (2, "2 images are")])
    def test_images_outside_are_told_and_still_found(self, count: int, images: str, tmp_path: Path) -> None:
        names = [f"{number}.png" for number in range(count)]

        def change(content: Any) -> None:
            content["images"] = [{"uri": f"../{name}"} for name in names]

        source, target = edited("seam.glb", tmp_path / "in", change), tmp_path / "deep" / "er" / "a.glb"
        (notice,) = (
            one for one in bake_file(str(source), str(target)).notices if one.code == "image-outside"
        )
        assert notice.message.startswith(f"{images} outside its folder, and neither read nor copied; ")
        assert notice.count == count
        found = [target.parent / image["uri"] for image in read(target).content["images"]]
        assert [Path(os.path.normpath(path)) for path in found] == [tmp_path / name for name in names]

    def test_a_name_that_is_taken_twice_is_refused(self, source: Path, target: Path) -> None:
        """Somebody's files stand under the buffer's name and under the one made from its content."""
        folder = target.parent
        (folder / SHARED_BIN).write_bytes(b"somebody's")
        bake(source, target)
        (other,) = [path for path in folder.iterdir() if path.name.startswith("shared accessors-")]
        other.write_bytes(b"somebody else's")
        target.write_bytes(b"the old file")
        before = tree(folder)
        assert "is in the way" in str(write(source, target))
        assert tree(folder) == before


class TestModesAndLinks:
    @pytest.mark.parametrize(("umask", "mode"), [(0o022, 0o644), (0o027, 0o640), (0o077, 0o600)])
    def test_new_files_follow_the_umask(self, source: Path, target: Path, umask: int, mode: int) -> None:
        target.unlink()
        before = os.umask(umask)
        try:
            bake(source, target)
        finally:
            os.umask(before)
        written = [path for path in target.parent.rglob("*") if path.is_file()]
        written = [path for path in written if path.name != "neighbour.txt"]
        assert len(written) == 6  # two of them are notes
        assert {path.stat().st_mode & 0o777 for path in written} == {mode}

    @pytest.mark.parametrize("mode", [0o600, 0o664, 0o755])
    def test_a_replaced_file_keeps_its_mode(self, source: Path, target: Path, mode: int) -> None:
        target.chmod(mode)
        bake(source, target)
        assert target.stat().st_mode & 0o777 == mode
        assert read(target).has_attribute("_SKINBAKE_ALPHA_0")

    def test_a_link_stays_and_its_file_is_replaced(self, tmp_path: Path) -> None:
        (tmp_path / "real").mkdir()
        (tmp_path / "real" / "model.glb").write_bytes(b"old")
        link = tmp_path / "link.glb"
        link.symlink_to("real/model.glb")
        bake(FOLDER / "seam.glb", link)
        assert link.is_symlink()
        assert read(tmp_path / "real" / "model.glb").has_attribute("_SKINBAKE_ALPHA_0")
        assert sorted(tree(tmp_path)) == ["link.glb", "real", "real/model.glb"]

    def test_a_link_to_nothing_yet_is_followed(self, tmp_path: Path) -> None:
        link = tmp_path / "link.glb"
        link.symlink_to("new.glb")
        bake(FOLDER / "seam.glb", link)
        assert link.is_symlink()
        assert read(tmp_path / "new.glb").has_attribute("_SKINBAKE_ALPHA_0")

    def test_files_go_beside_the_file_that_a_link_stands_for(self, source: Path, tmp_path: Path) -> None:
        (tmp_path / "real").mkdir()
        (tmp_path / "link.gltf").symlink_to("real/model.gltf")
        bake(source, tmp_path / "link.gltf")
        assert read(tmp_path / "real" / "model.gltf").attribute("_SKINBAKE_ALPHA_0", 0, 1).any()
        assert (tmp_path / "real" / SHARED_BIN).is_file()


class TestOrder:
    def test_the_document_is_renamed_last(self, source: Path, target: Path) -> None:
        """A look meanwhile finds the old document, or the new one with all its files."""
        with failing("link", 0, NO_SPACE) as beside, failing("replace", 0, NO_SPACE) as last:
            bake(source, target)
            assert len(beside) == 3
        notes = [".skinbake-copies.json"] * 2
        assert [Path(arguments[1]).name for arguments in last] == [*notes, "model.gltf"]

    def test_planning_writes_nothing(self, source: Path, target: Path) -> None:
        before = tree(target.parent.parent)
        planned = plan_output(read_document(str(source)), str(target))
        assert {path.name for path in planned.files} == {"model.gltf", SHARED_BIN, "a.png"}
        assert tree(target.parent.parent) == before


@pytest.mark.parametrize(
    ("extras", "pointer"),
    [
        ('{"far": 1E400}', "/extras/far"),
        ('{"a/b": [0, {"c~d": -1E999}], "later": 1E400}', "/extras/a~1b/1/c~0d"),
        ("[[], {}, [1.5, 1E400]]", "/extras/2/1"),
    ],
)
def test_a_number_past_all_floats_stays_or_is_named(extras: str, pointer: str, tmp_path: Path) -> None:
    """It stays where its text does. A GLB has a new text, which cannot say it."""
    path = copied(SHARED, tmp_path)
    content = json.loads(path.read_text(encoding="utf-8"))
    content["extras"] = "@"
    path.write_text(json.dumps(content, indent=1).replace('"@"', extras), encoding="utf-8")
    bake_file(str(path), str(tmp_path / "out.gltf"))
    assert f'"extras": {extras}' in (tmp_path / "out.gltf").read_text(encoding="utf-8")
    with pytest.raises(InputError) as raised:
        bake_file(str(path), str(tmp_path / "out.glb"))
    assert raised.value.message == (
        f"its JSON cannot be written back: {pointer} is a number too large for any float"
    )
    assert not (tmp_path / "out.glb").exists()


def test_a_file_of_many_spellings_is_compared_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A small document can spell one name in thousands of ways, and the file may be large."""
    spellings = ["a.png", "%61.png", "./a.png", "././%61.png", "a%2Epng"]
    content = {"asset": {"version": "2.0"}, "images": [{"uri": uri} for uri in spellings]}
    source = tmp_path / "in" / "model.gltf"
    target = tmp_path / "out" / "model.gltf"
    for path in (source, target):
        path.parent.mkdir()
        path.with_name("a.png").write_bytes(b"pixels")
    source.write_text(json.dumps(content))
    compared: list[object] = []

    def counted(file: BinaryIO, pieces: Iterable[Bytes]) -> bool:
        compared.append(pieces)
        return has_content(file, pieces)

    monkeypatch.setattr(beside, "has_content", counted)
    planned = plan_output(read_document(str(source)), str(target))
    assert len(compared) == 1
    assert list(planned.files) == [target]
    assert list(planned.serving) == [target.with_name("a.png")]
