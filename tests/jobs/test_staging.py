"""Files behind URLs: the same bytes and the same words as on a disk, and nothing half written."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from skinbake.choices import Encoding
from skinbake.cli import exit_codes
from skinbake.commands import bake
from skinbake.commands.verify import verify_file
from skinbake.errors import InputError, OutputError
from skinbake.files.bounds import OWN_FOLDERS, Bounds, Within
from skinbake.files.urls import is_url, join_url
from skinbake.jobs import verify
from skinbake.jobs.bake import Bake
from skinbake.jobs.file_work import FileWork
from skinbake.jobs.remote.storages import expand_url
from skinbake.jobs.work import Job
from skinbake.measure.options import VerifyOptions
from skinbake.report.bake import FileResult
from skinbake.report.verify import FileVerdict
from skinbake.timing import Told, heard
from tests.support.baking import bake_file, bake_work
from tests.support.libraries import (
    Torn,
    Tree,
    bucket_for_s3,
    filesystem,
    register,
    stored,
    tree,
    upload,
    url_to_fs,
    write_library,
)
from tests.support.models import FOLDER

TUBE = FOLDER / "bent_tube.glb"


@pytest.fixture(autouse=True)
def _storages() -> Iterator[None]:
    """Empty the storages in memory, and let s3:// be one."""
    memory = filesystem("memory")
    register("torn", Torn, clobber=True)
    with bucket_for_s3():
        yield
    for storage in (memory, Torn):
        storage.store.clear()
        storage.pseudo_dirs[:] = [""]
    Torn.breaks_at = ""


def bake_one(
    source: str,
    target: str | None,
    within: Within = OWN_FOLDERS,
    **options: Any,
) -> FileResult:
    """Bake a file as one of many."""
    return FileWork((bake_work(**options),))(Job(source, target, within=within))


def verify_one(source: str, options: VerifyOptions) -> FileVerdict:
    """Verify a file as one of many."""
    return FileWork((verify.Verify(options),))(Job(source))


def bake_all(names: list[str], source: str, target: str, **options: Any) -> list[FileResult]:
    within = Within(Bounds(source), target)
    return [bake_one(f"{source}/{name}", f"{target}/{name}", within, **options) for name in names]


def baked_locally(folder: Path) -> tuple[list[str], Tree, list[FileResult]]:
    """Bake the library on the disk; return its files' names, all files that are there then, and results."""
    names = write_library(folder / "lib")
    results = bake_all(names, str(folder / "lib"), str(folder / "out"))
    assert [result.status for result in results] == ["baked"] * len(names)
    return names, tree(folder / "out"), results


def in_words(result: object, *names: tuple[str, str]) -> str:
    """Return all of a result as text, with names replaced."""
    text = re.sub(r"0x[0-9a-f]+", "", repr(result))
    for old, new in names:
        text = text.replace(old, new)
    return text


@pytest.mark.slow
@pytest.mark.parametrize("protocol", ["memory", "s3", "file", "torn"])
def test_outputs_in_a_storage_are_those_on_a_disk(protocol: str, tmp_path: Path) -> None:
    names, expected, locally = baked_locally(tmp_path)
    root = f"file://{tmp_path}/remote" if protocol == "file" else f"{protocol}://assets/x"
    if protocol == "file":
        shutil.copytree(tmp_path / "lib", tmp_path / "remote" / "lib")
    else:
        upload(tmp_path / "lib", f"{root}/lib")
    inputs = stored(f"{root}/lib")
    results = bake_all(names, f"{root}/lib", f"{root}/out")
    assert stored(f"{root}/out") == expected
    assert stored(f"{root}/lib") == inputs
    assert [in_words(result, (root, "*")) for result in results] == [
        in_words(result, (str(tmp_path), "*")) for result in locally
    ]
    assert any(name.startswith("props/skinbake-") for name in expected)
    assert "props/maps/wood.png" in expected


@pytest.mark.slow
def test_the_disk_on_either_side(tmp_path: Path) -> None:
    names, wanted, _ = baked_locally(tmp_path)
    bake_all(names, str(tmp_path / "lib"), "memory://there")
    assert stored("memory://there") == wanted
    upload(tmp_path / "lib", "s3://b/lib")
    bake_all(names, "s3://b/lib", str(tmp_path / "back"))
    assert tree(tmp_path / "back") == wanted
    bake_all(names, "s3://b/lib", "memory://across")
    assert stored("memory://across") == wanted


