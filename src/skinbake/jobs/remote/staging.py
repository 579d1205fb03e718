"""bake and verify for files that are not on this machine's disk.

They are fetched into a private folder, worked on there by the functions that local files go through, and
what was written is stored again. In the private folder stands a mirror of the storage's names, as far as
one file's work needs it: relative URIs, ``../`` among them, mean there what they mean in the storage, and
every rule about files beside a document holds as it does on a disk.
"""

from __future__ import annotations

import errno
import logging
import os
import posixpath
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from skinbake.containment import (
    BESIDE,
    OWN_FOLDERS,
    Bounds,
    RefusedError,
    Within,
    is_relative,
    leads_up,
    relative_names,
)
from skinbake.errors import InputError, OutputError, Place, SkinbakeError, defect
from skinbake.gltf.beside import NamedFile, named_files
from skinbake.gltf.document import GLB_SUFFIXES, STDIO, read_document
from skinbake.gltf.resources import is_there
from skinbake.jobs.remote.storages import Storage, located, reading, writing
from skinbake.timing import stage as timed
from skinbake.urls import is_url, on_disk

if TYPE_CHECKING:
    from skinbake.commands.bake import BakeOptions
    from skinbake.lighting.measured import Progress, VerifyOptions
    from skinbake.report.bake import FileResult
    from skinbake.report.verify import FileVerdict

logger = logging.getLogger(__name__)
T = TypeVar("T")

ATTEMPTS = 8
"""How often a bake is tried that finds other files beside its target than it did before."""

_workspace: ContextVar[str | None] = ContextVar("_workspace", default=None)


class Cargo(Storage, Protocol):
    """A storage that stands for the disk of another machine."""

    def name_of(self, path: str) -> str:
        """Return the name of what a path means on that machine."""


_cargo: ContextVar[Cargo | None] = ContextVar("_cargo", default=None)


@contextmanager
def staged_in(folder: str | None) -> Iterator[None]:
    """Make private folders in this one while the block runs, not where the system has its temporary ones."""
    token = _workspace.set(folder)
    try:
        yield
    finally:
        _workspace.reset(token)


@contextmanager
def carrying(cargo: Cargo) -> Iterator[None]:
    """Take plain paths for those of the machine for whose disk the cargo stands, while the block runs."""
    token = _cargo.set(cargo)
    try:
        yield
    finally:
        _cargo.reset(token)


@dataclass(frozen=True, slots=True)
class End:
    """One end of a job: what the user calls the file, and where it is.

    ``name`` is that in the storage, or a path of this machine's where there is no storage. ``tops`` are
    the folders in the storage that a document's names may lead to, its own first.
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


def end_of(given: str, bounds: Bounds = BESIDE) -> End:
    """Return the end that a path or URL names; InputError where a URL's driver is missing.

    Of the folders in ``bounds`` those count that are in the same storage.
    """
    storage, name = _place_of(given)
    if storage is None:
        roots = [posixpath.dirname(name) if bounds.root is None else bounds.root, *bounds.allowed]
        here = (on_disk(root) for root in roots)
        tops = tuple(Path(os.path.realpath(root)).as_posix() for root in here if root is not None)
        return End(given, None, name, tops)
    own = posixpath.dirname(name) if bounds.root is None else _top(_place_of(bounds.root)[1])
    allowed = [_place_of(folder) for folder in bounds.allowed if given != STDIO]
    return End(given, storage, name, (own, *(_top(top) for other, top in allowed if other == storage)))


def _top(name: str) -> str:
    """Return the name of a folder in a storage, empty for its root."""
    normal = posixpath.normpath(name).strip("/") if not name.startswith("/") else posixpath.normpath(name)
    return "" if normal == "." else normal


def _place_of(given: str) -> tuple[Storage | None, str]:
    """Return the storage of a path or URL, None for this machine's disk, and the name in it."""
    if is_url(given):
        return located(given)
    cargo = _cargo.get()
    if cargo is None or given == STDIO:
        return None, given
    return cargo, cargo.name_of(given)


def _is_here(given: str | None) -> bool:
    """Tell whether a name needs no staging: a path of this machine's disk, or none."""
    return given is None or (not is_url(given) and _cargo.get() is None)


