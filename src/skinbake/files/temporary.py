"""Temporary files, whose names say which process made them. So later processes remove what it left."""

from __future__ import annotations

import hashlib
import os
import re
import secrets
import stat
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from functools import lru_cache
from pathlib import Path
from threading import Thread

from skinbake.files import Bytes
from skinbake.files.folders import BY_DESCRIPTOR, Folder, beneath, flush
from skinbake.signals import interrupts_put_off

OWNER = r"([0-9a-f]{8})_([0-9a-f]+)_([0-9a-f]+)_"
"""The pattern of ``owner``. Its groups are the kernel, the process, and the start time of the process."""


TEMPORARY = re.compile(rf"\.skinbake-(?:{OWNER})?[0-9a-f]{{12}}\.tmp")
"""Names of temporary files: their owner, if it is known, and a random part."""

REMEMBERED = 4096
"""Number of folders that a process remembers as cleaned of abandoned files."""

ABANDONED = 86_400.0
"""Seconds after which a temporary file of an unknown process counts as abandoned."""

NEW_FILE = (
    os.O_WRONLY
    | os.O_CREAT
    | os.O_EXCL
    | getattr(os, "O_NOFOLLOW", 0)
    | getattr(os, "O_CLOEXEC", 0)
    | getattr(os, "O_BINARY", 0)
)
"""How a temporary file is opened: it is new, and no link."""

STEP = 1 << 23
"""Bytes of one write. Before each, the thread looks whether the part is still wanted."""

_looked_through: set[tuple[int, int]] = set()


def temporary_name() -> str:
    """Return a name for a temporary file that identifies its process."""
    return f".skinbake-{owner(os.getpid())}{secrets.token_hex(6)}.tmp"


def remove_abandoned(folder: Folder) -> None:
    """Remove temporary files of ended processes, once for each folder, because there may be many files."""
    with suppress(OSError):  # such files do no harm
        found = os.stat(folder.path if folder.descriptor is None else folder.descriptor)
        if (found.st_dev, found.st_ino) in _looked_through:
            return
        if len(_looked_through) >= REMEMBERED:  # pragma: no cover: takes 4,096 folders
            _looked_through.clear()
        _looked_through.add((found.st_dev, found.st_ino))
        with os.scandir(folder.path if folder.descriptor is None else folder.descriptor) as entries:
            left = [entry for entry in entries if entry.name.startswith(".skinbake-")]
            for entry in left:
                match = TEMPORARY.fullmatch(entry.name)
                if match is None or not entry.is_file(follow_symlinks=False):
                    continue
                # Where the name does not tell whether its process has ended, its age does.
                is_left = has_ended(match)
                if is_left is None:
                    is_left = time.time() - entry.stat(follow_symlinks=False).st_mtime > ABANDONED
                if is_left:
                    os.unlink(folder.name(entry.name), dir_fd=folder.descriptor)


@lru_cache(maxsize=1)
def owner(process: int) -> str:
    """Return the beginning of a name that tells of a process; empty if the system does not identify it."""
    kernel, (_, started) = _kernel(), _process(process)
    return f"{kernel}_{process:x}_{started:x}_" if kernel and started else ""


def has_ended(found: re.Match[str]) -> bool | None:
    """Tell whether the process in a name, by the groups of ``OWNER``, has ended; False if in doubt.

    None if the name does not tell, or tells of a process of another system.
    """
    kernel, process, started = found.groups()
    if not kernel or kernel != _kernel():
        return None
    number = int(process, 16)
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return True
    except (OSError, OverflowError):
        pass
    # It may be dead and not yet collected, or another process may have its number.
    state, now_started = _process(number)
    return state in {"Z", "X"} or now_started not in {0, int(started, 16)}


@lru_cache(maxsize=1)
def _kernel() -> str:
    """Return an identity of this running system among all that may share a folder; empty if unknown.

    Containers on one system count processes separately. Their namespace identifies them.
    """
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        return hashlib.sha256(f"{boot} {Path('/proc/self/ns/pid').readlink()}".encode()).hexdigest()[:8]
    except (OSError, ValueError):
        return ""


def _process(process: int) -> tuple[str, int]:
    """Return the state of a process and its start time in ticks; empty and 0 if unknown."""
    try:
        fields = Path(f"/proc/{process}/stat").read_bytes().rpartition(b")")[2].split()
        return fields[0].decode("ascii"), int(fields[19])
    except (OSError, ValueError, IndexError):
        return "", 0