def test_a_file_in_another_folder_is_out_of_another_storages_reach(tmp_path: Path) -> None:
    write_library(tmp_path / "lib")
    upload(tmp_path / "lib", "s3://b/lib")
    for root in (str(tmp_path / "lib"), "s3://b/lib"):
        within = Within(Bounds(root))
        result = bake_one(f"{root}/props/crate.gltf", "memory://out/crate.gltf", within)
        assert isinstance(result.error, OutputError)
        assert str(result.error).startswith('memory://out/crate.gltf: "../common/motion.bin" is outside')
    assert stored("memory://out") == {}


@pytest.mark.slow
def test_in_place_and_into_the_other_container(tmp_path: Path) -> None:
    names, _, _ = baked_locally(tmp_path)
    upload(tmp_path / "lib", "s3://b/lib")
    for name in names:
        path, url = tmp_path / "lib" / name, f"s3://b/lib/{name}"
        here, there = Within(Bounds(str(tmp_path / "lib"))), Within(Bounds("s3://b/lib"))
        assert bake_file(str(path), str(path), within=here).status == "baked"
        assert bake_one(url, url, there).status == "baked"
        suffix = ".glb" if name.endswith(".gltf") else ".gltf"
        other = f"{name.rpartition('.')[0]}-2{suffix}"
        assert bake_file(str(path), str(tmp_path / "lib" / other), within=here).status == "baked"
        assert bake_one(url, f"s3://b/lib/{other}", there).status == "baked"
    assert stored("s3://b/lib") == tree(tmp_path / "lib")


def test_files_of_others_beside_the_target_are_left_alone(tmp_path: Path) -> None:
    name = "props/crate.gltf"
    write_library(tmp_path / "lib")
    upload(tmp_path / "lib", "s3://b/lib")
    upload(tmp_path / "lib", "memory://b/lib")
    occupants = {"crate #1.bin": b"not ours", "maps/wood.png": b"wood"}
    for occupant, content in occupants.items():
        path = tmp_path / "out/props" / occupant
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    upload(tmp_path / "out", "s3://b/out")
    upload(tmp_path / "out", "memory://b/out")
    bake_all([name], str(tmp_path / "lib"), str(tmp_path / "out"))
    expected = tree(tmp_path / "out")
    assert expected["props/crate #1.bin"] == b"not ours"
    assert sum(path.startswith("props/crate #1-") for path in expected) == 1
    for root in ("s3://b", "memory://b"):
        bake_all([name], f"{root}/lib", f"{root}/out")
        assert stored(f"{root}/out") == expected


def test_where_another_file_has_the_name_of_gradients_nothing_is_stored(tmp_path: Path) -> None:
    _, expected, _ = baked_locally(tmp_path)
    upload(tmp_path / "lib", "memory://b/lib")
    name = next(name for name in expected if name.startswith("props/skinbake-"))
    filesystem("memory").pipe_file(f"/b/out/{name}", b"not ours")
    failed = bake_all(["props/crate.gltf"], "memory://b/lib", "memory://b/out")[0]
    assert isinstance(failed.error, OutputError)
    assert f"memory:///b/out/{name} is in the way" in failed.error.message
    assert stored("memory://b/out") == {name: b"not ours"}


@pytest.mark.slow
def test_verify_says_of_a_url_what_it_says_of_a_file(tmp_path: Path) -> None:
    baked_locally(tmp_path)
    upload(tmp_path / "out", "s3://b/out")
    options = VerifyOptions()
    for name in ("characters/bent_tube.glb", "shared/shared_accessors.gltf"):
        url, path = f"s3://b/out/{name}", str(tmp_path / "out" / name)
        told: list[Told] = []
        with heard(told.append):
            verdict = verify_one(url, options)
        assert verdict.passed
        assert in_words(verdict, (url, "*")) == in_words(verify_file(path, options), (path, "*"))
        assert {one.source for one in told} == {url}
    stale = verify_one("s3://b/out/characters/gone.glb", options)
    assert str(stale.error) == "s3://b/out/characters/gone.glb: cannot be read: No such file or directory"


