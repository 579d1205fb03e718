"""Commands for files that are not on this machine's disk.

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
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Protocol, TypeVar, cast

from skinbake.errors import InputError, OutputError, Place, SkinbakeError, noticed
from skinbake.files.bounds import BESIDE, Bounds, RefusedError, Within, is_relative, leads_up, relative_names
from skinbake.files.temporary import OWNER, has_ended, owner
from skinbake.files.urls import is_url, on_disk
from skinbake.files.writing import SAVED_ANEW
from skinbake.gltf.beside import NamedFile, named_files
from skinbake.gltf.document import GLB_SUFFIXES, STDIO, read_document
from skinbake.gltf.resources import is_there
from skinbake.jobs.remote.storages import Storage, located, reading, writing
from skinbake.jobs.work import Makes, ResultT
from skinbake.timing import stage

if TYPE_CHECKING:
    from skinbake.gltf.output import Writing

T = TypeVar("T")

ATTEMPTS = 8
"""The number of times that a file is made if the files beside its target have changed."""


PRIVATE = re.compile(rf"skinbake-{OWNER}\w{{8}}")
"""The names of private folders whose owner is known."""


class RemoteDisk(Storage, Protocol):
    """A storage that stands for the disk of another machine."""

    def name_of(self, path: str) -> str:
        """Return the storage's name of the file that a path means on that machine."""


@dataclass(frozen=True, slots=True)
class End:
    """One end of a job: the user's name for the file, and the place of the file.

    ``name`` is the name in the storage. Without a storage it is a path of this machine. ``tops`` are the
    folders in the storage that a document's names may lead to. The document's own folder is the first.
    """

    given: str
    storage: Storage | None
    name: str
    tops: tuple[str, ...]

    @property
    def folder(self) -> str:
        """The folder in the storage, empty at its root; on this machine's disk the real path."""
        folder = posixpath.dirname(self.name)
        return folder if self.storage is not None else Path(os.path.realpath(folder)).as_posix()


@dataclass(frozen=True, slots=True)
class Staging:
    """Work on files that are not on this machine's disk, in private folders in ``workspace``.

    ``disk`` is the disk that plain paths lead to. None means this machine's disk. If the workspace is None,
    it is the system's folder of temporary files.
    """

    disk: RemoteDisk | None = None
    workspace: str | None = None

    def write(
        self, source: str, target: str | None, makes: Makes[ResultT], how: Writing, within: Within
    ) -> ResultT:
        """Return ``makes(path, path of the target, how, within)``, where source and target may be URLs.

        The function writes the same bytes on a disk. The result names files as the user does. Raises
        SkinbakeError, and then the target has not been touched.
        """
        goal = None if target is None else self._target_end(target, within.output)
        start = self.end_of(source, within.bounds)
        return _made_between(start, goal, makes, how, within, self.workspace)

    def read(self, source: str, bounds: Bounds, reads: Callable[[str, Bounds], T]) -> T:
        """Return ``reads(path, bounds)`` for a file, which may be a URL.

        Raises SkinbakeError if the file cannot be read.
        """
        return _read_at(self.end_of(source, bounds), reads, bounds, self.workspace)

    def end_of(self, given: str, bounds: Bounds = BESIDE) -> End:
        """Return the end that a path or URL names. Raises InputError if a URL's driver is missing.

        Only the folders of ``bounds`` in the same storage count.
        """
        storage, name = self._place_of(given)
        if storage is None:
            roots = [posixpath.dirname(name) if bounds.root is None else bounds.root, *bounds.allowed]
            here = (on_disk(root) for root in roots)
            tops = tuple(Path(os.path.realpath(root)).as_posix() for root in here if root is not None)
            return End(given, None, name, tops)
        own = posixpath.dirname(name) if bounds.root is None else _top(self._place_of(bounds.root)[1])
        allowed = [self._place_of(folder) for folder in bounds.allowed if given != STDIO]
        return End(given, storage, name, (own, *(_top(top) for other, top in allowed if other == storage)))

    def _target_end(self, target: str, root: str | None) -> End:
        try:
            return self.end_of(target, Bounds(root))
        except InputError as error:
            raise OutputError(error.message, error.place) from error

    def _place_of(self, given: str) -> tuple[Storage | None, str]:
        """Return the storage of a path or URL, None for this machine's disk, and the name in it."""
        if is_url(given):
            return located(given)
        if self.disk is None or given == STDIO:
            return None, given
        return self.disk, self.disk.name_of(given)


def _top(name: str) -> str:
    """Return the name of a folder in a storage, empty for its root."""
    normal = posixpath.normpath(name).strip("/") if not name.startswith("/") else posixpath.normpath(name)
    return "" if normal == "." else normal


