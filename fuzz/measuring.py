"""Which branches of skinbake's readers and writers a child takes: measured in it, kept in a folder."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    import coverage

REPOSITORY = Path(__file__).resolve().parents[1]
SOURCE = "src/skinbake"
PACKAGES = ("files", "gltf")
"""The parts of skinbake that read and write files."""

Result = TypeVar("Result")


def measurement(file: Path) -> coverage.Coverage:
    """Return a measurement of the branches of these parts, to be saved in a file."""
    import coverage

    measured = [f"{REPOSITORY}/{SOURCE}/{package}/*" for package in PACKAGES]
    return coverage.Coverage(data_file=str(file), branch=True, include=measured, config_file=False)


def measured(work: Callable[[], Result], folder: Path) -> Result:
    """Do work in a child, keep which branches it took, and return what it returned."""
    own = measurement(folder / f"child-{os.getpid()}")
    own.start()
    try:
        return work()
    finally:
        own.stop()
        own.save()
