"""Small libraries of skinned files, on a disk and in storages, and storages that behave like others."""

from __future__ import annotations

import importlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from fixtures.builder import JsonObject
from tests.support.models import FOLDER, sheet, write_model
from tests.support.strictness import missing_tool

if find_spec("fsspec") is None:
    missing_tool("fsspec is not installed: pip install 'skinbake[dask]'")
import fsspec
from fsspec.implementations.memory import MemoryFileSystem

filesystem, register = fsspec.filesystem, fsspec.register_implementation
url_to_fs = fsspec.core.url_to_fs
"""For tests to import from here, so that they are skipped where there is no fsspec."""

Tree = dict[str, bytes]
"""Files by path relative to a folder."""


def write_sheets(folder: Path, count: int, *, prefix: str = "sheet") -> list[Path]:
    """Write skinned sheets that all differ."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for number in range(count):
        positions = sheet().attributes["POSITION"] * np.float32(1 + number / 64)
        part = sheet(POSITION=positions)
        paths.append(write_model(folder / f"{prefix}{number:03}.glb", [part]))
    return paths


def write_library(folder: Path) -> list[str]:
    """Write files of every kind that bake meets, some with files beside them; return their relative paths.

    ``props/crate.gltf`` has a buffer and an image beside it, and an image and a buffer of another folder.
    """
    names = []
    for name in ("bent_tube.glb", "two_sets.glb"):
        target = folder / "characters" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes((FOLDER / name).read_bytes())
        names.append(f"characters/{name}")
    shared = folder / "shared"
    shared.mkdir()
    for name in ("shared_accessors.gltf", "shared accessors.bin"):
        (shared / name).write_bytes((FOLDER / name).read_bytes())
    names.append("shared/shared_accessors.gltf")
    names.append(_crate(folder))
    return names


def _crate(folder: Path) -> str:
    path = folder / "props" / "crate.gltf"
    (path.parent / "maps").mkdir(parents=True)
    (folder / "common").mkdir()
    write_model(path, [sheet()])
    content = json.loads(path.read_text())
    data = fsspec.filesystem("data").cat_file(content["buffers"][0]["uri"])
    (path.parent / "crate #1.bin").write_bytes(data)
    (path.parent / "maps" / "wood.png").write_bytes(b"wood")
    (folder / "common" / "noise.png").write_bytes(b"noise")
    (folder / "common" / "motion.bin").write_bytes(b"motion")
    content["buffers"][0]["uri"] = "crate%20%231.bin"
    content["buffers"].append({"byteLength": 6, "uri": "../common/motion.bin"})
    content["images"] = [
        {"uri": "maps/wood.png"},
        {"uri": "../common/noise.png"},
        {"uri": "maps/gone.png"},
    ]
    path.write_text(json.dumps(content, indent=2))
    return "props/crate.gltf"


def tree(folder: Path) -> Tree:
    """Return all files in a folder, without the notes of copies, which only a disk has."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != ".skinbake-copies.json"
    }


def upload(folder: Path, url: str) -> None:
    """Store a folder's files under a URL."""
    storage, root = url_to_fs(url)
    for name, content in tree(folder).items():
        storage.pipe_file(f"{root}/{name}", content)


def stored(url: str) -> Tree:
    """Return all files under a URL."""
    storage, root = url_to_fs(url)
    return {
        str(path)[len(root) :].lstrip("/"): storage.cat_file(path)
        for path in (storage.find(root) if storage.exists(root) else [])
    }


class Bucket(fsspec.AbstractFileSystem):  # type: ignore[misc]  # fsspec is untyped
    """An object store like S3: keys, no folders, and an object appears when all of it is there.

    It stands for ``s3://`` where ``bucket_for_s3`` is entered.
    """

    protocol = ("s3", "s3a")
    objects: ClassVar[Tree] = {}
    forbidden: ClassVar[set[str]] = set()
    cachable = False

    def _content(self, path: str) -> bytes:
        if path in self.forbidden:
            raise PermissionError("Access Denied")
        if path not in self.objects:
            raise FileNotFoundError(path)
        return self.objects[path]

    def info(self, path: str, **_: Any) -> JsonObject:
        if any(key.startswith(f"{path}/") for key in self.objects):
            return {"name": path, "size": 0, "type": "directory"}
        return {"name": path, "size": len(self._content(path)), "type": "file"}

    def ls(self, path: str, detail: bool = True, **_: Any) -> list[Any]:
        start = f"{path}/" if path else ""
        names = {start + key[len(start) :].split("/")[0] for key in self.objects if key.startswith(start)}
        return [self.info(name) if detail else name for name in sorted(names)]

    def cat_file(self, path: str, *_: Any, **__: Any) -> bytes:
        return self._content(self._strip_protocol(path))

    def pipe_file(self, path: str, value: bytes, **_: Any) -> None:
        self.objects[self._strip_protocol(path)] = value

    def get_file(self, path: str, to: str, **_: Any) -> None:
        Path(to).write_bytes(self._content(path))

    def put_file(self, source: str, path: str, **_: Any) -> None:
        if path in self.forbidden:
            raise PermissionError("Access Denied")
        self.objects[path] = Path(source).read_bytes()

    def makedirs(self, path: str, exist_ok: bool = False) -> None:
        raise AssertionError(f"S3 would make a bucket for {path}")


@contextmanager
def bucket_for_s3() -> Iterator[type[Bucket]]:
    """Let ``s3://`` be an empty bucket while the block runs."""
    before = dict(fsspec.registry)
    fsspec.register_implementation("s3", Bucket, clobber=True)
    Bucket.objects.clear()
    Bucket.forbidden.clear()
    try:
        yield Bucket
    finally:
        registry = importlib.import_module("fsspec.registry")._registry
        registry.clear()
        registry.update(before)


class Torn(MemoryFileSystem):  # type: ignore[misc]  # fsspec is untyped
    """A file server, ``torn://``, whose connection breaks amid the files named in ``breaks_at``."""

    protocol = "torn"
    store: ClassVar[dict[str, Any]] = {}
    pseudo_dirs: ClassVar[list[str]] = [""]
    breaks_at = ""

    @classmethod
    def _strip_protocol(cls, path: str) -> str:
        return str(MemoryFileSystem._strip_protocol(path.removeprefix("torn://")))

    def put_file(self, source: str, path: str, **_: Any) -> None:
        content = Path(source).read_bytes()
        if not self.breaks_at:
            self.pipe_file(path, content)
            return
        self.pipe_file(path, content[: len(content) // 2])
        raise ConnectionResetError(104, "Connection reset by peer")
