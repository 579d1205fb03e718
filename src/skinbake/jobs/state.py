"""Records of the files made, their input bytes and the options, so that finished work is not repeated.

A record says: this code with these options made files of these digests from files of these digests. That
stays true, no matter who wrote the record and how the files changed later. Every run digests the files to
find out whether a record fits them as they are now. Sizes and times are not trusted, because copies, archives
and checkouts set them. So two runs may write to one state file at once, and a lost record costs one bake and
no more.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

from skinbake.errors import InputError, Notice, Place, SkinbakeError, not_written
from skinbake.files.bounds import (
    BESIDE,
    OWN_FOLDERS,
    BoundedPath,
    Bounds,
    RefusedError,
    Within,
    bounded_paths,
)
from skinbake.files.folders import flush, open_beneath, open_regular
from skinbake.files.versions import DIGITS, YOUNG, Signature, digest_of, signature_of
from skinbake.files.writing import write_file
from skinbake.gltf.budget import fits_memory
from skinbake.gltf.document import read_document
from skinbake.gltf.resources import FileContent
from skinbake.gltf.writing.beside import named_files
from skinbake.gradients import kernel
from skinbake.options import STATE_NAME
from skinbake.version import __version__

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

HEADER = b'{"skinbake": "state/1"}\n'

LONGEST = 1 << 22
"""The largest record in bytes: that of a document that names ten thousand files. Longer lines are skipped."""

SPARE = 1000
"""A state file is rewritten if it holds more superseded records than live ones, plus this number."""

ABSENT = (errno.ENOENT, errno.ENOTDIR, errno.ENAMETOOLONG)
"""The system's error codes for a file that is not there. The last one means that no such file can exist."""

FOREIGN = (
    "it is not a state file of skinbake: it is left untouched. Every file is done, and nothing is noted for "
    "the next run; name another file with --state"
)
DAMAGED = "the first line of this state file is damaged: a new one begins, and every file is done"

DIGEST = re.compile(f"[0-9a-f]{{{DIGITS}}}")

HEADING = ("key", "how", "from", "within")
"""The members of a record that must be those of the present run."""

Digests = dict[str, str | None]
"""The digest of each file by absolute path, or None if there is no file."""


@dataclass(frozen=True, slots=True)
class Seen:
    """The files of a document at one moment: their digests, and the signatures that would show a change.

    Both are by path. ``named`` are the files that the document names. They are opened below their folder
    only.
    """

    digests: Digests
    signatures: dict[str, Signature]
    young: frozenset[str]
    named: Mapping[str, BoundedPath]

    @property
    def still_there(self) -> bool:
        """Tell whether no file has changed since."""
        return all(
            (_signature_at(self.named[path]) if path in self.named else signature_of(path)) == found
            for path, found in self.signatures.items()
        ) and all(
            (_digest_at(self.named[path]) if path in self.named else _digest(path)) == self.digests[path]
            for path in self.young
        )


@dataclass(frozen=True, slots=True)
class Recipe:
    """A command with its options and code, and the folder from which paths in records start.

    ``roots`` are the folders in which inputs were searched. A record may name files below these, below the
    folders of its source and target, and below those that the user allowed, but no others.
    """

    command: str
    how: str
    folder: str
    roots: tuple[str, ...] = ()

    def with_options(self, options: DataclassInstance) -> Recipe:
        """Return the recipe of the same command with other options."""
        return replace(self, how=_how(self.command, options))

    def key(self, path: str) -> str:
        """Return the key of a file's records: the command, and the file that it makes (verify: reads)."""
        return f"{self.command} {self._relative(absolute(path))}"

    def still_holds(
        self, record: bytes, source: str, target: str | None, within: Within = OWN_FOLDERS
    ) -> bool:
        """Tell whether a record describes the files as they are now; False if in doubt.

        A record may be forged. Only files of this run are opened. A record that does not mention the source,
        or the target, is not valid. Neither is one of a run that might read and write in other folders.
        """
        try:
            note = json.loads(record)
            if {name: note[name] for name in HEADING} != self._heading(source, target, within):
                return False
            read, made = dict(note["read"]), dict(note["made"])
            sides = [(read, source)] if target is None else [(read, source), (made, target)]
            if any(DIGEST.fullmatch(side[self._relative(absolute(path))]) is None for side, path in sides):
                return False
            roots = [*self.roots, *(os.path.dirname(absolute(path)) for _, path in sides)]
            roots += map(os.path.realpath, within.bounds.allowed)
            roots += [] if within.output is None else [os.path.realpath(within.output)]
            found = {**made, **read}
            return all(found[path] == digest for path, digest in made.items()) and all(
                _has_digest(os.path.normpath(os.path.join(self.folder, path)), digest, roots)
                for path, digest in found.items()
            )
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return False

    def record(
        self,
        source: str,
        target: str | None,
        read: Digests,
        made: Digests,
        within: Within = OWN_FOLDERS,
    ) -> bytes:
        """Return the record, one line, that the files ``made`` came from the files ``read``."""
        note = {
            **self._heading(source, target, within),
            "read": {self._relative(path): digest for path, digest in read.items()},
            "made": {self._relative(path): digest for path, digest in made.items()},
        }
        return json.dumps(note).encode("ascii") + b"\n"

    def _heading(self, source: str, target: str | None, within: Within) -> dict[str, Any]:
        return {
            "key": self.key(target or source),
            "how": self.how,
            "from": self._relative(absolute(source)),
            "within": [
                self._folder(within.bounds.root),
                sorted(map(self._folder, within.bounds.allowed)),
                self._folder(within.output),
            ],
        }

    def _folder(self, path: str | None) -> str:
        return "" if path is None else self._relative(absolute(path))

    def _relative(self, path: str) -> str:
        try:
            return os.path.relpath(path, self.folder).replace(os.sep, "/")
        except ValueError:  # it is on another drive
            return path


