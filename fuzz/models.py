"""A model taken apart so that it can be damaged: its JSON, the bytes of buffer 0, and the files beside it.

Containers are read and written here anew, not by the code under test.
"""

from __future__ import annotations

import base64
import json
import marshal
import struct
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote

JsonObject = dict[str, Any]

GLB, GLTF, EMBEDDED, WRAPPED = "glb", "gltf", "embedded", "wrapped"
"""How a model is packed: one GLB, a .gltf with a .bin, a .gltf or a GLB with its buffer in a data: URI."""

COMPONENT_SIZES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
COMPONENT_COUNTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


@dataclass
class Model:
    """One model. ``binary`` holds buffer 0, ``files`` what other URIs name; ``raw`` text goes in last.

    ``raw`` maps marks that stand in the JSON as strings to the text that replaces them, quotes included:
    what json.dumps would never write, such as 1e999.
    """

    name: str
    json: JsonObject
    binary: bytearray
    files: dict[str, bytes] = field(default_factory=dict)
    raw: dict[str, str] = field(default_factory=dict)

    def copied(self) -> Model:
        """Return a copy that shares nothing that a mutation may change."""
        return Model(
            self.name,
            marshal.loads(marshal.dumps(self.json)),
            bytearray(self.binary),
            dict(self.files),
            dict(self.raw),
        )

    def text(self, indent: int | None = None) -> bytes:
        """Return the JSON as it is written; deeper nesting than json can write ends in null."""
        try:
            text = json.dumps(self.json, separators=(",", ":"), indent=indent)
        except RecursionError:
            text = "null"
        for mark, piece in self.raw.items():
            text = text.replace(f'"{mark}"', piece)
        return text.encode("utf-8", "surrogatepass")

    def packed(self, way: str, stem: str = "m") -> tuple[str, dict[str, bytes]]:
        """Return the suffix and, by name, the files of the model in a container."""
        if way == GLB:
            return ".glb", {f"{stem}.glb": glb(self.text(), bytes(self.binary)), **self.files}
        buffers = self.json.get("buffers")
        first = buffers[0] if isinstance(buffers, list) and buffers else None
        packed, files = self, dict(self.files)
        if isinstance(buffers, list) and isinstance(first, dict) and "uri" not in first:
            uri = "m.bin"
            if way in {EMBEDDED, WRAPPED}:
                uri = "data:application/octet-stream;base64," + base64.b64encode(self.binary).decode()
            packed = replace(self, json={**self.json, "buffers": [{**first, "uri": uri}, *buffers[1:]]})
        if way == WRAPPED:
            return ".glb", {f"{stem}.glb": glb(packed.text(), b""), **files}
        if way == GLTF:
            files["m.bin"] = bytes(self.binary)
        return ".gltf", {f"{stem}.gltf": packed.text(indent=None if len(self.binary) % 32 else 2), **files}


def glb(text: bytes, binary: bytes) -> bytes:
    """Return a GLB of a JSON text and a BIN chunk, none where it is empty."""
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if binary:
        binary += bytes(-len(binary) % 4)
        chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def read_model(path: Path) -> Model:
    """Return the model of a valid file whose first buffer is the BIN chunk, a file beside it, or in it."""
    data = path.read_bytes()
    if data[:4] != b"glTF":
        content = json.loads(data.decode("utf-8-sig"))
        buffers = content.get("buffers", [])
        binary = _taken(buffers[0], path.parent) if buffers else b""
        return Model(path.name, content, bytearray(binary))
    length = struct.unpack_from("<I", data, 12)[0]
    content = json.loads(data[20 : 20 + length])
    rest = data[20 + length :]
    binary = rest[8 : 8 + struct.unpack_from("<I", rest)[0]] if len(rest) >= 8 else b""
    return Model(path.name, content, bytearray(binary))


def _taken(buffer: JsonObject, folder: Path) -> bytes:
    uri = buffer.pop("uri", "")
    if uri.startswith("data:"):
        return base64.b64decode(uri.partition(",")[2])
    return (folder / unquote(uri)).read_bytes()


def element_size(accessor: JsonObject) -> int:
    """Return the bytes of one element of an accessor, 0 where its type is none."""
    kind, code = accessor.get("type"), accessor.get("componentType")
    count = COMPONENT_COUNTS.get(kind, 0) if isinstance(kind, str) else 0
    return count * (COMPONENT_SIZES.get(code, 0) if isinstance(code, int) else 0)


def span(model: Model, accessor: JsonObject) -> tuple[int, int, int] | None:
    """Return where an accessor's data begin in the model's binary, their stride, and their count.

    None where the data are elsewhere, or are not all there.
    """
    try:
        view = model.json["bufferViews"][accessor["bufferView"]]
        size = element_size(accessor)
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        stride, count = view.get("byteStride", size), accessor["count"]
        inside = view.get("buffer") == 0 and start >= 0 and start + stride * (count - 1) + size
    except (KeyError, IndexError, TypeError, AttributeError):
        return None
    whole = all(type(number) is int for number in (start, stride, count)) and count > 0 and size > 0
    return (start, stride, count) if whole and 0 < inside <= len(model.binary) else None
