"""Compile GLSL and HLSL with Khronos' reference compiler, and validate and disassemble its SPIR-V.

Debian packages glslang-tools and spirv-tools.
"""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from tests.support.tools import required_program

COMPILER, VALIDATOR, DISASSEMBLER, OPTIMISER = "glslangValidator", "spirv-val", "spirv-dis", "spirv-opt"
TIMEOUT_SECONDS = 300


def require_compiler() -> str:
    """Return the path of glslangValidator; else skip, or fail under SKINBAKE_STRICT=1."""
    return required_program(COMPILER, "glslang-tools")


def complaints(shaders: Mapping[str, str]) -> dict[str, str]:
    """Compile vertex shaders in one process; return errors and warnings of those that have any, by name.

    The version is each shader's own ``#version``. A name must do as a file name.
    """
    with tempfile.TemporaryDirectory() as folder:
        paths = {name: Path(folder) / f"{name}.vert" for name in shaders}
        for name, path in paths.items():
            path.write_text(shaders[name], encoding="ascii")
        process = _run([require_compiler(), *map(str, paths.values())])
    # It prints the path of each file, and below it what it has to say.
    found: dict[str, list[str]] = {}
    names = {str(path): name for name, path in paths.items()}
    current = "the compiler"
    for line in process.stdout.splitlines() + process.stderr.splitlines():
        if line in names:
            current = names[line]
        elif line.strip():
            found.setdefault(current, []).append(line)
    if process.returncode != 0 and not found:
        found["the compiler"] = [f"exit code {process.returncode}"]
    return {name: "\n".join(lines) for name, lines in found.items()}


def spirv(shader: str, stage: str = "vert") -> bytes:
    """Compile a shader of a stage to SPIR-V for Vulkan; ValueError with the compiler's words."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "shader.spv"
        options = ["--stdin", "-S", stage, "-V", "--auto-map-locations", "--auto-map-bindings"]
        process = _run([require_compiler(), *options, "-o", str(target)], shader)
        if process.returncode != 0:
            raise ValueError(process.stdout + process.stderr)
        return target.read_bytes()


def spirv_of_hlsl(shader: str) -> bytes:
    """Compile an HLSL compute shader, entry point ``main``; ValueError with the compiler's words."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "shader.spv"
        options = ["--stdin", "-D", "-S", "comp", "-e", "main", "-V"]
        process = _run([require_compiler(), *options, "-o", str(target)], shader)
        if process.returncode != 0:
            raise ValueError(process.stdout + process.stderr)
        return target.read_bytes()


def invalid(module: bytes) -> str:
    """Return what spirv-val finds wrong with a module for Vulkan 1.0; empty where nothing is."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "shader.spv"
        path.write_bytes(module)
        process = _run([required_program(VALIDATOR, "spirv-tools"), "--target-env", "vulkan1.0", str(path)])
    return process.stdout + process.stderr if process.returncode else ""


def optimised(module: bytes) -> bytes:
    """Return SPIR-V in one function, without what no output needs, as a driver's compiler makes it."""
    with tempfile.TemporaryDirectory() as folder:
        given, target = Path(folder) / "given.spv", Path(folder) / "optimised.spv"
        given.write_bytes(module)
        process = _run([required_program(OPTIMISER, "spirv-tools"), "-O", str(given), "-o", str(target)])
        if process.returncode != 0:
            raise ValueError(process.stderr)
        return target.read_bytes()


def disassembly(module: bytes) -> str:
    """Return SPIR-V as text, an instruction a line, ids as numbers."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "shader.spv"
        path.write_bytes(module)
        options = ["--raw-id", "--no-header", "--no-indent"]
        process = _run([required_program(DISASSEMBLER, "spirv-tools"), *options, str(path)])
    if process.returncode != 0:
        raise ValueError(process.stderr)
    return process.stdout


def _run(command: Sequence[str], given: str | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command, input=given, capture_output=True, text=True, timeout=TIMEOUT_SECONDS, check=False
    )
