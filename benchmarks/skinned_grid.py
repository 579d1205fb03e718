"""Write a skinned grid of any size as a GLB: the same plain file for every tool that is timed on it.

Usage: python -m benchmarks.skinned_grid VERTICES OUTPUT.glb [--phase RADIANS]

The grid is wavy, as square as VERTICES can be divided, with a chain of joints along x and four influences a
vertex. It is computed and written some rows at a time, so that ten million vertices need little more memory
than a thousand. Another phase of the waves makes another file of the same size.
"""

from __future__ import annotations

import argparse
import json
import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

JOINTS = 32
VERTICES_AT_ONCE = 1 << 16
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
CODES = {"<f4": 5126, "<u4": 5125, "|u1": 5121}
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Grid:
    """A grid of rows × columns vertices, rows along x; phase, in radians, shifts its waves."""

    rows: int
    columns: int
    phase: float = 0.0

    @property
    def vertices(self) -> int:
        """Return the number of vertices."""
        return self.rows * self.columns

    def parts(self) -> Iterator[range]:
        """Yield the rows in parts of about VERTICES_AT_ONCE vertices."""
        step = max(1, VERTICES_AT_ONCE // self.columns)
        for start in range(0, self.rows, step):
            yield range(start, min(start + step, self.rows))

    def coordinates(self, rows: range) -> tuple[Array, Array]:
        """Return u and v, 0 … 1 along rows and columns, of the vertices of some rows."""
        u = np.arange(rows.start, rows.stop) / (self.rows - 1)
        v = np.arange(self.columns) / (self.columns - 1)
        return np.repeat(u, self.columns), np.tile(v, len(rows))


def grid_of(vertices: int, phase: float = 0.0) -> Grid:
    """Return the grid of this many vertices whose sides differ least.

    Raises ValueError for a number of vertices that no grid has: a prime, or less than 4.
    """
    for rows in range(math.isqrt(max(vertices, 0)), 1, -1):
        if vertices % rows == 0:
            return Grid(rows, vertices // rows, phase)
    raise ValueError(f"there is no grid of {vertices:,} vertices: give a number with divisors")


def grid_vertices(text: str) -> int:
    """Read a number of vertices from a command line: the ``type`` of an argument that makes a grid.

    Raises argparse.ArgumentTypeError if there is no such grid, and ValueError if the text is no number.
    """
    vertices = int(text)
    try:
        return grid_of(vertices).vertices
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def positions(grid: Grid, rows: range) -> Array:
    """Return POSITION of the vertices of some rows."""
    u, v = grid.coordinates(rows)
    height = 0.02 * np.sin(9 * u + grid.phase) * np.cos(7 * v)
    return np.stack([4 * u, height, 4 * v], axis=1).astype(np.float32)


def normals(grid: Grid, rows: range) -> Array:
    """Return NORMAL: the surface's own."""
    u, v = grid.coordinates(rows)
    slope_u = 0.045 * np.cos(9 * u + grid.phase) * np.cos(7 * v)
    slope_v = -0.035 * np.sin(9 * u + grid.phase) * np.sin(7 * v)
    directions = np.stack([-slope_u, np.ones_like(u), -slope_v], axis=1)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return directions.astype(np.float32)


def texture_coordinates(grid: Grid, rows: range) -> Array:
    """Return TEXCOORD_0."""
    return np.stack(grid.coordinates(rows), axis=1).astype(np.float32)


def joints(grid: Grid, rows: range) -> Array:
    """Return JOINTS_0: four neighbours of the chain."""
    first, _ = _along_chain(grid, rows)
    return (first[:, None] + np.arange(4)).astype(np.uint8)


def weights(grid: Grid, rows: range) -> Array:
    """Return WEIGHTS_0: cubic B-splines along the chain, which add up to 1."""
    _, t = _along_chain(grid, rows)
    splines = [(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3]
    return (np.stack(splines, axis=1) / 6).astype(np.float32)


def indices(grid: Grid, rows: range) -> Array:
    """Return the triangles' corners between some rows and the next, one below the other."""
    above = np.arange(rows.start, min(rows.stop, grid.rows - 1))
    corner = (above[:, None] * grid.columns + np.arange(grid.columns - 1)).ravel()
    below = corner + grid.columns
    quads = np.stack([corner, corner + 1, below, corner + 1, below + 1, below], axis=1)
    return quads.reshape(-1, 1).astype(np.uint32)


def _along_chain(grid: Grid, rows: range) -> tuple[Array, Array]:
    """Return each vertex's first joint, and how far it is on the way to the next, 0 … 1."""
    along = grid.coordinates(rows)[0] * (JOINTS - 3)
    first = np.minimum(along.astype(np.int64), JOINTS - 4)
    return first, along - first


STORED: dict[str, Callable[[Grid, range], Array]] = {
    "POSITION": positions,
    "NORMAL": normals,
    "TEXCOORD_0": texture_coordinates,
    "JOINTS_0": joints,
    "WEIGHTS_0": weights,
    "indices": indices,
}


def grid_arrays(grid: Grid) -> dict[str, Array]:
    """Return the whole arrays, as stored, by attribute; the triangles as ``indices``, (3 T, 1)."""
    return {name: values(grid, range(grid.rows)) for name, values in STORED.items()}


def write_grid(path: Path, grid: Grid, payload: int = 0) -> None:
    """Write a GLB with one skinned mesh and a chain of joints.

    payload is how many bytes, a multiple of 4, stand in for textures: noise that no tool looks at.
    """
    text = json.dumps(_content(grid, payload), separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    size = sum(length for _, _, length in _stored_sizes(grid)) + payload
    with path.open("wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + size))
        file.write(struct.pack("<II", len(text), 0x4E4F534A) + text)
        file.write(struct.pack("<II", size, 0x004E4942))
        for values in STORED.values():
            for rows in grid.parts():
                file.write(values(grid, rows).data)
        file.write(np.random.default_rng(0).bytes(payload))


def _stored_sizes(grid: Grid) -> Iterator[tuple[str, Array, int]]:
    """Yield every attribute's name, its values in the first row for their type, and its length in bytes."""
    for name, values in STORED.items():
        sample = values(grid, range(1))
        rows = grid.rows - 1 if name == "indices" else grid.rows
        yield name, sample, sample.nbytes * rows


def _content(grid: Grid, payload: int) -> dict[str, Any]:
    """Return the GLB's JSON."""
    views, accessors, offset = [], [], 0
    for name, sample, length in _stored_sizes(grid):
        target = ELEMENT_ARRAY_BUFFER if name == "indices" else ARRAY_BUFFER
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": length, "target": target})
        accessor: dict[str, Any] = {
            "bufferView": len(views) - 1,
            "componentType": CODES[sample.dtype.str],
            "count": length // sample[0].nbytes,
            "type": TYPES[sample.shape[1]],
        }
        if name == "POSITION":
            accessor |= _bounds(grid)
        accessors.append(accessor)
        offset += length
    if payload:
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": payload})
    attributes = {name: number for number, name in enumerate(STORED) if name != "indices"}
    chain = [
        {"name": f"joint{joint}", **({"children": [joint + 1]} if joint + 1 < JOINTS else {})}
        for joint in range(JOINTS)
    ]
    return {
        "asset": {"version": "2.0", "generator": "skinned_grid.py"},
        "scene": 0,
        "scenes": [{"nodes": [0, JOINTS]}],
        "nodes": [*chain, {"mesh": 0, "skin": 0}],
        "skins": [{"joints": list(range(JOINTS))}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": len(attributes)}]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offset + payload}],
        **({"images": [{"bufferView": len(views) - 1, "mimeType": "image/png"}]} if payload else {}),
    }


def _bounds(grid: Grid) -> dict[str, list[float]]:
    """Return the least and largest coordinates, which glTF wants to know of POSITION."""
    extremes = []
    for rows in grid.parts():
        part = positions(grid, rows)
        extremes.append((part.min(axis=0), part.max(axis=0)))
    least, largest = zip(*extremes, strict=True)
    return {"min": np.min(least, axis=0).tolist(), "max": np.max(largest, axis=0).tolist()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("vertices", type=grid_vertices)
    parser.add_argument("output", type=Path)
    parser.add_argument("--phase", type=float, default=0.0)
    arguments = parser.parse_args()
    write_grid(arguments.output, grid_of(arguments.vertices, arguments.phase))


if __name__ == "__main__":
    main()
