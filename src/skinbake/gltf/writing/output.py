"""Write a document and the files beside it, whole or not at all; only the target is replaced."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from skinbake.errors import InputError, Notice, OutputError, Place, not_written
from skinbake.files import Bytes
from skinbake.files.bounds import OutsideError, RefusedError, below, bounded_path, relative_names
from skinbake.files.temporary import Ahead
from skinbake.files.urls import STDIO
from skinbake.files.versions import Signature, Version
from skinbake.files.writing import TakenError, check_target, write_files, write_stdout
from skinbake.gltf import json_text
from skinbake.gltf.document import Document, refuse_buffers_outside
from skinbake.gltf.glb import binary_offset, join_glb
from skinbake.gltf.resources import find
from skinbake.gltf.writing.beside import Beside, named_files, named_paths
from skinbake.gltf.writing.copies import Copies
from skinbake.gltf.writing.rewriting import rewritten
from skinbake.threads import thread_count
from skinbake.timing import tell_written
from skinbake.wording import one_or_many

ATTEMPTS = 8
"""The number of times that an output is planned again if the files beside it change meanwhile."""


LARGE, MULTIPLE = 1 << 24, 1 << 16
"""The bytes of a BIN chunk from which on it is written ahead, and begins at a multiple of so many bytes.

The text of the JSON before it is not known yet. Spaces after the text leave it some room.
"""


class Writing(NamedTuple):
    """The options of writing an output.

    A ``dry_run`` does everything except writing. ``traced`` requests digests of the written files. ``sync``
    waits until they are on the disk. ``pack`` brings the files of buffers and images into a GLB's BIN chunk.
    ``lists_read`` requests the paths of the files that were read.
    """

    dry_run: bool = False
    traced: bool = False
    sync: bool = True
    pack: bool = False
    lists_read: bool = False


AS_USUAL = Writing()


@dataclass(frozen=True, slots=True)
class PlannedOutput:
    """All that writing a document will do: the pieces of each file, the target last.

    ``copies`` are its copies, and those that earlier outputs left. ``needed`` are the files that it names.
    Nothing is written outside ``root``. ``serving`` are existing files that the document names, as they were.
    ``replaces`` is the source file, if it will be replaced. ``again`` makes a new plan if another run has
    taken a name meanwhile.
    """

    target: str
    files: dict[Path, Iterable[Bytes]]
    root: Path = field(default_factory=Path)
    serving: dict[Path, Signature] = field(default_factory=dict)
    replaces: Version | None = None
    again: Callable[[], PlannedOutput] | None = None
    copies: Copies | None = None
    needed: frozenset[Path] = frozenset()

    def write(self, *, sync: bool = True, ahead: Ahead | None = None) -> PlannedOutput:
        """Write all files, or raise OutputError and leave everything as it was; return the written paths.

        ``sync`` waits until all is on the disk. ``ahead`` may have a part of the target. Raises TakenError if
        a name is taken and there is no ``again``.
        """
        if self.target == STDIO:
            write_stdout(self.files[Path(STDIO)])
            return self
        planned, final = self, self
        written: Signature = ()
        for _ in range(ATTEMPTS):  # pragma: no branch: races
            try:
                written = write_files(
                    planned.root,
                    planned.files,
                    self.target,
                    serving=planned.serving,
                    replaces=None if written else self.replaces,
                    sync=sync,
                    notes=planned.copies,
                    ahead=None if written else ahead,
                    named=tell_written,
                )
                final = planned
                if planned.copies is None or planned.again is None or not planned.copies.replace(sync=sync):
                    break
            except TakenError:
                if planned.again is None:  # pragma: no cover: Dask: tests/files/test_writing.py
                    raise
            except (OSError, OutputError):
                if not written:
                    raise
                break  # the output is whole
            planned = planned.again()
        if not written:
            raise not_written("the files beside it keep changing", Place(self.target))
        if final.copies is not None:
            with suppress(OSError, OutputError):
                final.copies.tidy(final.needed, written)
        return final


def plan_output(
    document: Document,
    target: str,
    *,
    root: str | None = None,
    grows: bool = False,
) -> PlannedOutput:
    """Return the plan of writing a document to ``target``, or to stdout for ``-``; tell what is not copied.

    The suffix of the target must match the container. ``root`` is the folder that nothing is written outside
    of; the default is the folder of the target. Files that a relative URI names are copied under their
    relative path, if the target is in another folder and that path is below the root. An existing file is not
    changed: if it has the same content it serves, otherwise the copy has another name and the URI follows. It
    is replaced only if it is noted as an earlier copy (``copies``), never for a fetched document. A copy that
    would have the name of the target has another name too.
    Other URIs are rewritten so that they still lead to the same file. A document that was not edited is
    written with the bytes that were read. ``grows`` tells that a large one may have been given to
    ``write_ahead``. The folder of the target is made if it is missing. Raises OutputError if the target
    cannot be written, and InputError if a buffer is outside the bounds of the document or has a name that is
    never opened.
    """
    refuse_buffers_outside(document)
    if target == STDIO:
        return PlannedOutput(target, {Path(STDIO): _serialised(document, grows=grows)})

    def again() -> PlannedOutput:
        return plan_output(document, target, root=root, grows=grows)

    try:
        path, base = _path_of(target, root)
        check_target(path, target)
        copies = None if document.bounds.fetched else Copies(path, base)
        written, beside, serving = Beside(document, path, base, copies).planned()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise not_written(reason, Place(target)) from error
    return PlannedOutput(
        target,
        {**beside, path: _serialised(written, grows=grows)},
        root=base,
        serving=serving,
        again=again,
        copies=copies,
        needed=named_paths(written, path.parent),
    )


def write_ahead(ahead: Ahead, document: Document, target: str, *, root: str | None, growth: int) -> None:
    """Begin to write the BIN chunk of a large GLB that will be ``target``, before it gets its additions.

    The JSON of the document will be longer by about ``growth`` bytes. If the chunk will then begin elsewhere,
    or does not begin with the same bytes, the output is written without what is there. Nothing is raised:
    errors are for ``plan_output``. The arguments are as there. A bake of 19 MB takes 3 % less time so, one of
    76 MB 13 %, and as long as ever if it does not wait for the disk.
    """
    if document.former is None or target == STDIO or thread_count() == 1:
        return
    pieces = document.binary or ()
    if sum(map(len, pieces)) < LARGE:
        return
    length = len(bytes(document.former[0]).rstrip(b" ")) + growth
    with suppress(OSError, OutputError, RuntimeError, ValueError):
        path, base = _path_of(target, root)
        check_target(path, target)
        ahead.begin(path, base, binary_offset(length, MULTIPLE), pieces)


def _path_of(target: str, root: str | None) -> tuple[Path, Path]:
    """Return the path of a target without links, and the folder that nothing is written outside of."""
    if root is None:  # the user named the file, so a link in its path is followed
        path = Path(os.path.realpath(target))
        return path, path.parent
    base = os.path.realpath(root)
    path = Path(os.path.realpath(bounded_path(target, root).path))
    if below(os.fspath(path), base) is None:
        raise OutputError(f"a link leads out of {root}", Place(target))
    return path, Path(base)


def refuse_own_input(document: Document, source: str, target: str) -> None:
    """Raise OutputError if the target is a buffer or image of the document read from ``source``."""
    if STDIO in {target, source}:
        return
    written = Path(os.path.realpath(target))
    try:
        there = written.stat()
    except (OSError, ValueError):
        return
    for resource in named_files(document):
        try:
            file, descriptor = find(resource.uri, document.folder, document.bounds)
        except OutsideError:  # the file is not opened, and its identity is not read
            # Whether a URI names a path, judged by names only.
            home = os.path.realpath(document.folder)
            is_own = any(
                os.path.normpath(Path(home, name)) == os.path.normpath(written)
                for name in relative_names(resource.uri)
            )
        except (OSError, RefusedError):
            continue
        else:
            is_own = Path(file.path) == written or os.path.samestat(os.fstat(descriptor), there)
            os.close(descriptor)
        if is_own:
            raise OutputError("it is a file of the input", Place(target))


def tell_other_names(document: Document, source: str) -> None:
    """Tell of a file that is replaced in place if it has other names, by hard links."""
    try:
        count = Path(source).stat().st_nlink - 1
    except OSError:
        return
    if count < 1:
        return
    message = one_or_many(
        count,
        "it has 1 other name (a hard link), which keeps the former bytes",
        "it has {} other names (hard links), which keep the former bytes",
    )
    document.notices.tell(Notice("hard-links", message, Place(source), count))


def _serialised(document: Document, *, grows: bool) -> Sequence[Bytes]:
    if document.raw is not None:
        return [document.raw]
    # The JSON as UTF-8. What is unchanged keeps its former text; lone surrogates are escaped.
    try:
        try:
            text = _json_text(document, ascii_only=document.escaped).encode("utf-8")
        except UnicodeEncodeError:
            text = _json_text(document, ascii_only=True).encode("utf-8")
    except ValueError as error:
        where = next(json_text.not_finite(document.json), None)
        why = str(error) if where is None else f"{where} is a number too large for any float"
        raise InputError(f"its JSON cannot be written back: {why}", document.place) from error
    if not document.is_glb:
        return [text]
    multiple = MULTIPLE if grows and sum(map(len, document.binary or ())) >= LARGE else 4
    parts = join_glb(text, document.binary, document.other_chunks, multiple=multiple)
    return [*parts, document.trailing]


def _json_text(document: Document, *, ascii_only: bool) -> str:
    if document.former is None:
        text = json_text.written(document.json, indent=document.indent, ascii_only=ascii_only)
        return f"{text}\n" if "\n" in text else text
    data, value = document.former
    former = str(data, "utf-8")
    text = rewritten(former, value, document.json, indent=document.indent, ascii_only=ascii_only)
    return text.rstrip(" ") if document.is_glb else text  # a GLB has spaces behind it, to fill its chunk
