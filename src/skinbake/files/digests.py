"""Digests of files, to tell whether two of them are equal."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path

from skinbake.files import Bytes

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
