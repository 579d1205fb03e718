"""The files that a document names, and their place beside an output in another folder."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from skinbake.errors import Notice, OutputError, Place
from skinbake.files import Bytes
from skinbake.files.bounds import (
    BoundedPath,
    OutsideError,
    RefusedError,
    below,
    bounded_path,
    is_relative,
    moved_uri,
    path_uri,
    relative_names,
)
from skinbake.files.folders import open_beneath
from skinbake.files.versions import Signature, signature_of
from skinbake.files.writing import has_content
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject
from skinbake.gltf.resources import LINKED_OUT, FileContent, find, is_data_uri, listed, refused, shortened
from skinbake.gltf.writing.additions import content_digest
from skinbake.gltf.writing.copies import GRADIENTS, Copies, gradients_name
from skinbake.wording import one_or_many


class NamedFile(NamedTuple):
    """A reference of a document to a file: its array, index and URI."""

    array: str
    number: int
    uri: str


class Beside:
    """The files that a document names, on their way to the folder of the target.

    ``target`` is a path without links. No file gets the name of the target. ``copies`` are notes of earlier
    copies. They get to know which ones are used, and what is in their way.
    """

    def __init__(self, document: Document, target: Path, root: Path, copies: Copies | None = None) -> None:
        self._document, self._target, self._folder, self._root = document, target, target.parent, root
        self._copies = copies
        self._home = Path(os.path.realpath(document.folder))
        self._files: dict[Path, Iterable[Bytes]] = {}
        self._serving: dict[Path, Signature] = {}
        self._names: dict[tuple[str, object], str] = {}
        self._missing: list[str] = []
        self._outside: list[str] = []
        self._refused: list[tuple[str, str]] = []

    def planned(
        self,
    ) -> tuple[Document, dict[Path, Iterable[Bytes]], dict[Path, Signature]]:
        """Return the document with URIs for the target's folder, and the files to write there.

        Last come the files that are already there with the same content. Notices tell of those that cannot
        be copied, but for those that have been ``told`` already.
        """
        named = list(named_files(self._document))
        is_buffer = {resource.uri: resource.array == "buffers" for resource in reversed(named)}
        uris = {uri: self._placed(uri, is_buffer=is_buffer[uri]) for uri in {r.uri: None for r in named}}
        renamed = [(resource, uris[resource.uri]) for resource in named if uris[resource.uri] != resource.uri]
        document = self._document
        if renamed:
            root: JsonObject = dict(document.json)
            for array in {resource.array for resource, _ in renamed}:
                root[array] = list(root[array])
            for resource, uri in renamed:
                root[resource.array][resource.number] = {**root[resource.array][resource.number], "uri": uri}
            document = document.edited(json=root)
        place, told, tell = self._document.place, self._document.told, self._document.notices.tell
        if missing := [uri for uri in self._missing if uri not in told]:
            count = len(missing)
            files = "1 file that it names is" if count == 1 else f"{count} files that it names are"
            message = f"{files} missing and cannot be copied: {listed(missing)}"
            tell(Notice("file-missing", message, place, count))
        if away := [uri for uri in self._outside if uri not in told]:
            count = len(away)
            images = "1 image is" if count == 1 else f"{count} images are"
            message = (
                f"{images} outside its folder, and neither read nor copied; the output refers to "
                f"the same place: {listed(away)}"
            )
            tell(Notice("image-outside", message, place, count))
        if unopened := [(uri, why) for uri, why in self._refused if uri not in told]:
            count, (uri, why) = len(unopened), unopened[0]
            names = one_or_many(
                count,
                "1 URI names no file beside it, and stays as it is:",
                "{} URIs name no file beside it, and stay as they are. The first is",
            )
            message = f'{names} "{shortened(uri)}": {why}'
            tell(Notice("uri-refused", message, place, count))
        return document, self._files, self._serving

    def _placed(self, uri: str, *, is_buffer: bool) -> str:
        """Return a URI relative to the target's folder, and note the file if it must be copied."""
        if uri in self._document.new_files:  # the document did not have it before
            pieces, made = self._document.new_files[uri], GRADIENTS.fullmatch(uri)
            if not made:
                return self._copied(uri, relative_names(uri)[0], pieces)
            return self._planned_name(gradients_name(self._target, made[1]), pieces, is_noted=False)
        try:
            file = None if self._home == self._folder else self._found(uri)
        except OutsideError as error:
            return self._left(uri, error, is_buffer=is_buffer)
        if file is None:
            return uri
        name = Path(os.path.relpath(file.path, self._home)).as_posix()
        if not (file.is_own and below(self._path(name), os.fspath(self._root))):
            return path_uri(Path(os.path.relpath(file.path, self._folder)).as_posix())
        return self._copied(uri, name, FileContent(file))

    def _found(self, uri: str) -> BoundedPath | None:
        """Return the place of a file; None, with a note, if it is missing or its URI is refused."""
        try:
            file, descriptor = find(uri, self._document.folder, self._document.bounds)
        except OutsideError:
            raise
        except RefusedError as error:
            self._refused.append((uri, str(error)))
            return None
        except OSError as error:
            if error.errno == errno.EXDEV:
                raise OutsideError(LINKED_OUT) from error
            if error.errno == errno.EACCES:  # pragma: no cover: not as root
                place = Place(str(self._document.folder / uri))
                raise OutputError(f"cannot be copied: {error.strerror}", place) from error
            self._missing.append(uri)
            return None
        os.close(descriptor)
        return file

    def _path(self, name: str) -> str:
        """Return the path of a relative one, seen from the target's folder."""
        return os.path.normpath(self._folder / name)

    def _left(self, uri: str, why: OutsideError, *, is_buffer: bool) -> str:
        """Return the URI of a file that is not read, relative to the target's folder."""
        if is_buffer:
            raise refused(uri, why, self._document.place)
        try:
            moved = moved_uri(uri, os.fspath(self._document.folder), os.fspath(self._folder))
        except RefusedError as error:
            self._refused.append((uri, str(error)))
            return uri
        self._outside.append(uri)
        return uri if relative_names(moved)[0] == relative_names(uri)[0] else moved

    def _copied(self, uri: str, name: str, pieces: Iterable[Bytes]) -> str:
        """Return the URI of a copied file: its own name, or another one if that is taken."""
        key = name, pieces if isinstance(pieces, FileContent) else id(pieces)
        if key not in self._names:  # many URIs may be spellings of one name
            self._names[key] = self._planned_name(name, pieces)
        free = self._names[key]
        meant = relative_names(uri)[0]  # the literal name is tried if this one does not exist
        path = self._path(meant)
        would_stay = name == meant or not (os.path.lexists(path) or self._is_target(path))
        return uri if free == name and would_stay else path_uri(free)

    def _planned_name(self, name: str, pieces: Iterable[Bytes], *, is_noted: bool = True) -> str:
        """Return the name of a copy, and note the file that will be written or serves."""
        before = signature_of(self._path(name))  # read before the content, so that a later change shows
        # Another file has, or will have, the name: then one that is made from the content.
        free, planned = name, self._files.get(Path(self._path(name)))
        differs = planned is not None and content_digest(planned) != content_digest(pieces)
        if differs or self._occupied(name, pieces):
            plain = PurePosixPath(name)
            free = str(plain.with_name(f"{plain.stem}-{content_digest(pieces)}{plain.suffix}"))
            if self._occupied(free, pieces):
                message = f"a file of that name with other content is in the way: {free}"
                raise OutputError(message, Place(str(self._folder)))
        path = Path(self._path(free))
        if not os.path.lexists(path):
            self._files[path] = pieces
        else:
            self._serving[path] = before if free == name else signature_of(path)
        if self._copies is not None and is_noted:
            made_of = self._home / Path(self._document.name).name
            source = pieces.file.path if isinstance(pieces, FileContent) else str(made_of)
            wanted = Path(self._path(name))
            self._copies.use(path, source, pieces)
            if free != name and wanted not in self._files:
                self._copies.in_the_way.setdefault(wanted, path)
        return free

    def _occupied(self, name: str, pieces: Iterable[Bytes]) -> bool:
        """Tell whether another file, or the target, has a name in the target's folder.

        A link that leads out of the folder is not opened.
        """
        path = self._path(name)
        if self._is_target(path):  # pragma: no cover: tests/gltf/test_container.py
            return True
        if not os.path.lexists(path):
            return False
        try:
            with os.fdopen(open_beneath(bounded_path(path, os.fspath(self._root))), "rb") as file:
                return not has_content(file, pieces)
        except OSError:
            return True

    def _is_target(self, path: str) -> bool:
        """Tell whether a path, all links followed, is the target."""
        return Path(os.path.realpath(path)) == self._target