def _read_at(source: End, reads: Callable[[str, Bounds], T], given: Bounds, workspace: str | None) -> T:
    """Read the file at an end, through a private folder if it is in a storage; may raise SkinbakeError."""
    with _PrivateFolder(workspace) as folder:
        path = folder.fetch_input(source)
        bounds = folder.bounds_of(source, given)
        for resource in resources_of(path, bounds):
            if resource.array == "buffers":
                folder.fetch_named(source, resource, bounds, with_content=True)
        naming = folder.naming((source, path))
        return _named(lambda: reads(path, bounds), naming)


def _made_between(
    source: End,
    target: End | None,
    makes: Makes[ResultT],
    how: Writing,
    within: Within,
    workspace: str | None,
) -> ResultT:
    """Make a file from one end to another, through a private folder. On a SkinbakeError nothing is stored."""
    if target is not None and source.given != target.given and _one_file(source, target):
        raise OutputError("it is the input; use --in-place to replace it", Place(target.given))
    taken: frozenset[str] = frozenset()
    for _ in range(ATTEMPTS):
        with _PrivateFolder(workspace) as folder:
            result, clashing = _attempt(folder, source, target, makes, how, within, taken)
        if not clashing:
            return result
        taken |= clashing
    assert target is not None
    raise OutputError("cannot be written: the files beside it keep changing", Place(target.given))


def _one_file(first: End, second: End) -> bool:
    return first.storage is not None and first.storage == second.storage and first.name == second.name


def _attempt(
    folder: _PrivateFolder,
    source: End,
    target: End | None,
    makes: Makes[ResultT],
    how: Writing,
    within: Within,
    taken: frozenset[str],
) -> tuple[ResultT, frozenset[str]]:
    """Return the result, and the names that other files in the target's storage have.

    If there are such names, nothing is stored. ``taken`` are the names known from earlier attempts. The
    function sees their files, and gives its own files other names.
    """
    path = folder.fetch_input(source)
    bounds = folder.bounds_of(source, within.bounds)
    _fetch_needed(folder, source, path, target, bounds, pack=how.pack)
    goal = None if target is None else folder.path_of_target(target)
    if target is not None:
        with writing(target.given):
            for name in taken:
                folder.fetch_file(target.storage, name)
    before = folder.files_of(target)
    as_read = folder.kept(path) if target is not None and _one_file(source, target) else None
    is_stored = target is not None and target.storage is not None
    output = within.output if target is None else folder.output_of(target, within.output)
    how = replace(how, sync=how.sync and not is_stored)
    naming = folder.naming((source, path), (target, goal))
    result = _named(lambda: makes(path, goal, how, Within(bounds, output)), naming)
    written = [name for name, state in folder.files_of(target).items() if before.get(name) != state]
    if target is None or target.storage is None or not written:
        return result, frozenset()
    with noticed(result.notices):
        return result, _stored(folder, target.storage, target, written, as_read)


def _stored(
    folder: _PrivateFolder, storage: Storage, target: End, written: list[str], as_read: Path | None
) -> frozenset[str]:
    """Store the written files, the target last. If other files have their names, store none; return these.

    ``as_read`` has the content of the source, if the target replaces it. Raises OutputError if the source has
    other content by now.
    """
    beside = [name for name in written if name != target.name]
    with writing(target.given), stage("store"):
        there = {name for name in beside if storage.has_file(name)}
        clashing = {name for name in there if not storage.has_content(name, folder.path_of(storage, name))}
        if clashing:
            return frozenset(clashing)
        if as_read is not None and not storage.has_content(target.name, as_read):
            raise OutputError(SAVED_ANEW, Place(target.given))
        # If the target fails, these stay: the bake of another file may have found them already.
        for name in beside:
            if name not in there:
                storage.store_file(name, folder.path_of(storage, name))
        if target.name in written:
            storage.store_file(target.name, folder.path_of(storage, target.name))
    return frozenset()


def resources_of(path: str, bounds: Bounds) -> list[NamedFile]:
    """Return the files that a document names, none if it cannot be read. Its own work reports that."""
    if path == STDIO:
        return []
    try:
        return list(named_files(read_document(path, bounds)))
    except InputError:
        return []


def names_of(resource: NamedFile, end: End) -> list[str]:
    """Return the names that a file may have in the storage of the document. The likelier one is first.

    Names outside the folders that the document may name are left out.
    """
    try:
        relative = relative_names(resource.uri)
    except RefusedError:
        return []
    found = (posixpath.normpath(posixpath.join(end.folder, name)) for name in relative)
    return [name for name in found if any(_is_below(name, top) for top in end.tops)]


def _is_below(name: str, folder: str) -> bool:
    return name.startswith(f"{folder}/") if folder else not leads_up(name)


