"""Read glTF files by another route than skinbake's own, so that tests compare two readers.

After the glTF 2.0 specification, §3.6 (buffers, accessors) and §4.4 (GLB). Only pygltflib's constants are
used: its loader crashes on ``extras`` that are not objects and loses keys.
"""

from __future__ import annotations

import base64
import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
import numpy.typing as npt
import pygltflib

AnyArray = npt.NDArray[Any]
JsonObject = dict[str, Any]

DTYPES: dict[int, np.dtype[Any]] = {
    pygltflib.BYTE: np.dtype("<i1"),
    pygltflib.UNSIGNED_BYTE: np.dtype("<u1"),
    pygltflib.SHORT: np.dtype("<i2"),
    pygltflib.UNSIGNED_SHORT: np.dtype("<u2"),
    pygltflib.UNSIGNED_INT: np.dtype("<u4"),
    pygltflib.FLOAT: np.dtype("<f4"),
}
# type: (columns, rows of one column)
SHAPES: dict[str, tuple[int, int]] = {
    pygltflib.SCALAR: (1, 1),
    pygltflib.VEC2: (1, 2),
    pygltflib.VEC3: (1, 3),
    pygltflib.VEC4: (1, 4),
    pygltflib.MAT2: (2, 2),
    pygltflib.MAT3: (3, 3),
    pygltflib.MAT4: (4, 4),
}
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
DRACO = "KHR_draco_mesh_compression"


