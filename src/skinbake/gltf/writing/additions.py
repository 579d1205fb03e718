"""New accessors at the end of a document: old ones keep their index, their bytes and their place."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Container, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from skinbake.files import Bytes
from skinbake.gltf import resources
from skinbake.gltf.asset import COMPONENT_CODES, COMPONENTS, TYPES
from skinbake.gltf.codecs import meshopt
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject, integer
from skinbake.gltf.writing.references import check_views, refuse_dangling

ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963

BUFFER_LENGTH = "bufferByteLength"
BUFFER_ADDED = "bufferAdded"
FALLBACK_ADDED = "fallbackAdded"


class Packed(NamedTuple):
    """The compression of views by the meshopt extension ``name``, at a level of 0 … 3.

    beside: the plain data is stored too, for loaders without the extension. Otherwise the view is in a
    fallback buffer without bytes, and the extension is required.
    """

    name: str
    level: int
    beside: bool


class Additions:
    """Collect vertex attributes and other data, and append them to a document at once.

    Every attribute has its own accessor and buffer view, 4-byte aligned. Equal arrays share the bytes, and
    those of different primitives the accessor too. The bytes go to the end of the BIN chunk of a GLB, or into
    a new buffer. The new buffer is a file beside a ``.gltf``, named after its content. It is a data: URI in a
    GLB whose buffers are elsewhere, and in a ``.gltf`` whose buffers are all data: URIs, which so stays one
    file. Fallback buffers of compressed views come after it. If ``note_key`` is given, the first view gets a
    note of the former buffer in its ``extras``, under that key. With it the additions can be removed again.
    """

    def __init__(self, document: Document, *, note_key: str | None = None) -> None:
        self._document, self._note_key = document, note_key
        self._accessors: list[JsonObject] = []
        self._views: list[JsonObject] = []
        self._pieces: list[Bytes] = []
        self._length = 0
        self._fallback_length = 0
        self._fallback_name = ""
        self._shared: dict[tuple[Any, ...], list[int]] = {}
        self._streams: dict[bytes, int] = {}
        self._described: dict[str, int] = {}
        buffers = document.objects("buffers")
        self._into_binary = document.has_binary_buffer
        self._base = sum(len(piece) for piece in document.binary or ()) if self._into_binary else 0
        self._buffer = 0 if self._into_binary else len(buffers)
        self._fallback = len(buffers) if self._into_binary else len(buffers) + 1

    @property
    def byte_length(self) -> int:
        """Return the number of added bytes."""
        return self._length

    def add(
        self,
        values: npt.NDArray[Any],
        *,
        normalized: bool = False,
        extras: JsonObject | None = None,
        packed: Packed | None = None,
        apart_from: Container[int] = (),
    ) -> int:
        """Add an attribute (V, components) and return the index of its accessor.

        values has one of the component types of glTF. The size of an element must be a multiple of 4 bytes.
        With ``extras`` the accessor is not shared, and has these extras. It is none of ``apart_from``: some
        loaders (panda3d-gltf 1.3) read no primitive with two attributes in one accessor, or in one view.
        """
        data = np.ascontiguousarray(values)
        key = data.dtype.str, data.shape, normalized, packed, hashlib.sha256(data.data).digest()
        equal = [] if extras is not None else self._shared.setdefault(key, [])
        for number in equal:
            if number not in apart_from:
                return number
        if equal:  # a view of the same bytes
            accessor = self._accessors[equal[-1] - len(self._document.objects("accessors"))]
            same = self._views[accessor["bufferView"] - len(self._document.objects("bufferViews"))]
            view = self._add_view({key: value for key, value in same.items() if key != "extras"})
        else:
            view = self._add_attribute(data, packed)
        equal.append(self.add_accessor({"bufferView": view}, data, normalized, extras))
        return equal[-1]

    def add_stream(self, data: bytes) -> int:
        """Add bytes that are not a vertex attribute, such as a Draco stream or the keys of a clip.

        Return the index of their buffer view. Equal bytes share one.
        """
        key = hashlib.sha256(data).digest()
        if key not in self._streams:
            self._streams[key] = self._add_view(self.add_data(data))
        return self._streams[key]

    def add_accessor(
        self, where: JsonObject, values: npt.NDArray[Any], normalized: bool, extras: JsonObject | None
    ) -> int:
        """Add the accessor of an attribute (V, components) and return its index.

        ``where`` are the members that tell where its data is: none if it is in a Draco stream.
        """
        self._accessors.append(
            {
                **where,
                "componentType": COMPONENT_CODES[values.dtype],
                "count": len(values),
                "type": TYPES[values.shape[1]],
                **({"normalized": True} if normalized else {}),
                **({"extras": extras} if extras else {}),
            }
        )
        return len(self._document.objects("accessors")) + len(self._accessors) - 1

    def add_described(self, accessor: JsonObject) -> int:
        """Add an accessor that is described in full, and return its index. Equal ones are one."""
        key = json.dumps(accessor, sort_keys=True)
        if key not in self._described:
            self._accessors.append(accessor)
            self._described[key] = len(self._document.objects("accessors")) + len(self._accessors) - 1
        return self._described[key]

    def add_floats(self, values: npt.NDArray[Any], kind: str = "SCALAR", **members: Any) -> int:
        """Add the accessor of the times or the values of a clip's sampler, and return its index.

        values are numbers in the order of the file, as many as elements of the type ``kind`` take.
        """
        view = self.add_stream(np.ascontiguousarray(values, dtype="<f4").tobytes())
        count = values.size // COMPONENTS[kind]
        described = {"bufferView": view, "componentType": 5126, "count": count, "type": kind}
        return self.add_described({**described, **members})

    def add_data(self, data: Bytes) -> JsonObject:
        """Add bytes, padded for the next ones, and return the members of a buffer view of them."""
        offset = self._base + self._length
        padding = bytes(-len(data) % 4)
        self._pieces += [data, padding] if padding else [data]
        self._length += len(data) + len(padding)
        return {"buffer": self._buffer, "byteOffset": offset, "byteLength": len(data)}

    def add_values(self, values: npt.NDArray[Any], packed: Packed | None, *, indices: bool = False) -> int:
        """Add the buffer view of a whole accessor (count, components) and return its index.

        Elements of vertex attributes are padded to a multiple of 4 bytes, as glTF requires.
        """
        if indices:
            data = np.ascontiguousarray(values)
            target: JsonObject = {"target": ELEMENT_ARRAY_BUFFER}
            if packed is None:
                return self._add_view({**self.add_data(data.data.cast("B")), **target})
            return self._add_packed(data, packed, target)
        rows = np.ascontiguousarray(values).view(np.uint8).reshape(len(values), -1)
        if rows.shape[1] % 4 == 0:
            return self._add_attribute(np.ascontiguousarray(values), packed)
        padded = np.pad(rows, ((0, 0), (0, -rows.shape[1] % 4)))
        if packed is not None:
            return self._add_attribute(padded, packed)
        stride = {"byteStride": padded.shape[1], "target": ARRAY_BUFFER}
        return self._add_view({**self.add_data(padded.data.cast("B")), **stride})

    def _add_attribute(self, values: npt.NDArray[Any], packed: Packed | None) -> int:
        target: JsonObject = {"target": ARRAY_BUFFER}
        if packed is None:
            return self._add_view({**self.add_data(values.data.cast("B")), **target})
        return self._add_packed(
            values, packed, {"byteStride": values.dtype.itemsize * values.shape[1], **target}
        )

    def _add_packed(self, values: npt.NDArray[Any], packed: Packed, members: JsonObject) -> int:
        """Add a compressed view; ``members`` are its other members, for attributes with byteStride."""
        data = values.data.cast("B")
        if packed.beside:
            place = self.add_data(data)
        else:
            place = {"buffer": self._fallback, "byteOffset": self._fallback_length, "byteLength": len(data)}
            self._fallback_name = packed.name
            self._fallback_length += len(data) + -len(data) % 4
        kind = meshopt.ATTRIBUTES if "byteStride" in members else meshopt.TRIANGLES
        compressed, mode = meshopt.encoded(values, kind, packed.name, packed.level)
        stored = {
            **self.add_data(compressed),
            "byteStride": values.dtype.itemsize * values.shape[1],
            "mode": mode,
            "count": len(values),
        }
        return self._add_view({**place, **members, "extensions": {packed.name: stored}})

    def _add_view(self, view: JsonObject) -> int:
        if not self._views and self._note_key is not None:
            is_longer = self._into_binary
            former = {BUFFER_LENGTH: self._former_length()} if is_longer else {BUFFER_ADDED: True}
            view["extras"] = {self._note_key: former}
        self._views.append(view)
        return len(self._document.objects("bufferViews")) + len(self._views) - 1

    def _former_length(self) -> int:
        """Return what the document says of the length of buffer 0: the chunk may have padding behind it."""
        buffer = self._document.objects("buffers")[0]
        return integer(buffer, "byteLength", self._document.place)

    def applied(self, changes: Mapping[str, Any]) -> Document:
        """Return the document with the additions, and with top-level ``changes`` in its JSON.

        Raises InputError if an addition would become the target of a broken reference, or if a buffer view is
        not valid: ``strip`` could not remove the additions again.
        """
        former = min(self._base, self._former_length()) if self._into_binary else None
        check_views(self._document.objects("bufferViews"), former, self._document.place)
        root = {**self._document.json, **changes}
        for key, added in (("accessors", self._accessors), ("bufferViews", self._views)):
            if added:
                refuse_dangling(self._document.json, key, len(added), self._document.place)
                root[key] = [*root.get(key, []), *added]
        buffers = list(self._document.objects("buffers"))
        fallback: list[JsonObject] = []
        if self._fallback_length:
            if self._note_key is not None:
                self._views[0]["extras"][self._note_key][FALLBACK_ADDED] = True
            extensions = {self._fallback_name: {"fallback": True}}
            fallback = [{"byteLength": self._fallback_length, "extensions": extensions}]
        if self._into_binary:
            buffers[0] = {**buffers[0], "byteLength": self._base + self._length}
            root["buffers"] = [*buffers, *fallback]
            return self._document.edited(json=root, binary=(*(self._document.binary or ()), *self._pieces))
        refuse_dangling(self._document.json, "buffers", 1 + len(fallback), self._document.place)
        # A file, or a data: URI where the other buffers are such ones, or are elsewhere.
        uris = [buffer["uri"] for buffer in self._document.objects("buffers") if "uri" in buffer]
        is_embedded = bool(uris) and all(isinstance(uri, str) and resources.is_data_uri(uri) for uri in uris)
        new_files: dict[str, tuple[Bytes, ...]] = {}
        if self._document.is_glb or is_embedded:
            uri = resources.encode_data_uri(b"".join(self._pieces))
        else:
            uri = f"skinbake-{content_digest(self._pieces)}.bin"
            new_files = {uri: tuple(self._pieces)}
        root["buffers"] = [*buffers, {"uri": uri, "byteLength": self._length}, *fallback]
        return self._document.edited(json=root, new_files={**self._document.new_files, **new_files})


def content_digest(pieces: Iterable[Bytes]) -> str:
    """Return 16 hexadecimal digits that name bytes by their content."""
    from skinbake.files.versions import digest_of  # verify reads notes, and writes nothing

    return digest_of(pieces)[:16]
