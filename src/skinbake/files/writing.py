"""Write several files below a folder, whole or not at all, so that they survive a power cut.

The last file names the others. It replaces an existing file of its name. The others replace nothing, so that
no run changes a file that another run's document names. ``TakenError`` says that a name was taken meanwhile.
Names are used relative to open folders, so no link leads out of the root.
"""

from __future__ import annotations

import errno
import os
import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, NamedTuple, Protocol

from skinbake.errors import OutputError, Place, ReaderGoneError, not_written
from skinbake.files import Bytes
from skinbake.files.folders import BY_DESCRIPTOR, Folder, beneath, flush, open_regular
from skinbake.files.temporary import NEW_FILE, remove_abandoned, status_of, take_over, temporary_name
from skinbake.files.urls import STDIO
from skinbake.files.versions import Signature, Version, signature_of
from skinbake.signals import interrupts_put_off

if BY_DESCRIPTOR:  # pragma: no branch: Windows, browsers
    import fcntl

if TYPE_CHECKING:
    from skinbake.files.temporary import Ahead

MOST_PIECES = 512
"""Pieces of one call: POSIX promises 16, every system with writev accepts 1,024."""

PATIENCE = 5.0
"""Seconds to wait for another run that names its files in the same folder, which takes it some ms.

After that time the other run has been stopped. This run then goes on: it finds taken names also without the
lock.
"""

SHORT = 1 << 20
"""Bytes of one file during which interrupts wait. Changing handlers for each piece would take as long."""

NO_LINKS = frozenset({errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK, errno.EACCES, errno.EINVAL})
"""Error codes of systems that cannot give a file a second name."""

SAVED_ANEW = "another program has saved it since it was read, so it is not replaced: run this again"


class TakenError(OutputError):
    """Another program has put or changed a file beside the output since it was planned."""


def check_target(path: Path, target: str) -> None:
    """Raise OutputError if the user's target, ``path`` without links, cannot be written.

    A missing folder is made when the file is written.
    """
    there = os.path.lexists(path.parent)  # read first, because another process may be about to make it
    if there and not path.parent.is_dir():
        raise OutputError(f"{path.parent} is a file, not a folder", Place(target))
    if path.is_symlink() or (path.exists() and not path.is_file()):
        raise OutputError("it exists and is not a regular file", Place(target))
    if path.exists() and not os.access(path, os.W_OK):  # pragma: no cover: not as root
        raise OutputError("it exists and is read-only", Place(target))


def write_stdout(pieces: Iterable[Bytes]) -> None:
    """Write to stdout; raises OutputError, or ReaderGoneError if the reader of stdout has left."""
    try:
        for piece in pieces:
            sys.stdout.buffer.write(piece)
        sys.stdout.buffer.flush()
    except BrokenPipeError as error:
        raise ReaderGoneError("its reader has left", Place("<stdout>")) from error
    except (AttributeError, OSError) as error:  # AttributeError: stdout is closed
        reason = getattr(error, "strerror", None) or "it is closed"
        raise not_written(reason, Place("<stdout>")) from error


def write_result(pieces: Iterable[Bytes], target: str, *, sync: bool = True) -> None:
    """Write to a file that the user named, or to stdout for ``-``. Raises OutputError."""
    if target == STDIO:
        write_stdout(pieces)
    else:
        write_file(pieces, target, sync=sync)


def write_file(pieces: Iterable[Bytes], target: str, *, sync: bool = True) -> None:
    """Write one file that the user named, whole or not at all. Raises OutputError.

    A link is followed. The missing folders of the name are made.
    """
    try:
        path = Path(os.path.realpath(target))
        check_target(path, target)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise not_written(reason, Place(target)) from error
    write_files(path.parent, {path: pieces}, target, sync=sync)


class Noting(Protocol):
    """Notes of files beside a target, which hold if they get their names."""

    def note(self, written: Collection[Path], target: str) -> None:
        """Note that these files get their names. Raises OSError, and OutputError that names ``target``."""

    def forget(self) -> None:
        """Make the notes as they were before ``note``."""


