"""Write a document and the files beside it, whole or not at all, overwriting nothing but the target."""

from __future__ import annotations

import json
import os
import secrets
import signal
import stat
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from skinbake.errors import InputError, Notice, OutputError, Place
from skinbake.gltf import resources
from skinbake.gltf.additions import content_digest
from skinbake.gltf.document import STDIO, Document
from skinbake.gltf.glb import Bytes, join_glb
from skinbake.gltf.json_access import JsonObject

MOST_PIECES = 512
"""Pieces that go into one call: POSIX promises 16, every system that has writev takes 1,024."""


@dataclass(frozen=True, slots=True)
class PlannedOutput:
    """Everything that writing a document will do: the pieces of each file, the target's last, and notices."""

    target: str
    files: dict[Path, Sequence[Bytes]]
    notices: list[Notice]

    def write(self) -> None:
        """Write all files, or raise OutputError and leave everything as it was."""
        if self.target == STDIO:
            _write_stdout(self.files[Path(STDIO)])
        else:
            _write_files(self.files, self.target)


def plan_output(document: Document, target: str, *, make_folder: bool = False) -> PlannedOutput:
    """Return how a document goes to ``target``, whose suffix its container must match, or stdout for ``-``.

    Files that a relative URI names are copied beside the target where it is in another folder. A file that
    is there already is left alone: where its content is the same it serves, else ours gets a name of its own
    and the URI follows. URIs that lead out of the document's folder are not copied but rewritten. A document
    that was not edited is written as the bytes it was read from. The target's folder must exist, unless
    ``make_folder``. Raises OutputError where the target cannot be written.
    """
    if target == STDIO:
        return PlannedOutput(target, {Path(STDIO): _serialised(document)}, [])
    try:
        path = Path(os.path.realpath(target))
        _check_target(path, target, make_folder=make_folder)
        document, beside, notices = _with_files_beside(document, path.parent)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputError(f"cannot be written: {reason}", Place(target)) from error
    return PlannedOutput(target, {**beside, path: _serialised(document)}, notices)


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
    if STDIO in {target, source} or not resources.is_file(Path(target)):
        return
    for resource in _relative_resources(document):
        named = resources.locate(resource.uri, document.folder)
        if resources.is_file(named) and named.samefile(target):
            raise OutputError("it is a file that the input consists of", Place(target))


def _serialised(document: Document) -> Sequence[Bytes]:
    if document.raw is not None:
        return [document.raw]
    text = _json_bytes(document)
    if not document.is_glb:
        return [text]
    return [*join_glb(text, document.binary, document.other_chunks), document.trailing]


def _json_bytes(document: Document) -> bytes:
    """Return the JSON as UTF-8, indented as it came; escapes where its strings hold lone surrogates."""
    separators = (",", ":") if document.indent is None else (",", ": ")
    end = "" if document.indent is None else "\n"

    def dumped(ascii_only: bool) -> str:
        return json.dumps(
            document.json,
            ensure_ascii=ascii_only,
            allow_nan=False,
            indent=document.indent,
            separators=separators,
        )

    try:
        try:
            return (dumped(False) + end).encode("utf-8")
        except UnicodeEncodeError:
            return (dumped(True) + end).encode("ascii")
    except (ValueError, RecursionError) as error:  # numbers past a double's range, nesting past all sense
        raise InputError(f"its JSON cannot be written back: {error}", document.place) from error


def _write_stdout(pieces: Sequence[Bytes]) -> None:
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


@dataclass(frozen=True, slots=True)
class _Resource:
    """A file that the document names: in which array, at which index, under which URI."""

    array: str
    number: int
    uri: str


def _with_files_beside(
    document: Document, folder: Path
) -> tuple[Document, dict[Path, Sequence[Bytes]], list[Notice]]:
    """Return the document with URIs that hold from ``folder``, the files to write there, and notices."""
    files: dict[Path, Sequence[Bytes]] = {}
    renamed: list[tuple[_Resource, str]] = []
    missing: list[str] = []
    same_folder = document.folder.resolve() == folder
    for resource in _relative_resources(document):
        pieces: Sequence[Bytes] | None = document.new_files.get(resource.uri)
        name = resources.relative_path(resource.uri)
        if pieces is None:
            if same_folder:
                continue
            source = resources.locate(resource.uri, document.folder)
            if not resources.is_file(source):
                missing.append(resource.uri)
                continue
            if name == ".." or name.startswith("../"):
                renamed.append((resource, _relative_uri(source, folder)))
                continue
            name = source.relative_to(document.folder).as_posix()
            pieces = [_read(source)]
        free = _free_name(folder, name, pieces, files)
        if free != name:
            renamed.append((resource, resources.path_uri(free)))
        if not (folder / free).exists():
            files[folder / free] = pieces
    notices = [_missing_notice(missing, document.place)] if missing else []
    return (_with_uris(document, renamed) if renamed else document), files, notices


def _missing_notice(missing: Sequence[str], place: Place) -> Notice:
    shown = ", ".join(missing[:3]) + (", …" if len(missing) > 3 else "")
    count = len(missing)
    files = "1 file that it names is" if count == 1 else f"{count} files that it names are"
    return Notice("file-missing", f"{files} not beside it and cannot be copied: {shown}", place, count)


def _relative_resources(document: Document) -> Iterator[_Resource]:
    for array in ("buffers", "images"):
        for number, entry in enumerate(document.objects(array)):
            uri = entry.get("uri")
            if isinstance(uri, str) and resources.is_relative(uri):
                yield _Resource(array, number, uri)


def _relative_uri(source: Path, folder: Path) -> str:
    try:
        return resources.path_uri(Path(os.path.relpath(source.resolve(), folder)).as_posix())
    except ValueError:  # another drive
        return source.resolve().as_uri()


def _read(path: Path) -> Bytes:
    try:
        return resources.read_file(path)
    except OSError as error:
        raise OutputError(f"cannot be copied: {error.strerror}", Place(str(path))) from error


def _free_name(
    folder: Path, name: str, pieces: Sequence[Bytes], planned: Mapping[Path, Sequence[Bytes]]
) -> str:
    """Return ``name``, or one made from the content where another file has or will have that name."""
    other_comes = folder / name in planned and b"".join(planned[folder / name]) != b"".join(pieces)
    if not other_comes and not _occupied(folder / name, pieces):
        return name
    path = PurePosixPath(name)
    other = str(path.with_name(f"{path.stem}-{content_digest(tuple(pieces))}{path.suffix}"))
    if _occupied(folder / other, pieces):
        raise OutputError(
            f"a file of that name with other content is in the way: {other}", Place(str(folder))
        )
    return other


def _occupied(path: Path, pieces: Sequence[Bytes]) -> bool:
    if not os.path.lexists(path):
        return False
    length = sum(len(piece) for piece in pieces)
    return not (path.is_file() and path.stat().st_size == length and path.read_bytes() == b"".join(pieces))


def _with_uris(document: Document, renamed: Sequence[tuple[_Resource, str]]) -> Document:
    root: JsonObject = dict(document.json)
    for resource, uri in renamed:
        entries = list(root[resource.array])
        entries[resource.number] = {**entries[resource.number], "uri": uri}
        root[resource.array] = entries
    return document.edited(json=root)


def _write_files(files: dict[Path, Sequence[Bytes]], target: str) -> None:
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


def _write_temporary(path: Path, pieces: Sequence[Bytes]) -> Path:
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


def _write_pieces(descriptor: int, pieces: Sequence[Bytes]) -> None:
    """Write the pieces one after the other, many in one call where the system can, without joining them."""
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
