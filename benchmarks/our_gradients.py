"""Time skinbake's weight gradients alone, on the mesh that authors_loop.cpp reads too.

Usage: python -m benchmarks.our_gradients MESH REPEATS

Prints the seconds of each repeat, one a line, after one that does not count. The mesh is one surface: every
vertex a weld class of its own.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.skinned_grid import Grid, grid_arrays
from skinbake.gradients import kernel
from skinbake.gradients.surface import Surface, WeightField

SLOTS = 4


@dataclass(frozen=True)
class Mesh:
    """The input of both loops: positions (V, 3) float32, triangles (T, 3), joints and weights (V, SLOTS)."""

    positions: npt.NDArray[np.float32]
    triangles: npt.NDArray[np.int32]
    joints: npt.NDArray[np.int32]
    weights: npt.NDArray[np.float32]


def mesh_of(grid: Grid) -> Mesh:
    """Return a grid's mesh."""
    arrays = grid_arrays(grid)
    return Mesh(
        arrays["POSITION"],
        arrays["indices"].reshape(-1, 3).astype("<i4"),
        arrays["JOINTS_0"].astype("<i4"),
        arrays["WEIGHTS_0"],
    )


def write_mesh(path: Path, mesh: Mesh) -> None:
    """Write a mesh as authors_loop.cpp reads it: the counts, then the arrays."""
    with path.open("wb") as file:
        np.array([len(mesh.positions), len(mesh.triangles)], "<i8").tofile(file)
        for values in (mesh.positions, mesh.triangles, mesh.joints, mesh.weights):
            values.tofile(file)


def read_mesh(path: Path) -> Mesh:
    """Read what write_mesh wrote."""
    with path.open("rb") as file:
        vertices, triangles = np.fromfile(file, "<i8", 2)
        return Mesh(
            np.fromfile(file, "<f4", 3 * vertices).reshape(-1, 3),
            np.fromfile(file, "<i4", 3 * triangles).reshape(-1, 3),
            np.fromfile(file, "<i4", SLOTS * vertices).reshape(-1, SLOTS),
            np.fromfile(file, "<f4", SLOTS * vertices).reshape(-1, SLOTS),
        )


def prepared(mesh: Mesh) -> Callable[[], Any]:
    """Return the call to time, its arguments in the form in which bake has them by then.

    It does more than the gradients: one pass gathers them, takes their products with the tangents, and
    moves neighbours' joints into free slots.
    """
    weights = mesh.weights.astype(np.float64)
    weights /= weights.sum(axis=1, keepdims=True)
    up = np.zeros_like(mesh.positions)
    up[:, 1] = 1
    surface = Surface(
        mesh.positions,
        mesh.triangles.astype(np.uint32),
        WeightField(mesh.joints, weights, mesh.weights == 0),
        np.arange(len(mesh.positions), dtype=np.int32),
        up,
        None,
        [len(mesh.positions)],
    )
    return lambda: kernel.bake_surface(surface, weighting="max", adopt=True)


def main() -> None:
    call = prepared(read_mesh(Path(sys.argv[1])))
    call()
    for _ in range(int(sys.argv[2])):
        start = time.perf_counter()
        call()
        print(f"{time.perf_counter() - start:.6f}")


if __name__ == "__main__":
    main()