def write_files(  # noqa: PLR0913  # what else is to happen in the one moment of naming
    root: Path,
    files: Mapping[Path, Iterable[Bytes]],
    target: str,
    *,
    serving: Mapping[Path, Signature] | None = None,
    replaces: Version | None = None,
    sync: bool = True,
    notes: Noting | None = None,
    ahead: Ahead | None = None,
    named: Callable[[], None] | None = None,
) -> Signature:
    """Write files below ``root`` under temporary names, then rename them, the last one last.

    ``serving`` are existing files that the last one names, as they were. ``replaces`` is the source of the
    last one, if it replaces its source. ``sync`` waits until all is on the disk. ``notes`` are taken
    before the files get their names, while no other run names files there. ``ahead`` may have a part of the
    last one. ``named`` is called when all have their names, before any interrupt. Returns the signature of
    the last one, without the time when its name was made. Raises OutputError that names ``target``, and
    TakenError if the names must be planned again. In both cases everything is as it was.
    """
    place = Place(target)
    begun = _Begun(os.path.realpath(root), str(root))
    is_shared = len(files) > 1 or bool(serving) or replaces is not None
    is_short = not is_shared and sum(map(len, files[next(iter(files))])) <= SHORT
    try:
        with interrupts_put_off() if is_short else nullcontext(), ExitStack() as stack, begun:
            # The folder that the user named, and its parents, are made if they are missing.
            missing, folder = [], begun.root
            while not os.path.exists(folder):
                missing.append(folder)
                folder = os.path.dirname(folder)
            for made in reversed(missing):
                with interrupts_put_off(), suppress(FileExistsError):  # another process was faster
                    os.mkdir(made)
                    begun.above.append(made)
            for path, pieces in files.items():
                is_last = len(begun.written) == len(files) - 1
                is_itself, part = replaces is not None and is_last, ahead if is_last else None
                one = _written(path, pieces, begun, stack, place, sync=sync, is_itself=is_itself, ahead=part)
                begun.written.append(one)
            for path in serving or ():  # files that ended runs left beside these are removed too
                _opened(tuple(_parts(path, (begun.root, begun.given), place)[:-1]), begun, stack)
            with locked(begun.open.values()) if is_shared else nullcontext(), interrupts_put_off():
                _check_still_so(serving or {}, replaces, place)
                try:
                    if notes is not None:
                        begun.notes = notes
                        notes.note(files.keys(), target)
                    _rename(begun, replaces, place)
                    if named is not None:
                        named()
                except BaseException:
                    if not begun.is_done:  # pragma: no branch: races
                        begun.take_names_back()  # before another run can take them for its own
                    raise
            if sync:
                _sync_folders(begun)
        return begun.written[-1].signature
    except OSError as error:
        raise not_written(error.strerror or error, place) from error


class _Written(NamedTuple):
    """A file with its temporary name and its final name."""

    folder: Folder
    temporary: str
    name: str
    pieces: Iterable[Bytes]
    signature: Signature


@dataclass(slots=True)
class _Begun:
    """The files of a write so far; if it fails, all of them are removed again.

    ``is_done`` is true when the last file has its name. From then on an interrupt undoes nothing, and a
    failure undoes only files that replaced nothing.
    """

    root: str
    given: str
    open: dict[tuple[str, ...], Folder] = field(default_factory=dict)
    above: list[str] = field(default_factory=list)
    below: list[tuple[str, ...]] = field(default_factory=list)
    temporary: list[tuple[Folder, str]] = field(default_factory=list)
    created: list[tuple[Folder, str]] = field(default_factory=list)
    written: list[_Written] = field(default_factory=list)
    notes: Noting | None = None
    is_done: bool = False
    is_new: bool = False

    def __enter__(self) -> _Begun:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if kind is None or (self.is_done and not (self.is_new and issubclass(kind, OSError))):
            return
        with interrupts_put_off():
            self.take_names_back()
            for folder, name in self.temporary:
                with suppress(OSError):  # it has its final name, or is gone
                    os.unlink(folder.name(name), dir_fd=folder.descriptor)
            for parts in reversed(self.below):
                with suppress(OSError), beneath(self.root, parts[:-1]) as parent:
                    os.rmdir(parent.name(parts[-1]), dir_fd=parent.descriptor)
            for path in reversed(self.above):
                with suppress(OSError):  # another process has put a file there
                    os.rmdir(path)

    def take_names_back(self) -> None:
        """Remove the files whose names were new."""
        for folder, name in self.created:
            with suppress(OSError):  # another process has removed it
                os.unlink(folder.name(name), dir_fd=folder.descriptor)
        self.created.clear()
        if self.notes is not None:
            self.notes.forget()
            self.notes = None


