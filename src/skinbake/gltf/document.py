"""The glTF document: the parsed JSON and its buffers, as read (glTF 2.0 specification, §3).

pygltflib loses data as a whole-file reader and writer. So the document *is* the parsed JSON. Untouched parts
are written back as they were read, with unknown keys and in the same key order.
"""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, wraps
from json import JSONDecodeError
from pathlib import Path
from typing import Any, TypeVar, TypeVarTuple

from skinbake.errors import InputError, Notices, Place, UnsupportedFeatureError
from skinbake.files import Bytes
from skinbake.files.bounds import (
    BESIDE,
    NOWHERE,
    Bounds,
    RefusedError,
    bounded_path,
    bounded_paths,
    relative_names,
)
from skinbake.files.folders import open_beneath, open_regular
from skinbake.files.urls import STDIO
from skinbake.gltf import json_access, json_text, resources
from skinbake.gltf.asset import Asset
from skinbake.gltf.budget import Budget, Work
from skinbake.gltf.glb import STDIN, other_kind, refuse_other_kind, split_glb
from skinbake.wording import counted, meant_file, not_gltf, one_or_many

GLB_SUFFIXES = (".glb", ".vrm")
GLTF_SUFFIX = ".gltf"

JSON_FAULTS = {
    "Expecting value": "expected a value",
    "Extra data": "expected nothing after the last brace",
    "Invalid control character at": "a control character in a text",
}
"""Faults of a JSON text that Python's parser words for programmers."""


Key = TypeVarTuple("Key")
Found = TypeVar("Found")


