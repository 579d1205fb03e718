"""Bake real files, edit what was written byte by byte, and ask ``skinbake verify`` about the result."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from click.testing import CliRunner

from fixtures.builder import VECTOR_TYPES, pack_glb
from skinbake.cli.main import main
from skinbake.gradients.baker import BakeSettings
from tests.support import corpus, gltf_reading
from tests.support.baking import bake_file

REPOSITORY = Path(__file__).resolve().parents[2]
CESIUM_MAN = "CesiumMan/CesiumMan.glb"

AnyArray = npt.NDArray[Any]
JsonObject = dict[str, Any]


def source(name: str) -> Path:
    """Return a fixture, or a model of the corpus where the name has a folder; else its stand-in, or skip."""
    return corpus.character(name) if "/" in name else REPOSITORY / "fixtures" / name


def baked(original: Path, folder: Path, settings: BakeSettings | None = None, **options: Any) -> Path:
    """Bake a file into a folder and return what was written; options are those of ``bake_file``."""
    target = folder / original.name
    result = bake_file(original, target, settings=settings, **options)
    assert result.status == "baked", result.notices
    return target


@dataclass(frozen=True)
class Answer:
    """The outcome of one file on the command line: the exit code, its JSON, and its text."""

    exit_code: int
    file: JsonObject
    messages: str

    def problems(self, check: str) -> list[JsonObject]:
        """Return the problems of one check."""
        found: list[JsonObject] = next(c["problems"] for c in self.file["checks"] if c["name"] == check)
        return found

    @property
    def failed(self) -> list[str]:
        """Return the names of the checks that failed."""
        return [check["name"] for check in self.file["checks"] if check["outcome"] == "failed"]


def verify(path: Path, *options: str) -> Answer:
    """Run ``skinbake verify --json``; anything but an orderly exit fails the test."""
    result = CliRunner().invoke(main, ["verify", "--json", *options, str(path)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    document = json.loads(result.stdout)
    assert document["exit_code"] == result.exit_code
    return Answer(result.exit_code, document["files"][0], result.stderr)


class Editable:
    """A GLB taken apart: its JSON, and arrays that write through to its bytes."""

    def __init__(self, path: Path) -> None:
        read = gltf_reading.read(path)
        self.content = read.content
        self.binary = bytearray(read.binary_chunk or b"")

    def primitive(self, number: int = 0) -> JsonObject:
        """Return the JSON of a primitive of the first mesh."""
        found: JsonObject = self.content["meshes"][0]["primitives"][number]
        return found

    def metadata(self, number: int = 0) -> JsonObject:
        """Return what bake noted of a primitive of the first mesh."""
        found: JsonObject = self.primitive(number)["extras"]["skinbake"]
        return found

    def array(self, name: str, number: int = 0) -> AnyArray:
        """Return an attribute, or ``indices``, (count, components) as stored; writing to it edits it."""
        primitive = self.primitive(number)
        accessor = primitive["indices"] if name == "indices" else primitive["attributes"][name]
        return self.stored(accessor)

    def stored(self, accessor: int) -> AnyArray:
        """Return an accessor's elements (count, components); writing to them edits the file."""
        description = self.content["accessors"][accessor]
        view = self.content["bufferViews"][description["bufferView"]]
        columns, rows = gltf_reading.SHAPES[description["type"]]
        dtype = gltf_reading.DTYPES[description["componentType"]]
        size = columns * rows * dtype.itemsize
        start = view.get("byteOffset", 0) + description.get("byteOffset", 0)
        shape, strides = (
            (description["count"], columns * rows),
            (view.get("byteStride", size), dtype.itemsize),
        )
        return np.ndarray(shape, dtype, self.binary, start, strides)

    def add(self, values: npt.NDArray[np.float32]) -> int:
        """Append an accessor (count, components) and return its index. Ends the life of earlier arrays."""
        grown = self.binary + bytes(-len(self.binary) % 4)
        view = {"buffer": 0, "byteOffset": len(grown), "byteLength": values.nbytes}
        self.binary = grown + values.tobytes()
        self.content["bufferViews"].append(view)
        accessor = {
            "bufferView": len(self.content["bufferViews"]) - 1,
            "componentType": 5126,
            "count": len(values),
            "type": VECTOR_TYPES[values.shape[1]],
        }
        self.content["accessors"].append(accessor)
        return len(self.content["accessors"]) - 1

    def write(self, path: Path) -> Path:
        """Write the GLB and return its path."""
        self.content["buffers"][0]["byteLength"] = len(self.binary)
        path.write_bytes(pack_glb(self.content, bytes(self.binary)))
        return path