def test_messages_name_urls_and_no_private_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_library(tmp_path / "lib")
    upload(tmp_path / "lib", "s3://b/lib")
    private = tmp_path / "private"
    private.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(private))
    codes: set[str] = set()
    for source in ("props/crate.gltf", "shared/shared_accessors.gltf", "characters/two_sets.glb"):
        within = Within(Bounds("s3://b/lib"), "s3://b/out")
        result = bake_one(f"s3://b/lib/{source}", f"s3://b/out/{source}", within, encoding=Encoding.PACKED8)
        assert result.error is None
        assert str(private) not in repr(result)
        assert {notice.place.file for notice in result.notices} <= {f"s3://b/lib/{source}"}
        codes |= {notice.code for notice in result.notices}
    assert "file-missing" in codes
    assert list(private.iterdir()) == []
    for name, content in stored("s3://b/out").items():
        assert str(private).encode() not in content, name


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("s3://b/gone.glb", "cannot be read: No such file or directory"),
        ("s3://b/secret.glb", "cannot be read: Permission denied (Access Denied)"),
        ("memory://b/gone.glb", "cannot be read: No such file or directory"),
        ("file:///gone/gone.glb", "cannot be read: No such file or directory"),
        ("warp://b/a.glb", "fsspec knows no protocol warp://"),
        (
            "gs://b/a.glb",
            "the driver for gs:// is not installed: Please install gcsfs to access Google Storage",
        ),
    ],
)
def test_inputs_that_cannot_be_had(source: str, message: str) -> None:
    with bucket_for_s3() as bucket:
        bucket.objects["b/secret.glb"] = TUBE.read_bytes()
        bucket.forbidden.add("b/secret.glb")
        result = bake_one(source, "memory://out/a.glb")
        verdict = verify_one(source, VerifyOptions())
    for error in (result.error, verdict.error):
        assert isinstance(error, InputError)
        assert str(error) == f"{source}: {message}"
        assert exit_codes.of_error(error) == exit_codes.INPUT
    assert (result.input, result.output, result.status) == (source, "memory://out/a.glb", "failed")
    assert stored("memory://out") == {}


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("s3://b/closed.glb", "cannot be written: Permission denied (Access Denied)"),
        ("warp://b/a.glb", "fsspec knows no protocol warp://"),
        ("memory://a.glb/b.glb", "cannot be written: "),
    ],
)
def test_outputs_that_cannot_be_stored(target: str, message: str) -> None:
    filesystem("memory").pipe_file("/a.glb", TUBE.read_bytes())
    with bucket_for_s3() as bucket:
        bucket.forbidden.add("b/closed.glb")
        result = bake_one("memory://a.glb", target)
    assert isinstance(result.error, OutputError)
    assert str(result.error).startswith(f"{target}: {message}")
    assert exit_codes.of_error(result.error) == exit_codes.OUTPUT
    assert stored("memory://") == {"a.glb": TUBE.read_bytes()}


def test_a_connection_that_breaks_leaves_the_old_file() -> None:
    upload_one("torn://lib/a.glb", TUBE.read_bytes())
    upload_one("torn://out/[1]/a.glb", b"the former one")
    Torn.breaks_at = "everywhere"
    result = bake_one("torn://lib/a.glb", "torn://out/[1]/a.glb")
    assert str(result.error) == "torn://out/[1]/a.glb: cannot be written: Connection reset by peer"
    assert stored("torn://out") == {"[1]/a.glb": b"the former one"}
    Torn.breaks_at = ""
    assert bake_one("torn://lib/a.glb", "torn://out/[1]/a.glb").error is None
    assert list(stored("torn://out")) == ["[1]/a.glb"]


def test_a_target_that_is_the_input_is_refused() -> None:
    upload_one("memory://b/lib/a.glb", TUBE.read_bytes())
    result = bake_one("memory://b/lib/a.glb", "memory:///b/lib/a.glb")
    assert "it is the input" in str(result.error)
    assert stored("memory://b") == {"lib/a.glb": TUBE.read_bytes()}


def test_a_target_that_the_input_consists_of_is_refused(tmp_path: Path) -> None:
    write_library(tmp_path / "lib")
    content = (tmp_path / "lib/props/crate.gltf").read_text().replace("maps/wood.png", "wood.glb")
    content = content.replace("../common/motion.bin", "motion.bin")
    upload_one("s3://b/lib/crate.gltf", content.encode())
    upload_one("s3://b/lib/crate #1.bin", (tmp_path / "lib/props/crate #1.bin").read_bytes())
    upload_one("s3://b/lib/wood.glb", b"wood")
    upload_one("s3://b/lib/motion.bin", b"motion")
    before = stored("s3://b")
    result = bake_one("s3://b/lib/crate.gltf", "s3://b/lib/wood.glb")
    assert str(result.error) == "s3://b/lib/wood.glb: it is a file of the input"
    assert stored("s3://b") == before