@dataclass(frozen=True)
class Document:
    """A glTF document. Treat it as immutable: edits make a new one, and share the unchanged parts.

    - ``name`` is its name in messages.
    - ``folder`` is the folder where its relative URIs start, ``bounds`` the folders where they may lead.
    - ``is_glb`` tells the container. ``binary`` is the BIN chunk in pieces, None without such a chunk.
    - ``new_files`` are files that must be written beside it, by relative URI.
    - ``told`` are URIs of buffers and images that stay files. A notice says so, and what becomes of them.
    - ``other_chunks`` and ``trailing`` are further contents of a GLB.
    - ``indent`` is the white space before the keys of its JSON, None for text on one line. ``escaped`` tells
      whether the JSON spells what is not ASCII by escapes of four digits.
    - ``former`` are the JSON text as read and its value, None after a change of the container.
    - ``raw`` is the text or the container as read, None after an edit.
    - ``asset`` has its parts as typed records. What a room finds out about a document once, it keeps there by
      ``once_a_document``.
    - ``budget`` counts the memory that it has claimed, with all edited versions.
    - ``notices`` collects what is told of it, with all edited versions.
    """

    name: str
    folder: Path
    json: json_access.JsonObject
    is_glb: bool
    bounds: Bounds = BESIDE
    binary: tuple[Bytes, ...] | None = None
    other_chunks: tuple[tuple[int, Bytes], ...] = ()
    trailing: Bytes = b""
    new_files: dict[str, tuple[Bytes, ...]] = field(default_factory=dict)
    told: frozenset[str] = frozenset()
    indent: str | None = None
    escaped: bool = False
    former: tuple[Bytes, json_access.JsonObject] | None = field(default=None, repr=False, compare=False)
    raw: Bytes | None = None
    budget: Budget = field(default_factory=Budget, repr=False, compare=False)
    notices: Notices = field(default_factory=Notices, repr=False, compare=False)
    _files: dict[str, Bytes] = field(default_factory=dict, repr=False)
    _loaded: dict[int, memoryview] = field(default_factory=dict, init=False, repr=False, compare=False)
    _found: dict[object, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def place(self) -> Place:
        """Return the place for messages about the whole document."""
        return Place(self.name)

    @property
    def has_binary_buffer(self) -> bool:
        """Tell whether buffer 0 is the BIN chunk: there is one, and the buffer has no URI."""
        buffers = self.objects("buffers")
        return self.binary is not None and bool(buffers) and buffers[0].get("uri") is None

    def edited(self, **changes: Any) -> Document:
        """Return a copy with fields replaced, which no longer has the bytes that were read."""
        return replace(self, raw=None, **changes)

    @cached_property
    def asset(self) -> Asset:
        """Its nodes, meshes, skins … as records."""
        return Asset(self.json, self.place)

    def objects(self, key: str) -> list[json_access.JsonObject]:
        """Return a top-level array of objects (``accessors``, ``meshes`` …), empty where absent."""
        return self.asset.objects(key)

    @property
    def text(self) -> str:
        """Its JSON on one line; ValueError if it holds numbers that are not finite."""
        return json_text.written(self.json, indent=None, ascii_only=False)

    def buffer(self, index: int) -> memoryview:
        """Return the ``byteLength`` bytes of one buffer.

        Raises InputError where its URI cannot be resolved or holds fewer bytes than declared.
        """
        if index not in self._loaded:
            buffer = self.objects("buffers")[index]
            length = json_access.integer(buffer, "byteLength", self.place, minimum=1)
            uri = json_access.text(buffer, "uri", self.place)
            if uri is not None:
                new = self.new_files.get(uri)
                data: Bytes = joined(new) if new else self._resource(index, uri)
            elif index == 0 and self.has_binary_buffer:
                data = joined(self.binary or ())
            else:
                raise InputError(
                    f"buffer {index} has no URI and there is no BIN chunk that holds it", self.place
                )
            if len(data) < length:
                kind = other_kind(data)
                if kind is not None and uri is not None and not resources.is_data_uri(uri):
                    message = f'buffer {index}, "{resources.shortened(uri)}", is {kind}'
                    raise InputError(message, self.place)  # another file took its place
                there = one_or_many(len(data), "1 is", "{} are")
                declared = f"it declares {counted(length, 'byte')}, but only {there} there"
                raise InputError(f"buffer {index} is cut short: {declared}", self.place)
            self._loaded[index] = memoryview(data)[:length]
        return self._loaded[index]

    def _resource(self, index: int, uri: str) -> Bytes:
        """Return the bytes that the URI of a buffer names; all edited versions share one reading."""
        if resources.is_data_uri(uri):
            self.budget.claim(Work(bytes=2 * len(uri)), f"the data: URI of buffer {index}", self.place)
            return resources.decode_data_uri(uri, self.place)
        if uri not in self._files:

            def claim(size: int) -> None:
                self.budget.back(size, relative_names(uri)[0], f"buffer {index}", self.place)

            self._files[uri] = resources.read_resource(uri, self.folder, self.bounds, self.place, claim)
        return self._files[uri]


def once_a_document(
    find: Callable[[Document, *Key], Found],
) -> Callable[[Document, *Key], Found]:
    """Return a function that finds something out about a document once for each of its other arguments.

    These are positional, and can be keys of a dict. Places are none: they are only named in errors, which
    are not kept. The result lives as long as the document; an edited copy starts anew.
    """

    @wraps(find)
    def found(document: Document, *arguments: *Key) -> Found:
        known = document._found.setdefault(found, {})
        key = tuple(one for one in arguments if not isinstance(one, Place))
        if key not in known:
            known[key] = find(document, *arguments)
        result: Found = known[key]
        return result

    return found


def joined(pieces: Sequence[Bytes]) -> Bytes:
    """Return the pieces as one series of bytes, without a copy if there is only one."""
    return pieces[0] if len(pieces) == 1 else b"".join(pieces)


def read_document(path: str, bounds: Bounds = BESIDE) -> Document:
    """Read ``.gltf``, ``.glb`` or ``.vrm`` by suffix, or a GLB from standard input for ``-``.

    ``bounds`` are the folders of the files that it may name. The default is its own folder and the folders
    below. If the bounds have a root, the file itself is opened from there, and no link leads out. A document
    from standard input may only name files in the allowed folders. Buffers of a ``.gltf`` are read when they
    are first needed. Raises InputError if the file cannot be read or is not glTF 2, and if a buffer is not
    within the bounds.
    """
    budget = Budget()
    if path == STDIO:
        # Its size is not known, so that it is counted block by block.
        data = bytearray()
        try:
            while block := sys.stdin.buffer.read(resources.BLOCK):
                budget.back(len(block), None, "reading it", Place(STDIN))
                data += block
        except (AttributeError, OSError) as error:  # AttributeError: stdin is closed
            raise InputError(
                f"cannot be read: {getattr(error, 'strerror', None) or 'it is closed'}", Place(STDIN)
            ) from error
        inside = bounds._replace(root=NOWHERE)
        document = parse_glb(memoryview(data).toreadonly(), STDIN, Path(), inside, budget)
        refuse_buffers_outside(document)
        return document
    file = Path(path)
    suffix = file.suffix.lower()
    if suffix != GLTF_SUFFIX and suffix not in GLB_SUFFIXES:  # pragma: no cover: tests/gltf/test_document.py
        raise InputError(not_gltf(path, ""), Place(path))
    parse = parse_gltf if suffix == GLTF_SUFFIX else parse_glb
    document = parse(read_named(path, bounds.root, budget), path, file.parent, bounds, budget)
    refuse_buffers_outside(document)
    return document


def refuse_buffers_outside(document: Document) -> None:
    """Raise InputError where a buffer's URI leads nowhere that may be read; nothing is opened.

    The rule holds for a document that nothing is read of, and for one that passes through: an output must not
    name such a file.
    """
    for entry in document.objects("buffers"):
        uri = entry.get("uri")
        if not isinstance(uri, str) or resources.is_data_uri(uri) or uri in document.new_files:
            continue
        try:
            bounded_paths(uri, os.fspath(document.folder), document.bounds)
        except RefusedError as error:
            raise resources.refused(uri, error, document.place) from error


def read_named(path: str, root: str | None, budget: Budget) -> Bytes:
    """Return the bytes of an input; a file found in the folder ``root`` is opened from there.

    Raises InputError.
    """

    def claim(size: int) -> None:
        budget.back(size, path, "reading it", Place(path))

    try:
        if root is None:
            return resources.read_open_file(open_regular(os.fspath(Path(path))), claim)
        return resources.read_open_file(open_beneath(bounded_path(path, root)), claim)
    except RefusedError as error:
        raise InputError(f"cannot be read: {error}", Place(path)) from error
    except OSError as error:
        if error.errno == errno.EXDEV:
            message = f"is not read: a link leads out of {root}; give the file itself, or its folder"
            raise InputError(message, Place(path)) from error
        meant = meant_file(path) if root is None and error.errno == errno.ENOENT else ""
        reason = f"{error.strerror or error}{meant and '; '}{meant}"
        raise InputError(f"cannot be read: {reason}", Place(path)) from error
    except ValueError as error:
        raise InputError(f"cannot be read: {error}", Place(path)) from error


def parse_glb(
    data: Bytes, name: str, folder: Path, bounds: Bounds = BESIDE, budget: Budget | None = None
) -> Document:
    """Return the document in the bytes of a GLB; InputError if they are not a GLB.

    ``budget`` has counted the bytes. None: they count now.
    """
    chunks = split_glb(data, Place(name))
    parsed = _parsed(chunks.json, data, Place(name), budget)
    return Document(
        name=name,
        folder=folder,
        bounds=bounds,
        is_glb=True,
        binary=None if chunks.binary is None else (chunks.binary,),
        other_chunks=chunks.others,
        trailing=chunks.trailing,
        **parsed,
    )


def parse_gltf(
    data: Bytes, name: str, folder: Path, bounds: Bounds = BESIDE, budget: Budget | None = None
) -> Document:
    """Return the document in the text of a ``.gltf`` file; InputError if it is none.

    ``budget`` has counted the bytes. None: they count now.
    """
    if data[:4] == b"glTF":
        raise InputError("this is a GLB container; name it .glb instead", Place(name))
    refuse_other_kind(data, Place(name))
    parsed = _parsed(data, data, Place(name), budget)
    # The white space before the first key, None for text on one line.
    _, newline, rest = bytes(data[:256]).partition(b"\n")
    line = rest.split(b"\n")[0]
    indent = line[: len(line) - len(line.lstrip())].decode("ascii", "replace") if newline else None
    return Document(name=name, folder=folder, bounds=bounds, is_glb=False, indent=indent, **parsed)


def _parsed(json: Bytes, whole: Bytes, place: Place, budget: Budget | None) -> dict[str, Any]:
    """Return the fields of a document that follow from its JSON text, and from all its bytes."""
    if budget is None:
        budget = Budget()
        budget.back(len(whole), place.file, "reading it", place)
    text = bytes(json)
    root = _parse_json(text, budget, place)
    # A JSON text is ASCII because it escapes what is not, as Blender writes it.
    escaped = b"\\u" in text and text.isascii()
    return {"json": root, "budget": budget, "escaped": escaped, "former": (json, root), "raw": whole}


def _parse_json(data: bytes, budget: Budget, place: Place) -> json_access.JsonObject:
    # About the memory of a parsed JSON text in bytes (objects of CPython, 64 bit).
    costs = {b"{": 240, b":": 100, b"[": 64, b",": 40}
    size = 2 * len(data) + sum(cost * data.count(mark) for mark, cost in costs.items())
    budget.claim(Work(bytes=size), "its JSON", place)
    try:
        root = json_text.parsed(data.decode("utf-8-sig"))
    except ValueError as error:
        raise InputError(f"its JSON cannot be parsed: {_fault(error)}", place) from error
    if not isinstance(root, dict):
        raise InputError("its JSON is not an object", place)
    asset = json_access.member(root, "asset", place)
    number = asset.get("version")
    if isinstance(number, int | float) and not isinstance(number, bool) and number < 2:
        version: str | None = str(number)  # files from before 2.0 may write it so
    else:
        version = json_access.text(asset, "version", place)
    if version is None:
        raise InputError('it is JSON, but not glTF: "asset.version" is missing', place)
    least = json_access.text(asset, "minVersion", place) or "2.0"
    if version.split(".")[0] != "2" or least != "2.0":
        wanted = version if least == "2.0" else least
        raise UnsupportedFeatureError(f'it needs glTF version "{wanted}"; only 2.0 is supported', place)
    return root


def _fault(error: ValueError) -> str:
    """Return why a text is not JSON, and where."""
    if isinstance(error, UnicodeDecodeError):
        return f"its byte {error.start} is {error.object[error.start]:#04x}, which is not UTF-8 text"
    if not isinstance(error, JSONDecodeError):
        return str(error)
    if not error.doc[error.pos :].strip() or error.msg.startswith("Unterminated string"):
        return "it ends too early; the file may be cut short"
    found = JSON_FAULTS.get(error.msg) or error.msg.replace("Expecting", "expected")
    return f"line {error.lineno}, column {error.colno}: {found}"
