"""Split and join the chunks of a GLB container (glTF 2.0 specification, §4 "GLB file format")."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

from skinbake.errors import InputError, OutputError, Place, UnsupportedFeatureError
from skinbake.files import Bytes
from skinbake.wording import OTHER_FORMATS, counted

MAGIC = b"glTF"
CHUNK_JSON = 0x4E4F534A
CHUNK_BIN = 0x004E4942
HEADER = struct.Struct("<4sII")
CHUNK_HEADER = struct.Struct("<II")
MAX_LENGTH = 2**32 - 1

STDIN = "<stdin>"
"""The name of a document from standard input."""


class GlbChunks(NamedTuple):
    """The chunks of one GLB, in file order; ``binary`` is None without a BIN chunk.

    ``others`` are further chunks of unknown type. ``trailing`` are bytes past the length in the header. Both
    are kept so that they can be written back.
    """

    json: Bytes
    binary: Bytes | None
    others: tuple[tuple[int, Bytes], ...]
    trailing: Bytes


def split_glb(data: Bytes, place: Place) -> GlbChunks:
    """Return the chunks of a GLB without copying them.

    Raises InputError if the header or a chunk header contradicts the size of the file, and
    UnsupportedFeatureError for a container version other than 2.
    """
    view = memoryview(data)
    if view[:4] != MAGIC:
        refuse_other_kind(view, place)
    if len(view) < HEADER.size:
        raise InputError(
            f"not a GLB: it has {counted(len(view), 'byte')}, fewer than the 12 bytes of the header", place
        )
    magic, version, length = HEADER.unpack_from(view)
    if magic != MAGIC:
        why = "not a GLB: it does not begin with 'glTF'"
        if bytes(view[:32]).removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"{"):
            piped = "- takes a GLB only; give a .gltf file by its name"
            why = f"this is JSON text, not a GLB: {piped if place.file == STDIN else 'name it .gltf instead'}"
        raise InputError(why, place)
    if version != 2:
        raise UnsupportedFeatureError(f"GLB container version {version}; only version 2 is supported", place)
    if length > len(view):
        raise InputError(
            f"the GLB is cut short: its header says {length:,} bytes, it has {len(view):,}; "
            "copy or download it again",
            place,
        )
    chunks = _chunks(view[:length], place)
    if not chunks or chunks[0][0] != CHUNK_JSON:
        raise InputError("the first chunk of the GLB is not JSON", place)
    binary: memoryview | None = None
    rest = chunks[1:]
    if rest and rest[0][0] == CHUNK_BIN:
        binary, rest = rest[0][1], rest[1:]
    if any(kind in {CHUNK_JSON, CHUNK_BIN} for kind, _ in rest):
        raise InputError("the GLB has a second JSON or BIN chunk, or one in the wrong place", place)
    return GlbChunks(chunks[0][1], binary, tuple(rest), view[length:])


def _chunks(view: memoryview, place: Place) -> list[tuple[int, memoryview]]:
    chunks = []
    offset = HEADER.size
    while offset < len(view):
        if offset + CHUNK_HEADER.size > len(view):
            raise InputError(f"the GLB is cut short inside the chunk header at byte {offset}", place)
        length, kind = CHUNK_HEADER.unpack_from(view, offset)
        start = offset + CHUNK_HEADER.size
        wrong = ["not a multiple of 4"] if length % 4 else []
        if start + length > len(view):
            wrong.append(f"more than the {counted(len(view) - start, 'byte')} left")
        if wrong:
            name = {CHUNK_JSON: "JSON chunk", CHUNK_BIN: "BIN chunk"}.get(kind, "chunk")
            found = f"the GLB's {name} at byte {offset} has the length {length:,}, {' and '.join(wrong)}"
            raise InputError(f"{found}: export the file again", place)
        chunks.append((kind, view[start : start + length]))
        offset = start + length
    return chunks


def join_glb(
    json_bytes: bytes,
    binary: Sequence[Bytes] | None,
    others: Sequence[tuple[int, Bytes]],
    *,
    multiple: int = 4,
) -> list[Bytes]:
    """Return the pieces of a GLB file in order, ready to be written one after the other.

    ``binary`` comes in pieces so that large buffers are never joined; None writes no BIN chunk. Its bytes
    begin at a ``multiple`` of so many bytes (``binary_offset``). Raises OutputError if the file exceeds the
    4 GiB that the header can hold.
    """
    end = binary_offset(len(json_bytes), multiple) - HEADER.size - 2 * CHUNK_HEADER.size
    parts: list[Bytes] = _chunk(CHUNK_JSON, [json_bytes, b" " * (end - len(json_bytes))], b" ")
    if binary is not None:
        parts += _chunk(CHUNK_BIN, binary, b"\0")
    for kind, chunk in others:
        parts += _chunk(kind, [chunk], b"\0")
    length = HEADER.size + sum(len(part) for part in parts)
    if length > MAX_LENGTH:  # pragma: no cover: takes 4 GiB: tests/gltf/test_glb.py
        raise OutputError(f"the GLB would have {length} bytes, over the format's limit of 4 GiB; write .gltf")
    return [HEADER.pack(MAGIC, 2, length), *parts]


def binary_offset(json_length: int, multiple: int) -> int:
    """Return the least multiple of so many bytes where the bytes of a BIN chunk can begin, after JSON."""
    least = HEADER.size + 2 * CHUNK_HEADER.size + json_length
    return least + -least % multiple


def _chunk(kind: int, pieces: Sequence[Bytes], pad: bytes) -> list[Bytes]:
    length = sum(len(piece) for piece in pieces)
    padding = pad * (-length % 4)
    return [CHUNK_HEADER.pack(length + len(padding), kind), *pieces, padding]


_TAKE_THE_MODEL = "take the model that it belongs to"

FIRST_BYTES = (
    (b"\x89PNG", f"a PNG picture: {_TAKE_THE_MODEL}"),
    (b"\xff\xd8\xff", f"a JPEG picture: {_TAKE_THE_MODEL}"),
    (b"\xabKTX ", f"a KTX picture: {_TAKE_THE_MODEL}"),
    (b"RIFF", f"a RIFF file, like a WebP picture: {_TAKE_THE_MODEL}"),
    (b"PK\x03\x04", "a ZIP archive: unpack it"),
    (b"\x1f\x8b", "a gzip archive: unpack it"),
    (b"Kaydara FBX Binary", f"FBX: {OTHER_FORMATS['.fbx']}"),
    (b"; FBX", f"FBX: {OTHER_FORMATS['.fbx']}"),
    (b"BLENDER", f"a file of Blender: {OTHER_FORMATS['.blend']}"),
    (b"version https://git-lfs", "the pointer that Git LFS left in its place: fetch it with git lfs pull"),
    (b"<", "a web page or XML: if it was downloaded, the server may have answered with an error"),
    (b"\xff\xfe", "text in UTF-16: save it as UTF-8"),
    (b"\xfe\xff", "text in UTF-16: save it as UTF-8"),
)
"""The beginning of files that take the place of a model by mistake, and their kind in words."""


def refuse_other_kind(data: Bytes, place: Place) -> None:
    """Raise InputError if a file is empty, or is of another kind by its first bytes."""
    if not len(data):
        raise InputError("it is empty: an export or a download may have stopped; write it again", place)
    if kind := other_kind(data):
        raise InputError(f"this is not glTF, but {kind}", place)


def other_kind(data: Bytes) -> str | None:
    """Return the kind of a file that is not a model by its first bytes, and what to do; None of any other."""
    head = bytes(data[:32])
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()  # servers answer with white space before a page
    return next(
        (kind for first, kind in FIRST_BYTES if first in {head[: len(first)], text[: len(first)]}), None
    )
