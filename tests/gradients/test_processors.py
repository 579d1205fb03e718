"""The bytes of a bake do not depend on the processor, as far as libraries of linear algebra look at it."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

import skinbake
from tests.support.models import FOLDER

MODELS = (
    "bent_tube.glb",
    "morphed_sheet.glb",
    "two_primitives.glb",
    "two_sets.glb",
    "characters/barbarian_walking.glb",
    "characters/butterfly_wings.glb",
    "characters/fox.glb",
    "characters/hand_l-weights-u8.glb",
    "characters/RiggedFigure.gltf",
    "characters/RiggedSimple.gltf",
)

PRESCOTT = {
    "OPENBLAS_CORETYPE": "Prescott",
    "NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3 AVX512F",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F",
    "PYTHONWARNINGS": "ignore",
}
"""A processor of 2004, for BLAS, and one without AVX2 for numpy and the C library."""

HASWELL = {"OPENBLAS_CORETYPE": "Haswell"}

OPTIONS = (
    "",
    "--correctives auto",
    "--morph-normals --fit-poses random:5 --encoding packed8 --generate-normals",
)

MEASURED = {
    "skinbake.correctives.principal": 1,
    "skinbake.geometry.dual_quaternions": 6,
    "skinbake.truth.by_numpy": 4,
    "skinbake.truth.normals": 1,
}
"""How many products and decompositions of linear algebra these modules have, and why no bake depends on them.

The first are of whole numbers, and exact. Dual quaternions, figures and sparse matrices are for verify; scipy
multiplies the latter in order.
"""


@cache
def bakes(options: str, **environment: str) -> dict[str, bytes]:
    """Return the bakes of ten models by a process in some environment."""
    with TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "skinbake", "bake", *(str(FOLDER / name) for name in MODELS)]
        command += ["--out-dir", folder, "-q", *options.split()]
        subprocess.run(command, check=True, env={**os.environ, **environment})
        return {path.name: path.read_bytes() for path in Path(folder).iterdir()}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "other"),
    [("", HASWELL), *((options, PRESCOTT) for options in OPTIONS)],
    ids=["Haswell", "Prescott", "Prescott, correctives", "Prescott, random poses"],
)
def test_ten_bakes_are_the_same_bytes_on_another_processor(options: str, other: dict[str, str]) -> None:
    usual = bakes(options, OPENBLAS_CORETYPE="")
    assert len(usual) >= len(MODELS)
    assert bakes(options, **other) == usual


@pytest.mark.slow
def test_the_options_of_these_bakes_change_them() -> None:
    changed = [bakes(options, OPENBLAS_CORETYPE="") for options in OPTIONS]
    for name in ("barbarian_walking.glb", "butterfly_wings.glb"):
        assert len({one[name] for one in changed}) == len(OPTIONS)


def _of_linear_algebra(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield the products and decompositions that BLAS and LAPACK do for numpy."""
    for node in ast.walk(tree):
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
            yield node
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            called = ast.unparse(node.func)
            is_norm = called == "np.linalg.norm" and any(given.arg == "axis" for given in node.keywords)
            products = {f"np.{name}" for name in ("dot", "matmul", "tensordot", "inner", "vdot", "outer")}
            if called in products or (
                called.startswith("np.linalg.") and called.count(".") == 2 and not is_norm
            ):
                yield node


@pytest.mark.parametrize(
    "room", ["correctives", "format", "freshness", "geometry", "gltf", "gradients", "truth"]
)
def test_no_module_that_a_bake_runs_calls_libraries_of_linear_algebra(room: str) -> None:
    root = Path(skinbake.__file__).parent
    for path in sorted((root / room).rglob("*.py")):
        name = ".".join(("skinbake", *path.relative_to(root).with_suffix("").parts))
        found = [ast.unparse(node) for node in _of_linear_algebra(ast.parse(path.read_text("utf-8")))]
        assert len(found) == MEASURED.get(name, 0), (name, found)
