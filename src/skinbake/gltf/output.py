"""Write a document and the files beside it, whole or not at all, overwriting nothing but the target."""

from __future__ import annotations

import os
import secrets
import signal
import stat
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from skinbake.containment import OutsideError, RefusedError, below, relative_names, spot_of
from skinbake.errors import InputError, Notice, OutputError, Place
from skinbake.gltf import json_text
from skinbake.gltf.beside import Beside, named_files
from skinbake.gltf.document import STDIO, Document
from skinbake.gltf.glb import Bytes, join_glb
from skinbake.gltf.resources import FileContent, find

MOST_PIECES = 512
"""Pieces that go into one call: POSIX promises 16, every system that has writev takes 1,024."""


@dataclass(frozen=True, slots=True)
class PlannedOutput:
    """Everything that writing a document will do: the pieces of each file, the target's last, and notices."""

    target: str
    files: dict[Path, Iterable[Bytes]]
    notices: list[Notice]
    root: Path

    def write(self) -> None:
        """Write all files, or raise OutputError and leave everything as it was."""
        if self.target == STDIO:
            _write_stdout(self.files[Path(STDIO)])
        else:
            _write_files(self.files, self.target)


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
        return PlannedOutput(target, {Path(STDIO): _serialised(document)}, [], Path(STDIO))
    try:
        path, base = _place_of(target, root)
        _check_target(path, target, make_folder=make_folder)
        document, beside, notices = Beside(document, path.parent, base).planned()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputError(f"cannot be written: {reason}", Place(target)) from error
    return PlannedOutput(target, {**beside, path: _serialised(document)}, notices, base)


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


def write_text(text: str, target: str) -> None:
    """Write a text file whole or not at all, ``-`` being stdout; OutputError where that fails."""
    pieces = [text.encode("utf-8")]
    if target == STDIO:
        _write_stdout(pieces)
        return
    path = Path(os.path.realpath(target))
    _check_target(path, target, make_folder=False)
    _write_files({path: pieces}, target)


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
            raise OutputError("it is a file that the input consists of", Place(target))


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


def _write_stdout(pieces: Iterable[Bytes]) -> None:
    try:
        for piece in pieces:
            sys.stdout.buffer.write(piece)
        sys.stdout.buffer.flush()
    except (AttributeError, OSError) as error:  # AttributeError: stdout is closed
        reason = getattr(error, "strerror", None) or "it is closed"
        raise OutputError(f"cannot be written: {reason}", Place("<stdout>")) from error


def _check_target(path: Path, target: str, *, make_folder: bool) -> None:
    there = os.path.lexists(path.parent)  # asked first: another process may be about to make it
    if not (path.parent.is_dir() if there else make_folder):
        raise OutputError("its folder does not exist", Place(target))
    if path.is_symlink() or (path.exists() and not path.is_file()):
        raise OutputError("it exists and is not a regular file", Place(target))
    if path.exists() and not os.access(path, os.W_OK):
        raise OutputError("it exists and is read-only", Place(target))


def _write_files(files: dict[Path, Iterable[Bytes]], target: str) -> None:
    """Write all files under temporary names, then rename them, the last one last."""
    with _undone_on_failure() as (folders, temporary, created):
        try:
            for path, pieces in files.items():
                _make_folders(path.parent, folders)
                temporary.append(_write_temporary(path, pieces))
            with _interrupts_put_off():
                for path, name in zip(files, temporary, strict=True):
                    is_new = not path.exists()
                    name.replace(path)
                    if is_new:
                        created.append(path)
                created.clear()  # from here on an interrupt no longer undoes anything
        except OSError as error:
            raise OutputError(f"cannot be written: {error.strerror or error}", Place(target)) from error


@contextmanager
def _interrupts_put_off() -> Iterator[None]:
    """Let Ctrl-C wait until all files have their names.

    Taking back a file that is needed beside several targets would spoil those that another process has
    finished meanwhile.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _undone_on_failure() -> Iterator[tuple[list[Path], list[Path], list[Path]]]:
    """Remove the listed folders, temporary files and new files where the block fails or is interrupted."""
    folders: list[Path] = []
    temporary: list[Path] = []
    created: list[Path] = []
    try:
        yield folders, temporary, created
    except BaseException:
        for path in (*temporary, *created):
            with suppress(OSError):
                path.unlink(missing_ok=True)
        for folder in reversed(folders):
            with suppress(OSError):
                folder.rmdir()
        raise


def _make_folders(folder: Path, made: list[Path]) -> None:
    missing = []
    while not folder.exists():
        missing.append(folder)
        folder = folder.parent
    for path in reversed(missing):
        with suppress(FileExistsError):  # another process was faster
            path.mkdir()
            made.append(path)


def _write_temporary(path: Path, pieces: Iterable[Bytes]) -> Path:
    """Write beside ``path`` with the mode it has, or a new file's; remove what a failure leaves."""
    name = path.with_name(f".skinbake-{secrets.token_hex(6)}.tmp")
    descriptor = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
    try:
        with os.fdopen(descriptor, "wb", buffering=0):
            if path.exists():
                name.chmod(stat.S_IMODE(path.stat().st_mode))
            _write_pieces(descriptor, pieces)
    except BaseException:
        name.unlink(missing_ok=True)
        raise
    return name


def _write_pieces(descriptor: int, pieces: Iterable[Bytes]) -> None:
    """Write the pieces one after the other, many in one call where the system can, without joining them."""
    if isinstance(pieces, FileContent):
        for block in pieces:
            _write_all(descriptor, [block])
    else:
        _write_all(descriptor, pieces)


def _write_all(descriptor: int, pieces: Iterable[Bytes]) -> None:
    left = [view for piece in pieces if (view := memoryview(piece).cast("B"))]
    while left:
        if hasattr(os, "writev"):
            written = os.writev(descriptor, left[:MOST_PIECES])
        else:  # Windows
            written = os.write(descriptor, left[0])
        while left and written >= len(left[0]):
            written -= len(left.pop(0))
        if written:
            left[0] = left[0][written:]
