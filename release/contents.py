"""Hold the files in an sdist or a wheel against the package's folder and the JavaScript of engines/."""

from __future__ import annotations

import tarfile
import zipfile
from pathlib import Path, PurePosixPath

REPOSITORY = Path(__file__).resolve().parents[1]
PACKAGE = REPOSITORY / "src" / "skinbake"

LOOPS = ("gradients/_kernel", "truth/_loops")
"""The compiled loops: C in the sdist, libraries in a wheel that has a platform."""

LC_CODE_SIGNATURE = 0x1D
"""The load command of Mach-O that names a signature."""

UNWANTED = {"tests", "fixtures", "benchmarks", "fuzz", "release", "engines", "node_modules", "__pycache__"}


def faults(path: Path) -> list[str]:
    """Return what an sdist or a wheel lacks, and what it should not have."""
    held = _names(path)
    wanted = {f"skinbake/{name}" for name in _sources(with_c=path.suffix != ".whl")}
    engines = {module.relative_to(REPOSITORY).as_posix() for module in REPOSITORY.glob("engines/*/*.js")}
    wanted |= {f"skinbake/{name}" for name in engines} if path.suffix == ".whl" else engines
    if path.suffix == ".whl" and not path.name.endswith("-any.whl"):
        loops = {name for name in held if name.endswith((".abi3.so", ".pyd"))}
        missing = [name for name in LOOPS if not any(loop.startswith(f"skinbake/{name}.") for loop in loops)]
    else:
        loops, missing = set(), []
    unsigned = _unsigned(path, loops) if "macosx" in path.name and "arm64" in path.name else []
    package = {name for name in held if name.startswith("skinbake/")}
    extra = sorted(package - wanted - loops)
    others = held - package - wanted
    extra += sorted(name for name in others if UNWANTED & set(PurePosixPath(name).parts))
    lacking = sorted(wanted - held) + missing + [f"a signature of {name}" for name in unsigned]
    return [f"lacks {name}" for name in lacking] + [f"has {name}" for name in extra]


def _unsigned(wheel: Path, modules: set[str]) -> list[str]:
    """Return the modules for macOS on ARM that have no signature: that system does not load them."""
    unsigned = []
    with zipfile.ZipFile(wheel) as archive:
        for name in sorted(modules):
            data = archive.read(name)
            count = int.from_bytes(data[16:20], "little")
            commands, at = set(), 32  # load commands follow the header: number, size, contents
            for _ in range(count):
                commands.add(int.from_bytes(data[at : at + 4], "little"))
                at += int.from_bytes(data[at + 4 : at + 8], "little")
            unsigned += [] if LC_CODE_SIGNATURE in commands else [name]
    return unsigned


def _names(path: Path) -> set[str]:
    if path.suffix == ".whl":
        with zipfile.ZipFile(path) as wheel:
            return {name for name in wheel.namelist() if not name.endswith("/")}
    with tarfile.open(path) as sdist:
        names = [member.name.partition("/")[2] for member in sdist if member.isfile()]
    return {name.removeprefix("src/") for name in names}


def _sources(*, with_c: bool) -> set[str]:
    """Return the files of the package, but not what Python and a compiler left beside them."""
    left = {".pyc", ".so", ".pyd"} | (set() if with_c else {".c", ".h"})
    files = [path for path in PACKAGE.rglob("*") if path.is_file() and path.suffix not in left]
    return {path.relative_to(PACKAGE).as_posix() for path in files}
