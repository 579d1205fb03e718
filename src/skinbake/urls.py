"""Telling URLs from paths, and joining them; no more, since the command line asks it of every argument."""

from __future__ import annotations

import re

URL = re.compile(r"^[A-Za-z][A-Za-z0-9+.\-]+(::.+)?://")
"""A scheme of two letters or more: one is a drive of Windows. ``zip://a.glb::s3://…`` is one of fsspec's."""


def is_url(path: str) -> bool:
    """Tell whether a name given by the user is a URL, not a path."""
    return URL.match(path) is not None


def join_url(folder: str, relative: str) -> str:
    """Return the URL of a file by its path relative to a folder's URL."""
    return f"{folder}{relative}" if folder.endswith("/") else f"{folder}/{relative}"
