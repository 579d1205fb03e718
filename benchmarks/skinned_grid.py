"""Write a skinned grid of any size as a GLB: the same plain file for every tool that is timed on it.

Usage: python benchmarks/skinned_grid.py VERTICES OUTPUT.glb
"""

from __future__ import annotations

import json
import struct
import sys
from pathlib import Path

import numpy as np

JOINTS = 32


def grid_arrays(side: int) -> dict[str, np.ndarray]:
    """Return the attributes of a wavy grid of side × side vertices, four influences each, along x."""
    u, v = (axis.ravel() for axis in np.meshgrid(*[np.linspace(0, 1, side)] * 2, indexing="ij"))
    height = 0.02 * np.sin(9 * u) * np.cos(7 * v)
    positions = np.stack([4 * u, height, 4 * v], axis=1).astype(np.float32)
    slope_u, slope_v = 0.045 * np.cos(9 * u) * np.cos(7 * v), -0.035 * np.sin(9 * u) * np.sin(7 * v)
    normals = np.stack([-slope_u, np.ones_like(u), -slope_v], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    along = u * (JOINTS - 4)
    first = np.minimum(along.astype(np.int64), JOINTS - 5)
    t = along - first
    weights = np.stack(
        [(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3], axis=1
    )
    weights[:, 0] = 6 - weights[:, 1:].sum(axis=1)
    row, column = np.meshgrid(np.arange(side - 1), np.arange(side - 1), indexing="ij")
    corner = (row * side + column).ravel()
    quads = np.stack(
        [corner, corner + 1, corner + side, corner + 1, corner + side + 1, corner + side], axis=1
    )
    return {
        "POSITION": positions,
        "NORMAL": normals.astype(np.float32),
        "TEXCOORD_0": np.stack([u, v], axis=1).astype(np.float32),
        "JOINTS_0": (first[:, None] + np.arange(4)).astype(np.uint8),
        "WEIGHTS_0": (weights / 6).astype(np.float32),
        "indices": quads.reshape(-1, 1).astype(np.uint32),
    }


def glb_bytes(arrays: dict[str, np.ndarray]) -> bytes:
    """Return a GLB with one skinned mesh of these arrays and a chain of joints."""
    types = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
    codes = {"<f4": 5126, "<u4": 5125, "|u1": 5121}
    views, accessors, blob = [], [], b""
    for name, values in arrays.items():
        target = 34963 if name == "indices" else 34962
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": values.nbytes, "target": target})
        accessor = {
            "bufferView": len(views) - 1,
            "componentType": codes[values.dtype.str],
            "count": len(values),
            "type": types[values.shape[1]],
        }
        if name == "POSITION":
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        accessors.append(accessor)
        blob += values.tobytes()
    names = [name for name in arrays if name != "indices"]
    joints = [
        {"name": f"joint{j}", **({"children": [j + 1]} if j + 1 < JOINTS else {})} for j in range(JOINTS)
    ]
    root = {
        "asset": {"version": "2.0", "generator": "skinned_grid.py"},
        "scene": 0,
        "scenes": [{"nodes": [0, JOINTS]}],
        "nodes": [*joints, {"mesh": 0, "skin": 0}],
        "skins": [{"joints": list(range(JOINTS))}],
        "meshes": [
            {"primitives": [{"attributes": {name: n for n, name in enumerate(names)}, "indices": len(names)}]}
        ],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(blob)}],
    }
    text = json.dumps(root, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = (
        struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(blob), 0x004E4942) + blob
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


if __name__ == "__main__":
    Path(sys.argv[2]).write_bytes(glb_bytes(grid_arrays(round(int(sys.argv[1]) ** 0.5))))
