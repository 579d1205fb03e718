"""The names that a document may use. They lead below a folder, on every system.

A document may come from a stranger. Every name in it passes ``relative_names`` once. Only the result is
compared, opened or written. Of the disk, this module reads only the names of folders.
"""

from __future__ import annotations

import os
import posixpath
import re
from contextlib import suppress
from typing import NamedTuple
from urllib.parse import quote, unquote

DEVICES = frozenset(
    {"CON", "PRN", "AUX", "NUL", "CONIN$", "CONOUT$", "CLOCK$"}
    | {f"{port}{number}" for port in ("COM", "LPT") for number in "0123456789¹²³"}
)
"""Names that mean a device in any folder of Windows, with any suffix."""

_SCHEME = re.compile(r"^[A-Za-z][A-Za-z0-9+.\-]*:")


class RefusedError(ValueError):
    """A name that is never opened, even if a file is there. The text says why."""


class OutsideError(RefusedError):
    """A relative name that leads out of the folders that may be read."""


NOWHERE = ""
"""The root of a document that came without a folder. It may name no file but the allowed ones."""


class Bounds(NamedTuple):
    """The places to which a document's names may lead: below ``root``, or below one of ``allowed``.

    They are paths, or URLs if the document has a URL. None stands for the document's own folder. Files that
    are ``fetched`` are gone after the work: nothing is noted of them beside a target.
    """

    root: str | None = None
    allowed: tuple[str, ...] = ()
    fetched: bool = False


BESIDE = Bounds()
"""A document may name the files in its own folder and below."""


class Within(NamedTuple):
    """The folders in which a job stays: it reads within ``bounds`` and writes below ``output``.

    If ``output`` is None, it is the target's own folder.
    """

    bounds: Bounds = BESIDE
    output: str | None = None


OWN_FOLDERS = Within()
"""The folders of a file that the user named, and of a target that the user named."""


class BoundedPath(NamedTuple):
    """The path to which a name leads: below a folder, in forward slashes.

    ``is_own`` tells that the folder is the document's own root.
    """

    root: str
    name: str
    is_own: bool = True

    @property
    def path(self) -> str:
        """The whole path, for messages and comparison. It is not opened."""
        return os.path.join(self.root, *self.name.split("/"))


def relative_names(uri: str) -> tuple[str, ...]:
    """Return the relative paths that a URI of a document may mean, the likelier first.

    Percent-encoding is decoded once. ``#`` and ``?`` belong to the name. The second path is for a file whose
    name has the URI's characters literally, as some exporters write it. Raises RefusedError if the first path
    is not a relative path that means the same on every system: NUL, a backslash, a colon (drives, schemes and
    streams of Windows), an absolute path, a device of Windows, or the name of no file.
    """
    names = [_checked(unquote(uri, errors="surrogateescape"))]
    if "%" in uri:
        with suppress(RefusedError):
            names.append(_checked(uri))
    return tuple(dict.fromkeys(names))


def _checked(name: str) -> str:
    """Return a relative path without inner dots to resolve. Raises RefusedError for any other."""
    if "\0" in name:
        raise RefusedError("it holds a NUL character")
    if "\\" in name:
        raise RefusedError("it holds a backslash; paths in glTF use forward slashes")
    if name.startswith("/"):
        raise RefusedError("it is an absolute path")
    if ":" in name:
        scheme = _SCHEME.match(name)
        kind = "a drive" if scheme and scheme.end() == 2 else "a scheme" if scheme else "a colon"
        raise RefusedError(f"it has {kind}, and is neither a relative path nor a data: URI")
    for part in name.split("/"):
        if part not in {"", ".", ".."} and not part.strip(". "):
            raise RefusedError(f'"{part}" is not a valid file name on every system')
        if part.split(".")[0].rstrip(" ").upper() in DEVICES:
            raise RefusedError(f'"{part}" is a device on Windows')
    normal = posixpath.normpath(name) if name else "."
    if name.endswith(("/", "/.", "/..")) or normal in {".", ".."}:
        raise RefusedError("it names no file")
    return normal


def is_relative(uri: str) -> bool:
    """Tell whether a URI of a document names a file by a relative path."""
    try:
        return bool(relative_names(uri))
    except RefusedError:
        return False


def path_uri(path: str) -> str:
    """Return the relative URI of a path with forward slashes."""
    return quote(os.fsencode(path), safe="/!$&'()*+,;=@~-._")


def bounded_paths(uri: str, folder: str, bounds: Bounds) -> list[BoundedPath]:
    """Return the paths to which a document's URI may lead, the likelier first. ``folder`` is the document's.

    On the disk only the folders are looked at, to find their names. Raises RefusedError, and OutsideError if
    the first name leads out of all bounds.
    """
    home = os.path.realpath(folder)
    own = folder if bounds.root is None else bounds.root
    roots = [*([own] if own != NOWHERE else []), *bounds.allowed]
    found: list[BoundedPath] = []
    for name in relative_names(uri):
        path = os.path.normpath(os.path.join(home, *name.split("/")))
        for number, root in enumerate(map(os.path.realpath, roots)):
            inside = below(path, root)
            if inside is not None:
                found.append(BoundedPath(root, inside, number == 0 and own != NOWHERE))
                break
        else:
            if not found:  # pragma: no branch: tests/files/test_containment.py
                reason = f"it leads out of {own or os.curdir}" if own != NOWHERE else "it has no folder"
                raise OutsideError(reason)
    return found


def below(path: str, root: str) -> str | None:
    """Return the path relative to a folder, in forward slashes, or None if it is not below the folder."""
    prefix = root if root.endswith(os.sep) else root + os.sep
    if not os.path.normcase(path).startswith(os.path.normcase(prefix)):
        return None
    return path[len(prefix) :].replace(os.sep, "/") or None


def bounded_path(path: str, root: str) -> BoundedPath:
    """Return a path as one below a folder. Links below the folder are not followed.

    Raises OutsideError if the path is outside.
    """
    folder = os.path.realpath(root)
    given = os.path.abspath(root)
    name = below(os.path.normpath(os.path.abspath(path)), given)
    if name is None:  # pragma: no cover: tests/files/test_containment.py
        raise OutsideError(f"it is not below {root}")
    return BoundedPath(folder, name)


def moved_uri(uri: str, folder: str, target: str) -> str:
    """Return a relative URI, made for a document in ``folder``, as seen from the folder ``target``.

    Only text is used; the disk is not read. Raises RefusedError.
    """
    path = os.path.normpath(os.path.join(os.path.realpath(folder), *relative_names(uri)[0].split("/")))
    try:
        return path_uri(os.path.relpath(path, target).replace(os.sep, "/"))
    except ValueError as error:
        raise RefusedError("no relative URI leads there from another drive") from error