def bake_anywhere(
    source: str, target: str | None, options: BakeOptions, within: Within = OWN_FOLDERS
) -> FileResult:
    """Bake one file, as ``bake_file`` does, where source and target may be URLs.

    What is written is byte for byte what ``bake_file`` writes on a disk; the result calls files as the user
    does. A URL's folder is made where it is missing. Raises nothing: what fails is in the result, and then
    the target has not been touched.
    """
    from skinbake.commands.bake import bake_file

    if _is_here(source) and _is_here(target):
        return bake_file(source, target, options, within)

    def work() -> FileResult:
        goal = None if target is None else _target_end(target, within.output)
        made = options.make_folder or (target is not None and is_url(target))
        start = end_of(source, within.bounds)
        return _bake_between(start, goal, replace(options, make_folder=made), within)

    return _survived(work, source, lambda error: _failed(source, target, error))


def verify_anywhere(
    source: str, options: VerifyOptions, progress: Progress | None = None, within: Within = OWN_FOLDERS
) -> FileVerdict:
    """Verify one file, as ``verify_file`` does, where it may be a URL. Raises nothing."""
    from skinbake.commands.verify import verify_file
    from skinbake.report.verify import FileVerdict

    if _is_here(source):
        return verify_file(source, options, progress, within.bounds)
    return _survived(
        lambda: _verify_at(end_of(source, within.bounds), options, progress, within),
        source,
        lambda error: FileVerdict(source, error=error),
    )


def _target_end(target: str, root: str | None) -> End:
    try:
        return end_of(target, Bounds(root))
    except InputError as error:
        raise OutputError(error.message, error.place) from error


def _failed(source: str, target: str | None, error: SkinbakeError) -> FileResult:
    from skinbake.report.bake import FileResult

    return FileResult(source, target, "failed", error=error)


def _survived(work: Callable[[], T], source: str, failed: Callable[[SkinbakeError], T]) -> T:
    """Return what the work returns, or what stands for its failure: no file fails another one's work."""
    try:
        return work()
    except SkinbakeError as error:
        return failed(error)
    except MemoryError:
        return failed(InputError("it needs more memory than there is", Place(source)))
    except Exception as error:
        logger.debug("where it failed", exc_info=True)
        return failed(defect(error, source))


def _verify_at(source: End, options: VerifyOptions, progress: Progress | None, within: Within) -> FileVerdict:
    """Verify the file at an end, through a private folder if it is in a storage; may raise SkinbakeError."""
    from skinbake.commands.verify import verify_file

    def advance(what: str, done: int, total: int) -> None:
        if progress is not None:
            progress(source.given, done, total)

    with _Stage() as stage:
        path = stage.fetched(source)
        bounds = stage.bounds(source, within.bounds)
        for resource in resources_of(path, bounds):
            if resource.array == "buffers":
                stage.bring(source, resource, bounds, with_content=True)
        verdict = verify_file(path, options, advance, bounds)
        return _renamed(verdict, stage.naming((source, path)))


def _bake_between(source: End, target: End | None, options: BakeOptions, within: Within) -> FileResult:
    """Bake from one end to another, through a private folder; may raise SkinbakeError, nothing stored."""
    if target is not None and source.given != target.given and _one_file(source, target):
        raise OutputError("it is the input; use --in-place to replace it", Place(target.given))
    taken: frozenset[str] = frozenset()
    for _ in range(ATTEMPTS):
        result, clashing = _attempt(source, target, options, within, taken)
        if not clashing:
            return result
        taken |= clashing
    assert target is not None
    raise OutputError("cannot be written: the files beside it keep changing", Place(target.given))


def _one_file(first: End, second: End) -> bool:
    return first.storage is not None and first.storage == second.storage and first.name == second.name


