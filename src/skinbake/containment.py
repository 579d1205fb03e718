"""Files that a document names. They are below a folder by construction, despite any name or link.

A document may come from a stranger. Every name in it passes ``relative_names`` once. Only the result is
compared, opened or written. The open walks down from a folder and never leaves it. If the system has
``openat2`` (Linux 5.6), the open uses it with ``RESOLVE_BENEATH``. Elsewhere it opens one part of the path at
a time. On Windows the real path is compared.
"""

from __future__ import annotations

import errno
import os
import posixpath
import re
import stat
import struct
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from typing import NamedTuple
from urllib.parse import quote, unquote

if sys.platform != "win32":
    import fcntl

DEVICES = frozenset(
    {"CON", "PRN", "AUX", "NUL", "CONIN$", "CONOUT$", "CLOCK$"}
    | {f"{port}{number}" for port in ("COM", "LPT") for number in "0123456789¹²³"}
)
"""Names that mean a device in any folder of Windows, with any suffix."""

MOST_LINKS = 40
"""The largest number of symbolic links on the way to one file, as on Linux."""

NO_SYNC = frozenset({errno.EINVAL, errno.EOPNOTSUPP, errno.ENOSYS, errno.EBADF, errno.EACCES, errno.EPERM})
"""The error codes of systems that cannot wait for the disk, for this kind of file or at all."""

BY_DESCRIPTOR = os.open in os.supports_dir_fd
"""Whether this system opens names relative to an open folder. All but Windows do."""

_SCHEME = re.compile(r"^[A-Za-z][A-Za-z0-9+.\-]*:")
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


class RefusedError(ValueError):
    """A name that is never opened, even if a file is there. The text says why."""


class OutsideError(RefusedError):
    """A relative name that leads out of the folders that may be read."""


NOWHERE = ""
"""The root of a document that came without a folder. It may name no file but the allowed ones."""


class Bounds(NamedTuple):
    """The places to which a document's names may lead: below ``root``, or below one of ``allowed``.

    They are paths, or URLs if the document has a URL. None stands for the document's own folder.
    """

    root: str | None = None
    allowed: tuple[str, ...] = ()


BESIDE = Bounds()
"""A document may name the files in its own folder and below."""


class Within(NamedTuple):
    """The folders in which a job stays: it reads within ``bounds`` and writes below ``output``.

    If ``output`` is None, it is the target's own folder.
    """

    bounds: Bounds = BESIDE
    output: str | None = None


OWN_FOLDERS = Within()
"""The folders of a file that the user named, and of a target that the user named."""


class Spot(NamedTuple):
    """The place to which a name leads: a path below a folder, in forward slashes.

    ``is_own`` tells that the folder is the document's own root.
    """

    root: str
    name: str
    is_own: bool = True

    @property
    def path(self) -> str:
        """The whole path, for messages and comparison. It is not opened."""
        return os.path.join(self.root, *self.name.split("/"))


def relative_names(uri: str) -> tuple[str, ...]:
    """Return the relative paths that a URI of a document may mean, the likelier first.

    Percent-encoding is decoded once. ``#`` and ``?`` belong to the name. The second path is for a file whose
    name has the URI's characters literally, as some exporters write it. Raises RefusedError if the first path
    is not a relative path that means the same on every system: NUL, a backslash, a colon (drives, schemes and
    streams of Windows), an absolute path, a device of Windows, or the name of no file.
    """
    names = [_checked(unquote(uri, errors="surrogateescape"))]
    if "%" in uri:
        with suppress(RefusedError):
            names.append(_checked(uri))
    return tuple(dict.fromkeys(names))


def _checked(name: str) -> str:
    """Return a relative path without inner dots to resolve. Raises RefusedError for any other."""
    if "\0" in name:
        raise RefusedError("it holds a NUL character")
    if "\\" in name:
        raise RefusedError("it holds a backslash; paths in glTF use forward slashes")
    if name.startswith("/"):
        raise RefusedError("it is an absolute path")
    if ":" in name:
        scheme = _SCHEME.match(name)
        kind = "a drive" if scheme and scheme.end() == 2 else "a scheme" if scheme else "a colon"
        raise RefusedError(f"it has {kind}, and is neither a relative path nor a data: URI")
    for part in name.split("/"):
        if part not in {"", ".", ".."} and not part.strip(". "):
            raise RefusedError(f'"{part}" is not a valid file name on every system')
        if part.split(".")[0].rstrip(" ").upper() in DEVICES:
            raise RefusedError(f'"{part}" is a device on Windows')
    normal = posixpath.normpath(name) if name else "."
    if name.endswith(("/", "/.", "/..")) or normal in {".", ".."}:
        raise RefusedError("it names no file")
    return normal


