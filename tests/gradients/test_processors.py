"""The bytes of a bake do not depend on the processor, as far as libraries of linear algebra look at it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.models import FOLDER

MODELS = (
    "bent_tube.glb",
    "foreign_joints.glb",
    "hard_edge.glb",
    "mirrored_tangent.glb",
    "seam.glb",
    "shared_accessors.gltf",
    "two_primitives.glb",
    "two_sets.glb",
    "weights_u8.glb",
    "weights_u16.glb",
)


def bytes_by(core: str, folder: Path) -> dict[str, bytes]:
    """Return the bakes of ten models by a process whose OpenBLAS works as on some core."""
    command = [sys.executable, "-m", "skinbake", "bake", *(str(FOLDER / name) for name in MODELS)]
    environment = {**os.environ, "OPENBLAS_CORETYPE": core}
    subprocess.run([*command, "--out-dir", folder, "-q"], check=True, env=environment)
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix != ".bin"}


@pytest.mark.parametrize("core", ["Prescott", "Haswell"])
def test_ten_bakes_are_the_same_bytes_by_other_kernels_of_linear_algebra(core: str, tmp_path: Path) -> None:
    usual, other = bytes_by("", tmp_path / "usual"), bytes_by(core, tmp_path / core)
    assert len(usual) >= len(MODELS)
    assert other == usual