def take_over(descriptor: int, folder: Folder, temporary: str, name: str, *, is_itself: bool) -> None:
    """Give a temporary file the mode of the file whose name it will have.

    If it replaces itself, it keeps its owner and its extended attributes too, as far as the system lets it.
    """
    before = status_of(folder, name)
    if before is None or not stat.S_ISREG(before.st_mode):
        return
    if is_itself and BY_DESCRIPTOR:
        # Give a file the owner and the group that it had; only the superuser may give any owner.
        now = os.fstat(descriptor)
        if (now.st_uid, now.st_gid) != (before.st_uid, before.st_gid):
            try:
                os.fchown(descriptor, before.st_uid, before.st_gid)
            except OSError:
                with suppress(OSError):
                    os.fchown(descriptor, -1, before.st_gid)
        # Its extended attributes, access lists among them.
        if sys.platform == "linux":
            with suppress(OSError):
                former = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=folder.descriptor)
                try:
                    for attribute in os.listxattr(former):
                        with suppress(OSError):  # some are the system's own
                            os.setxattr(descriptor, attribute, os.getxattr(former, attribute))
                finally:
                    os.close(former)
    os.chmod(descriptor if BY_DESCRIPTOR else folder.name(temporary), stat.S_IMODE(before.st_mode))


def status_of(folder: Folder, name: str) -> os.stat_result | None:
    """Return the status of a name in an open folder, of a link itself; None if nothing is there."""
    try:
        return os.stat(folder.name(name), dir_fd=folder.descriptor, follow_symlinks=False)
    except FileNotFoundError:
        return None


class Ahead:
    """A temporary file that a thread fills with a part of an output, and brings to the disk.

    ``is_itself`` tells that the output replaces its own source. There is no file before ``begin``. After the
    block the temporary name is gone. Nobody waits for the thread then: its file has no name any more.
    """

    def __init__(self, *, is_itself: bool) -> None:
        self._is_itself = is_itself
        self._open = ExitStack()
        self._pieces: Sequence[Bytes] = ()
        self._is_wanted, self._is_whole = True, False

    def __enter__(self) -> Ahead:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop the thread at its next step, and remove the temporary name."""
        self._is_wanted, self._pieces = False, ()
        with interrupts_put_off():
            self._open.close()

    def begin(self, path: Path, root: Path, offset: int, pieces: Sequence[Bytes]) -> None:
        """Begin to write pieces at an offset of the file that will be ``path``, which is below ``root``.

        The folder must exist. Systems that remove no open file do without. Raises OSError, or RuntimeError
        where no thread can be started.
        """
        if not BY_DESCRIPTOR:  # pragma: no cover: Windows
            return
        *parts, name = path.relative_to(root).parts
        with interrupts_put_off():
            self._folder = self._open.enter_context(beneath(os.fspath(root), parts))
            remove_abandoned(self._folder)
            self._temporary = temporary_name()
            self._descriptor = os.open(self._temporary, NEW_FILE, 0o666, dir_fd=self._folder.descriptor)
            self._open.callback(os.close, self._descriptor)
            self._open.callback(self._unlink)
        take_over(self._descriptor, self._folder, self._temporary, name, is_itself=self._is_itself)
        # It has a descriptor of its own: the number of a closed one may belong to another file.
        told = os.dup(self._descriptor), pieces, offset
        self._thread = Thread(target=self._fill, args=told, daemon=True)
        self._thread.start()
        self._pieces, self._offset = pieces, offset

    def part(self, folder: Folder, pieces: Sequence[Bytes]) -> slice | None:
        """Wait for the thread, and return which of all the pieces of the output are in the file.

        If the file is in another folder, lacks anything or has been handed over, it is gone: its space is
        free.
        """
        if self._pieces:
            self._thread.join()
            first = next((number for number, piece in enumerate(pieces) if piece is self._pieces[0]), 0)
            there = slice(first, first + len(self._pieces))
            if (
                self._is_whole
                and sum(map(len, pieces[:first])) == self._offset
                and [*map(id, pieces[there])] == [*map(id, self._pieces)]
                and os.path.samestat(*(os.fstat(of.descriptor or 0) for of in (folder, self._folder)))
            ):
                return there
        self.close()
        return None

    def handed_over(self) -> tuple[int, str]:
        """Return a descriptor of the file and its name. The caller closes and removes both from now on."""
        name, self._temporary, self._pieces = self._temporary, "", ()
        return os.dup(self._descriptor), name

    def _fill(self, descriptor: int, pieces: Sequence[Bytes], offset: int) -> None:
        """Write the pieces, as long as they are wanted."""
        try:
            for piece in pieces:
                view = memoryview(piece).cast("B")
                while view:
                    if not self._is_wanted:
                        return
                    written = os.pwrite(descriptor, view[:STEP], offset)
                    view, offset = view[written:], offset + written
            flush(descriptor)
            self._is_whole = True
        except OSError:  # the output is written without it, and fails in its own way
            pass
        finally:
            os.close(descriptor)

    def _unlink(self) -> None:
        if self._temporary:
            with suppress(OSError):  # another process has removed it
                os.unlink(self._temporary, dir_fd=self._folder.descriptor)
