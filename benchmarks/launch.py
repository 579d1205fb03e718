"""Run a command, and print its wall time in seconds and its peak memory in bytes as a last line.

Usage: python -I -S benchmarks/launch.py [--one-core] COMMAND [ARGUMENT ...]

The peak is that of the largest process among the command and those that it waited for. A process of its own
asks the system for it, a small one: until it executes its program, a new process counts as its own the memory
of the one that it came from, and a benchmark that holds arrays would hand its peak down.
"""

from __future__ import annotations

import os
import sys
import time


def main() -> int:
    """Return the command's exit code."""
    command = sys.argv[1:]
    if command[0] == "--one-core":
        command = command[1:]
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    start = time.perf_counter()
    child = os.posix_spawnp(command[0], command, os.environ)
    _, status, usage = os.wait4(child, 0)
    seconds = time.perf_counter() - start
    peak = usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    print(f"\n{seconds:.6f} {peak}")
    return os.waitstatus_to_exitcode(status)


if __name__ == "__main__":
    sys.exit(main())
