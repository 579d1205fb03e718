"""URLs on the command line, and what goes with --dask."""

from __future__ import annotations

import html
import os
import re
import shutil
import sys
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any, ClassVar
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest
from fsspec import AbstractFileSystem
from fsspec.implementations.memory import MemoryFileSystem

from skinbake.cli import exit_codes
from skinbake.errors import InputError
from skinbake.jobs.remote import dask_runner
from skinbake.jobs.remote.storages import expand_url
from tests.support.command_line import document, invoke
from tests.support.libraries import filesystem, stored, tree, upload, write_library
from tests.support.models import FOLDER, SHARED, copied, edited


@pytest.fixture(autouse=True)
def _storages() -> Iterator[None]:
    yield
    memory = filesystem("memory")
    memory.store.clear()
    memory.pseudo_dirs[:] = [""]


@pytest.fixture
def library(tmp_path: Path) -> Path:
    """A library on the disk and, the same, at memory://lib; baked to ``here`` on the disk."""
    write_library(tmp_path / "lib")
    upload(tmp_path / "lib", "memory://lib")
    assert invoke("bake", tmp_path / "lib", "--out-dir", tmp_path / "here").exit_code == 0
    return tmp_path


@pytest.mark.slow
def test_folders_and_patterns_behind_urls(library: Path) -> None:
    result = invoke("bake", "memory://lib/", "--out-dir", "memory://out", "--json")
    assert result.exit_code == 0
    assert [(file["input"], file["output"]) for file in document(result)["files"]] == [
        (f"memory://lib/{name}", f"memory://out/{name}")
        for name in (
            "characters/bent_tube.glb",
            "characters/two_sets.glb",
            "props/crate.gltf",
            "shared/shared_accessors.gltf",
        )
    ]
    assert stored("memory://out") == tree(library / "here")
    pattern = invoke("bake", "memory://lib/**/two*.glb", "--out-dir", "memory://one")
    assert pattern.exit_code == 0
    assert list(stored("memory://one")) == ["characters/two_sets.glb"]
    inspected = document(invoke("inspect", "memory://out/**/two*.glb", "--json"))["files"]
    assert [(file["input"], file["error"]) for file in inspected] == [
        ("memory://out/characters/two_sets.glb", None)
    ]
    assert all(primitive["baked"] for primitive in inspected[0]["primitives"])
    assert invoke("strip", "memory://out/characters", "--out-dir", "memory://back").exit_code == 0
    assert stored("memory://back")["two_sets.glb"] == (library / "lib/characters/two_sets.glb").read_bytes()
    verified = invoke("verify", "memory://out/characters", "--json")
    assert [file["input"] for file in document(verified)["files"]] == [
        "memory://out/characters/bent_tube.glb",
        "memory://out/characters/two_sets.glb",
    ]
    assert verified.exit_code == 0


@pytest.mark.slow
def test_outputs_are_not_taken_for_inputs(library: Path) -> None:
    for _ in range(2):
        assert invoke("bake", "memory://lib", "--out-dir", "memory://lib/out").exit_code == 0
    assert stored("memory://lib/out").keys() == tree(library / "here").keys()


@pytest.mark.slow
def test_images_behind_urls_are_packed(library: Path) -> None:
    folder = library / "lib" / "images"
    path = edited("seam.glb", folder, lambda content: content.update(images=[{"uri": "skin.png"}]))
    (folder / "skin.png").write_bytes(b"\x89PNG, or so it begins")
    upload(folder, "memory://images")
    for name in ("memory://images/packed.glb", "memory://elsewhere/packed.glb"):
        assert invoke("bake", "memory://images/seam.glb", "-o", name, "--pack").exit_code == 0
    assert invoke("bake", path, "-o", folder / "packed.glb", "--pack").exit_code == 0
    expected = (folder / "packed.glb").read_bytes()
    assert b"\x89PNG, or so it begins" in expected
    assert stored("memory://elsewhere") == {"packed.glb": expected}
    assert stored("memory://images")["packed.glb"] == expected


@pytest.mark.slow
def test_urls_in_several_processes(library: Path) -> None:
    sources = [f"file://{library}/lib"] * 1
    result = invoke("bake", *sources, "--out-dir", f"file://{library}/away", "--jobs", "2")
    assert result.exit_code == 0
    assert tree(library / "away") == tree(library / "here")


def test_a_url_is_baked_to_another_and_in_place(library: Path) -> None:
    url, path = "memory://lib/characters/two_sets.glb", "characters/two_sets.glb"
    assert invoke("bake", url, "-o", "memory://new/a.glb").exit_code == 0
    assert stored("memory://new") == {"a.glb": tree(library / "here")[path]}
    assert invoke("bake", url, "--in-place").exit_code == 0
    assert stored("memory://lib")[path] == tree(library / "here")[path]


