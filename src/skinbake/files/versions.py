"""Versions of files: whether a file has changed since it was read."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

from skinbake.files import Bytes
from skinbake.files.folders import Folder, open_regular

YOUNG = 1_000_000_000
"""Nanoseconds: a file that changed so recently may change again without a later time stamp."""

CHEAP = 1 << 20
"""Bytes of a young file that are digested, to find a change that its time stamps do not show."""

Signature = tuple[int, ...]
"""The properties that change with a file; empty if there is none."""


class Version(NamedTuple):
    """A file as it was when it was read; ``digest`` if its times alone may not show a change."""

    path: str
    signature: Signature
    digest: str | None

    @property
    def is_current(self) -> bool:
        """Tell whether the file is unchanged since."""
        if signature_of(self.path) != self.signature:  # pragma: no cover: races
            return False
        return self.digest is None or _digest(self.path) == self.digest

    def is_in(self, folder: Folder, name: str) -> bool:
        """Tell whether the file of a name in an open folder is this one, as it was; raises OSError.

        When its inode was changed is not asked: giving it another name changes that.
        """
        descriptor = open_regular(name, follow=False, dir_fd=folder.descriptor)
        with os.fdopen(descriptor, "rb") as file:
            found = os.fstat(file.fileno())
            if (found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns) != self.signature[:4]:
                return False  # pragma: no cover: races
            return self.digest is None or hashlib.file_digest(file, "sha256").hexdigest() == self.digest


def version_of(path: str) -> Version:
    """Return the present version of a file; call it before the file is read."""
    now, signature = time.time_ns(), signature_of(path)
    young = bool(signature) and now - max(signature[-2:]) < YOUNG and signature[2] <= CHEAP
    return Version(path, signature, _digest(path) if young else None)


def signature_of(path: str | Path | int) -> Signature:
    """Return the properties that change with a file, or with an open one: identity, size, times.

    It is empty if they are unknown.
    """
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return ()
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns


def _digest(path: str) -> str | None:
    try:
        with os.fdopen(open_regular(path), "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None


DIGITS = 32
"""Hexadecimal digits of SHA-256 that are kept."""


def digest_of(pieces: Iterable[Bytes]) -> str:
    """Return the digest of bytes that come in pieces."""
    digest = hashlib.sha256()
    for piece in pieces:
        digest.update(piece)
    return digest.hexdigest()[:DIGITS]


def digests_of(files: Mapping[Path, Iterable[Bytes]]) -> dict[str, str]:
    """Return the digests of files that will be written, given in pieces, by path."""
    return {str(path): digest_of(pieces) for path, pieces in files.items()}