def _written(
    path: Path,
    pieces: Iterable[Bytes],
    begun: _Begun,
    stack: ExitStack,
    place: Place,
    *,
    sync: bool,
    is_itself: bool,
    ahead: Ahead | None,
) -> _Written:
    """Write one file under a temporary name, or the rest of it, if a part has been written ahead."""
    *parts, name = _parts(path, (begun.root, begun.given), place)
    folder = _opened(tuple(parts), begun, stack)
    there = ahead.part(folder, pieces) if ahead is not None and isinstance(pieces, Sequence) else None
    with interrupts_put_off():
        if ahead is None or there is None:
            temporary, there = temporary_name(), slice(0, 0)
            descriptor = os.open(folder.name(temporary), NEW_FILE, 0o666, dir_fd=folder.descriptor)
        else:
            descriptor, temporary = ahead.handed_over()
        begun.temporary.append((folder, temporary))
    try:
        take_over(descriptor, folder, temporary, name, is_itself=is_itself)
        # Write the pieces one after the other, without joining them; generated pieces are written singly.
        if isinstance(pieces, Sequence):
            _write_all(descriptor, pieces[: there.start])
            os.lseek(descriptor, sum(map(len, pieces[there])), os.SEEK_CUR)
            _write_all(descriptor, pieces[there.stop :])
        else:
            for piece in pieces:
                _write_all(descriptor, [piece])
        if sync:
            flush(descriptor)
        signature = signature_of(descriptor)[:-1]
    finally:
        os.close(descriptor)
    return _Written(folder, temporary, name, pieces, signature)


def _parts(path: Path, roots: Sequence[str], place: Place) -> Sequence[str]:
    """Return the parts of a path from the root on; OutputError if it is not below the root."""
    parts = next((path.relative_to(base).parts for base in roots if path.is_relative_to(base)), ())
    if not parts or not {"", ".", ".."}.isdisjoint(parts):  # pragma: no cover: refused before
        raise not_written(f"{path} is not below {roots[-1]}", place)
    return parts


def _opened(parts: tuple[str, ...], begun: _Begun, stack: ExitStack) -> Folder:
    """Return an open folder below the root, made if it is missing; the stack closes it."""
    if parts not in begun.open:

        def made(path: str) -> None:
            begun.below.append(Path(path).relative_to(begun.root).parts)

        with interrupts_put_off():
            folder = stack.enter_context(beneath(begun.root, parts, made))
        begun.open[parts] = folder
        remove_abandoned(folder)
    return begun.open[parts]


def _write_all(descriptor: int, pieces: Sequence[Bytes]) -> None:
    """Write pieces, many in one call if the system can."""
    left = [view for piece in pieces if (view := memoryview(piece).cast("B"))]
    while left:
        if hasattr(os, "writev"):  # pragma: no branch: Windows
            written = os.writev(descriptor, left[:MOST_PIECES])
        else:  # Windows
            written = os.write(descriptor, left[0])
        while left and written >= len(left[0]):
            written -= len(left.pop(0))
        if written:
            left[0] = left[0][written:]


def _check_still_so(serving: Mapping[Path, Signature], replaces: Version | None, place: Place) -> None:
    """Raise OutputError if files have changed since the write was planned."""
    if replaces is not None and not replaces.is_current:  # pragma: no cover: races
        raise OutputError(SAVED_ANEW, place)
    for path, before in serving.items():
        if signature_of(path) != before:
            raise not_written(f"{path} was changed meanwhile", place, TakenError)


def _rename(begun: _Begun, replaces: Version | None, place: Place) -> None:
    """Give all files their names, the last one last; only that one replaces another."""
    *beside, last = begun.written
    for one in beside:
        _put_new(one, begun, place)
    is_new = status_of(last.folder, last.name) is None
    if replaces is not None and not is_new:
        from skinbake.files.replacing import StuckError, replaced  # most outputs replace no input

        expected = partial(replaces.is_in, last.folder, last.temporary)
        try:
            is_replaced = replaced(last.folder, last.temporary, last.name, expected)
        except StuckError:
            begun.is_done = True  # the files beside the new one must stay
            raise
        if is_replaced is False:  # pragma: no cover: races
            raise OutputError(SAVED_ANEW, place)
        if is_replaced:
            begun.is_done = True
            return
    descriptor = last.folder.descriptor
    os.replace(
        last.folder.name(last.temporary),
        last.folder.name(last.name),
        src_dir_fd=descriptor,
        dst_dir_fd=descriptor,
    )
    if is_new:
        begun.created.append((last.folder, last.name))
    begun.is_done, begun.is_new = True, is_new