def test_what_cannot_be_had_is_one_sentence_a_file(library: Path) -> None:
    names = ["memory://lib/gone.glb", "memory://gone", "memory://lib/*.png", "warp://a.glb", "gs://b/"]
    result = invoke("bake", *names, "--out-dir", "memory://out", "-q")
    assert result.exit_code == exit_codes.INPUT
    lines = result.stderr.splitlines()
    for name, reason in zip(
        names,
        [
            "cannot be read: No such file or directory",
            "nothing in this folder ends in .glb, .gltf, .vrm",
            "no file that matches this pattern ends in .glb, .gltf, .vrm",
            "fsspec knows no protocol warp://",
            "the driver for gs:// is not installed: Please install gcsfs to access Google Storage",
        ],
        strict=True,
    ):
        assert f"error: {name}: {reason}" in lines
    assert stored("memory://out") == {}


@pytest.mark.parametrize("url", ["s3://bucket/a.glb", "s3://bucket/"])
def test_a_url_without_fsspec_tells_what_to_install(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as without:
        for name in [*sys.modules]:
            if name.partition(".")[0] == "fsspec":
                without.setitem(sys.modules, name, None)
        result = invoke("bake", url, "--out-dir", "out")
    assert result.exit_code == exit_codes.INPUT
    assert f"error: {url}: URLs need fsspec, which is not installed: pip install" in result.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        ["verify", "a.glb", "--junit", "s3://bucket/report.xml"],
        ["verify", "a.glb", "--html", "file:///report.html"],
        ["bake", "a.glb", "--dry-run", "--summary", "s3://bucket/lines.jsonl"],
        ["shader", "--lang", "glsl", "-o", "s3://bucket/shader.glsl"],
        ["view", "a.glb", "-o", "s3://bucket/page.html"],
        ["example", "-o", "s3://bucket/a.glb"],
    ],
)
def test_only_models_are_written_to_urls(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = invoke(*arguments)
    assert result.exit_code == exit_codes.USAGE
    assert f"{arguments[-1]} is a URL: only models go to URLs" in result.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["a.glb", "--dask", "tcp://h:1", "--jobs", "2"], "--jobs controls processes of this machine"),
        (["-", "--dask", "tcp://h:1"], "not - for stdin"),
        (["memory://a.glb", "--skip-unchanged", "--state", "s.jsonl"], "without --dask and URLs"),
        (["a.glb", "--dask", "tcp://h:1", "--skip-unchanged", "--state", "s"], "without --dask and URLs"),
    ],
)
def test_what_does_not_go_together(arguments: list[str], message: str) -> None:
    for command in (["bake", "--dry-run"], ["verify"]):
        result = invoke(*command, *arguments)
        assert result.exit_code == exit_codes.USAGE
        assert message in result.stderr


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer(library: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_runner, "CONNECT_SECONDS", 0.3)
    with pytest.raises(InputError, match=r"tcp://127\.0\.0\.1:1: no Dask scheduler answers"):
        invoke("bake", library / "lib", "--out-dir", library / "away", "--dask", "tcp://127.0.0.1:1")
    assert not (library / "away").exists()


class TestOneFileByTwoNames:
    """An input is no output by mistake, whatever its names."""

    @pytest.fixture
    def model(self, tmp_path: Path) -> Path:
        path = tmp_path / "in" / "seam.glb"
        path.parent.mkdir()
        path.write_bytes((FOLDER / "seam.glb").read_bytes())
        return path

    @pytest.mark.parametrize(
        ("source", "target"),
        [
            ("{}/in/seam.glb", "file://{}/in/seam.glb"),
            ("file://{}/in/seam.glb", "{}/in/seam.glb"),
            ("file://{}/in/seam.glb", "file://{}/in/../in/seam.glb"),
            ("file://{}/in/seam.glb", "local://{}/in//seam.glb"),
            ("memory://a/seam.glb", "memory://a/b/../seam.glb"),
        ],
    )
    def test_a_target_that_is_the_input_is_refused(
        self, model: Path, source: str, target: str, tmp_path: Path
    ) -> None:
        result = invoke("bake", source.format(tmp_path), "-o", target.format(tmp_path))
        assert result.exit_code == 2
        assert "is the input; use --in-place" in result.stderr

    @pytest.mark.parametrize(
        ("source", "folder"),
        [("{}/in", "file://{}/in"), ("file://{}/in", "{}/in"), ("{}/in/seam.glb", "file://{}/in")],
    )
    def test_a_folder_of_targets_that_is_the_input_s_is_refused(
        self, model: Path, source: str, folder: str, tmp_path: Path
    ) -> None:
        before = model.read_bytes()
        result = invoke("bake", source.format(tmp_path), "--out-dir", folder.format(tmp_path))
        assert result.exit_code == 2
        assert "is the input; use --in-place" in result.stderr
        assert model.read_bytes() == before

    def test_a_folder_of_outputs_is_left_out_by_its_url_too(self, model: Path, tmp_path: Path) -> None:
        for _ in range(2):
            result = invoke("bake", f"{tmp_path}/in", "--out-dir", f"file://{tmp_path}/in/out")
            assert result.exit_code == 0
        assert sorted(path.name for path in (tmp_path / "in").rglob("*.glb")) == ["seam.glb", "seam.glb"]


