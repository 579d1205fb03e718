"""The true normals of one mesh in many poses, by both truths, block by block.

``tangent_normals`` has the truth by tangents, ``triangle_normals`` the truth by triangles, and ``rest_truth``
what both measure at rest. This module cuts the vertices into blocks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from skinbake.choices import Truth
from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray
from skinbake.lighting import kernel
from skinbake.lighting.blending import sample_blocks
from skinbake.lighting.operator import GradientOperator
from skinbake.lighting.rest_truth import carried_normals, rest_frames
from skinbake.lighting.tangent_normals import RestFrames, morphed_frames
from skinbake.lighting.triangle_normals import (
    CarriedNormals,
    ClassBlock,
    ClassSums,
    class_blocks,
)
from skinbake.skinning.rest import RestPrimitive
from skinbake.threads import Threads

SUMS = np.float32
"""The type of the sums of posed triangles. Doubles would take twice the memory, and tell nothing more."""


@dataclass(frozen=True, slots=True)
class Truths:
    """The data of one mesh that both truths need: blocks of vertices and of weld classes, the rest pose.

    names are one or both of ``Truth``, in the order of ``Truth``. frames are for the truth by tangents.
    carried is for the truth by triangles, None without it; then there are no class_blocks.
    """

    operator: GradientOperator
    names: Sequence[str]
    vertex_blocks: Sequence[VertexBlock]
    class_blocks: Sequence[ClassBlock]
    frames: RestFrames
    carried: CarriedNormals | None

    @classmethod
    def of(
        cls, operator: GradientOperator, primitives: Sequence[RestPrimitive], poses: int, names: Sequence[str]
    ) -> Truths:
        """Measure a mesh at rest, for chunks of so many poses."""
        blocks_of_vertices = _vertex_blocks(operator.slices, poses)
        positions, normals = (_joined(primitives, name) for name in ("positions", "normals"))
        parts = tuple(block.part for block in blocks_of_vertices)
        frames = rest_frames(operator, positions, normals, parts=parts)
        blocks_of_classes: list[ClassBlock] = []
        carried = None
        if Truth.TRIANGLES in names:
            blocks_of_classes = class_blocks(operator)
            carried = carried_normals(operator, frames, positions, normals, blocks_of_classes, SUMS)
        return cls(operator, names, blocks_of_vertices, blocks_of_classes, frames, carried)

    def moved(self, primitives: Sequence[RestPrimitive]) -> Truths:
        """Measure the mesh under morph targets, before skinning."""
        positions, normals = (_joined(primitives, name) for name in ("positions", "normals"))
        frames = morphed_frames(self.frames, positions, normals)
        carried = self.carried and carried_normals(
            self.operator, frames, positions, normals, self.class_blocks, SUMS
        )
        return replace(self, frames=frames, carried=carried)

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
        """Return a block's unit normals (U, 3, B, P) by each truth of ``names``, and where they exist."""
        normals, exist = kernel.true_normals(self.frames, number, deformed, sides, sums)
        # These are all truths in the order of Truth, or the first one alone if there are no sums.
        first = tuple(Truth).index(Truth(self.names[0]))
        named = slice(first, first + len(self.names))
        return normals[named], exist[named]


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


@dataclass(frozen=True, slots=True)
class VertexBlock:
    """Some vertices: the numbers of block and primitive, the rows in the primitive, the part of the mesh."""

    number: int
    primitive: int
    rows: slice
    part: slice


def _vertex_blocks(slices: Sequence[slice], poses: int) -> list[VertexBlock]:
    """Cut the vertices of all primitives, each at its slice of the mesh, for chunks of so many poses."""
    pieces = [
        (primitive, here.start, part)
        for primitive, here in enumerate(slices)
        for part in sample_blocks(here, poses)
    ]
    return [
        VertexBlock(number, primitive, slice(part.start - start, part.stop - start), part)
        for number, (primitive, start, part) in enumerate(pieces)
    ]


def _joined(primitives: Sequence[RestPrimitive], name: str) -> FloatArray:
    """Return one array of all primitives, their vertices concatenated. A single one is not copied."""
    if len(primitives) == 1:
        only: FloatArray = getattr(primitives[0], name)
        return only
    return np.concatenate([getattr(primitive, name) for primitive in primitives])
