"""Memory that the C library keeps after it was freed."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

KEPT = """
from pathlib import Path
import numpy as np
from skinbake.measure.measured import give_back_freed_memory

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096

# Each is too small for memory of its own, and the last one keeps the heap from shrinking.
arrays = [np.ones(12_000) for _ in range(1000)]
last = arrays.pop()
del arrays
before = resident()
give_back_freed_memory()
print(before - resident())
"""


@pytest.mark.slow
@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc keeps freed memory")
def test_freed_memory_goes_back_to_the_system() -> None:
    process = subprocess.run([sys.executable, "-c", KEPT], capture_output=True, text=True, check=True)
    assert int(process.stdout) > 80_000_000


def test_another_c_library_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    import ctypes

    from skinbake.measure.measured import give_back_freed_memory

    def refused(name: object) -> None:
        raise OSError("there is no such library")

    for library in (refused, lambda name: object()):
        monkeypatch.setattr(ctypes, "CDLL", library)
        give_back_freed_memory()
