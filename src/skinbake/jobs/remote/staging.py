"""Commands for files that are not on this machine's disk.

The files are fetched into a private folder. The functions for local files work on them there. Then the
written files are stored again. The private folder mirrors the names of the storage, as far as one file's work
needs them. So relative URIs, ``../`` among them, mean the same file there as in the storage. Every rule about
files beside a document holds as it does on a disk.
"""

from __future__ import annotations

import os
import posixpath
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Protocol, TypeVar, cast

from skinbake.errors import InputError, Message, OutputError, Place, SkinbakeError, noticed
from skinbake.files.bounds import BESIDE, Bounds, Within
from skinbake.files.urls import STDIO, is_url, on_disk
from skinbake.files.writing import SAVED_ANEW
from skinbake.gltf.document import GLB_SUFFIXES
from skinbake.jobs.remote.ends import End, is_copied, leads_out, names_of, needed, resources_of
from skinbake.jobs.remote.private_folder import PrivateFolder
from skinbake.jobs.remote.storages import Storage, storage_of, writing
from skinbake.jobs.work import Makes, ResultT
from skinbake.timing import stage

if TYPE_CHECKING:
    from skinbake.gltf.output import Writing


T = TypeVar("T")

ATTEMPTS = 8
"""The number of times that a file is made if the files beside its target have changed."""


class RemoteDisk(Storage, Protocol):
    """A storage that stands for the disk of another machine."""

    def name_of(self, path: str) -> str:
        """Return the storage's name of the file that a path means on that machine."""


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
        if goal is not None and start.given != goal.given and _one_file(start, goal):
            raise OutputError("it is the input; use --in-place to replace it", Place(goal.given))
        taken: frozenset[str] = frozenset()
        for _ in range(ATTEMPTS):
            with PrivateFolder(self.workspace) as folder:
                result, clashing = _attempt(folder, start, goal, makes, how, within, taken)
            if not clashing:
                return result
            taken |= clashing
        assert goal is not None
        raise OutputError("cannot be written: the files beside it keep changing", Place(goal.given))

    def read(self, source: str, bounds: Bounds, reads: Callable[[str, Bounds], T]) -> T:
        """Return ``reads(path, bounds)`` for a file, which may be a URL.

        Raises SkinbakeError if the file cannot be read.
        """
        end = self.end_of(source, bounds)
        with PrivateFolder(self.workspace) as folder:
            path = folder.fetch_input(end)
            here = folder.bounds_of(end, bounds)
            for resource in resources_of(path, here):
                if resource.array == "buffers":
                    folder.fetch_named(end, resource, here, with_content=True)
            return with_names(lambda: reads(path, here), folder.naming((end, path)))

    def end_of(self, given: str, bounds: Bounds = BESIDE) -> End:
        """Return the end that a path or URL names. Raises InputError if a URL's driver is missing.

        Only the folders of ``bounds`` in the same storage count.
        """
        storage, name = self._storage_of(given)
        if storage is None:
            roots = [posixpath.dirname(name) if bounds.root is None else bounds.root, *bounds.allowed]
            here = (on_disk(root) for root in roots)
            tops = tuple(Path(os.path.realpath(root)).as_posix() for root in here if root is not None)
            return End(given, None, name, tops)
        own = posixpath.dirname(name) if bounds.root is None else _top(self._storage_of(bounds.root)[1])
        allowed = [self._storage_of(folder) for folder in bounds.allowed if given != STDIO]
        return End(given, storage, name, (own, *(_top(top) for other, top in allowed if other == storage)))

    def _target_end(self, target: str, root: str | None) -> End:
        try:
            return self.end_of(target, Bounds(root))
        except InputError as error:
            raise OutputError(error.message, error.place) from error

    def _storage_of(self, given: str) -> tuple[Storage | None, str]:
        """Return the storage of a path or URL, None for this machine's disk, and the name in it."""
        if is_url(given):
            return storage_of(given)
        if self.disk is None or given == STDIO:
            return None, given
        return self.disk, self.disk.name_of(given)


