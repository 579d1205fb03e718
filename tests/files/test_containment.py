"""Names of documents lead below a folder and nowhere else, by every way of opening that there is."""

from __future__ import annotations

import errno
import json
import os
import shutil
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path, PurePosixPath, PureWindowsPath

import pytest

from fixtures.make_fixtures import FOLDER
from skinbake.files import folders
from skinbake.files.bounds import (
    NOWHERE,
    BoundedPath,
    Bounds,
    OutsideError,
    RefusedError,
    bounded_path,
    bounded_paths,
    moved_uri,
    relative_names,
)
from skinbake.files.folders import beneath, open_beneath
from tests.outside.names import uris
from tests.support.command_line import invoke

pytestmark = pytest.mark.skipif(os.name == "nt", reason="links need rights there")

COUNT = 20_000


@pytest.mark.slow
def test_every_name_means_the_same_below_its_folder_on_posix_and_on_windows() -> None:
    """The judge is pathlib's reading of both systems, not the code that made the names."""
    accepted = 0
    for uri in uris(COUNT):
        try:
            names = relative_names(uri)
        except RefusedError:
            continue
        for name in names:
            accepted += 1
            posix, windows = PurePosixPath(name), PureWindowsPath(name)
            assert not posix.is_absolute(), uri
            assert not windows.drive, uri
            assert not windows.root, uri
            with warnings.catch_warnings(
                action="ignore"
            ):  # its heir, os.path.isreserved, is of Windows alone
                assert not windows.is_reserved(), uri
            assert posix.parts == windows.parts, uri
            assert "\0" not in name, uri
            inner = [part for part in posix.parts if part != ".."]
            assert posix.parts == (*[".."] * (len(posix.parts) - len(inner)), *inner), uri
            assert all(part.strip(". ") for part in inner), uri
    assert accepted > COUNT / 20  # the grammar makes good names too


@pytest.mark.slow
def test_no_spot_is_outside_its_root(tmp_path: Path) -> None:
    home = tmp_path / "root" / "sub"
    home.mkdir(parents=True)
    found = 0
    for uri in uris(COUNT):
        try:
            places = bounded_paths(uri, str(home), Bounds(str(tmp_path / "root")))
        except RefusedError:
            continue
        for file in places:
            found += 1
            assert Path(os.path.normpath(file.path)).is_relative_to(tmp_path / "root"), uri
    assert found > COUNT / 20


WAYS = ["openat2", "part by part", "real path"]