def _attempt(
    source: End, target: End | None, options: BakeOptions, within: Within, taken: frozenset[str]
) -> tuple[FileResult, frozenset[str]]:
    """Return the result, and names in the target's storage that other files have, for which all waits.

    Of files in ``taken`` it is known; the bake sees them, and gives its own other names.
    """
    from skinbake.commands.bake import bake_file

    with _Stage() as stage:
        path = stage.fetched(source)
        bounds = stage.bounds(source, within.bounds)
        _bring_files(stage, source, path, target, bounds)
        goal = None if target is None else stage.place(target)
        if target is not None:
            with writing(target.given):
                for name in taken:
                    stage.fetch(target.storage, name)
        before = stage.files(target)
        stored = target is not None and target.storage is not None
        output = within.output if target is None else stage.output(target, within.output)
        chosen = replace(options, sync=options.sync and not stored)
        result = bake_file(path, goal, chosen, Within(bounds, output))
        naming = stage.naming((source, path), (target, goal))
        result = _renamed(result, naming)
        written = [name for name, state in stage.files(target).items() if before.get(name) != state]
        if result.error is not None or target is None or target.storage is None or not written:
            return result, frozenset()
        try:
            return result, _stored(stage, target.storage, target, written)
        except SkinbakeError as error:
            failed = replace(_failed(source.given, target.given, error), notices=result.notices)
            return failed, frozenset()


def _stored(stage: _Stage, storage: Storage, target: End, written: list[str]) -> frozenset[str]:
    """Store what was written, the target last; or nothing, and return the names that other files have."""
    beside = [name for name in written if name != target.name]
    with writing(target.given), timed("store"):
        there = {name for name in beside if storage.has(name)}
        clashing = {name for name in there if not storage.holds(name, stage.path(storage, name))}
        if clashing:
            return frozenset(clashing)
        # What is stored of these when the target fails stays: another file's bake may have found it already.
        for name in beside:
            if name not in there:
                storage.put(name, stage.path(storage, name))
        if target.name in written:
            storage.put(target.name, stage.path(storage, target.name))
    return frozenset()


def resources_of(path: str, bounds: Bounds) -> list[NamedFile]:
    """Return the files that a document names; none where it cannot be read, which its own work will say."""
    if path == STDIO:
        return []
    try:
        return list(named_files(read_document(path, bounds)))
    except InputError:
        return []


def names_of(resource: NamedFile, end: End) -> list[str]:
    """Return the names that a file may have in the storage of the document, the likelier first.

    Those outside the folders that the document may name are none.
    """
    try:
        relative = relative_names(resource.uri)
    except RefusedError:
        return []
    found = (posixpath.normpath(posixpath.join(end.folder, name)) for name in relative)
    return [name for name in found if any(_is_below(name, top) for top in end.tops)]


def _is_below(name: str, folder: str) -> bool:
    return name.startswith(f"{folder}/") if folder else not leads_up(name)


def needed(found: Sequence[NamedFile], source: End, target: End | None) -> Iterator[tuple[NamedFile, bool]]:
    """Yield the files that a bake reads, copies, or asks after, and for each whether its content counts."""
    for resource in found:
        if resource.array == "buffers" or _is_copied(resource, source, target):
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


def _bring_files(stage: _Stage, source: End, path: str, target: End | None, bounds: Bounds) -> None:
    """Bring what a bake needs; OutputError for a file that no relative URI can reach from the target."""
    for resource, with_content in needed(resources_of(path, bounds), source, target):
        there = stage.bring(source, resource, bounds, with_content=with_content)
        if target is None or target.storage == source.storage or _is_copied(resource, source, target):
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


