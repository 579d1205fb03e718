"""The true normals of one mesh in many poses, by all truths, block by block.

``normals`` has the normals of a block. Here is what they measure at rest, and what cuts vertices into blocks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from skinbake.choices import USUAL_TRUTHS, Truth
from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray
from skinbake.skinning.components import dot, scaled
from skinbake.skinning.rest import RestPrimitive
from skinbake.threads import Threads
from skinbake.timing import stage
from skinbake.truth import kernel
from skinbake.truth.blending import chunks, sample_blocks
from skinbake.truth.mesh import WeldedMesh
from skinbake.truth.normals import (
    ClassBlock,
    ClassSums,
    RestFrames,
    block_sums,
    class_blocks,
    measured_frames,
    posed_tangents,
    tangent_normals,
    triangle_frame,
)
from skinbake.truth.operator import GradientOperator
from skinbake.truth.values import SparseRows

SUMS = np.float32
"""The type of the sums of posed triangles. Doubles would take twice the memory, and tell nothing more."""


class Truths(NamedTuple):
    """The data of one mesh that the truths need: blocks of vertices and of weld classes, the rest pose.

    of_mesh are one or both of ``USUAL_TRUTHS``, in their order. frames are for the truth by tangents. carried
    is for the truth by triangles, None without it; then there are no class_blocks.
    """

    operator: GradientOperator
    of_mesh: Sequence[str]
    vertex_blocks: Sequence[VertexBlock]
    class_blocks: Sequence[ClassBlock]
    frames: RestFrames
    carried: Float64Array | None

    @classmethod
    def of(
        cls,
        operator: GradientOperator,
        primitives: Sequence[RestPrimitive],
        poses: int,
        of_mesh: Sequence[str] = USUAL_TRUTHS,
    ) -> Truths:
        """Measure a mesh at rest, for chunks of so many poses."""
        positions, normals = (joined(primitives, name) for name in ("positions", "normals"))
        # Cut the vertices of all primitives, each at its slice of the mesh, for chunks of so many poses.
        pieces = [
            (primitive, here.start, part)
            for primitive, here in enumerate(operator.slices)
            for part in sample_blocks(here, poses)
        ]
        blocks_of_vertices = [
            VertexBlock(number, primitive, slice(part.start - start, part.stop - start), part)
            for number, (primitive, start, part) in enumerate(pieces)
        ]
        parts = tuple(block.part for block in blocks_of_vertices)
        frames = rest_frames(operator, positions, normals, parts=parts)
        blocks_of_classes: list[ClassBlock] = []
        carried = None
        if Truth.TRIANGLES in of_mesh:
            blocks_of_classes = class_blocks(operator)
            carried = carried_normals(operator, frames, positions, normals, blocks_of_classes, SUMS)
        return cls(operator, of_mesh, blocks_of_vertices, blocks_of_classes, frames, carried)

    def surface_normals(self, primitives: Sequence[RestPrimitive]) -> list[Float64Array]:
        """Return the normals (V, 3) of each primitive under morph targets, as its positions alone tell them.

        They are the images of those at rest, by tangents. A vertex where the surface has none keeps its own.
        """
        positions, normals = (joined(primitives, name) for name in ("positions", "normals"))
        components = np.ascontiguousarray(np.asarray(positions, dtype=np.float64).T)[:, :, None]
        found = np.array(normals, dtype=np.float64)
        for part, derivatives in zip(self.frames.parts, self.frames.derivatives, strict=True):
            own, exist = tangent_normals(self.frames, part, posed_tangents(derivatives, components))
            found[part][exist[0]] = np.stack(own, axis=-1)[0][exist[0]]
        return [found[part] for part in self.operator.slices]

    def moved(self, primitives: Sequence[RestPrimitive]) -> Truths:
        """Measure the mesh under morph targets, before skinning.

        Frames are measured along the same curves on the surface as t0 and b0 at rest. So they are their
        images under the differential of the morph. If skinning is the identity, the truth by tangents returns
        the morphed normals exactly.
        """
        positions, normals = (joined(primitives, name) for name in ("positions", "normals"))
        frames = measured_frames(self.frames.parts, self.frames.derivatives, positions, normals)
        if self.carried is None:
            return self._replace(frames=frames)
        carried = carried_normals(self.operator, frames, positions, normals, self.class_blocks, SUMS)
        return self._replace(frames=frames, carried=carried)

    def sums(
        self, deformed: Float64Array, threads: Threads, memory: ChunkMemory | None = None
    ) -> ClassSums | None:
        """Return the sums of the truth by triangles for all deformed positions (3, V, P) at once."""
        if self.carried is None:
            return None
        shape = 3, len(self.operator.ends) - 1, deformed.shape[2]
        total = (memory or ChunkMemory()).array("sums", shape, SUMS)

        def sum_up(block: ClassBlock) -> None:
            kernel.class_sums(self.operator, deformed, block, total)

        threads.done(sum_up, self.class_blocks)
        return ClassSums(self.carried, self.operator.classes, total)

    def normals(
        self, number: int, deformed: Float64Array, sums: ClassSums | None, sides: Float64Array | None
    ) -> tuple[Float64Array, BoolArray]:
        """Return a block's unit normals (U, 3, B, P) by the truths ``of_mesh``, and where they exist."""
        normals, exist = kernel.true_normals(self.frames, number, deformed, sides, sums)
        # These are both truths in their order, or the last one alone if there are no sums.
        return normals[: len(self.of_mesh)], exist[: len(self.of_mesh)]