@pytest.fixture(params=WAYS)
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Open files by one of the three ways, whatever this system has."""
    if request.param == "openat2" and folders.openat2() is None:
        pytest.skip("this kernel has no openat2")
    if request.param == "part by part":
        monkeypatch.setattr(folders, "openat2", lambda: None)
    if request.param == "real path":
        monkeypatch.setattr(folders, "BY_DESCRIPTOR", False)
    return str(request.param)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    folder = tmp_path / "root"
    (folder / "a" / "b").mkdir(parents=True)
    (folder / "a" / "f.bin").write_bytes(b"content")
    (tmp_path / "secret").write_bytes(b"secret")
    links = {
        "in": "a/f.bin",
        "chain": "in",
        "folder": "a/b/..",
        "a/dots": "b/../f.bin",
        "a/more dots": "./b//.././f.bin",
        "out": "../secret",
        "abs": str(tmp_path / "secret"),
        "a/up": "../..",
        "loop": "loop",
        "nowhere": "gone",
    }
    for name, target in links.items():
        (folder / name).symlink_to(target)
    os.mkfifo(folder / "fifo")
    return folder


@pytest.mark.usefixtures("way")
class TestOpening:
    @pytest.mark.parametrize("name", ["a/f.bin", "in", "chain", "a/dots", "a/more dots", "folder/f.bin"])
    def test_files_below_are_opened(self, root: Path, name: str) -> None:
        descriptor = open_beneath(BoundedPath(str(root), name))
        assert os.read(descriptor, 100) == b"content"
        os.close(descriptor)

    @pytest.mark.parametrize("name", ["out", "abs", "a/up/secret"])
    def test_links_that_lead_out_are_not_followed(self, root: Path, name: str) -> None:
        with pytest.raises(OSError, match="a link leads out of the folder") as caught:
            open_beneath(BoundedPath(str(root), name))
        assert caught.value.errno == errno.EXDEV

    @pytest.mark.parametrize(
        ("name", "code"),
        [("fifo", errno.EINVAL), ("a", errno.EISDIR), ("gone", errno.ENOENT), ("nowhere", errno.ENOENT)],
    )
    def test_only_regular_files_are_opened(self, root: Path, name: str, code: int) -> None:
        with pytest.raises(OSError, match=r"\w") as caught:
            open_beneath(BoundedPath(str(root), name))
        assert caught.value.errno == code

    def test_a_circle_of_links_ends(self, root: Path) -> None:
        with pytest.raises(OSError, match=r"\w") as caught:
            open_beneath(BoundedPath(str(root), "loop"))
        assert caught.value.errno in {errno.ELOOP, errno.ENOENT}

    def test_no_descriptor_is_left_open(self, root: Path) -> None:
        before = len(list(Path("/dev/fd").iterdir()))
        for name in ("in", "a/dots", "out", "abs", "fifo", "a", "gone", "loop", "a/up/secret"):
            with suppress(OSError):  # most of them are refused
                os.close(open_beneath(BoundedPath(str(root), name)))
        assert len(list(Path("/dev/fd").iterdir())) == before


@pytest.mark.parametrize("way", WAYS[:2], indirect=True)
def test_links_are_followed_as_often_as_by_linux(way: str, root: Path) -> None:
    """By openat2 the kernel is the judge of the limit. Real paths are found without one."""
    (root / "link 1").symlink_to("a/f.bin")
    for number in range(2, 42):
        (root / f"link {number}").symlink_to(f"link {number - 1}")
    os.close(open_beneath(BoundedPath(str(root), "link 40")))
    with pytest.raises(OSError, match=r"\w") as caught:
        open_beneath(BoundedPath(str(root), "link 41"))
    assert caught.value.errno == errno.ELOOP


@pytest.mark.usefixtures("way")
class TestFolders:
    def test_missing_folders_are_made_and_told_of(self, root: Path) -> None:
        made: list[str] = []
        with beneath(str(root), ["a", "x", "y"], made.append) as folder:
            assert folder.path == str(root / "a" / "x" / "y")
        assert made == [str(root / "a" / "x"), str(root / "a" / "x" / "y")]
        assert (root / "a" / "x" / "y").is_dir()

    def test_a_missing_folder_is_made_only_where_that_was_asked_for(self, root: Path) -> None:
        with pytest.raises(FileNotFoundError), beneath(str(root), ["gone"]):
            pass
        assert not (root / "gone").exists()

    @pytest.mark.parametrize("parts", [["a", "up"], ["a", "up", "new"]])
    def test_a_link_leads_no_folder_out(self, root: Path, parts: list[str]) -> None:
        before = sorted(root.parent.rglob("*"))
        with pytest.raises(OSError, match="a link leads out"), beneath(str(root), parts, print):
            pass
        assert sorted(root.parent.rglob("*")) == before

    def test_no_descriptor_is_left_open(self, root: Path) -> None:
        before = len(list(Path("/dev/fd").iterdir()))
        for parts in (["a", "b"], ["a", "x", "y"], ["a", "up"], ["a", "up", "new"], ["in", "new"]):
            with suppress(OSError), beneath(str(root), parts, lambda path: None):
                pass
        assert len(list(Path("/dev/fd").iterdir())) == before


def test_an_open_folder_stays_the_one_that_was_opened(root: Path) -> None:
    with beneath(str(root), ["a"]) as folder:
        (root / "a").rename(root / "moved")
        (root / "a").symlink_to("..")
        descriptor = os.open(folder.name("new"), os.O_CREAT | os.O_WRONLY, dir_fd=folder.descriptor)
        os.close(descriptor)
    assert (root / "moved" / "new").exists()
    assert not (root.parent / "new").exists()


def test_what_the_kernel_makes_up_is_no_file() -> None:
    for name in ("/proc/self/environ", "/proc/kcore", "/sys/kernel/notes", "/dev/zero"):
        if not Path(name).exists():
            continue
        for opened in (
            lambda name=name: folders.open_regular(name),
            lambda name=name: open_beneath(BoundedPath("/", name[1:])),
        ):
            _refused(opened)


def _refused(opened: Callable[[], int]) -> None:
    with pytest.raises(OSError, match="not a regular file"):
        opened()


class TestBounds:
    def test_a_document_without_a_folder_names_allowed_files_alone(self, tmp_path: Path) -> None:
        with pytest.raises(OutsideError, match="it has no folder"):
            bounded_paths("a.bin", str(tmp_path), Bounds(NOWHERE))
        (file,) = bounded_paths("a.bin", str(tmp_path), Bounds(NOWHERE, (str(tmp_path),)))
        assert (file.path, file.is_own) == (str(tmp_path / "a.bin"), False)

    def test_names_of_neighbours_are_outside(self, tmp_path: Path) -> None:
        (tmp_path / "art").mkdir()
        with pytest.raises(OutsideError):
            bounded_paths("../artificial/a.bin", str(tmp_path / "art"), Bounds())

    def test_of_two_readings_the_one_inside_counts(self, tmp_path: Path) -> None:
        """Read literally, the name leads out. Decoded, it leads back into the folder."""
        (file,) = bounded_paths("../%61rt/a.bin", str(tmp_path / "art"), Bounds())
        assert (file.root, file.name) == (os.path.realpath(tmp_path / "art"), "a.bin")

    def test_a_path_outside_has_no_spot(self, tmp_path: Path) -> None:
        assert bounded_path(str(tmp_path / "art" / "a.bin"), str(tmp_path)).name == "art/a.bin"
        with pytest.raises(OutsideError, match="it is not below"):
            bounded_path(str(tmp_path / "a.bin"), str(tmp_path / "art"))

    def test_a_uri_keeps_its_meaning_in_another_folder(self, tmp_path: Path) -> None:
        home, other = tmp_path / "a" / "b", tmp_path / "out"
        home.mkdir(parents=True)
        assert moved_uri("../tex/h%20e.png", str(home), str(other)) == "../a/tex/h%20e.png"


@pytest.mark.parametrize(
    "command",
    [
        ("inspect", "{file}"),
        ("verify", "{file}"),
        ("shader", "--lang", "glsl", "--for", "{file}"),
        ("render", "{file}", "-o", "{dir}/out.png"),
        ("view", "{file}", "-o", "{dir}/out.html"),
        ("strip", "{file}", "-o", "{dir}/out.gltf"),
        ("bake", "{file}", "-o", "{dir}/out.gltf"),
    ],
    ids=lambda command: command[0],
)
@pytest.mark.parametrize("uri", ["/etc/passwd", "../secret.bin"])
def test_every_command_refuses_a_buffer_outside_that_nothing_needs(
    tmp_path: Path, command: tuple[str, ...], uri: str
) -> None:
    """Several commands read no buffer of a file without a bake, or not all of them."""
    folder = tmp_path / "models"
    folder.mkdir()
    for path in FOLDER.glob("shared*"):
        shutil.copy(path, folder)
    model = folder / "shared_accessors.gltf"
    content = json.loads(model.read_text())
    content["buffers"].append({"uri": uri, "byteLength": 4})
    model.write_text(json.dumps(content))
    result = invoke(*(word.format(file=model, dir=folder) for word in command))
    assert result.exit_code == 3
    assert f'its buffer "{uri}" is not read' in " ".join(result.stderr.split())
    assert not list(folder.glob("out.*"))
