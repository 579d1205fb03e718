"""A primitive at rest under morph targets: moved positions, and the frame that the shader would use."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from skinbake.geometry.frames import dot
from skinbake.geometry.morphs import (
    COMPONENTS,
    MorphTargets,
    carried_by_normal,
    carried_by_tangent,
    carried_in_plane,
    carried_in_space,
    morphed_normals,
    normals_of_frames,
)
from skinbake.geometry.skinned import FloatArray
from skinbake.skinning.rest import RestPrimitive


def morphed(
    rest: RestPrimitive, targets: MorphTargets, weights: FloatArray, *, dtype: npt.DTypeLike = np.float64
) -> RestPrimitive:
    """Return the primitive with the targets at these weights (N,).

    α, β, joints and weights of influences stay. The normal is n0 + Σ w ΔN at length 1, and ``sums`` has the
    length before. t and b are those of
    ``carried_by_tangent`` if ``targets.with_tangents``, otherwise of ``carried_by_normal``. If the targets
    have numbers of the differential, t and b come from ``carried_in_plane``, or with six numbers of
    ``carried_in_space``; the normal is then that of t and b, where they move. Positions and
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
    n, sums = morphed_normals(n0, targets.summed("normals", weights, count).astype(dtype))
    handedness = rest.handedness().astype(dtype)
    if targets.numbers:
        in_plane = targets.summed("in_plane", weights, count).astype(dtype)
        if targets.numbers > COMPONENTS["in_plane"]:
            upward = targets.summed("upward", weights, count).astype(dtype)
            t, b = carried_in_space(n0, (t0, b0), in_plane, upward)
            moved = np.concatenate([in_plane, upward], axis=1) != 0
            n = normals_of_frames(n0, (t, b), handedness, moved.any(axis=1))
        else:
            t, b = carried_in_plane(n0, (t0, b0), n, in_plane)
    elif targets.with_tangents:
        summed = added(rest.tangents, targets.summed("tangents", weights, count))
        t, b = carried_by_tangent(n0, (t0, b0), n, summed, handedness)
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
        sums=sums,
    )
    if targets.numbers:
        # t and b have any angle. ∇w · t = α and ∇w · b = β, so with c = t × b
        # ∇w = (α b × c + β c × t) / |c|². A frame without an area has no gradients.
        c = np.cross(t, b)
        square = dot(c, c)
        scale = (1 / np.where(square > 0, square, square.dtype.type(1)))[:, None]
        dual = replace(primitive, tangents=np.cross(b, c) * scale, bitangents=np.cross(c, t) * scale)
        return replace(primitive, gradients=dual.weight_gradients(), lengths=rest.tangent_lengths())
    if targets.with_tangents:
        # t and b are at right angles, and not of length 1: ∇w = (α t + β b) / |t|².
        square = dot(t, t)
        scale = 1 / np.where(square > 0, square, square.dtype.type(1))
        return replace(primitive, gradients=primitive.weight_gradients() * scale[:, None, None])
    return primitive


def as_engines_light(
    moved: RestPrimitive, rest: RestPrimitive, targets: MorphTargets, weights: FloatArray
) -> RestPrimitive:
    """Return a morphed primitive with the normals that engines give it: n0 + Σ w ΔN at length 1.

    rest is the primitive without morphs. The normals differ where targets have six numbers and no NORMAL. The
    frame stays, and so does what follows from it.
    """
    if targets.numbers <= COMPONENTS["in_plane"] or moved is rest:
        return moved
    n0 = rest.normals.astype(np.float64)
    normals, _ = morphed_normals(n0, targets.summed("normals", weights, len(n0)))
    return replace(moved, normals=normals, sides=moved.handedness())
