"""Build the compiled loops with sanitizers, beside a copy of the package that finds them."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sysconfig
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
BUILD = REPOSITORY / "build" / "asan"
COMPILER = os.environ.get("CC", "gcc")
FLAGS = (
    "-g", "-O1", "-DMOST_BITS=128", "-std=c11", "-fPIC", "-shared", "-ffp-contract=off", "-Wno-psabi",
    "-fno-omit-frame-pointer", "-fsanitize=address,undefined", "-fno-sanitize-recover=all",
)  # fmt: skip

LOOPS = (Path("gradients", "_kernel.c"), Path("truth", "_loops.c"))


class NoCompilerError(Exception):
    """No C compiler with sanitizers is here."""


def build() -> Path:
    """Return the folder to import the package from; raises NoCompilerError.

    The loops are compiled where they or the flags are others than last time, for one width of vectors: the
    text of the others is the same.
    """
    package = BUILD / "skinbake"
    source = REPOSITORY / "src" / "skinbake"
    compiled = {loops: _compiled(source / loops) for loops in LOOPS}
    shutil.rmtree(package, ignore_errors=True)
    shutil.copytree(source, package, ignore=shutil.ignore_patterns("*.so", "*.pyd", "__pycache__"))
    for loops, library in compiled.items():
        shutil.copy(library, package / loops.with_suffix(".abi3.so"))
    return BUILD


def _compiled(source: Path) -> Path:
    headers = sorted([*source.parents[1].glob("*.h"), *source.parent.glob("loops/*.h")])
    text = b"".join(path.read_bytes() for path in [source, *headers])
    recipe = hashlib.sha256(" ".join([COMPILER, *FLAGS]).encode() + text)
    compiled = BUILD / f"{recipe.hexdigest()[:16]}.so"
    if not compiled.exists():
        _compile(source, compiled)
    return compiled


def _compile(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    include = f"-I{sysconfig.get_path('include')}"
    command = [COMPILER, *FLAGS, include, str(source), "-o", str(target), "-lm"]
    try:
        subprocess.run(command, check=True, capture_output=True, text=True)
    except FileNotFoundError as error:
        raise NoCompilerError(f"{COMPILER} is not installed") from error
    except subprocess.CalledProcessError as error:
        said = error.stderr.strip()[-300:]
        raise NoCompilerError(f"{COMPILER} cannot build with sanitizers: {said}") from error


def environment() -> dict[str, str]:
    """Return the environment in which Python runs under the sanitizers.

    The C++ library is loaded with the sanitizer, which looks for its __cxa_throw when it begins.
    """
    libraries = [_library("libasan.so"), _library("libstdc++.so.6")]
    return {
        **os.environ,
        "LD_PRELOAD": " ".join(libraries),
        # The interpreter keeps what lasts as long as it does; an allocation too large is not a defect.
        "ASAN_OPTIONS": "detect_leaks=0:allocator_may_return_null=1:exitcode=99:max_allocation_size_mb=2048",
        "UBSAN_OPTIONS": "print_stacktrace=1:halt_on_error=1:exitcode=98",
        "PYTHONPATH": os.pathsep.join([str(BUILD), str(REPOSITORY)]),
        "PYTHONMALLOC": "malloc",
        "OPENBLAS_NUM_THREADS": "1",
    }


def _library(name: str) -> str:
    found = subprocess.run(
        [COMPILER, f"-print-file-name={name}"], check=False, capture_output=True, text=True
    )
    return found.stdout.strip()