def is_relative(uri: str) -> bool:
    """Tell whether a URI of a document names a file by a relative path."""
    try:
        return bool(relative_names(uri))
    except RefusedError:
        return False


def leads_up(name: str) -> bool:
    """Tell whether a normal relative path begins above its folder."""
    return name.startswith("../")


def path_uri(path: str) -> str:
    """Return the relative URI of a path with forward slashes."""
    return quote(os.fsencode(path), safe="/!$&'()*+,;=@~-._")


def spots(uri: str, folder: str, bounds: Bounds) -> list[Spot]:
    """Return the places to which a document's URI may lead, the likelier first. ``folder`` is the document's.

    On the disk only the folders are looked at, to find their names. Raises RefusedError, and OutsideError if
    the first name leads out of all bounds.
    """
    home = os.path.realpath(folder)
    own = folder if bounds.root is None else bounds.root
    roots = [*([own] if own != NOWHERE else []), *bounds.allowed]
    found: list[Spot] = []
    for name in relative_names(uri):
        path = os.path.normpath(os.path.join(home, *name.split("/")))
        for number, root in enumerate(map(os.path.realpath, roots)):
            inside = below(path, root)
            if inside is not None:
                found.append(Spot(root, inside, number == 0 and own != NOWHERE))
                break
        else:
            if not found:
                where = f"it leads out of {own or os.curdir}" if own != NOWHERE else "it has no folder"
                raise OutsideError(where)
    return found


def below(path: str, root: str) -> str | None:
    """Return the path relative to a folder, in forward slashes, or None if it is not below the folder."""
    prefix = root if root.endswith(os.sep) else root + os.sep
    if not os.path.normcase(path).startswith(os.path.normcase(prefix)):
        return None
    return path[len(prefix) :].replace(os.sep, "/") or None


def spot_of(path: str, root: str) -> Spot:
    """Return the place of a path below a folder. Links below the folder are not followed.

    Raises OutsideError if the path is outside.
    """
    folder = os.path.realpath(root)
    given = os.path.abspath(root)
    name = below(os.path.normpath(os.path.abspath(path)), given)
    if name is None:
        raise OutsideError(f"it is not below {root}")
    return Spot(folder, name)


def moved_uri(uri: str, folder: str, target: str) -> str:
    """Return a relative URI, made for a document in ``folder``, as seen from the folder ``target``.

    Only text is used; the disk is not read. Raises RefusedError.
    """
    path = os.path.normpath(os.path.join(os.path.realpath(folder), *relative_names(uri)[0].split("/")))
    try:
        return path_uri(os.path.relpath(path, target).replace(os.sep, "/"))
    except ValueError as error:
        raise RefusedError("no relative URI leads there from another drive") from error


def open_beneath(spot: Spot) -> int:
    """Return a descriptor of a regular file, opened for reading without leaving the spot's root.

    Raises OSError: EXDEV if a link leads out, EINVAL for devices, FIFOs, sockets and files that the system
    generates (/proc, /sys).
    """
    return _regular(_open(spot.root, spot.name, _READ_FLAGS))


def open_regular(path: str) -> int:
    """Return a descriptor of a regular file that the user named, opened for reading. Raises OSError."""
    return _regular(os.open(path, _READ_FLAGS))


def _regular(descriptor: int) -> int:
    """Return the descriptor of a regular file on a disk. Any other one is closed, and OSError is raised."""
    try:
        check_regular(descriptor)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def check_regular(descriptor: int) -> None:
    """Raise OSError unless the descriptor is a regular file on a disk."""
    found = os.fstat(descriptor)
    if stat.S_ISDIR(found.st_mode):
        raise OSError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(found.st_mode) or found.st_dev in _made_up():
        raise OSError(errno.EINVAL, "it is not a regular file")