class Origin(NamedTuple):
    """The source of an output, and the digests of the files that were read for it, by absolute path."""

    source: str
    read: Digests

    def changed(self, roots: Iterable[str]) -> list[str]:
        """Return the files that are not as they were when the output was made.

        No file outside the folders ``roots`` is opened, because a record may be forged: it counts as changed.
        """
        return [path for path, digest in self.read.items() if not _has_digest(path, digest, roots)]


def recipe(command: str, options: DataclassInstance, state: str, roots: Iterable[str] = ()) -> Recipe:
    """Return the recipe of a command with its options, a dataclass, for the state file of that name.

    ``roots`` are the folders in which inputs were searched.
    """
    folders = tuple(dict.fromkeys(map(os.path.realpath, roots)))
    return Recipe(command, _how(command, options), os.path.dirname(absolute(state)), folders)


def _how(command: str, options: DataclassInstance) -> str:
    """Return the digest of a command with its options and code."""
    text = json.dumps(
        [command, __version__, code_digest(), kernel.IS_COMPILED, asdict(options)],
        sort_keys=True,
        default=str,
    )
    return digest_of([text.encode()])


def seen(source: str, bounds: Bounds = BESIDE) -> Seen | None:
    """Look at a file and the files that it names in ``bounds``; None if it cannot be read or is gone."""
    start = time.time_ns()
    path = absolute(source)
    try:
        signatures = {path: signature_of(path)}
        document = read_document(source, bounds)
        digests: Digests = {path: digest_of([document.raw or b""])}
        # The places to which the document's URIs may lead in its bounds, each once.
        named: dict[str, BoundedPath] = {}
        for one in named_files(document):
            with suppress(RefusedError):  # out of bounds
                for file in bounded_paths(one.uri, os.fspath(document.folder), document.bounds):
                    named[file.path] = file
        for other, file in named.items():
            signatures[other], digests[other] = _signature_at(file), _digest_at(file)
    except (OSError, ValueError, SkinbakeError):
        return None
    young = frozenset(path for path, found in signatures.items() if found and start - max(found[-2:]) < YOUNG)
    return Seen(digests, signatures, young, named)


def made(target: str, written: Mapping[str, str], read: Digests, bounds: Bounds = BESIDE) -> Digests | None:
    """Return the digests of a target that was just written and of the files that it names.

    None if skinbake is not known to have made all of them. Each file must be in ``written``, by path, or have
    the same bytes as one of ``read``. Another program may have written there since.
    """
    found = seen(target, bounds)
    if found is None:
        return None
    known = set(read.values())
    for path, digest in found.digests.items():
        ours = written.get(os.path.realpath(path))
        content_named = digest is not None and Path(path).stem.rpartition("-")[2] == digest[:16]
        if digest != ours and not (ours is None and (digest in known or content_named)):
            return None
    return found.digests if absolute(target) in found.digests else None


