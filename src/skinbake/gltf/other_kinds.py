"""Files of other kinds under the name of a glTF file, by their first bytes."""

from __future__ import annotations

from skinbake.errors import InputError, Place
from skinbake.files import Bytes
from skinbake.wording import OTHER_FORMATS

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
