"""Names of files: URLs and paths. The command line imports this for every argument, so it is small."""

from __future__ import annotations

import os
import posixpath
import re

URL = re.compile(r"^[A-Za-z][A-Za-z0-9+.\-]+(::.+)?://")
"""A scheme of two letters or more. One letter is a drive of Windows. ``zip://a.glb::s3://…`` is of fsspec."""


def is_url(path: str) -> bool:
    """Tell whether a name given by the user is a URL, not a path."""
    return URL.match(path) is not None


def file_part(url: str) -> str:
    """Return the part of a URL that names the file: ``zip://a.glb`` of ``zip://a.glb::s3://b/c.zip``."""
    return next((part for part in url.split("::") if "://" in part), url)


def join_url(folder: str, relative: str) -> str:
    """Return the URL of a file by its path relative to a folder's URL."""
    return f"{folder}{relative}" if folder.endswith("/") else f"{folder}/{relative}"


def on_disk(name: str) -> str | None:
    """Return the path that a path, or a ``file:`` or ``local:`` URL, names. For other URLs return None."""
    if not is_url(name):
        return name
    scheme, _, rest = name.partition("://")
    return rest if scheme.lower() in {"file", "local"} else None


def canonical(name: str) -> str:
    """Return the canonical name of a file: its real path, or the URL without dots."""
    path = on_disk(name)
    if path is not None:
        return os.path.realpath(path)
    scheme, _, rest = name.partition("://")
    return f"{scheme}://{posixpath.normpath(rest)}"