def _top(name: str) -> str:
    """Return the name of a folder in a storage, empty for its root."""
    normal = posixpath.normpath(name).strip("/") if not name.startswith("/") else posixpath.normpath(name)
    return "" if normal == "." else normal


def _one_file(first: End, second: End) -> bool:
    return first.storage is not None and first.storage == second.storage and first.name == second.name


def _attempt(
    folder: PrivateFolder,
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
    # Fetch the files that the document names. Some a relative URI of the target cannot reach.
    for resource, with_content in needed(resources_of(path, bounds), source, target, pack=how.pack):
        there = folder.fetch_named(source, resource, bounds, with_content=with_content)
        if target is None or target.storage == source.storage or is_copied(resource, source, target):
            continue
        if how.pack and there:
            continue
        outside = not names_of(resource, source)
        if not leads_out(resource) or not (there or outside):
            continue
        first = (resource.array, resource.number) == ("buffers", 0)
        if not (first and PurePosixPath(target.name).suffix.lower() in GLB_SUFFIXES):
            raise OutputError(
                f'"{resource.uri}" is outside the folder of {source.given}, and no relative URI leads there '
                "from another storage",
                Place(target.given),
            )
    goal = None if target is None else folder.path_of_target(target)
    if target is not None:
        with writing(target.given):
            for name in taken:
                folder.fetch_file(target.storage, name)
    before = folder.files_of(target)
    as_read = folder.kept(path) if target is not None and _one_file(source, target) else None
    is_stored = target is not None and target.storage is not None
    output = within.output if target is None else folder.output_of(target, within.output)
    how = how._replace(sync=how.sync and not is_stored, keeps_notes=False)
    naming = folder.naming((source, path), (target, goal))
    result = with_names(lambda: makes(path, goal, how, Within(bounds, output)), naming)
    written = [name for name, state in folder.files_of(target).items() if before.get(name) != state]
    if target is None or target.storage is None or not written:
        return result, frozenset()
    with noticed(result.notices):
        return result, _stored(folder, target.storage, target, written, as_read)


def _stored(
    folder: PrivateFolder, storage: Storage, target: End, written: list[str], as_read: Path | None
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


def with_names(call: Callable[[], T], naming: Callable[[str], str]) -> T:
    """Return the result of the call, or raise its error, with the naming applied to every text in it."""
    try:
        return _renamed(call(), naming)
    except SkinbakeError as error:
        raise _renamed_error(error, naming) from error


def _renamed_error(error: SkinbakeError, naming: Callable[[str], str]) -> SkinbakeError:
    renamed = type(error)(_renamed(error.message, naming), _renamed(error.place, naming))
    renamed.notices = _renamed(error.notices, naming)
    return renamed


def _renamed(value: T, naming: Callable[[str], str]) -> T:
    """Return a value with the naming applied to every text in it."""
    renamed: object = value
    if isinstance(value, Message):
        renamed = Message(*(naming(part) if isinstance(part, str) else part for part in value.parts))
    elif isinstance(value, str):
        renamed = naming(value) if type(value) is str else value
    elif isinstance(value, SkinbakeError):
        renamed = _renamed_error(value, naming)
    elif is_dataclass(value) and not isinstance(value, type):
        texts = {f.name: _renamed(getattr(value, f.name), naming) for f in fields(value) if f.init}
        renamed = replace(value, **texts)
    elif isinstance(value, tuple) and hasattr(value, "_make"):
        renamed = value._make(_renamed(item, naming) for item in value)
    elif isinstance(value, tuple | list):
        renamed = type(value)(_renamed(item, naming) for item in value)
    elif isinstance(value, dict):
        renamed = {_renamed(key, naming): _renamed(item, naming) for key, item in value.items()}
    return cast("T", renamed)