def truths_at_rest(
    operator: GradientOperator,
    primitives: Sequence[RestPrimitive],
    poses: int,
    morphing: object,
    names: Sequence[str] = USUAL_TRUTHS,
) -> Truths:
    """Measure a mesh at rest, for any number of calls of ``lighting_errors`` with so many poses.

    names are one or both of ``USUAL_TRUTHS``.
    """
    parts = chunks(len(operator.positions), poses)
    most = max((part.stop - part.start for part in parts), default=0)
    with stage("truths"):
        # Under morph targets, poses are measured one at a time.
        return Truths.of(operator, primitives, min(most, 1) if morphing else most, names)


class ChunkMemory:
    """Large arrays that each chunk of poses fills anew. The system would clear fresh memory first."""

    def __init__(self) -> None:
        self._arrays: dict[str, Any] = {}

    def array(self, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> Any:
        """Return an array, its values arbitrary. The last one of this name must be in use no more."""
        size = math.prod(shape)
        if name not in self._arrays or len(self._arrays[name]) < size:
            self._arrays.pop(name, None)
            self._arrays[name] = np.empty(size, dtype)
        return self._arrays[name][:size].reshape(shape)


class VertexBlock(NamedTuple):
    """Some vertices: the numbers of block and primitive, the rows in the primitive, the part of the mesh."""

    number: int
    primitive: int
    rows: slice
    part: slice


def joined(primitives: Sequence[RestPrimitive], name: str) -> FloatArray:
    """Return one array of all primitives, their vertices concatenated. A single one is not copied."""
    if len(primitives) == 1:
        only: FloatArray = getattr(primitives[0], name)
        return only
    return np.concatenate([getattr(primitive, name) for primitive in primitives])


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
        # The tangents along which positions are differentiated.
        axes = (
            perpendicular(normals[whole])
            if tangents is None or bitangents is None
            else (tangents[whole], bitangents[whole])
        )
        # The first half of the rows is along t0, the second along b0.
        rows = operator.rows(whole, axes)
        half = len(rows) // 2
        end = int(rows.starts[half])
        along_t = SparseRows(rows.starts[: half + 1], rows.columns[:end].copy(), rows.values[:end])
        along_b = SparseRows(rows.starts[half:] - np.int32(end), rows.columns[end:].copy(), rows.values[end:])
        if np.array_equal(along_t.starts, along_b.starts) and np.array_equal(
            along_t.columns, along_b.columns
        ):
            # Usual: both have the same neighbours, which are kept once.
            along_b = SparseRows(along_t.starts, along_t.columns, along_b.values)
        for part in group:
            own = slice(part.start - whole.start, part.stop - whole.start + 1)
            along.append((along_t.some(own), along_b.some(own)))
    return measured_frames(chosen, tuple(along), positions, normals)


def perpendicular(normals: FloatArray) -> tuple[Float64Array, Float64Array]:
    """Return two unit tangents (V, 3) at right angles to each other and to n0 (V, 3).

    They are NaN if n0 is zero or not finite.
    """
    wide = np.asarray(normals, dtype=np.float64)
    with np.errstate(invalid="ignore"):  # a normal that is zero or not finite
        # The axis that is least along n0 gives the longest cross product.
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
) -> Float64Array:
    """Return the coordinates of the normals n0 (V, 3) on the mesh before skinning, with positions (V, 3).

    A vertex whose triangles cancel out has none. classes are as in ``vertex_normals``. dtype is that of the
    sums of the poses: only sums of the same rounding give back n0 where the pose is the rest pose.
    """
    components = np.ascontiguousarray(np.asarray(positions, dtype=np.float64).T)[:, :, None]
    # The normals of the triangles at rest: exact ones tell what cancels, and ones rounded as in the poses.
    wide = vertex_normals(mesh, components, classes)
    sums = vertex_normals(mesh, components, classes, dtype)
    sums[:, np.einsum("icp,icp->cp", wide, wide) < CANCELLED**2] = 0.0
    coefficients = np.full((3, len(positions)), np.nan)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # what has no frame gets NaN
        for part, derivatives in zip(rest.parts, rest.derivatives, strict=True):
            a, b = posed_tangents(derivatives, components)
            # The frame as seen along that normal.
            n, area, flat = triangle_frame(a, b, block_sums(mesh.classes, sums, part))
            n0 = tuple(np.asarray(normals[part], dtype=np.float64).T[:, None])
            n0 = scaled(1.0 / np.sqrt(dot(n0, n0)), n0)
            # How far n0 is along it, and how it leans along a and b.
            up, root = dot(n, n0), np.sqrt(np.abs(area))
            lean = [(dot(tangent, n0) - dot(tangent, n) * up) / root for tangent in (a, b)]
            coefficients[:, part] = np.where(flat, np.nan, np.sign(area) * np.concatenate([*lean, up]))
    return coefficients
