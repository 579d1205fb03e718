"""The data that URIs of buffers and images name: in the URI, or in a file beside the document."""

from __future__ import annotations

import base64
import errno
import mmap
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote, unquote_to_bytes

from skinbake.errors import InputError, Place
from skinbake.files import Bytes
from skinbake.files.bounds import BoundedPath, Bounds, OutsideError, RefusedError, bounded_paths
from skinbake.files.folders import open_beneath
from skinbake.gltf.budget import fits_memory

Claim = Callable[[int], None]
"""A function that hears the size of a file in bytes before it is read. It raises InputError to refuse it."""

BLOCK = 1 << 20
"""Number of bytes of a file that are copied at a time."""


def is_data_uri(uri: str) -> bool:
    """Tell whether the URI carries its data itself."""
    return uri[:5].lower() == "data:"


def decode_data_uri(uri: str, place: Place) -> bytes:
    """Return the bytes of a ``data:`` URI, base64 or percent-encoded; InputError if it is malformed.

    As in browsers, the ``=`` at the end of base64 may be missing, but only all of them ("forgiving-base64
    decode" of https://infra.spec.whatwg.org).
    """
    header, comma, payload = uri.partition(",")
    if not comma:
        raise InputError("a data: URI has no comma before its data", place)
    try:
        if not header.lower().endswith(";base64"):
            return unquote_to_bytes(payload)
        digits = unquote(payload) if "%" in payload else payload
        padding = "" if digits.endswith("=") else "=" * (-len(digits) % 4)
        return base64.b64decode(digits + padding, validate=True)
    except ValueError as error:  # binascii.Error, or characters outside of one byte
        raise InputError(f"a data: URI cannot be decoded: {error}", place) from error


def encode_data_uri(data: bytes) -> str:
    """Return the bytes as the ``data:`` URI of a glTF buffer."""
    return "data:application/octet-stream;base64," + base64.b64encode(data).decode("ascii")


PAGES_FROM = 1 << 20
"""From this number of bytes on, a file is read into its own pages."""


def read_open_file(descriptor: int, claim: Claim) -> Bytes:
    """Return the bytes of an open regular file, as a copy in memory, and close it. Its size is claimed first.

    The file is read, not mapped. Another process may rewrite a mapped file between a check and its use, and
    if it truncates the file, this process dies. Raises OSError, also for a file that changes its length while
    it is read.
    """
    with open(descriptor, "rb", buffering=0) as file:
        size = os.fstat(descriptor).st_size
        claim(size)
        if size < PAGES_FROM:
            data: Bytes = file.readall()
        else:
            # Memory that is not filled with zeros first, in huge pages if there are any: reading 72 MiB takes
            # 23 ms of processor time so, and 41 ms with ordinary pages.
            if hasattr(mmap, "MAP_ANONYMOUS"):  # pragma: no branch: other systems
                pages = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
                if hasattr(mmap, "MADV_HUGEPAGE"):  # pragma: no branch: other systems
                    with suppress(OSError):  # a kernel without them
                        pages.madvise(mmap.MADV_HUGEPAGE)
                data = memoryview(pages)
            else:  # pragma: no cover: other systems
                data = memoryview(bytearray(size))
            got = 0
            while got < size and (count := file.readinto(data[got:])):
                got += count
            data = data[:got].toreadonly()
        if not len(data) == size == os.fstat(descriptor).st_size:  # pragma: no cover: races
            raise OSError(errno.EBUSY, "it changed while it was read; try again")
    return data


@dataclass(frozen=True, slots=True)
class FileContent:
    """The bytes of a file beside the document, read a block at a time when they are needed."""

    file: BoundedPath

    def __iter__(self) -> Iterator[bytes]:
        """Yield the blocks. Raises OSError; InputError if the file is larger than any that may be read."""
        descriptor = open_beneath(self.file)
        try:
            size = os.fstat(descriptor).st_size
            if not fits_memory(size):
                message = f"it has {size:,} bytes, which is too large: raise --max-memory"
                raise InputError(message, Place(self.file.path))
            while block := os.read(descriptor, BLOCK):
                yield block
        finally:
            os.close(descriptor)


def find(uri: str, folder: Path, bounds: Bounds) -> tuple[BoundedPath, int]:
    """Return the path of a document's URI, and a descriptor of the regular file there.

    Raises RefusedError if the URI may not be opened (OutsideError: it leads out of ``bounds``). Raises
    OSError if there is no such file, or if a link on the way leads out.
    """
    missing: OSError | None = None
    for file in bounded_paths(uri, os.fspath(folder), bounds):
        try:
            return file, open_beneath(file)
        except (FileNotFoundError, NotADirectoryError, IsADirectoryError) as error:
            missing = missing or error
        except ValueError as error:  # not a valid name on this system
            missing = missing or OSError(errno.ENOENT, str(error))
    raise missing or FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))


def is_there(uri: str, folder: Path, bounds: Bounds) -> bool:
    """Tell whether a document's URI leads to a file that may be read."""
    try:
        os.close(find(uri, folder, bounds)[1])
    except (OSError, RefusedError):
        return False
    return True


def read_resource(
    uri: str, folder: Path, bounds: Bounds, place: Place, claim: Claim, *, of: str = "buffer"
) -> Bytes:
    """Return the bytes of the URI of a buffer, or of what ``of`` says.

    Raises InputError if the file is missing or unreadable, if the data URI is malformed, or if the document
    may not read the URI: a model must not read arbitrary files or the network.
    """
    try:
        return read_open_file(find(uri, folder, bounds)[1], claim)
    except RefusedError as error:
        raise refused(uri, error, place, of=of) from error
    except OSError as error:
        if error.errno == errno.EXDEV:
            raise refused(uri, OutsideError(LINKED_OUT), place, of=of) from error
        remedy = "; copy it there too, or export a .glb, which is one file" if of == "buffer" else ""
        advice = remedy if error.errno == errno.ENOENT else ""
        message = f'cannot read "{shortened(uri)}" beside it: {error.strerror}{advice}'
        raise InputError(message, place) from error


LINKED_OUT = "a link on the way leads out of its folder"


def refused(uri: str, why: RefusedError, place: Place, *, of: str = "buffer") -> InputError:
    """Return the error for a buffer, or another file, that a document may not read, or that nobody may."""
    remedy = (
        "To read the file, give its folder with --allow-outside DIR"
        if isinstance(why, OutsideError)
        else "No option changes that: in the document, name the file by a relative path with forward slashes"
    )
    return InputError(f'its {of} "{shortened(uri)}" is not read: {why}. {remedy}', place)


def shortened(uri: str) -> str:
    """Return a URI for messages, shortened."""
    return uri if len(uri) <= 80 else f"{uri[:77]}…"


def listed(uris: Sequence[str]) -> str:
    """Return the first three URIs for messages, shortened."""
    return ", ".join(map(shortened, uris[:3])) + (", …" if len(uris) > 3 else "")
