"""Compiled loops: others in their place, and what the processor here has for them."""

from __future__ import annotations

import subprocess
import sysconfig
from importlib.machinery import ExtensionFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import ModuleType

import pytest

from skinbake.gradients import by_numpy, kernel
from tests.support.tools import required_program

REPOSITORY = Path(__file__).parents[2]
OTHERWISE = [(128, "-O0"), (128, "-O3"), (256, "-O3")]
"""Other ways to compile the loops than that of setup.py, which has 512 bits and -O3.

The bits of the widest vectors, and how far a compiler optimises.
"""


def use_numpy(patch: pytest.MonkeyPatch) -> None:
    """Let everything that bakes use numpy, until the patch is undone."""
    for operation in kernel.__all__:
        patch.setattr(kernel, operation, getattr(by_numpy, operation))
    patch.setattr(kernel, "IS_COMPILED", False)


def compiled_otherwise(module: str, folder: Path, bits: int, optimised: str) -> ModuleType:
    """Compile a module, such as ``gradients/_kernel``, in a folder, in one of the ways of OTHERWISE."""
    library = folder / f"{Path(module).name}.so"
    options = [
        "-std=c11",
        optimised,
        "-fno-math-errno",
        "-fno-trapping-math",
        "-ffp-contract=off",
        "-w",
        "-Wno-psabi",
    ]
    options += ["-shared", "-fPIC", f"-DMOST_BITS={bits}", f"-I{sysconfig.get_path('include')}"]
    source = REPOSITORY / "src/skinbake" / f"{module}.c"
    subprocess.run([required_program("cc"), *options, str(source), "-o", str(library), "-lm"], check=True)
    made = loops_of(library)
    assert min(bits, bits_here()) == made.VECTOR_BITS
    return made


def loops_of(library: Path) -> ModuleType:
    """Return a module of loops from its file, whatever is loaded under its name already."""
    loader = ExtensionFileLoader(library.name.partition(".")[0], str(library))
    specification = spec_from_loader(loader.name, loader)
    assert specification is not None
    return module_from_spec(specification)


def bits_here() -> int:
    """Return the bits of the vectors that Linux says the processor has, of those that loops are made for."""
    told = Path("/proc/cpuinfo")
    has = set(told.read_text().split()) if told.exists() else set()
    if {"avx2", "avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"} <= has:
        return 512
    return 256 if "avx2" in has else 128
