"""New accessors at the end of a document: what was there keeps its index, its bytes and its place."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from skinbake.gltf import resources
from skinbake.gltf.document import Document
from skinbake.gltf.formats import COMPONENT_CODES, TYPES
from skinbake.gltf.glb import Bytes
from skinbake.gltf.json_access import JsonObject, integer

ARRAY_BUFFER = 34962

KEY = "skinbake"
"""The key in ``extras`` under which everything that skinbake notes in a file stands."""

BUFFER_LENGTH = "bufferByteLength"
BUFFER_ADDED = "bufferAdded"


class Additions:
    """Collects vertex attributes and appends them to a document in one go.

    Every attribute gets an accessor and a buffer view of its own, 4-byte aligned; equal arrays share one.
    The bytes go to the end of a GLB's BIN chunk, or into a new buffer: a file named after its content
    beside a ``.gltf``, a data: URI in a GLB whose buffers are elsewhere.
    """

    def __init__(self, document: Document) -> None:
        self._document = document
        self._accessors: list[JsonObject] = []
        self._views: list[JsonObject] = []
        self._pieces: list[Bytes] = []
        self._length = 0
        self._shared: dict[tuple[str, int, bytes], int] = {}
        buffers = document.objects("buffers")
        self._into_binary = document.has_binary_buffer
        self._base = sum(len(piece) for piece in document.binary or ()) if self._into_binary else 0
        self._buffer = 0 if self._into_binary else len(buffers)

    @property
    def byte_length(self) -> int:
        """Return how many bytes have been added."""
        return self._length

    def add(
        self, values: npt.NDArray[Any], *, normalized: bool = False, extras: JsonObject | None = None
    ) -> int:
        """Add an attribute (V, components) and return its accessor's index.

        values has one of glTF's component types; elements must be multiples of 4 bytes long. With
        ``extras`` the accessor is its own and carries them.
        """
        data = np.ascontiguousarray(values)
        key = (data.dtype.str + str(normalized), data.shape[1], hashlib.sha256(data.data).digest())
        if extras is None and key in self._shared:
            return self._shared[key]
        number = len(self._document.objects("accessors")) + len(self._accessors)
        self._accessors.append(
            {
                "bufferView": self._add_view(data.data.cast("B")),
                "componentType": COMPONENT_CODES[data.dtype],
                "count": len(data),
                "type": TYPES[data.shape[1]],
                **({"normalized": True} if normalized else {}),
                **({"extras": extras} if extras else {}),
            }
        )
        if extras is None:
            self._shared[key] = number
        return number

    def _add_view(self, data: memoryview) -> int:
        view: JsonObject = {
            "buffer": self._buffer,
            "byteOffset": self._base + self._length,
            "byteLength": len(data),
            "target": ARRAY_BUFFER,
        }
        if not self._views:
            view["extras"] = {KEY: self._undo_note()}
        self._views.append(view)
        self._pieces.append(data)
        self._length += len(data)
        return len(self._document.objects("bufferViews")) + len(self._views) - 1

    def _undo_note(self) -> JsonObject:
        """Return what strip needs to know of the buffer as it was."""
        if not self._into_binary:
            return {BUFFER_ADDED: True}
        buffer = self._document.objects("buffers")[0]
        return {BUFFER_LENGTH: integer(buffer, "byteLength", self._document.place)}

    def applied(self, changes: Mapping[str, Any]) -> Document:
        """Return the document with the additions, and with top-level ``changes`` in its JSON."""
        root = {**self._document.json, **changes}
        root["accessors"] = [*self._document.objects("accessors"), *self._accessors]
        root["bufferViews"] = [*self._document.objects("bufferViews"), *self._views]
        buffers = list(self._document.objects("buffers"))
        if self._into_binary:
            buffers[0] = {**buffers[0], "byteLength": self._base + self._length}
            root["buffers"] = buffers
            return self._document.edited(json=root, binary=(*(self._document.binary or ()), *self._pieces))
        uri, new_files = self._stored_pieces()
        root["buffers"] = [*buffers, {"uri": uri, "byteLength": self._length}]
        return self._document.edited(json=root, new_files={**self._document.new_files, **new_files})

    def _stored_pieces(self) -> tuple[str, dict[str, tuple[Bytes, ...]]]:
        if self._document.is_glb:
            return resources.encode_data_uri(b"".join(self._pieces)), {}
        name = f"skinbake-{content_digest(self._pieces)}.bin"
        return name, {name: tuple(self._pieces)}


def content_digest(pieces: list[Bytes] | tuple[Bytes, ...]) -> str:
    """Return 16 hexadecimal digits that name some bytes by their content."""
    digest = hashlib.sha256()
    for piece in pieces:
        digest.update(piece)
    return digest.hexdigest()[:16]
