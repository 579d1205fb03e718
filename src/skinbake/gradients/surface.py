"""One surface to bake, made of all primitives that are baked together, and the result of its bake."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from skinbake.geometry.rig import Rig
from skinbake.geometry.skinned import Float32Array, Float64Array, FloatArray, IntArray
from skinbake.gradients.field import WeightField

NEGLIGIBLE = 1e-4
"""The share of a vertex's gradient below which a neighbour's joint is not worth a slot.

It changes the correction of a tangent by a ten-thousandth. At a correction as long as the tangent itself,
that is less than 0.01°.
"""


@dataclass(frozen=True, slots=True)
class Surface:
    """One surface of P primitives, with their V vertices one after the other.

    positions (V, 3) are in mesh space. triangles (T, 3) index them, and all have an area. field has the
    normalised weights (V, K). classes (V,) is each vertex's weld class. normals (V, 3) are of any length.
    frame has the tangents and bitangents at rest, each (V, 3) and of one type. None means that they follow
    from the normals. ends (P,) is the index after each primitive's last vertex. If there is a rig, the
    gradients are fitted to its turns. It has all joints of the field.
    """

    positions: FloatArray
    triangles: IntArray
    field: WeightField
    classes: IntArray
    normals: FloatArray
    frame: tuple[FloatArray, FloatArray] | None
    ends: Sequence[int]
    rig: Rig | None = None


@dataclass(frozen=True, slots=True)
class SurfaceSlots:
    """α and β of every slot but the first, and the gradients that the slots could not hold.

    alpha, beta (V, K − 1) are float32, 1 / length unit. adopting (A,) lists the vertices that adopt,
    ascending. adopted (A, K) integer is the joint that each of their slots adopts, −1 if it stays. sums (P,
    4) float64 are over the vertices of each primitive: the number of vertices that adopt; the number of those
    with more foreign joints than free slots (without adoption: with any foreign joint); the lengths of all
    joints' gradients, in 1 / length unit; and the part of these lengths that no slot holds, which goes to s0.
    """

    alpha: Float32Array
    beta: Float32Array
    adopting: IntArray
    adopted: IntArray
    sums: Float64Array
