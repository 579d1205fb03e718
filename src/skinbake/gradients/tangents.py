"""The tangent frame of a bake, from TANGENT or from NORMAL alone, and the mending of few wrong tangents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from skinbake.choices import Frame
from skinbake.geometry import frames
from skinbake.geometry.skinned import FloatArray, SkinnedPrimitive, Straightened, blocks, not_finite

TANGENT_TOLERANCE = 0.1
"""Degrees between t0 × b0 and n0 up to which TANGENT serves as it is."""

FEW = 100
"""TANGENT is straightened if at most one vertex in FEW leans, or only one.

If more lean, they are not slips: quantised tangents lean everywhere, and other programs store other things.
"""


def leaning(primitive: SkinnedPrimitive, tangents: FloatArray) -> tuple[float, list[int]]:
    """Return the largest lean of TANGENT in degrees, and the vertices of triangles that lean too much."""
    used = np.zeros(len(tangents), dtype=np.bool_)
    used[primitive.triangles.ravel()] = True
    largest, found = 0.0, list[int]()
    for block in blocks(len(tangents)):
        rows = block.start + np.flatnonzero(used[block])
        normals = frames.unit_normals(primitive.normals[rows])
        angles = frames.tangent_deviation(normals, tangents[rows])
        largest = max(largest, float(angles.max(initial=0.0)))
        found += rows[angles > TANGENT_TOLERANCE].tolist()
    return largest, found


def with_straight_tangents(primitive: SkinnedPrimitive) -> SkinnedPrimitive:
    """Return the primitive with sound tangents, or unchanged if too many lean.

    A straightened tangent is t − n (n · t) with the length of t. A tangent without a usable direction becomes
    that of the frame from NORMAL. A handedness other than 1 and −1 becomes 1. The shader reads TANGENT, so
    α and β could not do this: at rest they have no effect.
    """
    if primitive.tangents is None:
        return primitive
    lean, vertices = leaning(primitive, primitive.tangents)
    if len(vertices) > 1 and len(vertices) > len(np.unique(primitive.triangles)) // FEW:
        return primitive
    if not vertices:
        return replace(primitive, straightened=Straightened((), lean))
    tangents = primitive.tangents.copy()
    normals = frames.unit_normals(primitive.normals[vertices])
    angles = frames.tangent_deviation(normals, tangents[vertices])
    tangents[vertices] = frames.straightened(normals, tangents[vertices])
    wrong = unhanded(primitive.tangents, vertices)
    broken = [
        (vertex, not_finite(primitive.tangents[vertex]))
        for vertex in vertices
        if not np.isfinite(primitive.tangents[vertex]).all()
    ]
    lean = float(angles[~np.isin(vertices, [*wrong, *dict(broken)])].max(initial=0.0))
    found = Straightened(tuple(vertices), lean, tuple(wrong), tuple(broken))
    return replace(primitive, tangents=tangents, straightened=found)


def unhanded(tangents: FloatArray, vertices: Sequence[int]) -> list[int]:
    """Return those of some vertices at which TANGENT is finite, and its w is neither 1 nor −1."""
    rows = np.asarray(vertices, dtype=np.int64)
    finite = rows[np.isfinite(tangents[rows]).all(axis=1)]
    found: list[int] = finite[np.abs(tangents[finite, 3]) != 1.0].tolist()
    return found


class ChosenFrame(NamedTuple):
    """The frame of one primitive's bake, and the quality of its TANGENT.

    kind is ``tangent`` or ``normal``. deviation is the largest angle in degrees by which t0 × b0 leans from
    n0 at a vertex of a triangle. deviating is the number of vertices that lean more than TANGENT_TOLERANCE,
    unhanded that of those among them at which TANGENT is finite, and its w is neither 1 nor −1.
    """

    kind: str
    deviation: float = 0.0
    deviating: int = 0
    unhanded: int = 0


def chosen_frame(primitive: SkinnedPrimitive, choice: str) -> ChosenFrame:
    """Return the frame of a primitive with normals. choice is ``auto``, ``tangent`` or ``normal``.

    ``auto`` uses TANGENT if it is orthonormal enough at every vertex, else the frame from NORMAL.
    """
    if primitive.tangents is None or choice == Frame.NORMAL:
        return ChosenFrame(Frame.NORMAL)
    if primitive.straightened is not None:  # it has been looked at
        return ChosenFrame(Frame.TANGENT, primitive.straightened.lean)
    deviation, vertices = leaning(primitive, primitive.tangents)
    fits = choice == Frame.TANGENT or not vertices
    wrong = len(unhanded(primitive.tangents, vertices))
    return ChosenFrame(Frame.TANGENT if fits else Frame.NORMAL, deviation, len(vertices), wrong)


def frame_vectors(primitive: SkinnedPrimitive, kind: str) -> tuple[FloatArray, FloatArray]:
    """Return the tangents t0 and bitangents b0 of a primitive at rest, each (V, 3).

    kind is ``tangent`` or ``normal``; the former needs TANGENT. NORMAL counts at length 1. With ``tangent``,
    t0 has the length of TANGENT, and both have its type. With ``normal``, both are float32 unit vectors.
    """
    given = primitive.tangents if kind == Frame.TANGENT else None
    dtype = np.result_type(np.float32, np.float32 if given is None else given.dtype)
    tangents, bitangents = (np.empty(primitive.normals.shape, dtype=dtype) for _ in range(2))
    for rows in blocks(len(tangents)):
        normals = frames.unit_normals(primitive.normals[rows])
        tangents[rows], bitangents[rows] = (
            frames.frame_from_normal(normals)
            if given is None
            else frames.frame_from_tangent(normals, given[rows])
        )
    return tangents, bitangents