def test_a_url_of_a_local_folder_follows_the_rules_of_paths(tmp_path: Path) -> None:
    for folder in ("in", "in/.hidden", "in/deep"):
        (tmp_path / folder).mkdir()
        shutil.copyfile(FOLDER / "seam.glb", tmp_path / folder / "seam.glb")
    for pattern in ("", "/*.glb", "/**/*.GLB"):
        by_path, by_url = (
            [file["input"] for file in document(invoke("bake", argument, "--dry-run", "--json"))["files"]]
            for argument in (f"{tmp_path}/in{pattern}", f"file://{tmp_path}/in{pattern}")
        )
        assert by_url == [f"file://{path}" for path in by_path]
    result = invoke("bake", f"file://{tmp_path}/gone", "--dry-run")
    assert result.exit_code == 3
    assert result.stderr == f"error: file://{tmp_path}/gone: there is no such folder\n"


def test_a_link_that_leads_nowhere_is_a_file_that_somebody_misses(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "hero.glb").symlink_to(tmp_path / "gone.glb")
    for argument in (f"{tmp_path}/in", f"file://{tmp_path}/in", f"{tmp_path}/in/*.glb"):
        result = invoke("bake", argument, "--out-dir", str(tmp_path / "out"))
        assert result.exit_code == 3
        assert "hero.glb" in result.stderr


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.glb")
    result = invoke("bake", str(tmp_path / "pipe.glb"), "-o", str(tmp_path / "out.glb"))
    assert result.exit_code == 3
    assert "not a regular file" in result.stderr


@pytest.mark.parametrize("address", ["", "127.0.0.1", "foo://bar", "tcp://host"])
def test_what_is_no_address_is_no_cluster(address: str, tmp_path: Path) -> None:
    result = invoke("bake", str(FOLDER / "seam.glb"), "-o", str(tmp_path / "out.glb"), "--dask", address)
    assert result.exit_code == 2
    assert "--dask needs the address" in result.stderr
    assert not (tmp_path / "out.glb").exists()


class WebServer(MemoryFileSystem):  # type: ignore[misc]  # fsspec is untyped
    """A folder of a web server, as fsspec lists it: whole URLs, percent-encoded."""

    protocol = ("http", "https")
    store: ClassVar[dict[str, Any]] = {}
    pseudo_dirs: ClassVar[list[str]] = [""]

    @classmethod
    def _strip_protocol(cls, path: str) -> str:
        return path

    def find(self, path: str, **_: Any) -> list[str]:
        names = ["a%20b.glb", "%c3%bc/c%231.glb", "%2e%2e%2fd.glb", "%2e%2e/e.glb", "a%5Cf.glb", "plain.glb"]
        return [f"{path.rstrip('/')}/{name}" for name in names]


def test_names_of_a_web_server_are_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    """A name that would lead elsewhere keeps its encoding."""
    monkeypatch.setattr("fsspec.core.url_to_fs", lambda url: (WebServer(), url))
    found = dict(expand_url("https://host/art"))
    assert found == {
        "https://host/art/a%20b.glb": "a b.glb",
        "https://host/art/%c3%bc/c%231.glb": "ü/c#1.glb",
        "https://host/art/%2e%2e%2fd.glb": "%2e%2e%2fd.glb",
        "https://host/art/%2e%2e/e.glb": "%2e%2e/e.glb",
        "https://host/art/a%5Cf.glb": "a%5Cf.glb",
        "https://host/art/plain.glb": "plain.glb",
    }
    assert expand_url("https://host/my%20hero.glb") == [("https://host/my%20hero.glb", "my hero.glb")]
    assert expand_url("s3://host/my%20hero.glb") == [("s3://host/my%20hero.glb", "my%20hero.glb")]


