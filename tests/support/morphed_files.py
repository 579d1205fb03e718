"""Baked files with morph targets added, byte by byte."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tests.support.baked_files import Editable
from tests.support.straightforward import unit

Floats = npt.NDArray[np.floating[Any]]


def warped(positions: Floats, normals: Floats, number: int) -> tuple[Floats, Floats]:
    """Differences of positions and unit normals under a smooth warp of space, which depends on a number."""
    x = positions.astype(np.float64)
    wave = np.array([1.3, 2.1 + number, 1.7])
    push = np.array([0.02, 0.06, 0.05 - 0.03 * number])
    phase = x @ wave + number
    jacobians = np.eye(3) + np.cos(phase)[:, None, None] * push[:, None] * wave
    turned = unit(np.einsum("vji,vj->vi", np.linalg.inv(jacobians), normals.astype(np.float64)))
    return np.sin(phase)[:, None] * push, turned - unit(normals.astype(np.float64))


def morphed(path: Path, target: Path, *, targets: int = 2, **changes: Any) -> Path:
    """Copy a GLB with morph targets on its first mesh; ``changes`` are members of its node (0)."""
    file = Editable(path)
    made = [warped(file.array("POSITION").copy(), file.array("NORMAL").copy(), n) for n in range(targets)]
    file.primitive()["targets"] = [
        {"POSITION": file.add(moved.astype(np.float32)), "NORMAL": file.add(turned.astype(np.float32))}
        for moved, turned in made
    ]
    file.content["nodes"][0] |= changes
    return file.write(target)


def with_tangents(path: Path, turned: float) -> Path:
    """Give the first target tangents that differ by a turn about n0."""
    file = Editable(path)
    normals = unit(file.array("NORMAL").astype(np.float64))
    tangents = file.array("TANGENT")[:, :3].astype(np.float64)
    rotated = np.cos(turned) * tangents + np.sin(turned) * np.cross(normals, tangents)
    file.primitive()["targets"][0]["TANGENT"] = file.add((rotated - tangents).astype(np.float32))
    return file.write(path)