class _Stage:
    """A private folder, in which each storage has a mirror."""

    def __init__(self) -> None:
        import tempfile

        self._folder = tempfile.TemporaryDirectory(
            prefix="skinbake-", dir=_workspace.get(), ignore_cleanup_errors=True
        )
        self._root = Path(os.path.realpath(self._folder.name))
        self._storages: list[Storage] = []

    def __enter__(self) -> _Stage:
        return self

    def __exit__(self, *_: object) -> None:
        self._folder.cleanup()

    def _mirror(self, storage: Storage) -> Path:
        if storage not in self._storages:
            self._storages.append(storage)
        return self._root / str(self._storages.index(storage))

    def path(self, storage: Storage, name: str) -> Path:
        """Return where a name of the storage stands here; InputError for one that would stand elsewhere."""
        mirror = self._mirror(storage)
        path = Path(os.path.normpath(mirror / name))
        if path == mirror or not path.is_relative_to(mirror):
            raise InputError("not the name of a file", Place(storage.shown(name)))
        return path

    def folder(self, storage: Storage, name: str) -> str:
        """Return where a folder of the storage stands here."""
        return os.path.normpath(self._mirror(storage) / name)

    def bounds(self, end: End, given: Bounds) -> Bounds:
        """Return where the names of a document may lead that is at this end."""
        if end.storage is None:
            root = None if given.root is None else on_disk(given.root)
            return Bounds(root, tuple(filter(None, map(on_disk, given.allowed))))
        own, *allowed = (self.folder(end.storage, top) for top in end.tops)
        return Bounds(own, tuple(allowed))

    def output(self, end: End, given: str | None) -> str | None:
        """Return the folder that a target is written below."""
        if end.storage is None:
            return None if given is None else on_disk(given)
        return self.folder(end.storage, end.tops[0])

    def place(self, end: End) -> str:
        """Return the path at which a target is to be written; its folder is there if it is in a storage."""
        if end.storage is None:
            return end.name
        path = self.path(end.storage, end.name)
        with writing(end.given):
            path.parent.mkdir(parents=True, exist_ok=True)
        return str(path)

    def fetched(self, end: End) -> str:
        """Return the path at which an input can be read; InputError where there is none."""
        if end.storage is None:
            return end.name
        with reading(end.given), timed("fetch"):
            return str(self.fetch(end.storage, end.name))

    def fetch(self, storage: Storage | None, name: str) -> Path:
        """Copy a file of the storage to its place here; raises what the storage raises."""
        assert storage is not None
        path = self.path(storage, name)
        path.parent.mkdir(parents=True, exist_ok=True)
        storage.fetch(name, path)
        return path

    def bring(self, source: End, resource: NamedFile, bounds: Bounds, *, with_content: bool) -> bool:
        """Bring a file that the source names, or an empty one in its place; tell whether there is one."""
        if source.storage is None:
            return is_there(resource.uri, Path(source.name).parent, bounds)
        with reading(source.given), timed("fetch"):
            for name in names_of(resource, source):
                try:
                    if self._brought(source.storage, name, with_content=with_content):
                        return True
                except FileNotFoundError:
                    continue
                except PermissionError as error:
                    raise InputError(
                        f'cannot read "{resource.uri}" beside it: Permission denied', Place(source.given)
                    ) from error
        return False

    def _brought(self, storage: Storage, name: str, *, with_content: bool) -> bool:
        try:
            path = self.path(storage, name)
            if path.is_file():
                return True
            path.parent.mkdir(parents=True, exist_ok=True)
        except (InputError, ValueError, FileExistsError, NotADirectoryError):
            return False  # a name that no file of this machine can have, as on a disk
        except OSError as error:
            if error.errno == errno.ENAMETOOLONG:
                return False
            raise
        if with_content:
            storage.fetch(name, path)
        elif storage.has(name):
            path.touch()
        return path.is_file()

    def files(self, end: End | None) -> dict[str, tuple[int, int, int]]:
        """Return the names in an end's mirror, each with what changes when the file is written."""
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
        """Return what puts the user's names in place of paths in a text."""
        names = {path: end.given for end, path in ends if end is not None and path is not None}
        for number, storage in enumerate(self._storages):
            mirror = str(self._root / str(number))
            names[mirror + os.sep] = names[mirror] = storage.shown("")
        changed = sorted((path for path in names if names[path] != path), key=len, reverse=True)

        def named(text: str) -> str:
            if not any(path in text for path in changed):
                return text
            return re.sub("|".join(map(re.escape, changed)), lambda match: names[match.group()], text)

        return named


def _renamed(value: T, naming: Callable[[str], str]) -> T:
    """Return a result with the naming applied to every text in it."""
    renamed: Any = value
    if type(renamed) is str:
        renamed = naming(renamed)
    elif isinstance(value, SkinbakeError):
        renamed = type(value)(naming(value.message), _renamed(value.place, naming))
    elif is_dataclass(value) and not isinstance(value, type):
        renamed = replace(
            value, **{f.name: _renamed(getattr(value, f.name), naming) for f in fields(value) if f.init}
        )
    elif isinstance(value, tuple | list):
        renamed = type(value)(_renamed(item, naming) for item in value)
    elif isinstance(value, dict):
        renamed = {_renamed(key, naming): _renamed(item, naming) for key, item in value.items()}
    return renamed  # type: ignore[no-any-return]
