"""Write a document and the files beside it, whole or not at all, overwriting nothing but the target."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from skinbake.containment import OutsideError, RefusedError, below, relative_names, spot_of
from skinbake.errors import InputError, Notice, OutputError, Place
from skinbake.gltf import json_text
from skinbake.gltf.beside import Beside, named_files
from skinbake.gltf.document import STDIO, Document
from skinbake.gltf.glb import Bytes, join_glb
from skinbake.gltf.resources import find
from skinbake.gltf.writing import Signature, TakenError, Version, check_target, write_files, write_stdout

ATTEMPTS = 8
"""How often an output is planned anew that finds other files beside it than it did before."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Writing:
    """How an output is written.

    A ``dry_run`` does everything else. ``make_folder`` makes the target's folder where it is missing.
    ``traced`` asks for digests of the files that are written. ``sync`` waits until they are on the disk.
    """

    dry_run: bool = False
    make_folder: bool = False
    traced: bool = False
    sync: bool = True


AS_USUAL = Writing()


@dataclass(frozen=True, slots=True)
class PlannedOutput:
    """Everything that writing a document will do: the pieces of each file, the target's last, and notices.

    Nothing is written but below ``root``. ``serving`` are files that are there already and that the document
    names, as they were; ``replaces`` is the file that it was made from, where that is to be replaced.
    ``again`` plans anew, where another run has taken a name meanwhile.
    """

    target: str
    files: dict[Path, Iterable[Bytes]]
    notices: list[Notice]
    root: Path = field(default_factory=Path)
    serving: dict[Path, Signature] = field(default_factory=dict)
    replaces: Version | None = None
    again: Callable[[], PlannedOutput] | None = None

    def write(self, *, sync: bool = True) -> PlannedOutput:
        """Write all files, or raise OutputError and leave everything as it was; return what was written.

        ``sync`` waits until all is on the disk. TakenError where a name is taken, and ``again`` is not there.
        """
        if self.target == STDIO:
            write_stdout(self.files[Path(STDIO)])
            return self
        planned = self
        for _ in range(ATTEMPTS):
            try:
                write_files(
                    planned.root,
                    planned.files,
                    self.target,
                    serving=planned.serving,
                    replaces=self.replaces,
                    sync=sync,
                )
            except TakenError:
                if planned.again is None:
                    raise
                planned = planned.again()
            else:
                return planned
        raise OutputError("cannot be written: the files beside it keep changing", Place(self.target))


def plan_output(
    document: Document, target: str, *, make_folder: bool = False, root: str | None = None
) -> PlannedOutput:
    """Return how a document goes to ``target``, whose suffix its container must match, or stdout for ``-``.

    ``root`` is the folder that nothing is written outside of; the target's own by default. Files that a
    relative URI names are copied, under their relative path, where the target is in another folder and that
    path is below the root. A file that is there already is left alone: where its content is the same it
    serves, else ours gets a name of its own and the URI follows. Other URIs are rewritten so that they still
    lead to the same file. A document that was not edited is written as the bytes it was read from. The
    target's folder must exist, unless ``make_folder``. Raises OutputError where the target cannot be written,
    InputError where a buffer is outside the document's bounds.
    """
    if target == STDIO:
        return PlannedOutput(target, {Path(STDIO): _serialised(document)}, [])

    def again() -> PlannedOutput:
        return plan_output(document, target, make_folder=make_folder, root=root)

    try:
        path, base = _place_of(target, root)
        check_target(path, target, make_folder=make_folder)
        written, beside, serving, notices = Beside(document, path.parent, base).planned()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputError(f"cannot be written: {reason}", Place(target)) from error
    files = {**beside, path: _serialised(written)}
    return PlannedOutput(target, files, notices, root=base, serving=serving, again=again)


def _place_of(target: str, root: str | None) -> tuple[Path, Path]:
    """Return the path that a target has without links, and the folder that nothing is written outside of."""
    if root is None:  # the user named the file: a link there is meant
        path = Path(os.path.realpath(target))
        return path, path.parent
    base = os.path.realpath(root)
    path = Path(os.path.realpath(spot_of(target, root).path))
    if below(os.fspath(path), base) is None:
        raise OutputError(f"a link leads out of {root}", Place(target))
    return path, Path(base)


def refuse_own_input(document: Document, source: str, target: str) -> None:
    """Raise OutputError where the target is a buffer or image of the document read from ``source``."""
    if STDIO in {target, source}:
        return
    written = Path(os.path.realpath(target))
    try:
        there = written.stat()
    except (OSError, ValueError):
        return
    for resource in named_files(document):
        try:
            spot, descriptor = find(resource.uri, document.folder, document.bounds)
        except OutsideError:  # it is not looked at, not even by its identity
            is_own = _leads_to(resource.uri, document.folder, written)
        except (OSError, RefusedError):
            continue
        else:
            is_own = Path(spot.path) == written or os.path.samestat(os.fstat(descriptor), there)
            os.close(descriptor)
        if is_own:
            raise OutputError("it is a file of the input", Place(target))


def _leads_to(uri: str, folder: Path, path: Path) -> bool:
    """Tell whether a URI names a path, as far as names tell."""
    home = os.path.realpath(folder)
    return any(os.path.normpath(Path(home, name)) == os.path.normpath(path) for name in relative_names(uri))


def _serialised(document: Document) -> Sequence[Bytes]:
    if document.raw is not None:
        return [document.raw]
    text = _json_bytes(document)
    if not document.is_glb:
        return [text]
    return [*join_glb(text, document.binary, document.other_chunks), document.trailing]


def _json_bytes(document: Document) -> bytes:
    """Return the JSON as UTF-8, indented as it came; escapes where its strings hold lone surrogates."""
    end = "" if document.indent is None else "\n"
    root, indent = document.json, document.indent
    try:
        try:
            return (json_text.written(root, indent=indent, ascii_only=False) + end).encode("utf-8")
        except UnicodeEncodeError:
            return (json_text.written(root, indent=indent, ascii_only=True) + end).encode("ascii")
    except ValueError as error:  # numbers past a double's range
        raise InputError(f"its JSON cannot be written back: {error}", document.place) from error
