"""The compiled loops of wheels: what they find out about the processor."""

from __future__ import annotations

import importlib.util
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from release.cross import FLAGS, PROCESSORS, SYSTEMS, compile_loops, zig

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("ziglang") is None,
    reason="zig comes with make dist: make try-dist runs these tests",
)
REPOSITORY = Path(__file__).parents[2]
SYSTEM = "manylinux_2_17_x86_64"
XGETBV = bytes([0x0F, 0x01, 0xD0])
"""The instruction that asks which registers the system keeps."""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux" or platform.machine() != "x86_64", reason="runs what it compiles")
def test_what_zig_compiles_knows_whether_the_processor_has_avx2(tmp_path: Path) -> None:
    source, program = tmp_path / "asks.c", tmp_path / "asks"
    asks = '__builtin_cpu_init(), __builtin_cpu_supports("avx2")'
    source.write_text(f"int main(void) {{ return {asks} != 0; }}")
    options = [option for option in FLAGS if option != "-shared"]
    zig("cc", "-target", SYSTEMS[SYSTEM], *options, str(source), str(PROCESSORS), "-o", str(program))
    has_avx2 = " avx2 " in Path("/proc/cpuinfo").read_text()
    assert subprocess.run([program], check=False).returncode == has_avx2


@pytest.mark.slow
@pytest.mark.parametrize("module", ["gradients/_kernel", "truth/_loops"])
def test_loops_of_linux_ask_what_the_processor_has(module: str, tmp_path: Path) -> None:
    name, compiled = compile_loops(module, REPOSITORY, SYSTEM, tmp_path)
    assert name == f"{module}.abi3.so"
    assert XGETBV in compiled
