"""Blended skinning: each vertex between linear blend skinning and dual quaternions, by a weight of its own.

Both methods move a vertex, to l and to d, and its blend weight b takes it to p' = l + b (d − l). So do
*Weight Blended* of Maya, and its like elsewhere. b varies over the surface, and so the derivative of p' along
a tangent t has a part of its own, beside those of both methods:

    t' = (1 − b) t'[l] + b t'[d] + ∂b/∂t (d − l)        b' likewise, n' = ± t' × b'

With algorithms 3 and 6 for the two methods, it is exact. Standard lighting blends both standard normals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skinbake.geometry.skinned import FloatArray
from skinbake.skinning.components import (
    Component,
    PosedVertex,
    Vector,
    cross,
    dot,
    minus,
    plus_scaled,
    reciprocal_root,
    scaled,
)
from skinbake.skinning.rest import Algorithm, Options, RestPrimitive
from skinbake.skinning.run import Skinning

LINEAR = {
    Algorithm.DQS_STANDARD: Algorithm.LBS_STANDARD,
    Algorithm.DQS_EXACT: Algorithm.LBS_ACCURATE,
}
"""The algorithm of linear blending that goes with one of dual quaternions."""


def standard(linear: PosedVertex, dual: PosedVertex, blend: Vector) -> PosedVertex:
    """Return standard lighting between that of both methods. blend is b, and perhaps its derivatives."""
    of_linear, of_dual = (
        scaled(reciprocal_root(dot(one.normal, one.normal)), one.normal) for one in (linear, dual)
    )
    return PosedVertex(
        _between(linear.position, dual.position, blend[0]),
        _between(of_linear, of_dual, blend[0]),
        _between(linear.tangent, dual.tangent, blend[0]),
        _between(linear.bitangent, dual.bitangent, blend[0]),
    )


def accurate(linear: PosedVertex, dual: PosedVertex, blend: Vector, handedness: Component) -> PosedVertex:
    """Return accurate lighting between that of both methods. blend is b, ∂b/∂t0 and ∂b/∂b0.

    It costs 30 multiply-adds (``counting``) more than both methods.
    """
    weight, along_t, along_b = blend
    apart = minus(dual.position, linear.position)
    position = plus_scaled(linear.position, weight, apart)
    tangent = plus_scaled(_between(linear.tangent, dual.tangent, weight), along_t, apart)
    bitangent = plus_scaled(_between(linear.bitangent, dual.bitangent, weight), along_b, apart)
    return PosedVertex(position, scaled(handedness, cross(tangent, bitangent)), tangent, bitangent)


def _between(linear: Vector, dual: Vector, weight: Component) -> Vector:
    return plus_scaled(linear, weight, minus(dual, linear))


@dataclass(frozen=True, slots=True)
class BlendedSkinning:
    """A primitive at rest under both methods, on which both run block by block, and are blended."""

    rest: RestPrimitive
    linear: Skinning
    dual: Skinning

    @classmethod
    def of_mesh(
        cls, primitives: Sequence[RestPrimitive], joint_matrices: FloatArray, options: Options
    ) -> list[BlendedSkinning]:
        """Prepare the primitives of one mesh, for joint matrices (P, J, 4, 4)."""
        linear, dual = (
            Skinning.of_mesh(primitives, joint_matrices, options, dual_quaternions=is_dual)
            for is_dual in (False, True)
        )
        return list(map(cls, primitives, linear, dual))

    def run(self, algorithms: Sequence[Algorithm], pose: slice, part: slice) -> list[PosedVertex]:
        """Return the results for a block of poses and vertices, as components (P, V).

        algorithms are for dual quaternions. ``LINEAR`` names what goes with them by linear blending.
        """
        rows = self.rest.rows(part)
        blend = tuple(np.zeros((3, len(rows.positions))) if rows.blend is None else rows.blend.T)
        linear = self.linear.run([LINEAR[one] for one in algorithms], pose, part)
        dual = self.dual.run(algorithms, pose, part)
        return [
            standard(of_linear, of_dual, blend)
            if algorithm is Algorithm.DQS_STANDARD
            else accurate(of_linear, of_dual, blend, rows.handedness())
            for algorithm, of_linear, of_dual in zip(algorithms, linear, dual, strict=True)
        ]
