"""Digests of the arrays that α and β depend on: whether a tool has changed them since the bake."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from skinbake.choices import Frame
from skinbake.geometry.skinned import FloatArray, IntArray, SkinnedPrimitive, blocks
from skinbake.threads import Threads, thread_count

LARGE = 1 << 23
"""The bytes of arrays from which several threads read them: about 10 ms of work."""

INFLUENCE_TYPES = {"JOINTS": "<u2", "WEIGHTS": "<f4"}
"""The types to which influences are converted for their digests."""

Digests = Callable[[], dict[str, str]]
"""What returns the digests of a primitive's arrays, by name."""


def digests(primitive: SkinnedPrimitive, frame: str) -> dict[str, str]:
    """Return a digest of each array that α and β depend on, by name.

    Each is the first 32 hexadecimal digits of the SHA-256 of the decoded values, tightly packed and little
    endian: float32 for POSITION, NORMAL, TANGENT (only if the frame uses it) and WEIGHTS, uint16 for JOINTS,
    uint32 for the unrolled triangles. So another storage of the same values has the same digests.
    """
    arrays: dict[str, tuple[npt.NDArray[Any], str]] = {
        "POSITION": (primitive.positions, "<f4"),
        "NORMAL": (primitive.normals, "<f4"),
        "indices": (primitive.triangles, "<u4"),
    }
    if frame == Frame.TANGENT and primitive.tangents is not None:
        arrays["TANGENT"] = (primitive.tangents, "<f4")
    joints = primitive.joints if primitive.stored_joints is None else primitive.stored_joints
    return _array_digests({**arrays, **_of_influences(joints, primitive.weights)})


def influence_digests(joints: npt.NDArray[Any], weights: npt.NDArray[Any]) -> dict[str, str]:
    """Return the digests of joints and weights (V, K) alone, in the form of ``digests``."""
    return _array_digests(_of_influences(joints, weights))


def _of_influences(
    joints: npt.NDArray[Any], weights: npt.NDArray[Any]
) -> dict[str, tuple[npt.NDArray[Any], str]]:
    return {"JOINTS": (joints, INFLUENCE_TYPES["JOINTS"]), "WEIGHTS": (weights, INFLUENCE_TYPES["WEIGHTS"])}


def _array_digests(arrays: Mapping[str, tuple[npt.NDArray[Any], str]]) -> dict[str, str]:
    """Return the digest of each array and its type, by name. Large arrays are read side by side."""
    size = sum(values.nbytes for values, _ in arrays.values())
    with Threads(thread_count() if size >= LARGE else 1) as threads:
        found = threads.each(lambda array: array_digest(*array), arrays.values())
        return dict(zip(arrays, found, strict=True))


def slots_digest(arrays: Mapping[str, npt.NDArray[Any]]) -> str:
    """Return one digest of the attributes that hold α and β, by name, as they are stored."""
    digest = hashlib.sha256()
    typed = {name: (values, values.dtype.newbyteorder("<").str) for name, values in sorted(arrays.items())}
    for name, found in _array_digests(typed).items():
        digest.update(f"{name} {typed[name][1]} {found} ".encode())
    return digest.hexdigest()[:32]


def array_digest(values: npt.NDArray[Any], dtype: str) -> str:
    """Return the digest of one array, its values first converted to ``dtype``."""
    digest = hashlib.sha256()
    if values.dtype == dtype and values.flags.c_contiguous:
        digest.update(values.data)
    else:
        for rows in blocks(len(values)):
            with np.errstate(invalid="ignore", over="ignore"):  # NaN has a digest too
                digest.update(np.ascontiguousarray(values[rows], dtype=dtype).data)
    return digest.hexdigest()[:32]


def unordered_digest(
    primitive: SkinnedPrimitive, parts: Sequence[tuple[int, IntArray, FloatArray | IntArray]]
) -> str:
    """Return the digest of the triangles of a primitive by what is known of their vertices.

    parts are numbers of a kind, vertices (N,), and values (N, C) of these, read as float32. The order of
    vertices and triangles does not count, nor do copies of a vertex: tools change both.
    """
    # A number of 64 bits for what is known of each vertex, mixed as by splitmix64 (Steele et al. 2014).
    vertices = np.zeros(len(primitive.positions), np.uint64)
    for part, rows, values in parts:
        with np.errstate(over="ignore", invalid="ignore"):  # a NaN may be signalling
            stored = values.astype(np.float32) + np.float32(0)  # −0 is 0
        for column in stored.T:
            mixed = (vertices[rows] ^ np.uint64(part)) * np.uint64(0x9E3779B97F4A7C15)
            mixed = (mixed ^ column.view(np.uint32)) * np.uint64(0xBF58476D1CE4E5B9)
            mixed = (mixed ^ mixed >> np.uint64(27)) * np.uint64(0x94D049BB133111EB)
            vertices[rows] = mixed ^ mixed >> np.uint64(31)
    # Each triangle begins with its smallest number, and so does their list.
    corners = vertices[primitive.triangles]
    turns = corners.argmin(axis=1)[:, None] + np.arange(3)
    corners = np.take_along_axis(corners, turns % 3, axis=1)
    return array_digest(corners[np.lexsort(corners.T[::-1])], "<u8")


def changed_arrays(noted: Mapping[str, str], frame: str, primitive: SkinnedPrimitive) -> tuple[str, ...]:
    """Return the names of arrays that are missing, or whose digest differs from the noted one."""
    now = digests(primitive, frame)
    return tuple(name for name in {**now, **noted} if noted.get(name) != now.get(name))