class PlainWeb(AbstractFileSystem):  # type: ignore[misc]  # fsspec is untyped
    """Files behind a real web server. As with the driver of fsspec, paths are URLs, sent as they are."""

    protocol = ("http", "https")

    @classmethod
    def _strip_protocol(cls, path: str) -> str:
        return path

    def find(self, path: str, **_: Any) -> list[str]:
        listed = re.findall('href="([^"?]+)"', self.cat_file(f"{path.rstrip('/')}/").decode("utf-8"))
        names = [f"{path.rstrip('/')}/{html.unescape(name)}" for name in listed]
        return [one for name in names for one in (self.find(name) if name.endswith("/") else [name])]

    def cat_file(self, path: str, *_: Any, **__: Any) -> bytes:
        try:
            with urlopen(path, timeout=60) as answer:
                content: bytes = answer.read()
        except HTTPError as error:
            raise FileNotFoundError(path) from error
        return content

    def get_file(self, path: str, to: str, **_: Any) -> None:
        Path(to).write_bytes(self.cat_file(path))

    def info(self, path: str, **_: Any) -> dict[str, Any]:
        return {"name": path, "type": "file", "size": len(self.cat_file(path))}


@pytest.mark.slow
def test_a_folder_of_a_web_server_is_baked_as_one_of_this_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Names of documents, and names in documents, hold what a URL holds only percent-encoded."""
    models = tmp_path / "www" / "my art" / "ü"
    models.parent.mkdir(parents=True)
    uris = ["skins/skin%20%231.png", "skins/%C3%BC%20%25.png", "skins/per%41.png", "skins/plain.png"]
    source = edited(SHARED, models, lambda content: content.update(images=[{"uri": uri} for uri in uris]))
    source.rename(models / "sh ared #1.gltf")
    (models / "skins").mkdir()
    for name in ("skin #1.png", "ü %.png", "per%41.png", "plain.png"):
        (models / "skins" / name).write_bytes(b"\x89PNG\r\n\x1a\n" + name.encode())
    for name in ("a b.glb", "100%.glb", "%41.glb", "it's (1).glb", "a&b=c;d.glb", "e+f.glb"):
        shutil.copyfile(FOLDER / "seam.glb", models.parent / name)

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            pass

    here = partial(Quiet, directory=str(tmp_path / "www"))
    with ThreadingHTTPServer(("127.0.0.1", 0), here) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        monkeypatch.setattr("fsspec.core.url_to_fs", lambda url: (PlainWeb(), url))
        url = f"http://127.0.0.1:{server.server_port}/my%20art"
        for given, folder in ((url, "web"), (tmp_path / "www" / "my art", "disk")):
            result = invoke("bake", given, "--out-dir", tmp_path / folder)
            assert result.exit_code == 0, result.stderr
        packed = invoke(
            "bake", f"{url}/%C3%BC/sh%20ared%20%231.gltf", "--pack", "-o", tmp_path / "packed.glb"
        )
        server.shutdown()
    assert tree(tmp_path / "web") == tree(tmp_path / "disk")
    assert len(tree(tmp_path / "web")) == 13
    assert packed.exit_code == 0, packed.stderr
    assert b"skin #1.png" in (tmp_path / "packed.glb").read_bytes()


@pytest.mark.parametrize("chain", ["dir", "simplecache", "simplecache::cached", "zip://a.glb"])
def test_a_chained_url_is_refused(chain: str, tmp_path: Path) -> None:
    source = copied("seam.glb", tmp_path)
    result = invoke("bake", f"{chain}::file://{source}", "-o", tmp_path / "a.glb")
    assert result.exit_code == 3
    assert "it is a chained URL: copy the file out, and name the copy" in " ".join(result.stderr.split())
    assert not (tmp_path / "a.glb").exists()


@pytest.mark.parametrize("command", [["view"], ["render", "-o", "a.png"], ["shader", "-o", "a", "--for"]])
def test_commands_that_read_no_urls_say_so(command: list[str], tmp_path: Path) -> None:
    result = invoke(*command, "s3://bucket/hero.glb")
    assert result.exit_code == 2
    assert "this command reads no URLs. Copy the file" in " ".join(result.stderr.split())


@pytest.mark.slow
def test_the_url_of_a_file_of_this_disk_can_be_viewed(tmp_path: Path) -> None:
    source = copied("seam.glb", tmp_path)
    for number, name in enumerate((str(source), f"file://{source}")):
        assert invoke("view", name, "-o", tmp_path / f"{number}.html").exit_code == 0
    assert (tmp_path / "0.html").read_bytes() == (tmp_path / "1.html").read_bytes()
