"""The compiled loops of wheels: what they find out about the processor."""

from __future__ import annotations

import importlib.util
import json
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from release.cross import BROWSER, SYSTEMS, compile_loops, stable_names
from tests.support.kernels import REPOSITORY, bits_here, loops_of

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("ziglang") is None,
    reason="zig comes with make dist: make try-dist runs these tests",
)
XGETBV = bytes([0x0F, 0x01, 0xD0])
"""The instruction that asks which registers the system keeps."""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux" or platform.machine() != "x86_64", reason="runs what it compiles")
@pytest.mark.parametrize("module", ["gradients/_kernel", "truth/_loops"])
def test_loops_that_zig_compiles_use_the_widest_vectors(module: str, tmp_path: Path) -> None:
    name, compiled = compile_loops(module, REPOSITORY, "manylinux_2_17_x86_64", tmp_path)
    assert name == f"{module}.abi3.so"
    library = tmp_path / Path(name).name
    library.write_bytes(compiled)
    assert bits_here() == loops_of(library).VECTOR_BITS


@pytest.mark.slow
@pytest.mark.parametrize("system", [system for system in SYSTEMS if not system.startswith("manylinux")])
def test_loops_of_every_system_of_x86_64_ask_what_the_processor_has(system: str, tmp_path: Path) -> None:
    _, compiled = compile_loops("truth/_loops", REPOSITORY, system, tmp_path, links=False)
    assert (XGETBV in compiled) == system.endswith(("x86_64", "amd64"))


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("node") is None, reason="Node.js reads the module")
@pytest.mark.parametrize("module", ["gradients/_kernel", "truth/_loops"])
def test_loops_for_browsers_ask_for_nothing_but_python_and_c(module: str, tmp_path: Path) -> None:
    """What else they used, Pyodide could not link. They export the one name that Python looks for."""
    name, compiled = compile_loops(module, REPOSITORY, BROWSER, tmp_path)
    (tmp_path / "loops.wasm").write_bytes(compiled)
    script = """
    const module = new WebAssembly.Module(require('fs').readFileSync('loops.wasm'));
    const names = (list) => list.filter(({ name }) => !name.startsWith('__')).map(({ name }) => name);
    const { imports, exports } = WebAssembly.Module;
    process.stdout.write(JSON.stringify([imports(module), exports(module)].map(names)));
    """
    told = subprocess.run(["node", "-e", script], cwd=tmp_path, check=True, capture_output=True).stdout
    imported, exported = json.loads(told)
    assert exported == [f"PyInit_{name.split('/')[1].partition('.')[0]}"]
    of_c = {
        "atan2",
        "calloc",
        "fmax",
        "fmin",
        "free",
        "malloc",
        "memchr",
        "memcmp",
        "qsort",
        "strchr",
        "strlen",
    }
    stable = {name.removesuffix(" DATA") for name in stable_names()}
    assert set(imported) - stable - of_c == {"memory"}