@pytest.mark.parametrize("uri", ["../secret.bin", "../../secret.bin", "%2e%2e/../b/%2e%2e/secret.bin"])
def test_uris_lead_out_of_neither_the_bucket_nor_the_private_folder(
    uri: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_library(tmp_path / "lib")
    source = (tmp_path / "lib/props/crate.gltf").read_text().replace("crate%20%231.bin", uri)
    upload_one("s3://b/crate.gltf", source.encode())
    secret = (tmp_path / "lib/props/crate #1.bin").read_bytes()
    upload_one("s3://secret.bin", secret)
    private = tmp_path / "1" / "2"
    private.mkdir(parents=True)
    for folder in (tmp_path, tmp_path / "1"):
        (folder / "secret.bin").write_bytes(secret)
    before = tree(tmp_path)
    monkeypatch.setattr(tempfile, "tempdir", str(private))
    result = bake_one("s3://b/crate.gltf", "s3://b/out/crate.gltf")
    assert f'its buffer "{uri}" is not read: it leads out of s3://b/' in str(result.error)
    assert tree(tmp_path) == before
    assert list(stored("s3://b")) == ["crate.gltf"]


def test_in_place_a_file_that_was_saved_meanwhile_stays(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    name = write_library(tmp_path / "lib")[0]
    upload(tmp_path / "lib", "memory://saved/lib")
    url = f"memory://saved/lib/{name}"
    files, path = url_to_fs(url)

    def saving(*arguments: Any) -> FileResult:
        result = bake.bake_file(*arguments)
        files.pipe_file(path, b"saved by another program")
        return result

    monkeypatch.setattr("skinbake.jobs.bake.bake_file", saving)
    result = FileWork((Bake(),))(Job(url, url))
    assert isinstance(result.error, OutputError)
    assert "another program has saved it since it was read, so it is not replaced" in result.error.message
    assert stored("memory://saved/lib")[name] == b"saved by another program"


def test_a_dry_run_stores_nothing() -> None:
    upload_one("s3://b/a.glb", TUBE.read_bytes())
    result = bake_one("s3://b/a.glb", "s3://b/out/a.glb", dry_run=True)
    assert result.status == "baked"
    assert list(stored("s3://b")) == ["a.glb"]


def upload_one(url: str, content: bytes) -> None:
    storage, path = url_to_fs(url)
    storage.pipe_file(path, content)


@pytest.mark.parametrize("protocol", ["memory", "s3", "file"])
def test_folders_and_patterns_are_expanded(protocol: str, tmp_path: Path) -> None:
    root = f"file://{tmp_path}/lib" if protocol == "file" else f"{protocol}://b/lib"
    files = [
        "a.glb",
        "b/c.GLTF",
        "b/c.bin",
        "b/d/e.vrm",
        "b/d/f [1].glb",
        "b/d/notes.txt",
        ".h/g.glb",
        "b/.i.glb",
    ]
    for name in files:
        path = tmp_path / "lib" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")
    if protocol != "file":
        upload(tmp_path / "lib", root)

    def expanded(pattern: str) -> list[str]:
        found = expand_url(f"{root}{pattern}")
        base = f"{root}{pattern}".split("*")[0].rpartition("/")[0] if "*" in pattern else f"{root}{pattern}"
        assert [url for url, _ in found] == [f"{base.rstrip('/')}/{name}" for _, name in found]
        return [name for _, name in found]

    everything = ["a.glb", "b/c.GLTF", "b/d/e.vrm", "b/d/f [1].glb"]
    assert expanded("") == expanded("/") == everything
    assert expanded("/b") == ["c.GLTF", "d/e.vrm", "d/f [1].glb"]
    assert expanded("/*.glb") == ["a.glb"]
    assert expanded("/**/*.glb") == ["a.glb", "b/d/f [1].glb"]
    assert expanded("/.h/*.glb") == ["g.glb"]
    assert expanded("/b/*/*") == ["d/e.vrm", "d/f [1].glb"]
    assert expand_url(f"{root}/b/d/f [1].glb") == [(f"{root}/b/d/f [1].glb", "f [1].glb")]
    assert expand_url(f"{root}/gone.glb") == [(f"{root}/gone.glb", "gone.glb")]
    for nothing in ("/gone", "/b/*.png"):
        with pytest.raises(
            InputError,
            match=r"(that matches this pattern|nothing in this folder) ends in \.glb, \.gltf, \.vrm",
        ):
            expand_url(f"{root}{nothing}")


def test_what_is_a_url() -> None:
    assert all(map(is_url, ["s3://b/a.glb", "simplecache::s3://b/a.glb", "zip://a.glb::file:///b.zip"]))
    assert not any(map(is_url, ["a.glb", "C:/a.glb", "C:\\a.glb", "/a://b.glb", "-", "s3:/b", "a::b.glb"]))
    assert join_url("memory://", "a/b.glb") == "memory://a/b.glb"
    assert join_url("s3://b/out", "a/b.glb") == join_url("s3://b/out/", "a/b.glb") == "s3://b/out/a/b.glb"
