"""Files and folders below a folder, opened without leaving it, despite any link.

The open walks down from a folder and never leaves it. If the system has ``openat2`` (Linux 5.6), the open
uses it with ``RESOLVE_BENEATH``. Elsewhere it opens one part of the path at a time. On Windows the real path
is compared.
"""

from __future__ import annotations

import errno
import os
import stat
import struct
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from typing import NamedTuple

from skinbake.files.bounds import BoundedPath, below

MOST_LINKS = 40
"""The largest number of symbolic links on the way to one file, as on Linux."""

NO_SYNC = frozenset({errno.EINVAL, errno.EOPNOTSUPP, errno.ENOSYS, errno.EBADF, errno.EACCES, errno.EPERM})
"""The error codes of systems that cannot wait for the disk, for this kind of file or at all."""

NOT_REGULAR = "it is not a regular file"

BY_DESCRIPTOR = os.open in os.supports_dir_fd and sys.platform != "emscripten"
"""Whether this system opens names relative to an open folder, and locks it. Windows and browsers do not."""

_SYS_OPENAT2 = 437
_NO_MAGIC_LINKS, _BENEATH = 0x02, 0x08
_READ_FLAGS = (
    os.O_RDONLY
    | getattr(os, "O_NONBLOCK", 0)  # a FIFO must not wait for a writer
    | getattr(os, "O_NOCTTY", 0)
    | getattr(os, "O_CLOEXEC", 0)
    | getattr(os, "O_BINARY", 0)
)
_FOLDER_FLAGS = os.O_RDONLY | getattr(os, "O_DIRECTORY", 0) | getattr(os, "O_CLOEXEC", 0)


def open_beneath(file: BoundedPath) -> int:
    """Return a descriptor of a regular file, opened for reading without leaving its root.

    Raises OSError: EXDEV if a link leads out, EINVAL for devices, FIFOs, sockets and files that the system
    generates (/proc, /sys).
    """
    return _regular(lambda: _open(file.root, file.name, _READ_FLAGS))


def open_regular(path: str, *, follow: bool = True, dir_fd: int | None = None) -> int:
    """Return a descriptor of a regular file that the user named, opened for reading. Raises OSError.

    Without ``follow`` it may not be a link.
    """
    flags = _READ_FLAGS | (0 if follow else getattr(os, "O_NOFOLLOW", 0))
    return _regular(lambda: os.open(path, flags, dir_fd=dir_fd))


def _regular(opens: Callable[[], int]) -> int:
    """Return the descriptor of a regular file on a disk. Any other one is closed, and OSError is raised."""
    try:
        descriptor = opens()
    except OSError as error:
        if error.errno == errno.ENXIO:  # a socket
            raise OSError(errno.EINVAL, NOT_REGULAR) from error
        raise
    try:
        found = os.fstat(descriptor)
        if stat.S_ISDIR(found.st_mode):  # pragma: no cover: tests/files/test_containment.py
            raise OSError(errno.EISDIR, os.strerror(errno.EISDIR))
        if not stat.S_ISREG(found.st_mode) or found.st_dev in _made_up():
            raise OSError(errno.EINVAL, NOT_REGULAR)  # pragma: no cover: tests/files
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


@lru_cache(maxsize=1)
def _made_up() -> frozenset[int]:
    """Return the devices of file systems whose files the kernel generates when they are read."""
    devices = set()
    for folder in ("/proc", "/sys") if sys.platform.startswith("linux") else ():
        with suppress(OSError):  # it may not be mounted
            found = os.stat(folder)
            if found.st_dev != os.stat("/").st_dev:  # pragma: no branch: other systems
                devices.add(found.st_dev)
    return frozenset(devices)


class Folder(NamedTuple):
    """An open folder below a root, which ``beneath`` opens. Names in it are used without following links.

    ``path`` is its name in messages. ``descriptor`` is the value for ``dir_fd``, None on systems without it.
    With it, the folder stays the opened one, even if it is renamed or replaced by a link meanwhile.
    """

    path: str
    descriptor: int | None

    def name(self, name: str) -> str:
        """Return the name of a file of the folder in calls that have ``dir_fd=folder.descriptor``."""
        return name if self.descriptor is not None else os.path.join(self.path, name)

    def sync(self) -> None:
        """Wait until the names in the folder are on the disk. Systems that cannot do it are ignored."""
        if self.descriptor is not None:  # pragma: no branch: Windows
            flush(self.descriptor)


def flush(descriptor: int) -> None:
    """Wait until a file or folder is on the disk, its cache included. Raises OSError if that fails."""
    try:
        if sys.platform == "darwin":  # where fsync leaves the data in the cache of the disk
            import fcntl  # Windows and browsers have none

            fcntl.fcntl(descriptor, fcntl.F_FULLFSYNC)
        else:
            os.fsync(descriptor)
    except OSError as error:
        if error.errno not in NO_SYNC:
            raise


