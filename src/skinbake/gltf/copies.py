"""Copies that earlier bakes of a target have left beside it. A later bake replaces or removes them.

A folder with copies has a file of notes. It says of each copy which content was written, from which file, and
for which targets. A file with other content is the user's, and is never touched. So is a file that a document
without notes names. The former target is not believed: it only tells in which folders to look.

A copy is replaced in steps, so that a document and its files always fit, also after a power cut:

1. The new content gets a name of its own, and a document that names it replaces the target. This alone is an
   output that is whole.
2. The new content replaces the earlier copy, which no document names any more.
3. The document that names it replaces the target. It has the bytes that it would have in an empty folder.
4. Copies that the target no longer needs are removed, that of the first step among them.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote_to_bytes

from skinbake.errors import SkinbakeError
from skinbake.files import Bytes
from skinbake.files.bounds import BoundedPath, Bounds, below, bounded_path, is_relative, relative_names
from skinbake.files.folders import Folder, beneath, check_regular, open_beneath
from skinbake.files.temporary import temporary_name
from skinbake.files.versions import DIGITS, signature_of
from skinbake.files.writing import locked, write_files
from skinbake.gltf import json_text
from skinbake.gltf.document import GLTF_SUFFIX, Document, read_document
from skinbake.gltf.resources import FileContent
from skinbake.signals import interrupts_put_off
from skinbake.wording import SUFFIXES

NAME = ".skinbake-copies.json"
"""The name of the notes. A file of this name that does not begin like notes is left untouched."""

KIND = "skinbake copies/1"

LONGEST = 1 << 26
"""The largest file of notes in bytes that is read: that of half a million copies in one folder."""

DIGEST = re.compile(f"[0-9a-f]{{{DIGITS}}}")

GRADIENTS = re.compile(r"skinbake-([0-9a-f]{16})\.bin")
"""The name of a buffer of α and β in a ``.gltf``, made from its content."""


class Copy(NamedTuple):
    """A copy as noted: digests of its content (two while it is replaced), the files it is of, its targets.

    Paths are relative to the folder of the copy.
    """

    contents: frozenset[str] = frozenset()
    of: frozenset[str] = frozenset()
    targets: frozenset[str] = frozenset()

    def joined(self, other: Copy) -> Copy:
        """Return what both say."""
        return Copy(self.contents | other.contents, self.of | other.of, self.targets | other.targets)


class Notes:
    """The notes of one folder below a root. Notes that cannot be read, or are not ours, are empty."""

    def __init__(self, root: Path, folder: Path) -> None:
        """Read the notes of a folder; neither the folder nor the notes need be there."""
        self.folder, self._root, self._is_ours = folder, root, True
        inside = below(os.fspath(folder), os.fspath(root))
        self._parts = tuple(inside.split("/")) if inside else ()
        self._former: dict[str, Copy] = {}
        with suppress(FileNotFoundError):
            try:
                self._former = dict(_read(root, folder))
            except FileNotFoundError:
                raise
            except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
                self._is_ours = False
        self.copies = dict(self._former)

    def opened(self) -> AbstractContextManager[Folder]:
        """Return the open folder as a context. Raises OSError if it is gone, or if a link leads out."""
        return beneath(os.fspath(self._root), self._parts)

    @property
    def targets(self) -> set[Path]:
        """Return the targets of all copies. All copies that these name are noted."""
        names = {name for copy in self.copies.values() for name in copy.targets}
        return {Path(os.path.normpath(self.folder / name)) for name in names}

    def relative(self, path: str | Path) -> str:
        """Return a path as the notes have it."""
        try:
            return os.path.relpath(path, self.folder).replace(os.sep, "/")
        except ValueError:  # another drive of Windows
            return os.fspath(path)

    def save(self) -> None:
        """Write the notes if they have changed, whole or not at all. Raises OSError."""
        if not self._is_ours or self.copies == self._former:
            return
        files = {
            name: {"contents": sorted(copy.contents), "of": sorted(copy.of), "for": sorted(copy.targets)}
            for name, copy in self.copies.items()
        }
        text = json.dumps({"kind": KIND, "files": files}, indent=1, sort_keys=True)
        with self.opened() as folder:
            if not files:
                os.unlink(folder.name(NAME), dir_fd=folder.descriptor)
            else:
                temporary = temporary_name()
                try:
                    _written(folder, temporary, f"{text}\n")
                    names = folder.name(temporary), folder.name(NAME)
                    os.replace(*names, src_dir_fd=folder.descriptor, dst_dir_fd=folder.descriptor)
                except BaseException:
                    with suppress(FileNotFoundError):
                        os.unlink(folder.name(temporary), dir_fd=folder.descriptor)
                    raise
        self._former = dict(self.copies)


def _written(folder: Folder, name: str, text: str) -> None:
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
    with os.fdopen(os.open(folder.name(name), flags, 0o666, dir_fd=folder.descriptor), "wb") as file:
        file.write(text.encode("ascii"))


def _read(root: Path, folder: Path) -> Iterator[tuple[str, Copy]]:
    """Yield the notes of a folder. Raises OSError, or any error of values that are not as expected."""
    with os.fdopen(open_beneath(bounded_path(os.fspath(folder / NAME), os.fspath(root))), "rb") as file:
        data = file.read(LONGEST + 1)
    found = json.loads(data) if len(data) <= LONGEST else {}
    if found["kind"] != KIND:
        raise ValueError("it is not a file of notes")
    for name, one in found["files"].items():
        copy = Copy(*(frozenset(map(str, one[key])) for key in ("contents", "of", "for")))
        if all(map(DIGEST.fullmatch, copy.contents)):
            yield name, copy


@dataclass
class Copies:
    """The copies beside a target in ``root``: those that it uses, and those that an earlier bake has left.

    ``used`` are the paths of copies, by the files they are of. ``replacing`` are earlier copies, by the path
    where the new content is until then. ``final`` is the document that names them, in pieces.
    """

    target: Path
    root: Path
    used: dict[Path, str] = field(default_factory=dict)
    replacing: dict[Path, Path] = field(default_factory=dict)
    final: Iterable[Bytes] | None = None
    _earlier: frozenset[Path] = frozenset()
    _cache: dict[Path, Notes] = field(default_factory=dict)
    _before: dict[Path, Copy | None] = field(default_factory=dict)

    def read_target(self) -> None:
        """Find out which files the former target names, if it is a ``.gltf``. It may be anything."""
        self._earlier = self._named_by_target()

    def _named_by_target(self) -> frozenset[Path]:
        if self.target.suffix.lower() == GLTF_SUFFIX:
            with suppress(SkinbakeError, OSError, ValueError):
                # What it names may lie in any folder of the root.
                bounds = Bounds(root=os.fspath(self.root))
                return named_paths(read_document(os.fspath(self.target), bounds), self.target.parent)
        return frozenset()

    def is_replaceable(self, path: Path, source: str, *, is_buffer: bool) -> bool:
        """Tell whether a file is an earlier copy of the file ``source``, and only our targets name it.

        A buffer that another target names is not replaced: with other content, that target might be invalid
        until it is made again.
        """
        notes = self._notes(path.parent)
        copy = notes.copies.get(path.name)
        if copy is None or copy.of != {notes.relative(source)} or _digest(path) not in copy.contents:
            return False
        ours = notes.relative(self.target)
        is_shared = any(os.path.lexists(path.parent / name) for name in copy.targets - {ours})
        return not (is_buffer and is_shared) and not self._is_named(path, notes.targets)

    def note(self, written: Mapping[Path, BoundedPath]) -> None:
        """Note copies that get their names next, and that this target uses copies that are noted.

        ``written`` are the places of the files until then. Raises OSError.
        """
        for folder in {path.parent for path in self.used}:
            notes = Notes(self.root, folder)
            for path in [path for path in self.used if path.parent == folder]:
                former = notes.copies.get(path.name, Copy())
                digest = _digest(Path(written[path].path) if path in written else path)
                if digest is None or (path not in written and digest not in former.contents):
                    continue  # it is the user's file, with the same content
                ours = Copy(
                    frozenset({digest}),
                    frozenset({notes.relative(self.used[path])}),
                    frozenset({notes.relative(self.target)}),
                )
                if not os.path.lexists(path):  # it was removed, or is of an interrupted run
                    others = {name for name in former.targets if os.path.lexists(folder / name)}
                    former = former._replace(contents=frozenset()) if others - ours.targets else Copy()
                self._before[path] = notes.copies.get(path.name)
                notes.copies[path.name] = former.joined(ours)
            notes.save()

    def forget(self) -> None:
        """Make the notes as they were before ``note``."""
        for folder in {path.parent for path in self._before}:
            with suppress(OSError):  # they have other content than the file that may get the name
                notes = Notes(self.root, folder)
                for path in [path for path in self._before if path.parent == folder]:
                    if (copy := self._before[path]) is not None:
                        notes.copies[path.name] = copy
                    else:
                        notes.copies.pop(path.name, None)
                notes.save()
        self._before.clear()

    def settle(self, *, sync: bool) -> bool:
        """Replace the earlier copies, then the target by its final document. Return whether that was done.

        It is not done if anything has changed since it was planned. Raises OSError and OutputError; then the
        target is whole, before or after.
        """
        before = signature_of(self.target)
        folders = {path.parent for path in (self.target, *self.replacing)}
        with ExitStack() as stack, interrupts_put_off():
            opened = [stack.enter_context(Notes(self.root, folder).opened()) for folder in folders]
            stack.enter_context(locked(opened))
            self._cache.clear()
            for path, new in self.replacing.items():
                notes, digest = self._notes(path.parent), _digest(new)
                copy = notes.copies.get(path.name)
                if copy is None or digest is None or _digest(path) not in copy.contents:
                    return False
                ours = frozenset({notes.relative(self.target)})
                notes.copies[path.name] = copy.joined(Copy(frozenset({digest}), targets=ours))
            for notes in self._cache.values():
                notes.save()
            for path, new in self.replacing.items():
                content = FileContent(bounded_path(os.fspath(new), os.fspath(self.root)))
                write_files(self.root, {path: content}, os.fspath(self.target), sync=sync)
                notes = self._notes(path.parent)
                digest = _digest(path)
                notes.copies[path.name] = notes.copies[path.name]._replace(
                    contents=frozenset({digest} if digest else ())
                )
            for notes in self._cache.values():
                notes.save()
            if signature_of(self.target) != before or self.final is None:
                return False
            write_files(self.root, {self.target: self.final}, os.fspath(self.target), sync=sync)
        return True

    def tidy(self, needed: frozenset[Path]) -> None:
        """Remove the earlier copies that the target does not need any more, and that nobody else names."""
        folders = {path.parent for path in (self.target, *self.used, *self._earlier)}
        for folder in folders:
            with suppress(OSError), interrupts_put_off():
                notes = Notes(self.root, folder)
                if notes.copies or (folder == self.target.parent and self._dead_gradients(needed)):
                    with notes.opened() as opened, locked([opened]):
                        self._tidy(Notes(self.root, folder), opened, needed)

    def _tidy(self, notes: Notes, opened: Folder, needed: frozenset[Path]) -> None:
        needed |= self._named_by_target()  # another run may have written it since
        ours = notes.relative(self.target)
        for name, copy in list(notes.copies.items()):
            path = notes.folder / name
            if ours in copy.targets and path in needed and (digest := _digest(path)) in copy.contents:
                notes.copies[name] = copy._replace(contents=frozenset({digest}))
            if ours not in copy.targets or path in needed or Path(name).name != name:
                continue
            others = {other for other in copy.targets - {ours} if os.path.lexists(notes.folder / other)}
            if others:
                notes.copies[name] = copy._replace(targets=frozenset(others))
                continue
            del notes.copies[name]
            if _digest(path) in copy.contents and not self._is_named(path, notes.targets):
                os.unlink(opened.name(name), dir_fd=opened.descriptor)
        notes.save()
        for path in self._dead_gradients(needed) if notes.folder == self.target.parent else ():
            if not self._is_named(path, set()):
                os.unlink(opened.name(path.name), dir_fd=opened.descriptor)

    def _dead_gradients(self, needed: frozenset[Path]) -> list[Path]:
        """Return the buffers of α and β of the former target: their content proves who wrote them."""
        own = [path for path in self._earlier - needed if path.parent == self.target.parent]
        named = [(path, GRADIENTS.fullmatch(path.name)) for path in own]
        return [path for path, found in named if found and (_digest(path) or "").startswith(found[1])]

    def _is_named(self, path: Path, noted: set[Path]) -> bool:
        """Tell whether a document of which there are no notes may name a file."""
        return _is_named(path, {path.parent, self.target.parent}, noted | {self.target})

    def _notes(self, folder: Path) -> Notes:
        if folder not in self._cache:
            self._cache[folder] = Notes(self.root, folder)
        return self._cache[folder]


def named_paths(document: Document, folder: Path) -> frozenset[Path]:
    """Return the paths to which the buffers and images of a document in a folder may lead."""
    found = set()
    for array in ("buffers", "images"):
        for entry in document.objects(array):
            uri = entry.get("uri")
            if isinstance(uri, str) and is_relative(uri):
                found |= {Path(os.path.normpath(folder / name)) for name in relative_names(uri)}
    return frozenset(found)


def _digest(path: Path) -> str | None:
    """Return the digest of a regular file; None if it is a link, or cannot be read."""
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    with suppress(OSError), os.fdopen(os.open(path, flags | getattr(os, "O_BINARY", 0)), "rb") as file:
        check_regular(file.fileno())
        return hashlib.file_digest(file, "sha256").hexdigest()[:DIGITS]
    return None


def _is_named(path: Path, folders: set[Path], known: set[Path]) -> bool:
    """Tell whether a document in some folders, but none of the known ones, names a file that is there.

    A document that holds the name, and cannot be read, counts as one that does.
    """
    spellings = {os.fsencode(path.name).lower(), json.dumps(path.name)[1:-1].encode("ascii").lower()}
    for folder in folders:
        with os.scandir(folder) as entries:
            documents = [Path(entry.path) for entry in entries if Path(entry.name).suffix.lower() in SUFFIXES]
        for document in documents:
            text = b"" if document in known else _json_of(document)
            if text is None:
                return True
            # Few documents hold the name in any spelling. Only these are parsed.
            texts = text.lower(), unquote_to_bytes(text).lower()
            if any(spelling in one for spelling in spellings for one in texts):
                try:
                    values = [json_text.parsed(str(text, "utf-8-sig"))]
                except ValueError:
                    return True
                if any(_leads_to(uri, folder, path) for uri in _uris(values)):
                    return True
    return False


def _uris(values: list[Any]) -> Iterator[str]:
    """Yield the members ``uri`` of JSON values, at any depth. The list is empty afterwards."""
    while values:
        value = values.pop()
        if isinstance(value, dict):
            if isinstance(uri := value.get("uri"), str):
                yield uri
            value = list(value.values())
        if isinstance(value, list):
            values += value


def _leads_to(uri: str, folder: Path, path: Path) -> bool:
    """Tell whether a URI of a document in a folder leads to a file."""
    for name in relative_names(uri) if is_relative(uri) else ():
        with suppress(OSError):
            if path.samefile(folder / name):
                return True
    return False


def _json_of(path: Path) -> bytes | None:
    """Return the JSON of a document as it stands there, None if it cannot be read."""
    try:
        with path.open("rb") as file:
            check_regular(file.fileno())
            if path.suffix.lower() == GLTF_SUFFIX:
                return file.read()
            head = file.read(20)
            return file.read(int.from_bytes(head[12:16], "little"))
    except OSError:
        return None