@dataclass(frozen=True)
class GltfFile:
    """One glTF file: its JSON as parsed, and the bytes of its buffers on request."""

    path: Path
    content: JsonObject
    binary_chunk: bytes | None

    def buffer(self, index: int) -> bytes:
        """Return the whole buffer, be it the GLB's chunk, a data URI or a file beside this one."""
        uri = self.content["buffers"][index].get("uri")
        if uri is None:
            if index != 0 or self.binary_chunk is None:
                raise ValueError(f"{self.path}: buffer {index} has no data")
            return self.binary_chunk
        if uri.startswith("data:"):
            head, payload = uri.split(",", 1)
            raw = unquote_to_bytes(payload)
            return base64.b64decode(raw) if head.endswith(";base64") else raw
        return (self.path.parent / unquote(uri)).read_bytes()

    def buffer_view(self, index: int) -> bytes:
        """Return the bytes of one buffer view. Raises ValueError where they are meshopt-compressed."""
        view = self.content["bufferViews"][index]
        if any(name in view.get("extensions", {}) for name in MESHOPT):
            raise ValueError(f"{self.path}: bufferView {index} is meshopt-compressed")
        start = view.get("byteOffset", 0)
        data = self.buffer(view["buffer"])[start : start + view["byteLength"]]
        if len(data) != view["byteLength"]:
            raise ValueError(f"{self.path}: bufferView {index} leaves its buffer")
        return data

    def stored(self, accessor: int) -> AnyArray:
        """Return the components of an accessor as stored, sparse ones applied.

        Shape (count, components), a matrix column by column; dtype that of the component type.
        """
        description = self.content["accessors"][accessor]
        columns, rows = SHAPES[description["type"]]
        dtype = DTYPES[description["componentType"]]
        count = description["count"]
        if "bufferView" in description:
            elements = self._elements(
                description["bufferView"], description.get("byteOffset", 0), count, dtype, (columns, rows)
            )
        else:
            elements = np.zeros((count, columns * rows), dtype)
        if "sparse" in description:
            sparse = description["sparse"]
            where, what = sparse["indices"], sparse["values"]
            places = self._elements(
                where["bufferView"],
                where.get("byteOffset", 0),
                sparse["count"],
                DTYPES[where["componentType"]],
                (1, 1),
            )
            elements[places[:, 0]] = self._elements(
                what["bufferView"], what.get("byteOffset", 0), sparse["count"], dtype, (columns, rows)
            )
        return elements

    def values(self, accessor: int) -> npt.NDArray[np.float64]:
        """Return what an accessor means: (count, components) float64, normalised integers decoded."""
        stored = self.stored(accessor)
        decoded = stored.astype(np.float64)
        if self.content["accessors"][accessor].get("normalized", False):
            decoded /= np.iinfo(stored.dtype).max
            # The most negative integer means −1 too (specification, §3.6.2.2).
            np.maximum(decoded, -1.0, out=decoded)
        return decoded

    def matrices(self, accessor: int) -> npt.NDArray[np.float64]:
        """Return the matrices of a MAT accessor: (count, n, n) float64, indexed [row, column]."""
        order, _ = SHAPES[self.content["accessors"][accessor]["type"]]
        return self.values(accessor).reshape(-1, order, order).transpose(0, 2, 1)

    def primitive(self, mesh: int, primitive: int = 0) -> JsonObject:
        """Return the JSON of one primitive."""
        found: JsonObject = self.content["meshes"][mesh]["primitives"][primitive]
        return found

    def has_attribute(self, name: str, mesh: int = 0, primitive: int = 0) -> bool:
        """Say whether the primitive has this attribute."""
        return name in self.primitive(mesh, primitive)["attributes"]

    def attribute(self, name: str, mesh: int = 0, primitive: int = 0) -> npt.NDArray[np.float64]:
        """Return what one attribute means: (V, components) float64. Raises KeyError where there is none."""
        return self.values(self._attribute_accessor(name, mesh, primitive))

    def stored_attribute(self, name: str, mesh: int = 0, primitive: int = 0) -> AnyArray:
        """Return one attribute as stored: (V, components). Raises KeyError where there is none."""
        return self.stored(self._attribute_accessor(name, mesh, primitive))

    def influences(self, mesh: int = 0, primitive: int = 0) -> tuple[AnyArray, npt.NDArray[np.float64]]:
        """Return joints (V, K) as stored and weights (V, K) float64 of every JOINTS_n / WEIGHTS_n set."""
        sets = 0
        while self.has_attribute(f"JOINTS_{sets}", mesh, primitive):
            sets += 1
        joints = [self.stored_attribute(f"JOINTS_{n}", mesh, primitive) for n in range(sets)]
        weights = [self.attribute(f"WEIGHTS_{n}", mesh, primitive) for n in range(sets)]
        return np.concatenate(joints, axis=1), np.concatenate(weights, axis=1)

    def triangles(self, mesh: int = 0, primitive: int = 0) -> npt.NDArray[np.int64]:
        """Return the triangles (T, 3) int64; strips and fans unrolled (specification, §3.7.2.1).

        Raises ValueError for points and lines.
        """
        description = self.primitive(mesh, primitive)
        self._refuse_draco(description)
        if "indices" in description:
            corners = self.stored(description["indices"])[:, 0].astype(np.int64)
        else:
            accessor = description["attributes"]["POSITION"]
            corners = np.arange(self.content["accessors"][accessor]["count"])
        mode = description.get("mode", pygltflib.TRIANGLES)
        if mode == pygltflib.TRIANGLES:
            return corners[: len(corners) // 3 * 3].reshape(-1, 3)
        first = range(len(corners) - 2)
        if mode == pygltflib.TRIANGLE_STRIP:
            places = [(i, i + 1 + i % 2, i + 2 - i % 2) for i in first]
        elif mode == pygltflib.TRIANGLE_FAN:
            places = [(i + 1, i + 2, 0) for i in first]
        else:
            raise ValueError(f"{self.path}: mode {mode} has no triangles")
        return corners[np.array(places, np.int64).reshape(-1, 3)]

    def _attribute_accessor(self, name: str, mesh: int, primitive: int) -> int:
        description = self.primitive(mesh, primitive)
        self._refuse_draco(description)
        accessor: int = description["attributes"][name]
        return accessor

    def _refuse_draco(self, primitive: JsonObject) -> None:
        if DRACO in primitive.get("extensions", {}):
            raise ValueError(f"{self.path}: a primitive is Draco-compressed")

    def _elements(
        self, view: int, offset: int, count: int, dtype: np.dtype[Any], shape: tuple[int, int]
    ) -> AnyArray:
        columns, rows = shape
        # Each column of a matrix starts at a multiple of four bytes (specification, §3.6.2.4).
        column_stride = -(-rows * dtype.itemsize // 4) * 4 if columns > 1 else rows * dtype.itemsize
        stride = self.content["bufferViews"][view].get("byteStride", columns * column_stride)
        strided = np.ndarray(
            (count, columns, rows),
            dtype,
            self.buffer_view(view),
            offset,
            (stride, column_stride, dtype.itemsize),
        )
        return strided.reshape(count, columns * rows).copy()


def read(path: Path) -> GltfFile:
    """Read a .gltf, .glb or .vrm file; GLB is recognised by its magic.

    Raises ValueError where the file is neither.
    """
    data = path.read_bytes()
    if not data.startswith(b"glTF"):
        return GltfFile(path, json.loads(data), None)
    chunks = dict(_chunks(data))
    if b"JSON" not in chunks:
        raise ValueError(f"{path}: the GLB has no JSON chunk")
    return GltfFile(path, json.loads(chunks[b"JSON"]), chunks.get(b"BIN\0"))


def _chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    _, version, length = struct.unpack_from("<4sII", data)
    if version != 2 or length > len(data):
        raise ValueError(f"GLB version {version}, {length} bytes declared, {len(data)} present")
    found = []
    at = 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<I4s", data, at)
        found.append((kind, data[at + 8 : at + 8 + size]))
        at += 8 + size
    return found