def named_files(document: Document) -> Iterator[NamedFile]:
    """Yield the buffers and images that are neither data: URIs nor on the network."""
    for array in ("buffers", "images"):
        for number, entry in enumerate(document.objects(array)):
            uri = entry.get("uri")
            if (
                isinstance(uri, str)
                and not is_data_uri(uri)
                and not ("://" in uri and not uri.lower().startswith("file:"))
            ):
                yield NamedFile(array, number, uri)


def named_paths(document: Document, folder: Path) -> frozenset[Path]:
    """Return the paths to which the buffers and images of a document in a folder may lead."""
    uris = (resource.uri for resource in named_files(document) if is_relative(resource.uri))
    return frozenset(Path(os.path.normpath(folder / name)) for uri in uris for name in relative_names(uri))


def files_of_extensions(root: JsonObject) -> list[str]:
    """Return the relative URIs that extensions of a document name, in its order, each once.

    They are the members ``uri`` at any depth of an object ``extensions``. ``extras`` do not count.
    """
    found: dict[str, None] = {}
    left: list[tuple[Any, bool]] = [(root, False)]
    while left:
        node, inside = left.pop()
        if isinstance(node, dict):
            uri = node.get("uri") if inside else None
            if isinstance(uri, str) and not is_data_uri(uri) and is_relative(uri):
                found[uri] = None  # pragma: no cover: tests/gltf/test_container.py
            for key, child in reversed(node.items()):
                if isinstance(child, (dict, list)) and key != "extras":
                    left.append((child, inside or key == "extensions"))
        else:
            left += [(child, inside) for child in reversed(node) if isinstance(child, (dict, list))]
    return list(found)


def is_elsewhere(document: Document, target: str) -> bool:
    """Tell whether a target is in another folder than the document, so that the files that it names move."""
    return Path(os.path.realpath(target)).parent != Path(os.path.realpath(document.folder))


def files_read(document: Document, target: str | None, *, pack: bool) -> tuple[str, ...]:
    """Return the paths of the files that a document names and that making the target reads.

    These are its buffers, and the images that are packed or copied. A file that is missing, or may not be
    read, is left out.
    """
    moves = target is not None and is_elsewhere(document, target)
    found = []
    for resource in named_files(document):
        if resource.array == "images" and not (pack or moves):
            continue
        with suppress(OSError, RefusedError):
            file, descriptor = find(resource.uri, document.folder, document.bounds)
            os.close(descriptor)
            if resource.array == "buffers" or pack or file.is_own:
                found.append(file.path)
    return tuple(dict.fromkeys(found))