def needed(
    found: Sequence[NamedFile], source: End, target: End | None, *, pack: bool = False
) -> Iterator[tuple[NamedFile, bool]]:
    """Yield the files that a bake reads, copies or looks for, and for each whether its content is needed.

    With ``pack``, it reads all of them.
    """
    for resource in found:
        if pack or resource.array == "buffers" or _is_copied(resource, source, target):
            yield resource, True
        elif _leads_out(resource) or (target is not None and target.name in names_of(resource, source)):
            yield resource, False


def _leads_out(resource: NamedFile) -> bool:
    """Tell whether a file is outside the document's folder."""
    return is_relative(resource.uri) and leads_up(relative_names(resource.uri)[0])


def _is_copied(resource: NamedFile, source: End, target: End | None) -> bool:
    """Tell whether a file goes to the target's folder under its own relative path."""
    if target is None or (target.storage == source.storage and target.folder == source.folder):
        return False
    if not is_relative(resource.uri):
        return False
    name = posixpath.normpath(posixpath.join(target.folder, relative_names(resource.uri)[0]))
    own = replace(source, tops=source.tops[:1])
    return bool(names_of(resource, own)) and _is_below(name, target.tops[0])


def _fetch_needed(
    folder: _PrivateFolder, source: End, path: str, target: End | None, bounds: Bounds, *, pack: bool
) -> None:
    """Fetch the files for a bake. Raises OutputError if no relative URI of the target can reach one."""
    for resource, with_content in needed(resources_of(path, bounds), source, target, pack=pack):
        there = folder.fetch_named(source, resource, bounds, with_content=with_content)
        if target is None or target.storage == source.storage or _is_copied(resource, source, target):
            continue
        if pack and there:
            continue
        outside = not names_of(resource, source)
        if not _leads_out(resource) or not (there or outside):
            continue
        first = (resource.array, resource.number) == ("buffers", 0)
        if not (first and PurePosixPath(target.name).suffix.lower() in GLB_SUFFIXES):
            raise OutputError(
                f'"{resource.uri}" is outside the folder of {source.given}, and no relative URI leads there '
                "from another storage",
                Place(target.given),
            )


