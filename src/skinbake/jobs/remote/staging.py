"""Commands for files behind URLs.

The files are fetched into a private folder. The functions for local files work on them there. Then the
written files are stored again. The private folder mirrors the names of the storage, as far as one file's work
needs them. So relative URIs, ``../`` among them, mean the same file there as in the storage. Every rule about
files beside a document holds as it does on a disk.
"""

from __future__ import annotations

import errno
import os
import posixpath
import re
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import NamedTuple, TypeVar, cast

from skinbake.errors import InputError, Message, OutputError, Place, SkinbakeError, noticed
from skinbake.files.bounds import (
    Bounds,
    RefusedError,
    Within,
    bounded_paths,
    is_relative,
    relative_names,
)
from skinbake.files.urls import STDIO, is_url, on_disk
from skinbake.files.writing import SAVED_ANEW
from skinbake.gltf.document import GLB_SUFFIXES, read_document
from skinbake.gltf.resources import is_there
from skinbake.gltf.writing.beside import NamedFile, named_files
from skinbake.jobs.remote.storages import Storage, reading, reason, storage_of, writing
from skinbake.jobs.work import Job, Makes, ResultT
from skinbake.timing import stage

T = TypeVar("T")

PREFIX = "skinbake-"
"""How the names of private folders begin."""


class End(NamedTuple):
    """One end of a job: the user's name for the file, and the place of the file.

    ``name`` is the name in the storage. Without a storage it is a path of this machine.
    """

    given: str
    storage: Storage | None
    name: str

    @classmethod
    def of(cls, given: str) -> End:
        """Return the end that a path or URL names. Raises InputError if a URL's driver is missing."""
        return cls(given, *(storage_of(given) if is_url(given) else (None, given)))

    @property
    def folder(self) -> str:
        """The folder in the storage, empty at its root; on this machine's disk the real path."""
        folder = posixpath.dirname(self.name)
        return folder if self.storage is not None else Path(os.path.realpath(folder)).as_posix()


class _Mirror:
    """A private folder, in which each storage has a folder with the storage's names."""

    def __init__(self, root: str) -> None:
        self.root = Path(os.path.realpath(root))
        self.storages: list[Storage] = []

    def folder(self, storage: Storage) -> Path:
        """Return the folder of a storage."""
        if storage not in self.storages:
            self.storages.append(storage)
        return self.root / str(self.storages.index(storage))

    def path(self, end: End, name: str | None = None) -> str:
        """Return the local path of an end, or of a name in its storage, and make its folder.

        Raises InputError if the path would be elsewhere.
        """
        if end.storage is None:
            return end.name if name is None else name
        mirror = self.folder(end.storage)
        path = Path(os.path.normpath(mirror / (name or end.name)))
        if path == mirror or not path.is_relative_to(mirror):
            raise InputError("not the name of a file", Place(end.storage.public_name(name or end.name)))
        path.parent.mkdir(parents=True, exist_ok=True)
        return str(path)

    def top(self, end: End, given: str | None) -> str | None:
        """Return the local path of a folder that the user named; None for none, or in another storage."""
        if given is None or end.storage is None:
            return None if given is None else on_disk(given)
        other = End.of(given)
        # A name from the root of a storage may begin with a slash, as in SFTP.
        name = posixpath.normpath(other.name).strip("/")
        return os.path.normpath(self.folder(end.storage) / name) if other.storage == end.storage else None

    def bounds(self, end: End, given: Bounds) -> Bounds:
        """Return the folders to which the names of a document at this end may lead."""
        allowed = (self.top(end, folder) for folder in given.allowed)
        return Bounds(self.top(end, given.root), tuple(filter(None, allowed)), fetched=True)

    def names_of(self, end: End, uri: str, bounds: Bounds) -> list[tuple[str, bool]]:
        """Return the names in a storage that a URI of a document may mean, but those outside.

        The likelier is first. With each is whether it is below the document's own root.
        """
        try:
            found = bounded_paths(uri, str(Path(self.path(end)).parent), bounds)
        except RefusedError:
            return []
        top = "" if end.storage is None else f"{self.folder(end.storage)}{os.sep}"
        return [(one.path.removeprefix(top).replace(os.sep, "/"), one.is_own) for one in found]

    def fetch(self, end: End, name: str | None = None) -> str:
        """Return the path at which an input can be read. Raises InputError if there is none."""
        with reading(end.given), stage("fetch"):
            path = self.path(end, name)
            if end.storage is not None:
                end.storage.fetch_file(name or end.name, Path(path))
        return path

    def fetch_named(self, source: End, resource: NamedFile, bounds: Bounds) -> bool:
        """Fetch a file that the source names, if it is there, and tell whether it is."""
        if source.storage is None:
            return is_there(resource.uri, Path(source.name).parent, bounds)
        for name, _ in self.names_of(source, resource.uri, bounds):
            try:
                path = Path(self.path(source, name))
                if not path.is_file():
                    with stage("fetch"):
                        source.storage.fetch_file(name, path)
            except (FileNotFoundError, FileExistsError, NotADirectoryError, InputError, ValueError):
                continue  # it is not there, or no file of this machine can have this name, as on a disk
            except PermissionError as error:
                message = f'cannot read "{resource.uri}" beside it: Permission denied'
                raise InputError(message, Place(source.given)) from error
            except Exception as error:
                if getattr(error, "errno", None) == errno.ENAMETOOLONG:
                    continue
                raise InputError(f"cannot be read: {reason(error)}", Place(source.given)) from error
            return True
        return False

    def states(self, end: End) -> dict[str, tuple[int, int, int]]:
        """Return the names in an end's storage, each with values that change when the file is written."""
        found = {}
        if end.storage is not None:
            for path in self.folder(end.storage).rglob("*"):
                if path.is_file():
                    status = path.stat()
                    name = path.relative_to(self.folder(end.storage)).as_posix()
                    found[name] = (status.st_ino, status.st_mtime_ns, status.st_size)
        return found

    def naming(self, *ends: End) -> Callable[[str], str]:
        """Return a function that replaces the paths in a text by the user's names."""
        names: dict[str, str] = {}
        for number, storage in enumerate(self.storages):
            mirror = str(self.root / str(number))
            names[mirror + os.sep] = names[mirror] = storage.public_name("")
        return naming({**names, **{self.path(end): end.given for end in ends}})


