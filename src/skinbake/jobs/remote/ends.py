"""The two ends of a job, and the files that a document at an end names."""

from __future__ import annotations

import os
import posixpath
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from skinbake.errors import InputError
from skinbake.files.bounds import Bounds, RefusedError, is_relative, leads_up, relative_names
from skinbake.files.urls import STDIO
from skinbake.gltf.beside import NamedFile, named_files
from skinbake.gltf.document import read_document
from skinbake.jobs.remote.storages import Storage


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
        if pack or resource.array == "buffers" or is_copied(resource, source, target):
            yield resource, True
        elif leads_out(resource) or (target is not None and target.name in names_of(resource, source)):
            yield resource, False


def leads_out(resource: NamedFile) -> bool:
    """Tell whether a file is outside the document's folder."""
    return is_relative(resource.uri) and leads_up(relative_names(resource.uri)[0])


def is_copied(resource: NamedFile, source: End, target: End | None) -> bool:
    """Tell whether a file goes to the target's folder under its own relative path."""
    if target is None or (target.storage == source.storage and target.folder == source.folder):
        return False
    if not is_relative(resource.uri):
        return False
    name = posixpath.normpath(posixpath.join(target.folder, relative_names(resource.uri)[0]))
    own = replace(source, tops=source.tops[:1])
    return bool(names_of(resource, own)) and _is_below(name, target.tops[0])
