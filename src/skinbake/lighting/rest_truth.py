"""The mesh before skinning, as the two truths measure it: frames along tangents, normals on triangles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import DTypeLike

from skinbake.geometry.skinned import Float64Array, FloatArray
from skinbake.lighting import kernel
from skinbake.lighting.operator import GradientOperator
from skinbake.lighting.sparse_rows import SparseRows
from skinbake.lighting.tangent_normals import RestFrames, measured_frames, posed_tangents
from skinbake.lighting.triangle_normals import (
    CarriedNormals,
    ClassBlock,
    block_sums,
    class_blocks,
    triangle_frame,
)
from skinbake.lighting.welded_mesh import WeldedMesh
from skinbake.skinning.components import dot, scaled

CANCELLED = 1e-9
"""Radians. Triangles that sum to less at a point cancel out. The direction of what is left is rounding.

This happens where a mesh has each triangle twice, once for each side, on the same vertices.
"""


def rest_frames(
    operator: GradientOperator,
    positions: FloatArray,
    normals: FloatArray,
    tangents: FloatArray | None = None,
    bitangents: FloatArray | None = None,
    *,
    parts: tuple[slice, ...] | None = None,
) -> RestFrames:
    """Measure the rest pose, once for any number of poses.

    All arrays are (V, 3) over the mesh's concatenated vertices, in mesh space: the rest positions, n0 of any
    length, t0 and b0. verify gives neither t0 nor b0: the tangents are then ones that no option of bake
    chooses (``perpendicular``). Tests and benchmarks give the tangents of the surface that they know, to
    which n0 need not be at right angles. A vertex is not valid if it has no triangles, a flat frame, or a
    zero or non-finite n0. ``parts`` are the blocks of vertices that will be requested.
    """
    chosen = tuple(operator.row_blocks()) if parts is None else parts
    along = []
    for group in operator.together(chosen):
        whole = slice(group[0].start, group[-1].stop)
        axes = (
            perpendicular(normals[whole])
            if tangents is None or bitangents is None
            else (tangents[whole], bitangents[whole])
        )
        along += _split(operator.rows(whole, axes), group)
    return measured_frames(chosen, tuple(along), positions, normals)


def _split(stacked: SparseRows, group: Sequence[slice]) -> list[tuple[SparseRows, SparseRows]]:
    """Cut rows along t0, and then along b0, into those of the parts of one group."""
    starts, columns = stacked.starts, stacked.columns
    first, half = group[0].start, len(stacked) // 2
    end = int(starts[half])
    along_t = SparseRows(starts[: half + 1], columns[:end].copy(), stacked.values[:end])
    along_b = SparseRows(starts[half:] - np.int32(end), columns[end:].copy(), stacked.values[end:])
    if np.array_equal(along_t.starts, along_b.starts) and np.array_equal(along_t.columns, along_b.columns):
        # Usual: both have the same neighbours, which are kept once.
        along_b = SparseRows(along_t.starts, along_t.columns, along_b.values)
    parts = [slice(part.start - first, part.stop - first + 1) for part in group]
    return [(along_t.some(part), along_b.some(part)) for part in parts]


def perpendicular(normals: FloatArray) -> tuple[Float64Array, Float64Array]:
    """Return two unit tangents (V, 3) at right angles to each other and to n0 (V, 3).

    They are NaN if n0 is zero or not finite.
    """
    wide = np.asarray(normals, dtype=np.float64)
    with np.errstate(invalid="ignore"):  # a normal that is zero or not finite
        axis = np.eye(3)[np.abs(wide).argmin(axis=1)]
        tangents = np.cross(axis, wide)
        tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
        bitangents = np.cross(wide, tangents)
        bitangents /= np.linalg.norm(bitangents, axis=1, keepdims=True)
    return tangents, bitangents


def vertex_normals(
    mesh: WeldedMesh,
    positions: Float64Array,
    classes: Sequence[ClassBlock] | None = None,
    dtype: DTypeLike = np.float64,
) -> FloatArray:
    """Return the angle-weighted sums of the weld classes: (3, C, P), from positions (3, V, P).

    classes are the ``class_blocks``, if they are there already. dtype is float32 or float64.
    """
    total = np.empty((3, len(mesh.ends) - 1, positions.shape[2]), dtype)
    for block in class_blocks(mesh) if classes is None else classes:
        kernel.class_sums(mesh, positions, block, total)
    return total


def carried_normals(
    mesh: WeldedMesh,
    rest: RestFrames,
    positions: FloatArray,
    normals: FloatArray,
    classes: Sequence[ClassBlock] | None = None,
    dtype: DTypeLike = np.float64,
) -> CarriedNormals:
    """Return the coordinates of the normals n0 (V, 3) on the mesh before skinning, with positions (V, 3).

    A vertex whose triangles cancel out has none. classes are as in ``vertex_normals``. dtype is that of the
    sums of the poses: only sums of the same rounding give back n0 where the pose is the rest pose.
    """
    components = np.ascontiguousarray(np.asarray(positions, dtype=np.float64).T)[:, :, None]
    wide = vertex_normals(mesh, components, classes)
    sums = vertex_normals(mesh, components, classes, dtype)
    sums[:, np.einsum("icp,icp->cp", wide, wide) < CANCELLED**2] = 0.0
    coefficients = np.full((3, len(positions)), np.nan)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # what has no frame gets NaN
        for part, derivatives in zip(rest.parts, rest.derivatives, strict=True):
            a, b = posed_tangents(derivatives, components)
            n, area, flat = triangle_frame(a, b, block_sums(mesh.classes, sums, part))
            n0 = tuple(np.asarray(normals[part], dtype=np.float64).T[:, None])
            n0 = scaled(1.0 / np.sqrt(dot(n0, n0)), n0)
            up, root = dot(n, n0), np.sqrt(np.abs(area))
            lean = [(dot(tangent, n0) - dot(tangent, n) * up) / root for tangent in (a, b)]
            coefficients[:, part] = np.where(flat, np.nan, np.concatenate([*lean, up]))
    return CarriedNormals(coefficients)
