"""The tools that skinbake is timed against, and how each is called; what is not installed is None."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

from benchmarks.processes import Command

REPOSITORY = Path(__file__).resolve().parents[1]
NODE_BIN = REPOSITORY / "tests" / "support" / "node_modules" / ".bin"
MESHOPTIMIZER = NODE_BIN.parent / "meshoptimizer" / "index.js"
MESHOPT_SOURCE = Path(__file__).with_name("meshopt_tangents.mjs")
LOOP_SOURCE = Path(__file__).with_name("authors_loop.cpp")
COMPILER = ("g++", "-O3", "-std=c++17")

EMPTY_PYTHON = (sys.executable, "-c", "pass")
"""The least that a Python program takes."""


def gltf_transform(work: str, source: Path, target: Path) -> Command | None:
    """Return the command for ``tangents`` (one attribute a vertex, from the surface) or ``copy``."""
    tool = NODE_BIN / "gltf-transform"
    return (tool, work, source, target) if tool.exists() else None


def gltfpack(source: Path, target: Path) -> Command | None:
    """Return the command that optimises a file without quantising it."""
    tool = NODE_BIN / "gltfpack"
    return (tool, "-noq", "-i", source, "-o", target) if tool.exists() else None


def meshopt_tangents(mesh: Path, repeats: int) -> Command | None:
    """Return the command that times meshoptimizer's generateTangents on a mesh."""
    if shutil.which("node") is None or not MESHOPTIMIZER.exists():
        return None
    return ("node", MESHOPT_SOURCE, MESHOPTIMIZER, mesh, str(repeats))


def authors_loop(folder: Path) -> Path | None:
    """Compile the authors' loop over triangles into a folder; None without a compiler."""
    if shutil.which(COMPILER[0]) is None:
        return None
    program = folder / "authors_loop"
    subprocess.run([*COMPILER, "-o", str(program), str(LOOP_SOURCE)], check=True)
    return program


def versions() -> dict[str, str]:
    """Return what the peers call themselves, by tool; those that are not installed are left out."""
    asked: dict[str, Command] = {
        "node": ("node", "--version"),
        "glTF-Transform": (NODE_BIN / "gltf-transform", "--version"),
        "gltfpack": (NODE_BIN / "gltfpack", "-v"),
        "g++": (COMPILER[0], "-dumpfullversion"),
    }
    found = {}
    for tool, command in asked.items():
        if shutil.which(str(command[0])) is not None:
            process = subprocess.run(command, capture_output=True, encoding="utf-8", check=False)
            found[tool] = process.stdout.split()[-1].lstrip("v") if process.stdout.strip() else "unknown"
    if MESHOPTIMIZER.exists():
        package = MESHOPTIMIZER.with_name("package.json").read_text(encoding="utf-8")
        found["meshoptimizer"] = json.loads(package)["version"]
    return found
