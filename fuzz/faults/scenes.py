"""Commands that run while calls fail, the folder that they begin with, and the files that they may leave."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from fixtures.make_fixtures import FOLDER
from skinbake.gltf.glb import join_glb
from skinbake.gltf.writing.output import LARGE

Tree = Mapping[str, bytes]
"""Files below a folder, by path."""


@dataclass(frozen=True)
class Scene:
    """A command in a folder that ``furnish`` fills; ``appended`` files may hold a part of themselves."""

    name: str
    arguments: tuple[str, ...]
    furnish: Callable[[Path], None]
    appended: tuple[str, ...] = ()


def tree(folder: Path) -> Tree:
    """Return all files below a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def lay(folder: Path, files: Tree) -> None:
    """Fill an empty folder with files, and with the folders that scenes write to."""
    for name in ("in", "out"):
        (folder / name).mkdir(parents=True)
    for name, data in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)


def _one(folder: Path) -> None:
    lay(folder, {"in/a.glb": (FOLDER / "seam.glb").read_bytes()})


def _over(folder: Path) -> None:
    _one(folder)
    (folder / "out/a.glb").write_bytes(b"what was there before")


def _large(folder: Path) -> None:
    """Lay a model with so many unused bytes at the end of its BIN chunk that they are written ahead."""
    data = (FOLDER / "seam.glb").read_bytes()
    json_length = int.from_bytes(data[12:16], "little")
    text, binary = json.loads(data[20 : 20 + json_length]), data[28 + json_length :]
    text["buffers"][0]["byteLength"] = len(binary) + LARGE
    parts = join_glb(json.dumps(text).encode(), [binary, bytes(LARGE)], ())
    lay(folder, {"in/a.glb": b"".join(parts), "out/a.glb": b"what was there before"})


def _gltf(folder: Path) -> None:
    lay(folder, {"in/sub/tex.png": b"an image"})
    text = (FOLDER / "shared_accessors.gltf").read_bytes()
    text = text.replace(b'"asset"', b'"images": [{"uri": "sub/tex.png"}], "asset"', 1)
    (folder / "in/a.gltf").write_bytes(text)
    shutil.copy(FOLDER / "shared accessors.bin", folder / "in")


def _several(folder: Path) -> None:
    lay(folder, {f"in/{name}.glb": (FOLDER / f"{name}.glb").read_bytes() for name in ("seam", "weights_u8")})


NOTES = ("out/state.jsonl", "out/summary.jsonl", "out/.skinbake-state.jsonl")
QUICK = ("--poses", "rest", "--method", "lbs")

SCENES = (
    Scene("glb", ("bake", "in/a.glb", "-o", "out/a.glb"), _over),
    Scene("large", ("bake", "in/a.glb", "-o", "out/a.glb", "--threads", "2"), _large),
    Scene("large in place", ("bake", "in/a.glb", "--in-place", "--threads", "2"), _large),
    Scene("glb to gltf", ("bake", "in/a.glb", "-o", "out/a.gltf"), _one),
    Scene("gltf with files", ("bake", "in/a.gltf", "-o", "out/a.gltf"), _gltf),
    Scene("in place", ("bake", "in/a.glb", "--in-place"), _one),
    Scene("gltf in place", ("bake", "in/a.gltf", "--in-place"), _gltf),
    Scene("new folder", ("bake", "in/a.gltf", "--out-dir", "out/new/sub"), _gltf),
    Scene(
        "batch",
        ("bake", "in", "--out-dir", "out", "--skip-unchanged", "--summary", "out/summary.jsonl"),
        _several,
        NOTES,
    ),
    Scene("compressed", ("bake", "in/a.glb", "-o", "out/a.glb", "--compress", "meshopt"), _over),
    Scene("strip", ("strip", "in/a.glb", "-o", "out/a.glb"), _over),
    Scene("shader", ("shader", "--lang", "glsl", "-o", "out/a.txt"), _one),
    Scene("verify", ("verify", "in", *QUICK, "--junit", "out/junit.xml"), _several),
    Scene(
        "verify with notes",
        ("verify", "in", *QUICK, "--summary", NOTES[1], "--skip-unchanged", "--state", NOTES[0]),
        _several,
        NOTES,
    ),
)
