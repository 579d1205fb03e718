"""The files that the arguments stand for: files, folders, and patterns that the shell did not expand."""

from __future__ import annotations

import fnmatch
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import click

from skinbake.errors import InputError
from skinbake.files.urls import STDIO, File, is_url, join_url, named_file, on_disk
from skinbake.wording import SUFFIXES, not_gltf

MAGIC = frozenset("*?[")
ANY_FOLDERS = "**"


class Input(NamedTuple):
    """A file to read, and the part of its name that is kept in a folder of outputs.

    That part is relative to the folder in which the file was found. For a file that was named itself, it is
    the file's own name. An argument that stands for no file is an input too. ``missing`` is the
    reason. ``searched`` is the folder in which a search found it. Its documents may name files there.
    """

    file: File
    kept: str
    missing: str | None = None
    searched: str | None = None

    @property
    def source(self) -> str:
        """The name of the file, as given or found."""
        return self.file.given

    @property
    def root(self) -> str:
        """The folder at which ``kept`` starts. A URL may have ``kept`` percent-encoded."""
        if self.source.endswith(self.kept):
            return self.source.removesuffix(self.kept)
        return f"{self.source.rsplit('/', self.kept.count('/') + 1)[0]}/" if is_url(self.source) else ""


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
        return argument.lower().endswith(SUFFIXES) and MAGIC.isdisjoint(argument)
    return argument == STDIO or _is_name(argument)


def check_readable_suffix(source: str) -> None:
    """Raise click.UsageError if an input's name does not show its kind of file, or is that of a folder."""
    if os.path.isdir(source):  # pathlib fails for long names
        raise click.UsageError(f"{source} is a folder: name one file in it")
    if source != STDIO and Path(source).suffix.lower() not in SUFFIXES:
        raise click.UsageError(f"{source}: {not_gltf(source)}")


def path_on_disk(source: str) -> str:
    """Return the path of an input of a command that reads no URLs. A ``file:`` URL is a path too.

    Raises click.UsageError for another URL, and as ``check_readable_suffix`` does.
    """
    path = on_disk(source)
    if path is None:
        raise click.UsageError(
            f"{source}: this command reads no URLs. Copy the file, and the files that it names, to this disk"
        )
    check_readable_suffix(path)
    return path


def _is_name(argument: str) -> bool:
    """Tell whether an argument is the name of one file, there or not: no stdin, URL, folder or pattern."""
    if argument == STDIO or is_url(argument) or os.path.isdir(argument):
        return False
    return MAGIC.isdisjoint(argument) or os.path.lexists(argument)


class _Search:
    """A search that leaves one folder out, and remembers the folders that it could not open."""

    def __init__(self, but: str | None) -> None:
        self._but = but
        self._folders: dict[str, str] = {}
        self._left_out = self._identity(but) if but else None
        self._closed: list[Input] = []

    def meant(self, argument: str) -> list[Input]:
        """Return the files that an argument stands for."""
        if argument == STDIO:
            return [self._input(argument, argument)]
        if is_url(argument):
            return self._behind(argument)
        if os.path.isdir(argument):
            return self._found(argument, argument, (ANY_FOLDERS, "*"), "nothing in this folder")
        if _is_name(argument):
            missing = None if argument.lower().endswith(SUFFIXES) else not_gltf(argument)
            return [self._input(argument, os.path.basename(argument), missing)]
        # The folder without wildcards, empty for the current one, and the parts after it.
        parts = Path(argument).parts
        first = next(number for number, part in enumerate(parts) if not MAGIC.isdisjoint(part))
        fixed = str(Path(*parts[:first])) if first else ""
        return self._found(argument, fixed, parts[first:], "no file that matches this pattern")

    def _behind(self, url: str) -> list[Input]:
        """Return the files that a URL stands for. For a URL to a local path, the rules of paths hold."""
        path = on_disk(url)
        if path is None or url.lower().endswith(SUFFIXES):
            from skinbake.jobs.remote.storages import expand_url

            try:
                files = expand_url(url)
            except InputError as error:
                return [self._input(url, url, error.message)]
            outputs = join_url(self._but, "") if self._but and is_url(self._but) else None
            if outputs is not None and not join_url(url, "").startswith(outputs):
                files = [(file, kept) for file, kept in files if not file.startswith(outputs)]
            found = [self._input(file, kept) for file, kept in files]
            return [entry if entry.source == url else entry._replace(searched=entry.root) for entry in found]
        if MAGIC.isdisjoint(path) and not os.path.isdir(path):
            return [self._input(url, url, "there is no such folder")]
        scheme = url[: len(url) - len(path)]
        return [
            entry._replace(
                file=entry.file._replace(given=scheme + entry.source),
                searched=entry.searched and scheme + entry.searched,
            )
            for entry in self.meant(path)
        ]

    def _found(self, argument: str, folder: str, pattern: Sequence[str], nothing: str) -> list[Input]:
        self._closed.clear()
        paths = sorted(set(self._files(folder or os.curdir, pattern)), key=lambda path: path.split(os.sep))
        within = folder or os.curdir
        entries = [self._input(os.path.join(folder, path), path, None, within) for path in paths]
        entries += self._closed
        return entries or [self._input(argument, argument, f"{nothing} ends in {', '.join(SUFFIXES)}")]

    def _files(self, folder: str, pattern: Sequence[str]) -> Iterator[str]:
        """Yield the matching glTF files below a folder, relative to it, in any order, perhaps repeatedly."""
        head, *rest = pattern
        if head == ANY_FOLDERS:
            yield from self._files(folder, rest or ("*",))
        elif not rest:
            found = (one for one in self._entries(folder) if one.name.lower().endswith(SUFFIXES))
            fits = (one for one in found if _matches(one.name, head))
            # A user misses the file of a broken link.
            yield from (
                one.name
                for one in fits
                if one.is_file() or (one.is_symlink() and not os.path.exists(one.path))
            )
            return
        elif MAGIC.isdisjoint(head):
            inside = os.path.join(folder, head)
            if self._left_out is None or self._identity(inside) != self._left_out:
                yield from (os.path.join(head, path) for path in self._files(inside, rest))
            return
        for entry in self._entries(folder):
            is_folder = entry.is_dir(follow_symlinks=False)
            if not is_folder or (self._left_out and self._identity(entry.path) == self._left_out):
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
            closed = self._input(folder, folder, f"this folder cannot be read: {reason}")
            if closed not in self._closed:
                self._closed.append(closed)
            return []

    def _input(
        self, source: str, kept: str, missing: str | None = None, searched: str | None = None
    ) -> Input:
        return Input(named_file(source, self._folders), kept, missing, searched)

    def _identity(self, folder: str) -> tuple[int, int] | None:
        return named_file(folder, self._folders).identity


def _matches(name: str, pattern: str) -> bool:
    """Tell whether a name matches. A hidden name matches only if the pattern begins with a dot too."""
    return fnmatch.fnmatch(name, pattern) and (not name.startswith(".") or pattern.startswith("."))
