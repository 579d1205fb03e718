"""Replace a file by another, unless a program has saved it meanwhile.

A check before a rename leaves a moment in which another program's work would be lost. Linux can exchange two
names in one step (``renameat2`` with ``RENAME_EXCHANGE``). Then the former file can be checked and put back.
"""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable
from functools import lru_cache

from skinbake.files.folders import Folder

EXCHANGE = 2

NO_EXCHANGE = frozenset({errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP, errno.EPERM})
"""The error codes of systems that cannot exchange two names."""

ATTEMPTS = 16
"""The number of times that other programs may save a file while it is put back."""


class StuckError(OSError):
    """The new file has its name, and the former one could not be put back."""


State = tuple[int, int, int, int]
"""The device and the number of a file, its size, and the time when it was written."""


def replaced(folder: Folder, temporary: str, name: str, is_expected: Callable[[], bool]) -> bool | None:
    """Give a file ``name`` by exchanging it with the file there. Return whether it has the name now.

    ``is_expected`` checks the file that then has the temporary name. If it returns False, that file is put
    back. Returns None if the system cannot exchange names. Raises OSError. Then nothing has changed, except
    after a StuckError.
    """
    exchange = exchange_call()
    if exchange is None or folder.descriptor is None:  # pragma: no cover: other systems
        return None
    ours = _state(folder, temporary)
    try:
        exchange(folder.descriptor, temporary, name)
    except OSError as error:
        if error.errno in NO_EXCHANGE:
            return None
        # Another program has removed or renamed it.
        if error.errno == errno.ENOENT:  # pragma: no cover: races
            return False
        raise
    try:
        is_as_read = is_expected()
        if is_as_read:  # pragma: no branch: races
            # The former file goes.
            try:
                os.unlink(temporary, dir_fd=folder.descriptor)
            except OSError:
                os.unlink(temporary, dir_fd=folder.descriptor)
    except OSError:
        _put_back(folder, temporary, name, ours, exchange)
        raise
    if not is_as_read:  # pragma: no cover: races
        _put_back(folder, temporary, name, ours, exchange)
    return is_as_read


def _put_back(  # pragma: no cover: races: tests/files/test_writing.py
    folder: Folder, temporary: str, name: str, ours: State, exchange: Callable[[int, str, str], None]
) -> None:
    """Exchange the names again, until no other program has saved meanwhile: the last save stays."""
    assumed = ours
    try:
        for _ in range(ATTEMPTS):
            put_in = _state(folder, temporary)
            exchange(folder.descriptor or 0, temporary, name)
            if _state(folder, temporary) == assumed:
                return
            assumed = put_in
    except OSError as error:
        raise StuckError(error.errno, f"{error.strerror}; the former file is now {temporary}") from error


def _state(folder: Folder, name: str) -> State:
    found = os.stat(name, dir_fd=folder.descriptor, follow_symlinks=False)
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


@lru_cache(maxsize=1)
def exchange_call() -> Callable[[int, str, str], None] | None:
    """Return Linux's call that exchanges two names in a folder, None if there is none."""
    if not sys.platform.startswith("linux"):  # pragma: no cover: other systems
        return None
    try:
        import ctypes
    except ImportError:  # pragma: no cover: a Python that was built without libffi
        return None

    call = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    # A C library from before 2018.
    if call is None:  # pragma: no cover: other systems
        return None

    def exchange(folder: int, one: str, other: str) -> None:
        if call(folder, os.fsencode(one), folder, os.fsencode(other), ctypes.c_uint(EXCHANGE)) != 0:
            code = ctypes.get_errno()
            raise OSError(code, os.strerror(code))

    return exchange
