"""Bring the buffers and images of a GLB into its BIN chunk: embedded ones, and on request files."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple, TypeGuard

from skinbake.errors import BudgetError, InputError, Notice
from skinbake.files import Bytes
from skinbake.files.bounds import OutsideError, RefusedError, is_relative
from skinbake.gltf.budget import Work
from skinbake.gltf.codecs import meshopt
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject, integer, member, reference
from skinbake.gltf.reading.materials import texture_image
from skinbake.gltf.resources import (
    decode_data_uri,
    find,
    is_data_uri,
    listed,
    read_open_file,
    read_resource,
    shortened,
)
from skinbake.wording import one_or_many

MIME_TYPES = {
    b"\x89PNG": "image/png",
    b"\xff\xd8\xff": "image/jpeg",
    b"\xabKTX 20\xbb": "image/ktx2",
}
"""The formats of images in glTF, by their first bytes. WebP has its length in between."""


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
        self.pieces += [bytes(padding), data] if padding else [data]
        start = self.length + padding
        self.length = start + len(data)
        return start


What = Literal["buffer", "image"]
Kind = Literal["outside", "refused", "unreadable", "unknown", "broken"]

FATES: dict[Kind, str] = {
    "outside": ". It is not copied either, and the output refers to the same place",
    "refused": ". Its URI stays as it is",
    "unreadable": ". It cannot be copied either",
    "unknown": "",
    "broken": "",
}
"""What becomes of a file that stays outside if the output is in another folder. Most are copied."""

CODES: dict[What, str] = {"buffer": "buffer-not-packed", "image": "image-not-packed"}
"""The code of the notice on files that stay outside."""


class _Left(NamedTuple):
    """A buffer or an image that stays a file, and why. All of one kind share a notice."""

    uri: str
    kind: Kind
    why: str
    what: What


class _StaysError(Exception):
    """An image cannot be packed. The text says why."""

    def __init__(self, kind: Kind, why: str) -> None:
        super().__init__(why)
        self.kind = kind


def packed(document: Document, *, buffer_files: bool = False) -> Document:
    """Return a GLB with the buffers and images of data: URIs in its BIN chunk, and on request buffer files.

    Files are read within the bounds of the document. A buffer or image that cannot be read stays as it is,
    and so does an image of unknown format. A GLB without a BIN chunk is returned as it is.
    """
    if not document.has_binary_buffer:
        return document
    return _with_all(document, buffer_files=buffer_files, image_files=False)[0]


def packed_with_files(document: Document, *, moves: bool) -> Document:
    """Return a GLB with all buffers and images in its BIN chunk; tell of those that stay outside.

    It gets a BIN chunk if it has none and needs one. The bytes of images are not changed. An image stays
    outside if it may not be read, is missing, or has an unknown format. A buffer stays outside if it is
    missing or too short. If the document ``moves`` to another folder, the notices say what becomes of these
    files there. Raises InputError for images that take more memory than the budget of the document.
    """
    prepared = document
    if not document.has_binary_buffer:  # it gets a new first buffer: its chunk, empty or an unused one
        buffers = document.objects("buffers")
        places = {number: (number + 1, 0) for number in range(len(buffers))}
        views = [_moved_view(view, places, document) for view in document.objects("bufferViews")]
        chunk = document.binary or ()
        root = {**document.json, "buffers": [{"byteLength": sum(map(len, chunk))}, *buffers]}
        prepared = document.edited(json=root | ({"bufferViews": views} if views else {}), binary=chunk)
    inside, left = _with_all(prepared, buffer_files=True, image_files=True)
    if inside is prepared:
        inside = document
    if moves and left:
        inside = replace(inside, told=frozenset(file.uri for file in left))
    kinds = dict.fromkeys((file.what, file.kind) for file in left)
    for alike in kinds:
        files = [file for file in left if (file.what, file.kind) == alike]
        uri, kind, why, what = files[0]
        others = list(dict.fromkeys(file.uri for file in files if file.uri != uri))
        also = f". The others are {listed(others)}" if others else ""
        stay = one_or_many(len(files), f"1 {what} stays a file", f"{{}} {what}s stay files")
        message = f'{stay}: "{shortened(uri)}" {why}{FATES[kind] if moves else ""}{also}'
        document.notices.tell(Notice(CODES[what], message, document.place, len(files)))
    return inside


def _with_all(document: Document, *, buffer_files: bool, image_files: bool) -> tuple[Document, list[_Left]]:
    """Return the document with its data in the chunk, and the buffers and images that stay files."""
    chunk = _Chunk(list(document.binary or ()))
    before = chunk.length
    changed, left = _with_buffers(document, chunk, files=buffer_files)
    root = {**document.json, **changed}
    images, views, loose = _with_images(document, chunk, len(root.get("bufferViews", ())), files=image_files)
    left += loose
    if chunk.length == before:
        return document, left
    if views:
        root |= {"images": images, "bufferViews": [*root.get("bufferViews", ()), *views]}
    root["buffers"] = [{**root["buffers"][0], "byteLength": chunk.length}, *root["buffers"][1:]]
    padding = bytes(-chunk.length % 4)
    pieces = (*chunk.pieces, padding) if padding else tuple(chunk.pieces)
    return document.edited(json=root, binary=pieces), left


def _is_wanted(uri: object, *, files: bool) -> TypeGuard[str]:
    return isinstance(uri, str) and (is_data_uri(uri) or (files and is_relative(uri)))


def _with_buffers(document: Document, chunk: _Chunk, *, files: bool) -> tuple[JsonObject, list[_Left]]:
    """Move buffers into the chunk. Return the members that change, and the buffers that stay files."""
    buffers, moved, left = document.objects("buffers"), {0: 0}, list[_Left]()
    for number, buffer in enumerate(buffers):
        uri = buffer.get("uri")
        if not _is_wanted(uri, files=files) or meshopt.is_fallback(buffer, document.place):
            continue
        try:
            moved[number] = chunk.add(document.buffer(number))
        except BudgetError:
            raise
        except InputError as error:  # a buffer that cannot be read stays where it is
            kind: Kind = "broken"
            why, cause = f"is not packed: {error.message}", error.__cause__
            if isinstance(cause, OSError):  # pragma: no branch: tests/gltf/test_packing.py
                kind, why = "unreadable", f"cannot be read: {cause.strerror}"
            if not is_data_uri(uri):
                left.append(_Left(uri, kind, why, "buffer"))
    if len(moved) == 1:
        return {"buffers": buffers}, left
    kept = [number for number in range(len(buffers)) if number == 0 or number not in moved]
    places = {number: (position, 0) for position, number in enumerate(kept)}
    places |= {number: (0, start) for number, start in moved.items()}
    views = [_moved_view(view, places, document) for view in document.objects("bufferViews")]
    return {"buffers": [buffers[number] for number in kept], "bufferViews": views}, left


def _moved_view(view: JsonObject, places: dict[int, tuple[int, int]], document: Document) -> JsonObject:
    """Return a buffer view, and its compressed twins, with the new places of their buffers."""
    changed = _moved(view, places, document)
    for name in meshopt.extensions_of(view, document.place):
        moved = _moved(member(view["extensions"], name, document.place), places, document)
        changed["extensions"] = {**changed["extensions"], name: moved}
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
) -> tuple[list[JsonObject], list[JsonObject], list[_Left]]:
    """Move images into the chunk. Return all images, the new buffer views, and the images that stay files.

    Images of the same URI share its buffer view.
    """
    images: list[JsonObject] = []
    added: list[JsonObject] = []
    left: list[_Left] = []
    known: dict[str, tuple[int, str]] = {}
    for image in document.objects("images"):
        uri = image.get("uri")
        if not _is_wanted(uri, files=files):
            images.append(image)
            if files and isinstance(uri, str):
                left.append(_Left(uri, "refused", "is not a relative path", "image"))
            continue
        if uri not in known:
            try:
                data = _bytes_at(uri, document)
                # The MIME type by the bytes, else as the URI or the image tells.
                found = _mime_type(bytes(data[:12]))
                declared = uri[len("data:") :].partition(",")[0].partition(";")[0] if is_data_uri(uri) else ""
                told = image.get("mimeType")
                kind = found or (declared if declared.startswith("image/") else told)
                if not data or not isinstance(kind, str):
                    raise _StaysError("unknown", "is in an unknown format" if data else "is empty")
            except _StaysError as reason:
                images.append(image)
                if not is_data_uri(uri):
                    left.append(_Left(uri, reason.kind, str(reason), "image"))
                continue
            added.append({"buffer": 0, "byteOffset": chunk.add(data), "byteLength": len(data)})
            known[uri] = views + len(added) - 1, kind
        kept = {key: value for key, value in image.items() if key != "uri"}
        number, kind = known[uri]
        images.append({**kept, "bufferView": number, "mimeType": kind})
    return images, added, left


def _bytes_at(uri: str, document: Document) -> Bytes:
    """Return the bytes of an image. Raises _StaysError, or InputError if a file is too large."""
    if not is_data_uri(uri):
        # The bytes of an image's file, within the bounds of the document.
        claim = document.budget.claiming(f'image "{shortened(uri)}"', document.place)
        try:
            return read_open_file(find(uri, document.folder, document.bounds)[1], claim)
        except OutsideError as error:
            why = f"is not read: {error}. --allow-outside DIR names further folders"
            raise _StaysError("outside", why) from error
        except RefusedError as error:
            raise _StaysError("refused", f"is not read: {error}") from error
        except OSError as error:
            raise _StaysError("unreadable", f"cannot be read: {error.strerror}") from error
    try:
        document.budget.claim(Work(bytes=2 * len(uri)), "holding its images", document.place)
        data = decode_data_uri(uri, document.place)
    except BudgetError:
        raise
    except InputError as error:
        raise _StaysError("unreadable", error.message) from error
    return data


def bytes_of_images(document: Document) -> int:
    """Return the bytes that the images in a document take, as far as its JSON is sound."""
    views, images = document.objects("bufferViews"), document.objects("images")
    held = {reference(image.get("bufferView")) for image in images}
    sizes = (reference(views[one].get("byteLength")) for one in held if one is not None and one < len(views))
    return sum(size or 0 for size in sizes) + sum(len(str(image.get("uri", ""))) for image in images)


def with_images_inside(document: Document) -> tuple[Document, list[str]]:
    """Return a GLB with the images that it names in its BIN chunk, and reasons why some are missing.

    What no browser reads is missing too. The document has a BIN chunk, and nothing else in files.
    """
    chunk = _Chunk(list(document.binary or ()))
    views, images = list(document.objects("bufferViews")), list(document.objects("images"))
    lost = []
    for number in range(len(document.objects("textures"))):
        try:
            texture_image(document, number)
        except InputError as error:
            lost.append(error.message)
    held: dict[str, JsonObject] = {}

    claim = document.budget.claiming("holding its images in a page", document.place)
    for number, image in enumerate(images):
        uri = image.get("uri")
        if not isinstance(uri, str) or is_data_uri(uri):
            continue
        kept = {key: value for key, value in image.items() if key != "uri"}
        if uri not in held:  # a thousand images may have one name
            try:
                data = read_resource(uri, document.folder, document.bounds, document.place, claim, of="image")
            except InputError as error:
                lost.append(error.message)
                images[number] = kept
                continue
            views.append({"buffer": 0, "byteOffset": chunk.add(data), "byteLength": len(data)})
            kind = _mime_type(bytes(data[:12])) or "image/png"
            held[uri] = {"bufferView": len(views) - 1, "mimeType": kind}
        images[number] = {**kept, **held[uri]}
    if not images:
        return document, lost
    first, *others = document.objects("buffers")
    buffers = [{**first, "byteLength": chunk.length}, *others]
    root = {**document.json, "images": images, "bufferViews": views, "buffers": buffers}
    return document.edited(json=root, binary=tuple(chunk.pieces)), lost


def _mime_type(head: bytes) -> str | None:
    """Return the format of an image by its first 12 bytes, None for others."""
    if head[:4] == b"RIFF" and head[8:] == b"WEBP":
        return "image/webp"
    return next((kind for start, kind in MIME_TYPES.items() if head.startswith(start)), None)