def staged(job: Job, makes: Makes[ResultT], *, pack: bool) -> ResultT:
    """Return ``makes(path, path of the target, within)`` for a job whose source or target is a URL.

    The function writes the same bytes on a disk. The result names files as the user does. Raises
    SkinbakeError, and then the target has not been touched.
    """
    start, goal, within = End.of(job.source), None, job.within
    if job.target is not None:
        try:
            goal = End.of(job.target)
        except InputError as error:
            raise OutputError(error.message, error.place) from error
    is_one = goal is not None and None is not start.storage == goal.storage and start.name == goal.name
    if goal is not None and is_one and start.given != goal.given:
        raise OutputError("it is the input; use --in-place to replace it", Place(goal.given))
    with TemporaryDirectory(prefix=PREFIX, ignore_cleanup_errors=True) as folder:
        mirror = _Mirror(folder)
        path, bounds = mirror.fetch(start), mirror.bounds(start, within.bounds)
        as_read = Path(path).read_bytes() if is_one else None
        for resource in _named(path, bounds):
            if goal is not None:
                there = mirror.fetch_named(start, resource, bounds)
                _place(mirror, start, goal, resource, bounds, within.output, there=there, pack=pack)
            elif resource.array == "buffers":
                mirror.fetch_named(start, resource, bounds)
        if goal is None:
            here = Within(bounds, within.output)
            return with_names(lambda: makes(path, None, here), mirror.naming(start))
        with writing(goal.given):
            made_at = mirror.path(goal)
        before, here = mirror.states(goal), Within(bounds, mirror.top(goal, within.output))
        result = with_names(lambda: makes(path, made_at, here), mirror.naming(start, goal))
        written = [name for name, state in mirror.states(goal).items() if before.get(name) != state]
        if goal.storage is not None and written:
            with noticed(result.notices), writing(goal.given), stage("store"):
                _store(mirror, goal.storage, goal, written, as_read)
        return result