class _PrivateFolder:
    """A private folder, in which each storage has a mirror."""

    def __init__(self, workspace: str | None) -> None:
        import tempfile

        _remove_abandoned(workspace or tempfile.gettempdir())
        prefix = f"skinbake-{owner(os.getpid())}"
        self._folder = tempfile.TemporaryDirectory(prefix=prefix, dir=workspace, ignore_cleanup_errors=True)
        self.root = Path(os.path.realpath(self._folder.name))
        self._storages: list[Storage] = []

    def __enter__(self) -> _PrivateFolder:
        return self

    def __exit__(self, *_: object) -> None:
        self._folder.cleanup()

    def _mirror(self, storage: Storage) -> Path:
        if storage not in self._storages:
            self._storages.append(storage)
        return self.root / str(self._storages.index(storage))

    def path_of(self, storage: Storage, name: str) -> Path:
        """Return the local path for a name of the storage. Raises InputError if it would be elsewhere."""
        mirror = self._mirror(storage)
        path = Path(os.path.normpath(mirror / name))
        if path == mirror or not path.is_relative_to(mirror):
            raise InputError("not the name of a file", Place(storage.public_name(name)))
        return path

    def folder_of(self, storage: Storage, name: str) -> str:
        """Return the path of the mirror of a folder of the storage."""
        return os.path.normpath(self._mirror(storage) / name)

    def bounds_of(self, end: End, given: Bounds) -> Bounds:
        """Return the folders to which the names of a document at this end may lead."""
        if end.storage is None:
            root = None if given.root is None else on_disk(given.root)
            return Bounds(root, tuple(filter(None, map(on_disk, given.allowed))))
        own, *allowed = (self.folder_of(end.storage, top) for top in end.tops)
        return Bounds(own, tuple(allowed))

    def output_of(self, end: End, given: str | None) -> str | None:
        """Return the folder that a target is written below."""
        if end.storage is None:
            return None if given is None else on_disk(given)
        return self.folder_of(end.storage, end.tops[0])

    def path_of_target(self, end: End) -> str:
        """Return the path for writing a target. If the target is in a storage, the folder is made."""
        if end.storage is None:
            return end.name
        path = self.path_of(end.storage, end.name)
        with writing(end.given):
            path.parent.mkdir(parents=True, exist_ok=True)
        return str(path)

    def fetch_input(self, end: End) -> str:
        """Return the path at which an input can be read. Raises InputError if there is none."""
        if end.storage is None:
            return end.name
        with reading(end.given), stage("fetch"):
            return str(self.fetch_file(end.storage, end.name))

    def fetch_file(self, storage: Storage | None, name: str) -> Path:
        """Copy a file of the storage to its place here. Raises the errors of the storage."""
        assert storage is not None
        path = self.path_of(storage, name)
        path.parent.mkdir(parents=True, exist_ok=True)
        storage.fetch_file(name, path)
        return path

    def fetch_named(self, source: End, resource: NamedFile, bounds: Bounds, *, with_content: bool) -> bool:
        """Fetch a file that the source names, or make an empty one in its place. Tell whether it exists."""
        if source.storage is None:
            return is_there(resource.uri, Path(source.name).parent, bounds)
        with reading(source.given), stage("fetch"):
            for name in names_of(resource, source):
                try:
                    if self._is_fetched(source.storage, name, with_content=with_content):
                        return True
                except FileNotFoundError:
                    continue
                except PermissionError as error:
                    raise InputError(
                        f'cannot read "{resource.uri}" beside it: Permission denied', Place(source.given)
                    ) from error
        return False

    def _is_fetched(self, storage: Storage, name: str, *, with_content: bool) -> bool:
        try:
            path = self.path_of(storage, name)
            if path.is_file():
                return True
            path.parent.mkdir(parents=True, exist_ok=True)
        except (InputError, ValueError, FileExistsError, NotADirectoryError):
            return False  # no file of this machine can have this name, as on a disk
        except OSError as error:
            if error.errno == errno.ENAMETOOLONG:
                return False
            raise
        if with_content:
            storage.fetch_file(name, path)
        elif storage.has_file(name):
            path.touch()
        return path.is_file()

    def kept(self, path: str) -> Path:
        """Return a second name for a fetched file, which stays as it is when the file is replaced."""
        second = self.root / "as-read"
        try:
            os.link(path, second)
        except OSError:  # a file system without second names
            shutil.copyfile(path, second)
        return second

    def files_of(self, end: End | None) -> dict[str, tuple[int, int, int]]:
        """Return the names in an end's mirror, each with values that change when the file is written."""
        if end is None or end.storage is None:
            return {}
        mirror = self._mirror(end.storage)
        found = {}
        for folder, _, names in os.walk(mirror):
            for name in names:
                path = Path(folder, name)
                status = path.stat()
                state = (status.st_ino, status.st_mtime_ns, status.st_size)
                found[path.relative_to(mirror).as_posix()] = state
        return found

    def naming(self, *ends: tuple[End | None, str | None]) -> Callable[[str], str]:
        """Return a function that replaces the paths in a text by the user's names."""
        names = {path: end.given for end, path in ends if end is not None and path is not None}
        for number, storage in enumerate(self._storages):
            mirror = str(self.root / str(number))
            names[mirror + os.sep] = names[mirror] = storage.public_name("")
        changed = sorted((path for path in names if names[path] != path), key=len, reverse=True)

        def named(text: str) -> str:
            if not any(path in text for path in changed):
                return text
            return re.sub("|".join(map(re.escape, changed)), lambda match: names[match.group()], text)

        return named


@lru_cache(maxsize=1)
def _remove_abandoned(workspace: str) -> None:
    """Remove the private folders of ended processes, for example of a worker that was killed."""
    with suppress(OSError), os.scandir(workspace) as entries:  # such folders do no harm
        for entry in entries:
            found = PRIVATE.fullmatch(entry.name)
            if found is None or not entry.is_dir(follow_symlinks=False) or not has_ended(found):
                continue
            if entry.stat(follow_symlinks=False).st_uid == os.getuid():
                shutil.rmtree(entry.path, ignore_errors=True)


def _named(call: Callable[[], T], naming: Callable[[str], str]) -> T:
    """Return the result of the call, or raise its error, with the naming applied to every text in it."""
    try:
        return _renamed(call(), naming)
    except SkinbakeError as error:
        raise _renamed_error(error, naming) from error


def _renamed_error(error: SkinbakeError, naming: Callable[[str], str]) -> SkinbakeError:
    renamed = type(error)(naming(error.message), _renamed(error.place, naming))
    renamed.notices = _renamed(error.notices, naming)
    return renamed


def _renamed(value: T, naming: Callable[[str], str]) -> T:
    """Return a value with the naming applied to every text in it."""
    renamed: object = value
    if isinstance(value, str):
        renamed = naming(value) if type(value) is str else value
    elif isinstance(value, SkinbakeError):
        renamed = _renamed_error(value, naming)
    elif is_dataclass(value) and not isinstance(value, type):
        texts = {f.name: _renamed(getattr(value, f.name), naming) for f in fields(value) if f.init}
        renamed = replace(value, **texts)
    elif isinstance(value, tuple | list):
        renamed = type(value)(_renamed(item, naming) for item in value)
    elif isinstance(value, dict):
        renamed = {_renamed(key, naming): _renamed(item, naming) for key, item in value.items()}
    return cast("T", renamed)
