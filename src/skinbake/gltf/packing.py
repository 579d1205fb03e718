"""Bring the buffers and images of a GLB into its BIN chunk: embedded ones, and on request files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field

from skinbake.containment import is_relative
from skinbake.errors import InputError
from skinbake.gltf.codecs import meshopt
from skinbake.gltf.document import Document
from skinbake.gltf.glb import Bytes
from skinbake.gltf.json_access import JsonObject, integer
from skinbake.gltf.resources import decode_data_uri, is_data_uri, read_resource

MIME_TYPES = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg"}
"""The formats of images in glTF, by their first bytes."""


@dataclass(slots=True)
class _Chunk:
    """A BIN chunk that grows. Each addition starts at a multiple of 4 bytes."""

    pieces: list[Bytes]
    length: int = field(init=False)

    def __post_init__(self) -> None:
        self.length = sum(map(len, self.pieces))

    def add(self, data: Bytes) -> int:
        """Append data, and return its offset."""
        padding = -self.length % 4
        self.pieces += [bytes(padding), data]
        start = self.length + padding
        self.length = start + len(data)
        return start


def packed(document: Document, *, buffer_files: bool = False, image_files: bool = False) -> Document:
    """Return a GLB with the buffers and images of data: URIs in its BIN chunk, and on request those of files.

    Files are read within the bounds of the document. A buffer or image that cannot be read stays as it is,
    and so does an image of unknown format. A GLB without a BIN chunk is returned as it is.
    """
    if not document.has_binary_buffer:
        return document
    chunk = _Chunk(list(document.binary or ()))
    before = chunk.length
    root = {**document.json, **_with_buffers(document, chunk, files=buffer_files)}
    images, views = _with_images(document, chunk, len(root.get("bufferViews", ())), files=image_files)
    if chunk.length == before:
        return document
    if views:
        root |= {"images": images, "bufferViews": [*root.get("bufferViews", ()), *views]}
    root["buffers"] = [{**root["buffers"][0], "byteLength": chunk.length}, *root["buffers"][1:]]
    padding = bytes(-chunk.length % 4)
    return document.edited(json=root, binary=(*chunk.pieces, padding) if padding else tuple(chunk.pieces))


def _is_wanted(uri: object, *, files: bool) -> bool:
    return isinstance(uri, str) and (is_data_uri(uri) or (files and is_relative(uri)))


def _with_buffers(document: Document, chunk: _Chunk, *, files: bool) -> JsonObject:
    """Move buffers into the chunk, and return the members that change."""
    buffers, moved = document.objects("buffers"), {0: 0}
    for number, buffer in enumerate(buffers):
        if _is_wanted(buffer.get("uri"), files=files) and not meshopt.is_fallback(buffer, document.place):
            with suppress(InputError):
                moved[number] = chunk.add(document.buffer(number))
    if len(moved) == 1:
        return {"buffers": buffers}
    kept = [number for number in range(len(buffers)) if number == 0 or number not in moved]
    places = {number: (position, 0) for position, number in enumerate(kept)}
    places |= {number: (0, start) for number, start in moved.items()}
    views = [_moved_view(view, places, document) for view in document.objects("bufferViews")]
    return {"buffers": [buffers[number] for number in kept], "bufferViews": views}


def _moved_view(view: JsonObject, places: dict[int, tuple[int, int]], document: Document) -> JsonObject:
    """Return a buffer view, and its compressed twin, with the new places of their buffers."""
    changed = _moved(view, places, document)
    name = meshopt.extension_of(view, document.place)
    if name is not None:
        extensions = view["extensions"]
        changed["extensions"] = {**extensions, name: _moved(extensions[name], places, document)}
    return changed


def _moved(holder: JsonObject, places: dict[int, tuple[int, int]], document: Document) -> JsonObject:
    number = integer(holder, "buffer", document.place)
    if number not in places:
        raise InputError(f"a buffer view names buffer {number}, and there is none", document.place)
    position, start = places[number]
    offset = integer(holder, "byteOffset", document.place, default=0) + start
    return {**holder, "buffer": position, **({"byteOffset": offset} if start else {})}


def _with_images(
    document: Document, chunk: _Chunk, views: int, *, files: bool
) -> tuple[list[JsonObject], list[JsonObject]]:
    """Move images into the chunk, and return all images and the new buffer views."""
    images: list[JsonObject] = []
    added: list[JsonObject] = []
    for image, kind, data in _image_data(document, files=files):
        if kind is None:
            images.append(image)
            continue
        added.append({"buffer": 0, "byteOffset": chunk.add(data), "byteLength": len(data)})
        kept = {key: value for key, value in image.items() if key != "uri"}
        images.append({**kept, "bufferView": views + len(added) - 1, "mimeType": kind})
    return images, added


def _image_data(document: Document, *, files: bool) -> Iterator[tuple[JsonObject, str | None, bytes]]:
    """Yield each image with its MIME type and its bytes; the type is None if it stays as it is."""
    for image in document.objects("images"):
        uri, kind, data = image.get("uri"), None, b""
        if isinstance(uri, str) and _is_wanted(uri, files=files):
            with suppress(InputError):
                data = _bytes_at(uri, document)
                document.budget.claim(2 * len(data), "holding its images", document.place)
                kind = _mime_type(image, uri, data) if data else None
        yield image, kind, data


def _bytes_at(uri: str, document: Document) -> bytes:
    if is_data_uri(uri):
        return decode_data_uri(uri, document.place)
    return bytes(read_resource(uri, document.folder, document.bounds, document.place))


def _mime_type(image: JsonObject, uri: str, data: bytes) -> str | None:
    """Return the MIME type by the bytes, else as the URI or the image tells."""
    found = next((kind for head, kind in MIME_TYPES.items() if data.startswith(head)), None)
    declared = uri[len("data:") :].partition(",")[0].partition(";")[0] if is_data_uri(uri) else ""
    told = image.get("mimeType")
    return found or (declared if declared.startswith("image/") else told if isinstance(told, str) else None)
