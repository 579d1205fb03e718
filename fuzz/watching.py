"""Which files a process opens, makes, renames and removes, told by the interpreter's audit hook.

The hook sees each path as it goes to the system, whatever the code under test believes of it. What C code
opens by itself it does not see; for that the secrets outside of the folders are looked for in all outputs.
"""

from __future__ import annotations

import os
import re
import sys
import sysconfig
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from types import FrameType

WRITES = {
    "os.mkdir",
    "os.remove",
    "os.rmdir",
    "os.rename",
    "os.link",
    "os.symlink",
    "os.truncate",
    "os.chmod",
}
FORBIDDEN = {
    "socket.connect",
    "socket.getaddrinfo",
    "subprocess.Popen",
    "os.system",
    "os.exec",
    "os.posix_spawn",
}

OURS = tuple(
    {
        os.path.realpath(path) + "/"
        for path in (
            sys.prefix,
            sys.base_prefix,
            *sysconfig.get_paths().values(),
            *filter(os.path.isdir, sys.path),
        )
    }
)
BY_DESCRIPTOR = ("writing.py:", "replacing.py:", "folders.py:", "temporary.py:", "versions.py:", "copies.py:")
"""Where names are opened and changed relative to an open folder, of which the hook is not told.

``tests/outside`` watches those at the system call.
"""

READABLE = (
    "/proc/meminfo",
    "/proc/sys/kernel/random/boot_id",
    "/dev/null",
    "/dev/urandom",
    "/etc/localtime",
    "/sys/fs/cgroup",
)
OWN_PROCESS = ("/proc/self/stat", "/proc/self/statm", "/proc/self/status", "/proc/self/cgroup")


@dataclass
class Watch:
    """The folders that one run may read and write; ``broken`` lists all else, with the stack's last line."""

    inputs: str
    outputs: str
    replaces_inputs: bool
    broken: list[tuple[str, str]] = field(default_factory=list)

    def see(self, event: str, values: tuple[object, ...]) -> None:
        """Judge one event of the audit hook."""
        if event in FORBIDDEN:
            self.broken.append((f"{event} {values!r}"[:200], _line()))
        elif event == "open":
            path, mode, flags = values
            if not isinstance(path, int):
                writes = bool(isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
                self._judge(
                    path, writes or (isinstance(mode, str) and not set("wax+").isdisjoint(mode)), event
                )
        elif event in WRITES:
            for path in values[: 2 if event in {"os.rename", "os.link"} else 1]:
                if isinstance(path, str | bytes | os.PathLike):
                    self._judge(path, True, event)

    def _judge(self, path: object, writes: bool, event: str) -> None:
        if not isinstance(path, str | bytes | os.PathLike):
            return  # no name of a file
        name = os.fsdecode(path)
        try:
            real = os.path.realpath(name)
        except (ValueError, OSError):
            return  # no file can have this name
        if not name.startswith("/") and _line().startswith(BY_DESCRIPTOR):
            return
        if real == "/" and not writes:  # the root folder, to see whether the kernel has openat2
            return
        if self._is_below(real, self.outputs) or (
            self._is_below(real, self.inputs) and (not writes or self.replaces_inputs)
        ):
            return
        if not writes and (
            name in OWN_PROCESS
            or re.fullmatch(r"/proc/\d+/stat", real)
            or real.startswith((*OURS, *READABLE))
            or (event == "open" and real + "/" in OURS)
        ):
            return
        self.broken.append((f"{event} {'writes' if writes else 'reads'} {name[:200]}", _line()))

    @staticmethod
    def _is_below(path: str, folder: str) -> bool:
        return path == folder or path.startswith(folder + "/")


@lru_cache(maxsize=1)
def package() -> str:
    """Return the folder of the package that is watched."""
    import skinbake

    return f"{Path(skinbake.__file__).parent}{os.sep}"


def _line() -> str:
    """Return the innermost line of skinbake on the stack."""
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        code = frame.f_code
        if code.co_filename.startswith(package()):
            return f"{Path(code.co_filename).name}:{code.co_name}:{frame.f_lineno}"
        frame = frame.f_back
    return "?"


class Watcher:
    """Judges events while a watch is set; the hook itself can never be taken away again."""

    def __init__(self) -> None:
        self.watch: Watch | None = None
        self._is_inside = False
        sys.addaudithook(self._hook)

    def _hook(self, event: str, values: tuple[object, ...]) -> None:
        if (
            self.watch is None
            or self._is_inside
            or (event not in WRITES and event not in FORBIDDEN and event != "open")
        ):
            return
        self._is_inside = True
        try:
            self.watch.see(event, values)
        finally:
            self._is_inside = False
