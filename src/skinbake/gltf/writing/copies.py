"""Notes of the files that bakes have put beside targets, by which a later bake replaces or removes them.

A folder with such copies has a file of notes. It says of each copy which content was written, from which
file, and for which targets, and of each target which copies it has. A file with other content is the user's,
and is never touched. Documents beside the target are not read: what else names a copy is not known.

Buffers of α and β need no notes. Their name is made from that of their target and from their content.

A copy is replaced in steps, so that the target and its files always fit, also after a power cut:

1. The new content gets a name of its own, and a document that names it replaces the target. This alone is an
   output that is whole.
2. The new content replaces the earlier copy. Other targets that have this copy get it too.
3. The document is planned and written again. It has the bytes that it would have in an empty folder.
4. Copies that no target has any more are removed, that of the first step among them.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from skinbake.errors import OutputError
from skinbake.files import Bytes
from skinbake.files.bounds import below, bounded_path
from skinbake.files.folders import Folder, beneath, open_beneath, open_regular
from skinbake.files.versions import DIGITS, Signature, signature_of
from skinbake.files.writing import locked, write_files
from skinbake.gltf.budget import fits_memory
from skinbake.gltf.document import GLTF_SUFFIX
from skinbake.gltf.resources import BLOCK, FileContent
from skinbake.gltf.writing.additions import content_digest

NAME = ".skinbake-copies.json"
"""The name of the notes. A file of this name that does not begin like notes is left untouched."""

KIND = "skinbake copies/2"

LONGEST = 1 << 22
"""The largest file of notes in bytes: that of some ten thousand copies in one folder."""

CONTENT = re.compile(f"[0-9]+-[0-9a-f]{{{DIGITS}}}")

GRADIENTS = re.compile(r"skinbake-([0-9a-f]{16})\.bin")
"""The name of a buffer of α and β, made from its content, before its target is known."""


def gradients_name(target: Path, digest: str = "") -> str:
    """Return the name of a buffer of α and β beside a target; without a digest, how all of them begin."""
    of = hashlib.sha256(os.fsencode(target.name)).hexdigest()[:8]
    return f"skinbake-{of}-{digest}.bin" if digest else f"skinbake-{of}-"


class Copy(NamedTuple):
    """A copy as noted: its content (two while it is replaced), the files it is of, its targets.

    Paths are relative to the folder of the copy. A content is a size and a digest.
    """

    contents: frozenset[str] = frozenset()
    of: frozenset[str] = frozenset()
    targets: frozenset[str] = frozenset()


class Notes:
    """The notes of one folder below a root. Notes that cannot be read, or are not ours, are empty.

    ``copies`` are the copies in this folder. ``targets`` are the paths of the copies of each target in this
    folder.
    """

    def __init__(self, root: Path, folder: Path) -> None:
        """Read the notes of a folder; neither the folder nor the notes need be there."""
        self.folder, self._root, self._is_ours = folder, root, True
        self.copies: dict[str, Copy] = {}
        self.targets: dict[str, frozenset[str]] = {}
        try:
            descriptor = open_beneath(bounded_path(os.fspath(folder / NAME), os.fspath(root)))
            with os.fdopen(descriptor, "rb") as file:
                found = json.loads(file.read(LONGEST + 1))
            if found["kind"] != KIND:
                raise ValueError("it is not a file of notes")
            for name, one in found["files"].items():
                copy = Copy(*(frozenset(map(str, one[key])) for key in ("contents", "of", "for")))
                if all(map(CONTENT.fullmatch, copy.contents)):
                    self.copies[name] = copy
            self.targets = {name: frozenset(map(str, paths)) for name, paths in found["targets"].items()}
        except FileNotFoundError:
            pass
        except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
            self._is_ours, self.copies, self.targets = False, {}, {}
        self._read = self._former = dict(self.copies), dict(self.targets)

    def opened(self) -> AbstractContextManager[Folder]:
        """Return the open folder as a context. Raises OSError if it is gone, or if a link leads out."""
        inside = below(os.fspath(self.folder), os.fspath(self._root))
        return beneath(os.fspath(self._root), inside.split("/") if inside else ())

    def relative(self, path: str | Path) -> str:
        """Return a path as the notes have it."""
        try:
            return os.path.relpath(path, self.folder).replace(os.sep, "/")
        except ValueError:  # another drive of Windows
            return os.fspath(path)

    def save(self, target: str) -> None:
        """Write the notes if they have changed, whole or not at all. Raises OSError or OutputError.

        Errors name ``target``.
        """
        if not self._is_ours or (self.copies, self.targets) == self._former:
            return
        files = {
            name: {"contents": sorted(copy.contents), "of": sorted(copy.of), "for": sorted(copy.targets)}
            for name, copy in self.copies.items()
        }
        targets = {name: sorted(paths) for name, paths in self.targets.items()}
        text = json.dumps({"kind": KIND, "files": files, "targets": targets}, indent=1, sort_keys=True)
        if files or targets:
            write_files(self._root, {self.folder / NAME: [f"{text}\n".encode("ascii")]}, target, sync=False)
        else:
            with self.opened() as folder:
                os.unlink(folder.name(NAME), dir_fd=folder.descriptor)
        self._former = dict(self.copies), dict(self.targets)

    def undo(self, target: str) -> None:
        """Write the notes as they were read."""
        with suppress(OSError, OutputError):  # they have other content than the files that may get the names
            self.copies, self.targets = self._read
            self.save(target)


@dataclass
class Copies:
    """The copies of a target in ``root``.

    ``used`` are the files that the copies at some paths are of. ``in_the_way`` are the paths where copies
    would be if no other content were there, and where they are instead.
    """

    target: Path
    root: Path
    used: dict[Path, str] = field(default_factory=dict)
    in_the_way: dict[Path, Path] = field(default_factory=dict)
    _contents: dict[Path, str] = field(default_factory=dict)
    _noted: list[Notes] = field(default_factory=list)

    def use(self, path: Path, source: str, pieces: Iterable[Bytes]) -> None:
        """Have the target use a copy of the file ``source`` with this content. Raises OSError."""
        self.used[path], self._contents[path] = source, _content(pieces)

    def note(self, written: Collection[Path], target: str) -> None:
        """Note the copies, while no other run names files there; ``written`` are those that get their names.

        Raises OSError, and OutputError that names ``target``.
        """
        self._noted.clear()
        home = Notes(self.root, self.target.parent)
        noted = home.targets.get(self.target.name, frozenset())
        for folder in {path.parent for path in self.used}:
            notes = home if folder == home.folder else Notes(self.root, folder)
            ours = notes.relative(self.target)
            for path in (path for path in self.used if path.parent == folder):
                former, found = notes.copies.get(path.name, Copy()), self._contents[path]
                if path not in written and found not in former.contents:
                    continue  # it is the user's file, with the same content
                others = {name for name in former.targets - {ours} if os.path.lexists(folder / name)}
                sources = former.of if others or os.path.lexists(path) else frozenset()
                sources |= {notes.relative(self.used[path])}
                notes.copies[path.name] = Copy(frozenset({found}), sources, frozenset({ours, *others}))
                noted |= {home.relative(path)}
            if notes is not home:
                self._noted.append(notes)
                notes.save(target)
        if noted:
            home.targets[self.target.name] = noted
        self._noted.append(home)
        home.save(target)

    def forget(self) -> None:
        """Make the notes as they were before ``note``."""
        while self._noted:
            self._noted.pop().undo(os.fspath(self.target))

    def replace(self, *, sync: bool) -> bool:
        """Give the new content to the files in the way that are earlier copies of the same files, unchanged.

        Return whether there was any. Raises OSError and OutputError.
        """
        found = False
        for folder in {path.parent for path in self.in_the_way}:
            with Notes(self.root, folder).opened() as opened, locked([opened]):
                notes, ours = Notes(self.root, folder), dict[Path, Path]()
                for path, new in self.in_the_way.items():
                    copy = notes.copies.get(path.name, Copy()) if path.parent == folder else Copy()
                    if copy.of == {notes.relative(self.used[new])} and _holds(path, copy.contents):
                        ours[path] = new
                        both = copy.contents | {self._contents[new]}
                        notes.copies[path.name] = copy._replace(contents=both)
                notes.save(os.fspath(self.target))
                for path, new in ours.items():
                    if not _holds(path, [self._contents[new]]):  # another run may have been faster
                        pieces = FileContent(bounded_path(os.fspath(new), os.fspath(self.root)))
                        write_files(self.root, {path: pieces}, os.fspath(self.target), sync=sync)
                found |= bool(ours)
        return found

    def tidy(self, needed: frozenset[Path], written: Signature) -> None:
        """Remove the files that this target no longer needs, unless other targets have them.

        ``written`` is the signature of the target. Nothing is removed if another run has replaced it since.
        Raises OSError or OutputError.
        """
        home = Notes(self.root, self.target.parent)
        noted = (home.folder / name for name in home.targets.get(self.target.name, ()))
        dead = {
            Path(path) for one in noted if below(path := os.path.normpath(one), os.fspath(self.root))
        } - needed
        # The buffers of α and β that it does not need: their names prove whose they are.
        buffers, ours = [], gradients_name(self.target)
        for file in self.target.parent.iterdir() if self.target.suffix.lower() == GLTF_SUFFIX else ():
            if file.name.startswith(ours) and file not in needed:
                with suppress(OSError):
                    pieces = _pieces(file, fits_memory)  # it was in memory once
                    if file.name == gradients_name(self.target, content_digest(pieces)):
                        buffers.append(file.name)
        with home.opened() as here:
            for folder in {path.parent for path in dead} | ({home.folder} if buffers else set()):
                with suppress(OSError), Notes(self.root, folder).opened() as opened, locked([here, opened]):
                    if signature_of(self.target)[: len(written)] != written:
                        return
                    for name in buffers if folder == home.folder else ():
                        os.unlink(here.name(name), dir_fd=here.descriptor)
                    self._remove({path.name for path in dead if path.parent == folder}, folder, opened)

    def _remove(self, names: Collection[str], folder: Path, opened: Folder) -> None:
        """Remove copies in a folder, unless other targets have them, and what is noted of them."""
        notes, home = Notes(self.root, folder), Notes(self.root, self.target.parent)
        home = notes if folder == home.folder else home
        for name in names:
            copy = notes.copies.pop(name, Copy())
            others = copy.targets - {notes.relative(self.target)}
            others = frozenset(other for other in others if os.path.lexists(folder / other))
            if others:
                notes.copies[name] = copy._replace(targets=others)
            elif _holds(folder / name, copy.contents):
                os.unlink(opened.name(name), dir_fd=opened.descriptor)
        left = home.targets.pop(self.target.name, frozenset()) - {
            home.relative(folder / name) for name in names
        }
        if left:
            home.targets[self.target.name] = left
        notes.save(os.fspath(self.target))
        home.save(os.fspath(self.target))


def _content(pieces: Iterable[Bytes]) -> str:
    """Return the size of some content and its digest."""
    digest, size = hashlib.sha256(), 0
    for piece in pieces:
        digest.update(piece)
        size += len(piece)
    return f"{size}-{digest.hexdigest()[:DIGITS]}"


def _holds(path: Path, contents: Collection[str]) -> bool:
    """Tell whether a regular file, which is not a link, has one of some contents."""
    sizes = {content.partition("-")[0] for content in contents}
    with suppress(OSError):
        return bool(sizes) and _content(_pieces(path, lambda size: str(size) in sizes)) in contents
    return False


def _pieces(path: Path, fits: Callable[[int], bool]) -> Iterator[bytes]:
    """Yield the bytes of a regular file that is not a link. Raises OSError, also if its size does not fit."""
    with os.fdopen(open_regular(os.fspath(path), follow=False), "rb") as file:
        if not fits(os.fstat(file.fileno()).st_size):
            raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))
        while block := file.read(BLOCK):
            yield block
