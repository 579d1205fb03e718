"""A primitive at rest under morph targets: moved positions, and the frame that the shader would use."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from skinbake.geometry.morphs import (
    MorphTargets,
    carried_by_normal,
    carried_by_tangent,
    dot,
    morphed_normals,
)
from skinbake.geometry.skinned import FloatArray
from skinbake.skinning.rest import RestPrimitive


def morphed(
    rest: RestPrimitive, targets: MorphTargets, weights: FloatArray, *, dtype: npt.DTypeLike = np.float64
) -> RestPrimitive:
    """Return the primitive with the targets at these weights (N,).

    α, β, joints and weights of influences stay. The normal is n0 + Σ w ΔN at length 1. t and b are those of
    ``carried_by_tangent`` if ``targets.with_tangents``, otherwise of ``carried_by_normal``. Positions and
    frame are computed in ``dtype``, the sums over targets in float64. verify uses float64. float32 gives the
    numbers of a shader, with which the tests of the shaders compare. If all weights are 0, the primitive
    itself is returned.
    """
    if not weights.any():
        return rest
    count = len(rest.positions)

    def added(vectors: FloatArray, differences: FloatArray) -> FloatArray:
        return np.asarray(vectors.astype(dtype) + differences.astype(dtype))

    # The morphed normal, and the frame carried along with it.
    n0, t0, b0 = (vectors.astype(dtype) for vectors in (rest.normals, rest.tangents, rest.bitangents))
    n = morphed_normals(n0, targets.summed("normals", weights, count).astype(dtype))
    if targets.with_tangents:
        moved = added(rest.tangents, targets.summed("tangents", weights, count))
        t, b = carried_by_tangent(n0, (t0, b0), n, moved, rest.handedness().astype(dtype))
    else:
        t, b = carried_by_normal(n0, (t0, b0), n)
    # Gradients of the rest do not fit a frame that targets stretch.
    primitive = replace(
        rest,
        positions=added(rest.positions, targets.summed("positions", weights, count)),
        normals=n,
        tangents=t,
        bitangents=b,
        gradients=None,
    )
    return _with_gradients(primitive) if targets.with_tangents else primitive


def _with_gradients(primitive: RestPrimitive) -> RestPrimitive:
    """Return the primitive with ∇w = (α t + β b) / |t|²: t and b are at right angles, and not of length 1."""
    square = dot(primitive.tangents, primitive.tangents)
    scale = 1 / np.where(square > 0, square, square.dtype.type(1))
    return replace(primitive, gradients=primitive.weight_gradients() * scale[:, None, None])
