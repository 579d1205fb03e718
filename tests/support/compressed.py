"""Compressed twins of test models, made with the encoders themselves rather than by skinbake."""

from __future__ import annotations

import copy
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import DracoPy
import meshopt
import numpy as np
import pygltflib

from fixtures.builder import AnyArray, JsonObject, pack_glb
from tests.support.gltf_reading import DRACO, MESHOPT, GltfFile, read
from tests.support.models import Change, rewritten

EXT, KHR = MESHOPT


def draco_stream(
    arrays: dict[str, AnyArray], triangles: AnyArray, *, sequential: bool = True, bits: int = 0
) -> tuple[bytes, dict[str, int]]:
    """Encode attributes, POSITION among them, and return the stream and their unique ids."""
    others = [name for name in arrays if name != "POSITION"]
    data = DracoPy.encode(
        arrays["POSITION"],
        triangles.astype(np.uint32),
        quantization_bits=bits,
        preserve_order=sequential,
        generic_attributes={number: arrays[name] for number, name in enumerate(others)},
    )
    return data, {name: number for number, name in enumerate([*others, "POSITION"])}


def draco_twin(
    source: Path,
    target: Path,
    *,
    sequential: bool = True,
    bits: int = 0,
    meshes: Sequence[int] | None = None,
    change: Change | None = None,
) -> Path:
    """Write a model with the primitives of its meshes in Draco; their accessors lose their buffer views."""
    model = read(source)
    content = copy.deepcopy(model.content)
    data = bytearray(model.binary_chunk or b"")
    for number, mesh in enumerate(content["meshes"]):
        for position, primitive in enumerate(mesh["primitives"]):
            if meshes is not None and number not in meshes:
                continue
            arrays = {
                name: model.stored_attribute(name, number, position) for name in primitive["attributes"]
            }
            stream, ids = draco_stream(
                arrays, model.triangles(number, position), sequential=sequential, bits=bits
            )
            vertices = next(iter(DracoPy.decode(stream).attributes))["data"]
            for accessor in primitive["attributes"].values():
                _unbacked(content, accessor)["count"] = len(vertices)
            _unbacked(content, primitive["indices"])
            data += bytes(-len(data) % 4)
            content["bufferViews"].append({"buffer": 0, "byteOffset": len(data), "byteLength": len(stream)})
            data += stream
            view = len(content["bufferViews"]) - 1
            primitive["extensions"] = {DRACO: {"bufferView": view, "attributes": ids}}
    data += bytes(-len(data) % 4)
    content["buffers"][0]["byteLength"] = len(data)
    _name_extension(content, DRACO)
    if change is not None:
        change(content)
    target.write_bytes(pack_glb(content, bytes(data)))
    return target


def _unbacked(content: JsonObject, accessor: int) -> JsonObject:
    found: JsonObject = content["accessors"][accessor]
    for key in ("bufferView", "byteOffset"):
        found.pop(key, None)
    return found


def _name_extension(content: JsonObject, name: str, *, required: bool = True) -> None:
    for key in ("extensionsUsed", "extensionsRequired")[: 2 if required else 1]:
        content[key] = [*content.get(key, []), name]


def meshopt_twin(
    source: Path, target: Path, *, name: str = EXT, beside: bool = False, change: Change | None = None
) -> Path:
    """Write a model with every buffer view that an accessor uses compressed.

    beside keeps the plain data too, and does not require the extension; else the views lie in a fallback
    buffer that no bytes stand for.
    """
    model = read(source)
    content = copy.deepcopy(model.content)
    views = content["bufferViews"]
    data, hollow = bytearray(model.binary_chunk or b"") if beside else bytearray(), 0
    elements = {entry["bufferView"]: entry for entry in content["accessors"] if "bufferView" in entry}
    for number, view in enumerate(views):
        raw = model.buffer_view(number)
        packed = _packed(raw, elements.get(number), name) if number in elements else None
        if packed is None:
            if not beside:
                view |= {"buffer": 0, "byteOffset": len(data)}
                data += raw + bytes(-len(raw) % 4)
            continue
        stored, stream = packed
        if not beside:
            view |= {"buffer": 1, "byteOffset": hollow}
            hollow += len(raw) + -len(raw) % 4
        view["extensions"] = {
            name: {"buffer": 0, "byteOffset": len(data), "byteLength": len(stream), **stored}
        }
        data += stream + bytes(-len(stream) % 4)
    content["buffers"] = [{"byteLength": len(data)}]
    if not beside:
        content["buffers"].append({"byteLength": hollow, "extensions": {name: {"fallback": True}}})
    _name_extension(content, name, required=not beside)
    if change is not None:
        change(content)
    return rewritten(GltfFile(target, content, bytes(data)), target)


SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
BYTES = {
    pygltflib.UNSIGNED_BYTE: 1,
    pygltflib.UNSIGNED_SHORT: 2,
    pygltflib.UNSIGNED_INT: 4,
    pygltflib.FLOAT: 4,
}


def _packed(raw: bytes, accessor: JsonObject | None, name: str) -> tuple[JsonObject, bytes] | None:
    assert accessor is not None
    size = SIZES[accessor["type"]] * BYTES[accessor["componentType"]]
    rows = np.frombuffer(raw, np.uint8).reshape(-1, size)
    stored: dict[str, Any] = {"count": len(rows), "byteStride": size}
    if size % 4 == 0:
        stream = meshopt.encode_vertex_buffer_level(rows, 2, 0 if name == EXT else 1)
        return {**stored, "mode": "ATTRIBUTES"}, stream
    if size == 2:
        return {**stored, "mode": "INDICES"}, meshopt.encode_index_sequence(np.frombuffer(raw, np.uint16))
    return None


def content_of(path: Path) -> str:
    """Return a model's JSON as text, to compare."""
    return json.dumps(read(path).content)