@contextmanager
def beneath(root: str, parts: Sequence[str], made: Callable[[str], None] | None = None) -> Iterator[Folder]:
    """Yield the folder to which ``parts`` lead from the folder ``root``, without leaving ``root``.

    Missing folders are made if ``made`` is given. It is called with the path of each. Raises OSError: EXDEV
    if a link leads out of the root.
    """
    path = os.path.join(root, *parts)
    if not BY_DESCRIPTOR:  # pragma: no cover: Windows
        for number in range(1, len(parts) + 1):
            step = os.path.join(root, *parts[:number])
            _check_real(root, step)
            if not os.path.isdir(step):
                if made is None:
                    raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))
                os.mkdir(step)
                made(step)
        yield Folder(path, None)
        return
    current = os.open(root, _FOLDER_FLAGS)
    try:
        for number in range(1, len(parts) + 1):
            name = "/".join(parts[:number])
            try:
                following = _open(root, name, _FOLDER_FLAGS)
            except FileNotFoundError:
                if made is None:  # pragma: no cover: races
                    raise
                with suppress(FileExistsError):  # another process was faster, or a link there leads nowhere
                    os.mkdir(parts[number - 1], dir_fd=current)
                    made(os.path.join(root, *parts[:number]))
                following = _open(root, name, _FOLDER_FLAGS)
            os.close(current)
            current = following
        yield Folder(path, current)
    finally:
        os.close(current)


def _open(root: str, name: str, flags: int) -> int:
    """Open a path below a folder without leaving it."""
    if not BY_DESCRIPTOR:  # pragma: no cover: Windows
        path = os.path.join(root, *name.split("/"))
        _check_real(root, path)
        return os.open(path, flags)
    folder = os.open(root, _FOLDER_FLAGS)
    try:
        call = openat2()
        return _walked(folder, name, flags) if call is None else call(folder, os.fsencode(name), flags)
    finally:
        os.close(folder)


def _check_real(root: str, path: str) -> None:  # pragma: no cover: Windows
    """Raise OSError if a path, all links followed, is outside the folder."""
    real, base = os.path.realpath(path), os.path.realpath(root)
    if real != base and below(real, base) is None:
        raise OSError(errno.EXDEV, "a link leads out of the folder")


@lru_cache(maxsize=1)
def openat2() -> Callable[[int, bytes, int], int] | None:
    """Return Linux's call that opens a path without leaving a folder, or None if it is missing."""
    if not sys.platform.startswith("linux"):  # pragma: no cover: other systems
        return None
    try:
        import ctypes  # numpy has imported it by then
    except ImportError:  # pragma: no cover: a Python that was built without libffi
        return None

    syscall = ctypes.CDLL(None, use_errno=True).syscall
    syscall.restype = ctypes.c_long

    def call(folder: int, name: bytes, flags: int) -> int:
        how = struct.pack("QQQ", flags, 0, _BENEATH | _NO_MAGIC_LINKS)
        while True:
            descriptor = syscall(_SYS_OPENAT2, folder, ctypes.c_char_p(name), how, ctypes.c_size_t(len(how)))
            if descriptor >= 0:
                return int(descriptor)
            code = ctypes.get_errno()
            if code == errno.EXDEV:
                raise OSError(code, "a link leads out of the folder")
            # EAGAIN: a name on the way was changed.
            if code not in {errno.EAGAIN, errno.EINTR}:  # pragma: no branch: races
                raise OSError(code, os.strerror(code))

    try:
        folder = os.open("/", _FOLDER_FLAGS)
        try:
            os.close(call(folder, b".", _FOLDER_FLAGS))
        finally:
            os.close(folder)
    except OSError:  # an older kernel, or a sandbox that does not know the call
        return None
    return call


def _walked(folder: int, name: str, flags: int) -> int:  # pragma: no cover: without openat2
    """Open a path below an open folder, one part at a time. Links are resolved here and never lead out."""
    stack, links = [os.dup(folder)], 0
    parts = name.split("/")[::-1]
    try:
        while parts:
            part = parts.pop()
            if part in {"", "."}:
                continue
            if part == "..":
                if len(stack) == 1:
                    raise OSError(errno.EXDEV, "a link leads out of the folder")
                os.close(stack.pop())
                continue
            kind = _FOLDER_FLAGS if any(step not in {"", "."} for step in parts) else flags
            try:
                target = os.readlink(part, dir_fd=stack[-1])
            except OSError as error:
                if error.errno != errno.EINVAL:
                    raise
                stack.append(os.open(part, kind | os.O_NOFOLLOW, dir_fd=stack[-1]))  # it is not a link
                continue
            links += 1
            if links > MOST_LINKS:
                raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))
            if target.startswith("/"):
                raise OSError(errno.EXDEV, "a link leads out of the folder")
            parts.extend(target.split("/")[::-1])
        return stack.pop()
    finally:
        for descriptor in stack:
            os.close(descriptor)
