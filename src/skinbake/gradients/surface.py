"""One surface to bake, of all primitives that are baked together, and what its baking gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from skinbake.geometry.skinned import Float32Array, Float64Array, FloatArray, IntArray
from skinbake.gradients.field import WeightField

NEGLIGIBLE = 1e-4
"""Share of a vertex's gradient below which a neighbour's joint is not worth a slot.

It changes the correction of a tangent by a ten-thousandth: at a correction as long as the tangent itself
less than 0.01°.
"""


@dataclass(frozen=True, slots=True)
class Surface:
    """One surface of P primitives, their V vertices one after the other.

    positions (V, 3) in mesh space; triangles (T, 3) into them, all with an area; field the normalised
    weights (V, K); classes (V,) each vertex's weld class; normals (V, 3) of any length; frame the tangents
    and bitangents at rest, each (V, 3) and of one type, None for those that follow from the normals.
    ends (P,) is where each primitive's vertices end.
    """

    positions: FloatArray
    triangles: IntArray
    field: WeightField
    classes: IntArray
    normals: FloatArray
    frame: tuple[FloatArray, FloatArray] | None
    ends: Sequence[int]


@dataclass(frozen=True, slots=True)
class SurfaceSlots:
    """α and β of every slot but the first, and what the slots could not hold.

    alpha, beta (V, K − 1) float32, 1 / length unit. adopting (A,) names the vertices that adopt, ascending;
    adopted (A, K) integer the joint that each of their slots adopts, −1 where it stays. counts (P, 4)
    float64, by primitive: vertices that adopt; vertices with more foreign joints than free slots (all that
    have any, where none are adopted); the lengths of all joints' gradients summed over the vertices, in 1 /
    length unit; and the part of that sum that no slot holds, which falls to s0.
    """

    alpha: Float32Array
    beta: Float32Array
    adopting: IntArray
    adopted: IntArray
    counts: Float64Array