class State:
    """A state file with one record a line. The last record of each key counts. New records are appended.

    Its lines may hold anything. A line that is not a record is skipped. If the file is not a state file of
    skinbake, it is left untouched, and no record is kept. If a state file has lost its first line, it begins
    anew. ``notices`` tell of both.
    """

    def __init__(self, path: str, *, sync: bool = True) -> None:
        """Read the file; a missing file is empty. Raises InputError if the system cannot read it.

        With ``sync``, closing it waits until all is on the disk.
        """
        self._path, self._sync = Path(path), sync
        self._records: dict[str, bytes] = {}
        self._lines = 0
        self._descriptor: int | None = None
        self._is_damaged = False
        self.is_ours = True
        self.notices: tuple[Notice, ...] = ()
        self._read()

    def known(self, key: str) -> bytes | None:
        """Return the record of a key, or None if there is none."""
        return self._records.get(key)

    def origins(self) -> dict[str, Origin]:
        """Return what the outputs of bakes were made from, by absolute path. Damaged records are left out."""
        folder, found = os.path.dirname(absolute(str(self._path))), dict[str, Origin]()

        def whole(path: str) -> str:
            return os.path.normpath(os.path.join(folder, path))

        for key, record in self._records.items():
            command, _, output = key.partition(" ")
            if command == "bake":
                with suppress(ValueError, KeyError, TypeError, AttributeError, RecursionError):
                    note = json.loads(record)
                    read = {whole(path): digest for path, digest in note["read"].items()}
                    found[whole(output)] = Origin(whole(note["from"]), read)
        return found

    def add(self, record: bytes) -> None:
        """Add a record, on the disk too. Raises OutputError if the write fails."""
        if not self.is_ours:
            return
        try:
            if self._descriptor is None:
                self._descriptor = self._opened()
            # The record goes out in one write, so that records of two runs do not mix.
            if os.write(self._descriptor, record) < len(record):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            raise not_written(error.strerror, Place(str(self._path))) from error
        self._remember(record)

    def close(self) -> None:
        """Close the file. If most of it is superseded, write it anew."""
        if self._descriptor is None:
            return
        descriptor, self._descriptor = self._descriptor, None
        try:
            if self._sync:
                with suppress(OSError):  # a lost record costs one bake
                    flush(descriptor)
        finally:
            os.close(descriptor)
        if self._lines > 2 * len(self._records) + SPARE:
            with suppress(SkinbakeError):  # the file stays as it is
                write_file([HEADER, *self._records.values()], str(self._path), sync=self._sync)

    def _read(self) -> None:
        place, head = Place(str(self._path)), None
        try:
            with os.fdopen(open_regular(str(self._path)), "rb") as file:
                if fits_memory(os.fstat(file.fileno()).st_size):  # else it is another program's
                    head = file.read(len(HEADER))
                    for line in _lines(file) if head == HEADER else ():
                        self._remember(line)
        except FileNotFoundError:
            return
        except (OSError, ValueError) as error:
            if getattr(error, "errno", None) not in {errno.EINVAL, errno.EISDIR}:
                reason = getattr(error, "strerror", None) or error
                raise InputError(f"cannot be read: {reason}", place) from error
        # A power cut can leave any bytes. A file with another name may belong to another program.
        if head is None or (not HEADER.startswith(head) and self._path.name != STATE_NAME):
            self.is_ours = False
            self.notices = (Notice("state-foreign", FOREIGN, place),)
        elif head not in {HEADER, b""}:
            self._is_damaged = True
            self.notices = (Notice("state-damaged", DAMAGED, place),)

    def _remember(self, record: bytes) -> None:
        with suppress(ValueError, KeyError, TypeError, RecursionError):  # a damaged line is not a record
            key = json.loads(record)["key"]
            if isinstance(key, str):
                self._records[key] = record
                self._lines += 1

    def _opened(self) -> int:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | getattr(os, "O_BINARY", 0)
        descriptor = os.open(self._path, flags | (os.O_TRUNC if self._is_damaged else 0), 0o666)
        self._is_damaged = False
        size = os.fstat(descriptor).st_size
        if not size:
            os.write(descriptor, HEADER)
        else:
            os.lseek(descriptor, -1, os.SEEK_END)
            if os.read(descriptor, 1) != b"\n":
                os.write(descriptor, b"\n")
        return descriptor


def _signature_at(file: BoundedPath) -> Signature:
    """Return the signature of a file that a document names: empty if it cannot be read."""
    try:
        descriptor = open_beneath(file)
    except (OSError, ValueError):
        return ()
    try:
        return signature_of(descriptor)
    finally:
        os.close(descriptor)


def _digest_at(file: BoundedPath) -> str | None:
    """Return the digest of a file that a document names, or None if it cannot be read."""
    try:
        return digest_of(FileContent(file))
    except (OSError, ValueError):
        return None


def _lines(file: BinaryIO) -> Iterator[bytes]:
    """Yield whole lines. An interrupt leaves a line without an end; a line that is too long is left out."""
    is_within = False
    while line := file.readline(LONGEST):
        if line.endswith(b"\n"):
            if not is_within:
                yield line
            is_within = False
        else:
            is_within = True


def absolute(path: str) -> str:
    """Return a path whose folder has no links, so that ``..`` in a relative path leads where it says."""
    folder, name = os.path.split(path)
    return os.path.join(os.path.realpath(folder), name)


def _digest(path: str) -> str | None:
    """Return a file's digest, None if there is no file. Raises OSError or ValueError if it cannot be read."""
    try:
        with os.fdopen(open_regular(path), "rb") as file:
            if not fits_memory(os.fstat(file.fileno()).st_size):
                return None  # it cannot be read
            return hashlib.file_digest(file, "sha256").hexdigest()[:DIGITS]
    except OSError as error:
        if error.errno in (*ABSENT, errno.EISDIR):
            return None
        raise


def _has_digest(path: str, digest: str | None, roots: Iterable[str]) -> bool:
    """Tell whether a file below one of the folders has this digest (None: the file is absent)."""
    below = any(path.startswith(root.rstrip(os.sep) + os.sep) for root in roots)
    return below and _digest(path) == digest


def code_digest() -> str:
    """Return a digest of skinbake's own code. In a checkout, the code changes but the version does not."""
    folder = Path(__file__).parents[1]
    files = sorted(path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return digest_of(
        piece for path in files for piece in (str(path.relative_to(folder)).encode(), path.read_bytes())
    )
