"""The angle between the normals of algorithms 2 and 3.

Given the same gradients, both are exact. So they differ by rounding alone, and a larger angle is a fault.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeAlias

import numpy as np

from skinbake.geometry.skinned import FloatArray
from skinbake.lighting.metrics import squared_cross
from skinbake.skinning.components import Vector, cross, dot, scaled
from skinbake.skinning.rest import RestPrimitive

IDENTITY_TOLERANCE = 1e-4
"""Degrees by which algorithms 2 and 3 may differ."""

WELL_CONDITIONED = 1e-3
"""The sine between t' and b', relative to their lengths, below which a fold has no normal to compare."""

COLLAPSED = 1e-9
"""The length of t' × b', relative to the longest one, below which only rounding is left.

Joints that are scaled to 0 hide parts of a character. If these parts have most of its vertices, the median of
the lengths is rounding too.
"""

Compared: TypeAlias = tuple[FloatArray, FloatArray]
"""What ``compared_normals`` returns for a block."""


def primitive_for_direct(primitive: RestPrimitive, part: slice) -> RestPrimitive:
    """Return the vertices from which algorithm 2 equals algorithm 3, even in a slightly skewed frame.

    n0 is ± t0 × b0. The gradients are in the dual basis: their products with t0 and b0 *are* α and β. NORMAL
    and TANGENT of a file are orthonormal to a tenth of a degree, and a frame in float32 to 1e-7. A fold
    amplifies either error.
    """
    block = primitive.rows(part)
    t, b = (tuple(vectors.T.astype(np.float64)) for vectors in (block.tangents, block.bitangents))
    normal = cross(t, b)
    volume = dot(normal, normal)
    # For very small arrays, numpy's own cross product would take most of the time.
    by_alpha, by_beta = cross(b, normal), cross(normal, t)
    gradients = np.empty((*block.joints.shape, 3))
    for axis in range(3):
        gradients[:, 1:, axis] = (
            block.alpha * (by_alpha[axis] / volume)[:, None] + block.beta * (by_beta[axis] / volume)[:, None]
        )
    gradients[:, 0] = -gradients[:, 1:].sum(axis=1)
    sign = np.where(dot(normal, tuple(block.normals.T)) < 0, -1.0, 1.0)
    return replace(block, normals=np.stack(scaled(sign, normal), axis=1), gradients=gradients)


def compared_normals(direct: Vector, accurate: Vector) -> Compared:
    """Return the squared tangent of the angle between two lightings of a block, and the second's length.

    Both are float32 (P, V). All blocks of a chunk are kept until its last block is there.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a fold may have no normal
        ratio = squared_cross(direct, accurate) / np.square(dot(direct, accurate))
        length = np.sqrt(dot(accurate, accurate))
        return ratio.astype(np.float32), length.astype(np.float32)


class Identity:
    """The largest angle between the normals of algorithms 2 and 3, block by block, without their signs.

    In a fold that turns the surface inside out (det J < 0), J⁻ᵀ n keeps to the side of J n, and t' × b' does
    not. A very sharp fold amplifies rounding. Its normal nearly vanishes beside the pose's median, and it is
    left out. So is a vertex of a part that its joints collapse.
    """

    def __init__(self) -> None:
        self.largest = 0.0
        self._ratios: list[FloatArray] = []
        self._lengths: list[FloatArray] = []

    def take(self, compared: Compared | None) -> None:
        """Take the result of ``compared_normals`` for a block, or None if the block was not compared."""
        if compared is not None:
            self._ratios.append(compared[0])
            self._lengths.append(compared[1])

    def close(self) -> None:
        """Measure the blocks taken since the last call: all vertices of a mesh, in the same poses."""
        if not self._ratios:
            return
        highest = np.max([np.fmax.reduce(block, axis=1, initial=0.0) for block in self._ratios], axis=0)
        # Medians take time. Only poses that may have a larger angle need a median.
        for pose in np.argsort(-highest):
            if not _angle(highest[pose]) > self.largest:
                break
            ratios, lengths = (
                np.concatenate([block[pose] for block in values]) for values in (self._ratios, self._lengths)
            )
            longest = lengths[np.isfinite(lengths)].max(initial=0.0)
            sound = lengths > max(WELL_CONDITIONED * _median(lengths), COLLAPSED * longest)
            self.largest = max(self.largest, _angle(np.fmax.reduce(ratios[sound], initial=0.0)))
        self._ratios, self._lengths = [], []


def _median(values: FloatArray) -> float:
    """Return the median, NaN if a value is NaN. NumPy's own one imports its masked arrays, 17 ms."""
    upper = len(values) // 2
    lower = upper - 1 + len(values) % 2
    ordered = np.partition(values, (lower, upper, -1))
    return float(np.nan if np.isnan(ordered[-1]) else ordered[[lower, upper]].mean())


def _angle(squared_tangent: float) -> float:
    return float(np.degrees(np.arctan(np.sqrt(squared_tangent))))
