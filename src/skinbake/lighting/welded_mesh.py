"""The welded vertices of a mesh, as both kernels of verify read them, and the weights of its corners."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skinbake.choices import Weighting
from skinbake.geometry.skinned import Float64Array, IntArray
from skinbake.lighting.influences import Int32Array, Int64Array
from skinbake.skinning.components import Vector, cross, dot

ROWS = 1 << 13
"""The number of rows that are made at a time."""

CORNERS = 1 << 16
"""The number of triangle corners that are looked at for these rows. A vertex may have thousands of copies."""


@dataclass(frozen=True, slots=True)
class WeldedMesh:
    """The triangles of a mesh that have an area, and the corners at each point of its surface.

    V runs over the vertices of all primitives, concatenated in order. counts holds the number of each.
    positions (V, 3) are float64. triangles (T, 3) have an area. classes (V,) are the weld classes. totals
    (C,) are the weights of all corners of a class. corners (3 T,) lists them class by class, from ends[c] to
    ends[c + 1].
    """

    counts: tuple[int, ...]
    positions: Float64Array
    triangles: Int32Array
    classes: Int32Array
    weighting: Weighting
    totals: Float64Array
    corners: Int32Array
    ends: Int64Array

    @property
    def slices(self) -> list[slice]:
        """The slice of each primitive's vertices among the mesh's vertices."""
        ends = np.cumsum(self.counts).tolist()
        return [slice(end - count, end) for end, count in zip(ends, self.counts, strict=True)]

    def row_blocks(self, within: slice | None = None) -> list[slice]:
        """Cut the vertices, or some of them, into blocks whose rows are made together."""
        start, stop = (0, len(self.positions)) if within is None else (within.start, within.stop)
        total = self._corners_before(start, stop)
        found = []
        first = 0
        while first < stop - start:
            end = int(np.searchsorted(total, total[first] + CORNERS, side="right")) - 1
            end = min(max(end, first + 1), first + ROWS, stop - start)
            found.append(slice(start + first, start + end))
            first = end
        return found

    def together(self, parts: Sequence[slice]) -> list[list[slice]]:
        """Group consecutive blocks whose rows are made together."""
        if not parts:
            return []
        first = parts[0].start
        before = self._corners_before(first, parts[-1].stop)
        groups = [[parts[0]]]
        for part in parts[1:]:
            start = groups[-1][0].start
            corners = before[part.stop - first] - before[start - first]
            if part.stop - start <= ROWS and corners <= CORNERS:
                groups[-1].append(part)
            else:
                groups.append([part])
        return groups

    def _corners_before(self, start: int, stop: int) -> Int64Array:
        """Return the number of corners of the vertices from ``start`` up to each of the next ones."""
        lengths = np.diff(self.ends)[self.classes[start:stop]]
        return np.concatenate([[0], np.cumsum(lengths)])

    def corners_of(self, part: slice) -> tuple[IntArray, IntArray]:
        """Return the corners of a block's vertices and of their copies, each with its vertex in the block."""
        classes = self.classes[part]
        lengths = self.ends[classes + 1] - self.ends[classes]
        owners = np.repeat(np.arange(len(classes)), lengths)
        offsets = np.arange(len(owners)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
        return owners, self.corners[np.repeat(self.ends[classes], lengths) + offsets]


def weights_of_corners(first: Vector, second: Vector, weighting: Weighting) -> Float64Array:
    """Return the weights of corners from their two edges, by components."""
    normal = cross(first, second)
    area: Float64Array = np.sqrt(dot(normal, normal))
    if weighting == "max":
        return np.asarray(area / (dot(first, first) * dot(second, second)))
    if weighting == "area":
        return area
    angle = np.arctan2(area, dot(first, second))
    return np.asarray(angle if weighting == "angle" else angle * area)
