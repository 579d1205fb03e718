"""What the URIs of buffers and images stand for: data in the URI, or a file beside the document."""

from __future__ import annotations

import base64
import errno
import mmap
import os
import posixpath
import re
import stat
from pathlib import Path
from urllib.parse import quote, unquote, unquote_to_bytes

from skinbake.errors import InputError, Place
from skinbake.gltf.glb import Bytes

_SCHEME = re.compile(r"^[A-Za-z][A-Za-z0-9+.\-]+:")


def is_data_uri(uri: str) -> bool:
    """Tell whether the URI carries its data itself."""
    return uri[:5].lower() == "data:"


def is_relative(uri: str) -> bool:
    """Tell whether the URI names a file relative to the document (a relative reference of RFC 3986)."""
    return bool(uri) and not _SCHEME.match(uri) and not unquote(uri).startswith(("/", "\\"))


def decode_data_uri(uri: str, place: Place) -> bytes:
    """Return the bytes of a ``data:`` URI, base64 or percent-encoded; InputError where it is malformed."""
    header, comma, payload = uri.partition(",")
    if not comma:
        raise InputError("a data: URI has no comma before its data", place)
    try:
        if not header.lower().endswith(";base64"):
            return unquote_to_bytes(payload)
        return base64.b64decode(unquote(payload) if "%" in payload else payload, validate=True)
    except ValueError as error:  # binascii.Error, or characters that no byte stands for
        raise InputError(f"a data: URI does not hold what it says: {error}", place) from error


def encode_data_uri(data: bytes) -> str:
    """Return the bytes as the ``data:`` URI of a glTF buffer."""
    return "data:application/octet-stream;base64," + base64.b64encode(data).decode("ascii")


def relative_path(uri: str) -> str:
    """Return the path that a relative URI names, dots resolved as in RFC 3986, §5.2.4.

    Percent-encoding is undone, query and fragment are cut off. It begins with ``..`` where it leads out of
    the document's folder.
    """
    return posixpath.normpath(unquote(uri.split("#", maxsplit=1)[0].split("?", maxsplit=1)[0]))


def path_uri(path: str) -> str:
    """Return the relative URI of a path with forward slashes."""
    return quote(os.fsencode(path), safe="/!$&'()*+,;=@~-._")


def locate(uri: str, folder: Path) -> Path:
    """Return the file that a relative URI names, seen from ``folder``.

    Percent-encoding is undone; a file that carries the URI's characters literally, ``%20`` or ``#`` among
    them, as some exporters write it, is found where the decoded one is absent.
    """
    decoded = folder / relative_path(uri)
    literal = folder / uri
    return literal if not is_file(decoded) and is_file(literal) else decoded


def is_file(path: Path) -> bool:
    """Tell whether a path is a file; a name that no file can have is none."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


MAPPED_FROM = 1 << 20
"""Bytes from which a file is mapped, not read: nothing is copied, and what nobody looks at stays out."""


def read_file(path: Path) -> Bytes:
    """Return the bytes of a file; those of a large one are mapped into memory.

    Windows would not let a file be replaced while it is mapped. Raises OSError.
    """
    mode = path.stat().st_mode
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):  # opening a pipe waits until somebody writes to it
        raise OSError(errno.EINVAL, "it is not a regular file")
    with path.open("rb", buffering=0) as file:
        size = os.fstat(file.fileno()).st_size
        if size < MAPPED_FROM or os.name == "nt":
            return file.readall()
        return memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))


def read_resource(uri: str, folder: Path, place: Place) -> Bytes:
    """Return the bytes that a buffer's URI stands for.

    Raises InputError where the file is missing or unreadable, the data URI is malformed, or the URI has
    another scheme or an absolute path: a model does not get to read arbitrary files or the network.
    """
    if is_data_uri(uri):
        return decode_data_uri(uri, place)
    if not is_relative(uri):
        raise InputError(f'the URI "{_short(uri)}" is neither relative nor a data: URI', place)
    try:
        return read_file(locate(uri, folder))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f'cannot read "{_short(uri)}" beside it: {reason}', place) from error


def _short(uri: str) -> str:
    return uri if len(uri) <= 80 else f"{uri[:77]}…"