def _named(path: str, bounds: Bounds) -> list[NamedFile]:
    """Return the files that a document names, none if it cannot be read. Its own work reports that."""
    try:
        return [] if path == STDIO else list(named_files(read_document(path, bounds)))
    except InputError:
        return []


def _place(
    mirror: _Mirror,
    start: End,
    goal: End,
    resource: NamedFile,
    bounds: Bounds,
    output: str | None,
    *,
    there: bool,
    pack: bool,
) -> None:
    """Fetch what another file at a target's end has where a copy of a named file goes.

    Raises OutputError if the named file is out of reach of the target.
    """
    uri, is_glb = resource.uri, PurePosixPath(goal.name).suffix.lower() in GLB_SUFFIXES
    found, copy = mirror.names_of(start, uri, bounds), None
    moves = goal.storage != start.storage or goal.folder != start.folder
    if moves and any(is_own for _, is_own in found):
        copy = next((name for name, _ in mirror.names_of(goal, uri, Bounds(mirror.top(goal, output)))), None)
    if copy is not None and goal.storage is not None:
        with writing(goal.given):
            if goal.storage.has_file(copy):
                mirror.fetch(goal, copy)
    if goal.storage == start.storage or copy is not None or (pack and there):
        return
    names = relative_names(uri) if is_relative(uri) else ()
    becomes_chunk = (resource.array, resource.number) == ("buffers", 0) and is_glb
    if names and names[0].startswith("../") and (there or not found) and not becomes_chunk:
        raise OutputError(
            f'"{uri}" is outside the folder of {start.given}, and no relative URI leads there from another '
            "storage",
            Place(goal.given),
        )


def _store(mirror: _Mirror, storage: Storage, goal: End, written: list[str], as_read: bytes | None) -> None:
    """Store the written files, the target last. ``as_read`` is the source, if the target replaces it.

    Raises OutputError if other files have their names, or if the source has other content by now.
    """
    beside = []
    for name in written:
        if name != goal.name:
            if not storage.has_file(name):
                beside.append(name)
            elif not storage.has_content(name, Path(mirror.path(goal, name)).read_bytes()):
                raise OutputError(f"{storage.public_name(name)} is in the way", Place(goal.given))
    if as_read is not None and not storage.has_content(goal.name, as_read):
        raise OutputError(SAVED_ANEW, Place(goal.given))
    # If the target fails, the others stay: the bake of another file may have found them already.
    for name in [*beside, *({goal.name} & set(written))]:
        storage.store_file(name, Path(mirror.path(goal, name)))


def naming(names: Mapping[str, str]) -> Callable[[str], str]:
    """Return a function that replaces paths in a text by other names, the longest first."""
    changed = sorted((path for path in names if names[path] != path), key=len, reverse=True)

    def named(text: str) -> str:
        if not any(path in text for path in changed):
            return text
        return re.sub("|".join(map(re.escape, changed)), lambda match: names[match.group()], text)

    return named


def with_names(call: Callable[[], T], named: Callable[[str], str]) -> T:
    """Return the result of the call, or raise its error, with the naming applied to every text in it."""
    try:
        return _renamed(call(), named)
    except SkinbakeError as error:
        raise _renamed(error, named) from error


def _renamed(value: T, named: Callable[[str], str]) -> T:
    """Return a value with the naming applied to every text in it."""
    renamed: object = value
    if isinstance(value, Message):
        renamed = Message(*(named(part) if isinstance(part, str) else part for part in value.parts))
    elif isinstance(value, str):
        renamed = named(value) if type(value) is str else value
    elif isinstance(value, SkinbakeError):
        renamed = type(value)(_renamed(value.message, named), _renamed(value.place, named))
        renamed.notices = _renamed(value.notices, named)
    elif is_dataclass(value) and not isinstance(value, type):
        texts = {f.name: _renamed(getattr(value, f.name), named) for f in fields(value) if f.init}
        renamed = replace(value, **texts)
    elif isinstance(value, tuple) and hasattr(value, "_make"):
        renamed = value._make(_renamed(item, named) for item in value)
    elif isinstance(value, tuple | list):
        renamed = type(value)(_renamed(item, named) for item in value)
    elif isinstance(value, dict):
        renamed = {_renamed(key, named): _renamed(item, named) for key, item in value.items()}
    return cast("T", renamed)
