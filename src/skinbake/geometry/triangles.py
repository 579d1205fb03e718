"""Triangles of a mesh: unrolled from the modes of glTF, without degenerate ones, measured."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from skinbake.geometry.frames import dot
from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray, IntArray, bincount, blocks

TRIANGLES, TRIANGLE_STRIP, TRIANGLE_FAN = 4, 5, 6
"""Values of ``primitive.mode`` that draw a surface (glTF 2.0, §5.24.4)."""

DEGENERATE_AREA = 1e-10
"""A triangle has no area if its doubled area is at most this share of its longest squared edge.

float32 positions leave about 1e-7 of relative noise in the height of a flat sliver. A triangle that is a
thousand times flatter was never a surface.
"""

BLOCK = 1 << 15
"""Number of triangles in a block, so that its arrays stay in the processor's cache."""


def unrolled(indices: IntArray, mode: int) -> npt.NDArray[np.uint32]:
    """Return the triangles (T, 3) that an index list (N,) draws in ``mode``; those of a list are not copied.

    Odd triangles of a strip are turned, so that every triangle keeps the winding of the first. Triangles of a
    fan are (i + 1, i + 2, 0), as in glTF 2.0 §3.7.2.1. Surplus indices of a list are ignored.
    """
    corners = indices.astype(np.uint32, copy=False)
    # A list: as it is.
    if mode == TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    count = max(len(corners) - 2, 0)
    # A fan: all triangles end at the first vertex.
    if mode == TRIANGLE_FAN:
        return np.stack([corners[1:][:count], corners[2:], np.repeat(corners[:1], count)], axis=1)
    # A strip: every other triangle swaps its last two corners.
    first = np.arange(count)
    odd = first % 2
    return np.stack([corners[first], corners[first + 1 + odd], corners[first + 2 - odd]], axis=1)


def mark_proper(positions: FloatArray, triangles: IntArray) -> BoolArray:
    """Tell for each triangle (T, 3) whether it has an area: a mask (T,), see DEGENERATE_AREA."""
    x, y, z = np.ascontiguousarray(positions.T, dtype=np.float64)
    found = np.zeros(len(triangles), dtype=np.bool_)
    for rows in blocks(len(triangles), BLOCK):
        i, j, k = np.ascontiguousarray(triangles[rows].T)
        # Two edges, the squares of all three lengths, and twice the area.
        ax, ay, az = x[j] - x[i], y[j] - y[i], z[j] - z[i]
        bx, by, bz = x[k] - x[i], y[k] - y[i], z[k] - z[i]
        first, second = ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz
        third = first + second - 2.0 * (ax * bx + ay * by + az * bz)
        area = np.sqrt((ay * bz - az * by) ** 2 + (az * bx - ax * bz) ** 2 + (ax * by - ay * bx) ** 2)
        # A comparison with NaN is false: what is not finite has no area.
        found[rows] = area > DEGENERATE_AREA * np.maximum(np.maximum(first, second), third)
    return found


def smooth_normals(positions: FloatArray, triangles: IntArray, groups: IntArray) -> Float64Array:
    """Return unit normals (V, 3), averaged over all triangles at a vertex group, weighted after Max (1999).

    groups (V,) names the vertices that share one normal. A vertex without a proper triangle gets (0, 0, 1).
    """
    points = positions.astype(np.float64, copy=False)
    total = np.zeros((int(groups.max(initial=-1)) + 1, 3))
    for turn in range(3):
        # Both edges at a corner, and their cross product, which is 2 A n.
        corners = np.roll(triangles, -turn, axis=1)
        origin, one, other = (points[column] for column in corners.T)
        first, second = one - origin, other - origin
        cross = cross_products(first, second)
        # n / (|e1|² |e2|²): Max's weight of the unit normal is the sine over both lengths.
        scale = dot(first, first) * dot(second, second)
        weighted = np.divide(cross, scale[:, None], out=np.zeros_like(cross), where=scale[:, None] > 0)
        for axis in range(3):
            total[:, axis] += bincount(groups[corners[:, 0]], weighted[:, axis], len(total))
    # A sum without a length has no direction.
    length = np.sqrt(dot(total, total))[:, None]
    unit = np.divide(total, length, out=np.tile([0.0, 0.0, 1.0], (len(total), 1)), where=length > 0)
    return np.asarray(unit[groups])


def cross_products(first: Float64Array, second: Float64Array) -> Float64Array:
    """Return first × second (N, 3). np.cross takes twice as long."""
    ax, ay, az = first.T
    bx, by, bz = second.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)
