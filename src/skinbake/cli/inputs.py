"""The files that the arguments stand for: files, folders, and patterns that the shell did not expand."""

from __future__ import annotations

import fnmatch
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import click

from skinbake.cli.names import STDIO, check_readable_suffix
from skinbake.cli.remote import behind
from skinbake.errors import InputError
from skinbake.files.urls import file_part, is_url, on_disk
from skinbake.wording import SUFFIXES, not_gltf

MAGIC = frozenset("*?[")
ANY_FOLDERS = "**"


@dataclass(frozen=True, slots=True)
class Input:
    """A file to read, and the part of its name that is kept in a folder of outputs.

    That part is relative to the folder in which the file was found. For a file that was named itself, it is
    the file's own name. An argument that stands for no file is an input too. ``missing`` is the
    reason. ``searched`` is the folder in which a search found it. Its documents may name files there.
    """

    source: str
    kept: str
    missing: str | None = None
    searched: str | None = None

    @property
    def root(self) -> str:
        """The folder at which ``kept`` starts."""
        return self.source[: len(self.source) - len(self.kept)] if self.source.endswith(self.kept) else ""


def expanded(arguments: Sequence[str], *, but: str | None = None) -> list[Input]:
    """Return the files that the arguments stand for, in order. Files of a folder are sorted by path.

    A file that several searches find is there once. ``but`` is the folder of the outputs. It is not searched,
    unless a search begins there. Hidden files and folders, and linked folders, are skipped. An argument that
    names something that exists is not a pattern, even if it has pattern characters. A name that does not
    show its kind of file is missing, so that the others are tried. Raises click.UsageError if it is the only
    argument, and if stdin is to be read twice.
    """
    if list(arguments).count(STDIO) > 1:
        raise click.UsageError("stdin can be read only once")
    if is_one_file(arguments) and _is_name(arguments[0]):
        check_readable_suffix(arguments[0])
    search = _Search(but)
    found: list[Input] = []
    seen: set[tuple[str, str]] = set()
    for argument in arguments:
        for entry in search.meant(argument):
            if entry.source == argument or (entry.source, entry.kept) not in seen:
                found.append(entry)
                seen.add((entry.source, entry.kept))
    return found


def is_one_file(arguments: Sequence[str]) -> bool:
    """Tell whether the arguments name one file: no folder or pattern, whatever it would find."""
    if len(arguments) != 1:
        return False
    (argument,) = arguments
    if is_url(argument):
        return file_part(argument).lower().endswith(SUFFIXES) and MAGIC.isdisjoint(argument)
    return argument == STDIO or _is_name(argument)


def _is_name(argument: str) -> bool:
    """Tell whether an argument is the name of one file, there or not: no stdin, URL, folder or pattern."""
    if argument == STDIO or is_url(argument) or os.path.isdir(argument):
        return False
    return MAGIC.isdisjoint(argument) or os.path.lexists(argument)


