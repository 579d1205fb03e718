"""A private folder that mirrors storages: a file has the name there that it has in its storage."""

from __future__ import annotations

import errno
import os
import re
import shutil
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

from skinbake.errors import InputError, Place
from skinbake.files.bounds import Bounds
from skinbake.files.temporary import OWNER, has_ended, owner
from skinbake.files.urls import on_disk
from skinbake.gltf.beside import NamedFile
from skinbake.gltf.resources import is_there
from skinbake.jobs.remote.ends import End, names_of
from skinbake.jobs.remote.storages import Storage, reading, writing
from skinbake.timing import stage

PRIVATE = re.compile(rf"skinbake-{OWNER}\w{{8}}")
"""The names of private folders whose owner is known."""


class PrivateFolder:
    """A private folder, in which each storage has a mirror."""

    def __init__(self, workspace: str | None) -> None:
        import tempfile

        _remove_abandoned(workspace or tempfile.gettempdir())
        prefix = f"skinbake-{owner(os.getpid())}"
        self._folder = tempfile.TemporaryDirectory(prefix=prefix, dir=workspace, ignore_cleanup_errors=True)
        self.root = Path(os.path.realpath(self._folder.name))
        self._storages: list[Storage] = []

    def __enter__(self) -> PrivateFolder:
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
