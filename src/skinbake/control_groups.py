"""The folders in which Linux keeps the limits of a process's control groups, which containers set."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

GROUPS, GROUP_ROOT = Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")
"""The paths where Linux lists the control groups of a process, and their limits."""


def group_folders(controller: str, groups: Path = GROUPS, root: Path = GROUP_ROOT) -> Iterator[Path]:
    """Yield the folders that limit this process for a controller: its own groups and those around them.

    The folders of version 2 and of version 1 have files of different names.
    """
    try:
        lines = groups.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, path = (*line.split(":", maxsplit=2), "", "")[:3]
        if controllers and controller not in controllers.split(","):
            continue
        base = root / controller if controllers else root
        own = base / path.strip("/")
        for folder in dict.fromkeys((own, *own.parents)):
            if folder != base and base not in folder.parents:
                break
            yield folder
