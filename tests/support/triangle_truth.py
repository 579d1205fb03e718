"""The true normals of deformed meshes by triangles, as verify measures them."""

from __future__ import annotations

from typing import Any

import numpy as np

from skinbake.geometry.skinned import Float64Array, SkinnedPrimitive
from skinbake.truth.normals import block_sums, posed_tangents, triangle_normals
from skinbake.truth.operator import gradient_operator
from skinbake.truth.truths import carried_normals, rest_frames, vertex_normals


def true_normals(
    primitive: SkinnedPrimitive, deformed: Float64Array, normals: Any = None, sides: Any = None
) -> Float64Array:
    """Return the truth by triangles (P, V, 3) of deformed positions (P, V, 3)."""
    n0 = np.asarray(primitive.normals if normals is None else normals, dtype=np.float64)
    operator = gradient_operator([primitive])
    rest = rest_frames(operator, primitive.positions, n0)
    carried = carried_normals(operator, rest, primitive.positions, n0)
    posed = np.ascontiguousarray(deformed.transpose(2, 1, 0))
    sums = vertex_normals(operator, posed)
    found = np.empty(deformed.shape)
    for part, derivatives in zip(rest.parts, rest.derivatives, strict=True):
        side = None if sides is None else sides[:, part]
        tangents = posed_tangents(derivatives, posed)
        vectors, valid = triangle_normals(
            carried, part, tangents, block_sums(operator.classes, sums, part), side
        )
        found[:, part] = np.stack(vectors, axis=2)
        assert (np.isfinite(found[:, part, 0]) == valid).all()
    return found