class _Search:
    """A search that leaves one folder out, and remembers the folders that it could not open."""

    def __init__(self, but: str | None) -> None:
        self._but = but
        self._left_out = _identity(on_disk(but) or "") if but else None
        self._closed: list[Input] = []

    def meant(self, argument: str) -> list[Input]:
        """Return the files that an argument stands for."""
        if argument == STDIO:
            return [Input(argument, argument)]
        if is_url(argument):
            return self._behind(argument)
        if os.path.isdir(argument):
            return self._found(argument, argument, (ANY_FOLDERS, "*"), "nothing in this folder")
        if _is_name(argument):
            is_model = argument.lower().endswith(SUFFIXES)
            return [Input(argument, os.path.basename(argument), None if is_model else not_gltf(argument))]
        fixed, pattern = _split(argument)
        return self._found(argument, fixed, pattern, "no file that matches this pattern")

    def _behind(self, url: str) -> list[Input]:
        """Return the files that a URL stands for. For a URL to a local path, the rules of paths hold."""
        path = on_disk(url)
        if path is None or url.lower().endswith(SUFFIXES):
            try:
                return [
                    Input(file, kept, searched=None if file == url else file.removesuffix(kept))
                    for file, kept in behind(url, self._but)
                ]
            except InputError as error:
                return [Input(url, url, error.message)]
        if MAGIC.isdisjoint(path) and not os.path.isdir(path):
            return [Input(url, url, "there is no such folder")]
        scheme = url[: len(url) - len(path)]
        return [
            replace(
                entry,
                source=scheme + entry.source,
                searched=entry.searched and scheme + entry.searched,
            )
            for entry in self.meant(path)
        ]

    def _found(self, argument: str, folder: str, pattern: Sequence[str], nothing: str) -> list[Input]:
        self._closed.clear()
        paths = sorted(set(self._files(folder or os.curdir, pattern)), key=_by_parts)
        within = folder or os.curdir
        entries = [Input(os.path.join(folder, path), path, searched=within) for path in paths]
        entries += self._closed
        return entries or [Input(argument, argument, f"{nothing} ends in {', '.join(SUFFIXES)}")]

    def _files(self, folder: str, pattern: Sequence[str]) -> Iterator[str]:
        """Yield the matching glTF files below a folder, relative to it, in any order, perhaps repeatedly."""
        head, *rest = pattern
        if head == ANY_FOLDERS:
            yield from self._files(folder, rest or ("*",))
        elif not rest:
            for entry in self._entries(folder):
                if _matches(entry.name, head) and entry.name.lower().endswith(SUFFIXES) and _is_file(entry):
                    yield entry.name
            return
        elif MAGIC.isdisjoint(head):
            inside = os.path.join(folder, head)
            if self._left_out is None or _identity(inside) != self._left_out:
                yield from (os.path.join(head, path) for path in self._files(inside, rest))
            return
        for entry in self._entries(folder):
            if not self._is_folder(entry):
                continue
            if head == ANY_FOLDERS:
                inner: Sequence[str] = () if entry.name.startswith(".") else pattern
            else:
                inner = rest if _matches(entry.name, head) else ()
            if inner:
                for path in self._files(entry.path, inner):
                    yield os.path.join(entry.name, path)

    def _entries(self, folder: str) -> list[os.DirEntry[str]]:
        try:
            with os.scandir(folder) as entries:
                return list(entries)
        except (FileNotFoundError, NotADirectoryError):
            return []
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            closed = Input(folder, folder, f"this folder cannot be read: {reason}")
            if closed not in self._closed:
                self._closed.append(closed)
            return []

    def _is_folder(self, entry: os.DirEntry[str]) -> bool:
        if not entry.is_dir(follow_symlinks=False):
            return False
        return self._left_out is None or _identity(entry.path) != self._left_out


def _is_file(entry: os.DirEntry[str]) -> bool:
    """Tell whether an entry is a file, or a broken link, because a user misses the file of a broken link."""
    return entry.is_file() or (entry.is_symlink() and not os.path.exists(entry.path))


def _split(argument: str) -> tuple[str, tuple[str, ...]]:
    """Return a pattern's folder without wildcards, empty for the current one, and the parts after it."""
    parts = Path(argument).parts
    first = next(n for n, part in enumerate(parts) if not MAGIC.isdisjoint(part))
    return str(Path(*parts[:first])) if first else "", parts[first:]


def _matches(name: str, pattern: str) -> bool:
    """Tell whether a name matches. A hidden name matches only if the pattern begins with a dot too."""
    return fnmatch.fnmatch(name, pattern) and (not name.startswith(".") or pattern.startswith("."))


def _identity(folder: str) -> tuple[int, int] | None:
    """Return the identity that separates a folder from all others, or None if there is no folder."""
    try:
        found = os.stat(folder)
    except (OSError, ValueError):
        return None
    return found.st_dev, found.st_ino


def _by_parts(path: str) -> list[str]:
    return path.split(os.sep)
