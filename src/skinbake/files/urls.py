"""The files that a user names: URLs and paths. The command line imports this always, so it is small."""

from __future__ import annotations

import os
import posixpath
import re
import stat
import sys
from contextlib import suppress
from typing import NamedTuple

STDIO = "-"
"""The name of stdin as an input, and of stdout as an output."""

IGNORES_CASE = sys.platform in {"darwin", "win32"}
"""Whether the usual disks of this system take ``A.glb`` and ``a.glb`` for one file."""

URL = re.compile(r"^[A-Za-z][A-Za-z0-9+.\-]+(::.+)?://")
"""A scheme of two letters or more. One letter is a drive of Windows. Chained URLs of fsspec are refused."""


def is_url(path: str) -> bool:
    """Tell whether a name given by the user is a URL, not a path."""
    return URL.match(path) is not None


def join_url(folder: str, relative: str) -> str:
    """Return the URL of a file by its path relative to a folder's URL."""
    return f"{folder}{relative}" if folder.endswith("/") else f"{folder}/{relative}"


def on_disk(name: str) -> str | None:
    """Return the path that a path, or a ``file:`` or ``local:`` URL, names. For other URLs return None."""
    if not is_url(name):  # pragma: no branch: URLs: tests/jobs/test_urls.py
        return name
    scheme, _, rest = name.partition("://")
    return rest if scheme.lower() in {"file", "local"} else None


class File(NamedTuple):
    """A file that the user named, as it was when the command began. ``named_file`` makes it.

    ``place`` is the real path, or the URL without dots: the name that writing replaces. Where disks ignore
    case, its letters are small: it is compared, and never opened. ``identity`` is the device and the inode,
    None for a URL and if nothing is there. Hard links have several places and one identity.
    """

    given: str
    place: str
    identity: tuple[int, int] | None = None

    @property
    def key(self) -> str | tuple[int, int]:
        """What is equal for all names of one file, through links of both kinds, there or not yet."""
        return self.identity or self.place

    def is_same(self, other: File) -> bool:
        """Tell whether to write the other file is to change this one, which must exist if it is on a disk."""
        return self.key == other.key and (self.identity is not None or is_url(self.place))


def named_file(name: str, folders: dict[str, str] | None = None) -> File:
    """Return the file of a name: a path, a URL, or - for stdin or stdout. A name may be that of no file.

    ``folders`` keeps the real paths of folders, for one look at each if there are many names.
    """
    path, folders = on_disk(name), {} if folders is None else folders
    if path is None:  # pragma: no cover: URLs: tests/jobs/test_urls.py
        scheme, _, rest = name.partition("://")
        return File(name, f"{scheme}://{posixpath.normpath(rest)}")
    if name == STDIO:
        return File(name, name)
    place, identity = path, None
    with suppress(ValueError):  # no disk accepts a name with a zero in it
        folder, last = os.path.split(path)
        if folder not in folders:
            folders[folder] = os.path.realpath(folder)
        place = os.path.normpath(os.path.join(folders[folder], last))
        with suppress(OSError):  # nothing is there
            found = os.lstat(place)
            if stat.S_ISLNK(found.st_mode):
                place = os.path.realpath(place)
                found = os.stat(place)
            identity = found.st_dev, found.st_ino
    return File(name, place.casefold() if IGNORES_CASE else place, identity)