@lru_cache(maxsize=1)
def _made_up() -> frozenset[int]:
    """Return the devices of file systems whose files the kernel generates when they are read."""
    devices = set()
    for folder in ("/proc", "/sys") if sys.platform.startswith("linux") else ():
        with suppress(OSError):  # it may not be mounted
            found = os.stat(folder)
            if found.st_dev != os.stat("/").st_dev:
                devices.add(found.st_dev)
    return frozenset(devices)


class Folder:
    """An open folder below a root. Names in it are used without following links.

    ``path`` is its name in messages. If the system opens names relative to descriptors, the folder stays the
    opened one, even if it is renamed or replaced by a link meanwhile.
    """

    def __init__(self, path: str, descriptor: int | None) -> None:
        """Hold an open folder. ``beneath`` makes one."""
        self.path, self._descriptor = path, descriptor

    @property
    def descriptor(self) -> int | None:
        """The value for ``dir_fd``, or None on systems without it."""
        return self._descriptor

    def name(self, name: str) -> str:
        """Return the name of a file of the folder in calls that have ``dir_fd=folder.descriptor``."""
        return name if self._descriptor is not None else os.path.join(self.path, name)

    def sync(self) -> None:
        """Wait until the names in the folder are on the disk. Systems that cannot do it are ignored."""
        if self._descriptor is not None:
            flush(self._descriptor)


def flush(descriptor: int) -> None:
    """Wait until a file or folder is on the disk, its cache included. Raises OSError if that fails."""
    try:
        full = getattr(fcntl, "F_FULLFSYNC", None) if sys.platform != "win32" else None
        if full is None:
            os.fsync(descriptor)
        else:  # macOS: fsync leaves the data in the cache of the disk
            fcntl.fcntl(descriptor, full)
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
    if not BY_DESCRIPTOR:
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
            following = _stepped(root, current, parts[:number], made)
            os.close(current)
            current = following
        yield Folder(path, current)
    finally:
        os.close(current)


def _stepped(root: str, current: int, parts: Sequence[str], made: Callable[[str], None] | None) -> int:
    """Return a descriptor of the folder at ``parts``. Its last part is in the folder ``current``."""
    name = "/".join(parts)
    try:
        return _open(root, name, _FOLDER_FLAGS)
    except FileNotFoundError:
        if made is None:
            raise
    with suppress(FileExistsError):  # another process was faster, or a link there leads nowhere
        os.mkdir(parts[-1], dir_fd=current)
        made(os.path.join(root, *parts))
    return _open(root, name, _FOLDER_FLAGS)


def _open(root: str, name: str, flags: int) -> int:
    """Open a path below a folder without leaving it."""
    if not BY_DESCRIPTOR:
        path = os.path.join(root, *name.split("/"))
        _check_real(root, path)
        return os.open(path, flags)
    folder = os.open(root, _FOLDER_FLAGS)
    try:
        openat2 = _openat2()
        return _walked(folder, name, flags) if openat2 is None else openat2(folder, os.fsencode(name), flags)
    finally:
        os.close(folder)


def _check_real(root: str, path: str) -> None:
    """Raise OSError if a path, all links followed, is outside the folder."""
    real, base = os.path.realpath(path), os.path.realpath(root)
    if real != base and below(real, base) is None:
        raise OSError(errno.EXDEV, "a link leads out of the folder")


@lru_cache(maxsize=1)
def _openat2() -> Callable[[int, bytes, int], int] | None:
    """Return Linux's call that opens a path without leaving a folder, or None if it is missing."""
    if not sys.platform.startswith("linux"):
        return None
    import ctypes  # numpy has imported it by then

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
            if code not in {errno.EAGAIN, errno.EINTR}:  # EAGAIN: a name on the way was changed
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


def _walked(folder: int, name: str, flags: int) -> int:
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
            target = _link(part, stack[-1])
            if target is None:
                stack.append(os.open(part, kind | os.O_NOFOLLOW, dir_fd=stack[-1]))
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


def _link(name: str, folder: int) -> str | None:
    """Return the target of a symbolic link, or None if the name is no link."""
    try:
        return os.readlink(name, dir_fd=folder)
    except OSError as error:
        if error.errno == errno.EINVAL:
            return None
        raise
