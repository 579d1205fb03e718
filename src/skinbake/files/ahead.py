"""Write the part of a large file that is known first, while the rest is being made."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from threading import Thread

from skinbake.files import Bytes
from skinbake.files.folders import BY_DESCRIPTOR, Folder, beneath, flush
from skinbake.files.temporary import NEW_FILE, remove_abandoned, take_over, temporary_name
from skinbake.signals import interrupts_put_off

STEP = 1 << 23
"""Bytes of one write. Before each, the thread looks whether the part is still wanted."""


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