def _put_new(one: _Written, begun: _Begun, place: Place) -> None:
    """Give a file a name that no other file has, unless a file with the same content has it already."""
    descriptor = one.folder.descriptor
    source, goal = one.folder.name(one.temporary), one.folder.name(one.name)
    try:
        is_renamed = _name_anew(source, goal, descriptor)
    except FileExistsError:
        is_same = False
        with suppress(OSError):  # a link, or gone
            name = one.folder.name(one.name)
            with os.fdopen(open_regular(name, follow=False, dir_fd=one.folder.descriptor), "rb") as file:
                is_same = has_content(file, one.pieces)
        if not is_same:  # pragma: no cover: races
            reason = f"another run has put its {one.name} there meanwhile"
            raise not_written(reason, place, TakenError) from None
        is_renamed = False
    else:
        begun.created.append((one.folder, one.name))
    if not is_renamed:
        os.unlink(source, dir_fd=descriptor)


def _name_anew(source: str, goal: str, descriptor: int | None) -> bool:
    """Give a file a name; FileExistsError if it is taken. False: the file still has its old name too."""
    if not BY_DESCRIPTOR:  # pragma: no cover: Windows, browsers
        if os.path.lexists(goal):  # Windows would replace nothing, browsers have no other process
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
        os.rename(source, goal)
        return True
    try:
        os.link(source, goal, src_dir_fd=descriptor, dst_dir_fd=descriptor, follow_symlinks=False)
    except OSError as error:
        if error.errno not in NO_LINKS:
            raise
        if goal in os.listdir(descriptor):  # pragma: no cover: races
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST)) from error
        os.rename(source, goal, src_dir_fd=descriptor, dst_dir_fd=descriptor)
        return True
    return False


def has_content(file: BinaryIO, pieces: Iterable[Bytes]) -> bool:
    """Tell whether an open file holds these bytes. It is read up to the first difference. Raises OSError."""
    if isinstance(pieces, Sequence) and os.fstat(file.fileno()).st_size != sum(map(len, pieces)):
        return False
    for piece in pieces:
        view = memoryview(piece).cast("B")
        for start in range(0, len(view), SHORT):
            part = view[start : start + SHORT]
            if file.read(len(part)) != part:
                return False
    return not file.read(1)


def _sync_folders(begun: _Begun) -> None:
    """Wait until names are on the disk: of files, and of the folders that were made for them."""
    for folder in begun.open.values():
        folder.sync()
    for parts in {parts[:-1] for parts in begun.below} - begun.open.keys():
        with beneath(begun.root, parts) as folder:
            folder.sync()
    for path in begun.above:
        with beneath(os.path.dirname(path), ()) as folder:
            folder.sync()


@contextmanager
def locked(folders: Iterable[Folder]) -> Iterator[None]:
    """Keep other runs from naming files in these folders, if the system has locks for this.

    The order of the locks is the same everywhere, so that two runs never wait for each other.
    """
    held: dict[tuple[int, int], int] = {}
    for folder in folders:
        if folder.descriptor is not None:  # pragma: no branch: Windows
            found = os.fstat(folder.descriptor)
            held[found.st_dev, found.st_ino] = folder.descriptor
    try:
        for identity in sorted(held):
            _lock(held[identity])
        yield
    finally:
        for descriptor in held.values():
            with suppress(OSError):  # a file system without locks
                fcntl.flock(descriptor, fcntl.LOCK_UN)


def _lock(descriptor: int) -> None:
    deadline = time.monotonic() + PATIENCE
    pause = 0.001
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if time.monotonic() > deadline:  # pragma: no cover: races
                return
        except OSError:  # a file system without locks
            return
        time.sleep(pause)
        pause = min(2 * pause, 0.05)
