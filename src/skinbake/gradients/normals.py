"""Smooth normals for primitives without normals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skinbake.geometry.skinned import SkinnedPrimitive
from skinbake.geometry.triangles import smooth_normals
from skinbake.gradients import kernel


def with_smooth_normals(primitives: Sequence[SkinnedPrimitive]) -> list[SkinnedPrimitive]:
    """Return the primitives of one mesh. A primitive without normals gets smooth ones, float32.

    Vertices at one position share a normal, across the primitives that lack them. Tangents are dropped,
    because they mean nothing without normals. A vertex of no proper triangle gets (0, 0, 1).
    """
    lacking = [primitive for primitive in primitives if len(primitive.normals) == 0]
    if not lacking:
        return list(primitives)
    starts = np.cumsum([0, *(len(primitive.positions) for primitive in lacking)])
    positions = np.concatenate([primitive.positions for primitive in lacking])
    triangles = np.concatenate(
        [primitive.triangles + start for primitive, start in zip(lacking, starts, strict=False)]
    )
    triangles = triangles[kernel.mark_proper(positions, triangles)]
    points = kernel.label_equal_rows(positions)
    normals = smooth_normals(positions, triangles, points).astype(np.float32)
    made = iter(np.split(normals, starts[1:-1]))
    return [
        replace(primitive, normals=next(made), tangents=None) if len(primitive.normals) == 0 else primitive
        for primitive in primitives
    ]
