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

STIFFNESS = 0.12
"""The share of a turn's squared lever that pulls the fitted gradients to the surface's gradients."""

TOGETHER = 10.0
"""How much more it counts that all joints of a long chain turn alike than that one joint turns by itself."""

MISSING = 15.0
"""How much STIFFNESS grows with the share of a vertex's gradients whose joints have no slot there.

The fit would let another joint stand in for a missing one, because both turn when their parent does. In clips
they turn differently.
"""

DOUBT = 0.01
"""The tilt of the tangents, for each radian that a joint turns, of which the fit takes half.

The true normals of a mesh are themselves off a smooth surface. So a fit would spoil gradients whose tangents
follow them this closely. Of a tilt e, the fit takes the share e² / (e² + doubt²).
"""

SMOOTH, MOST_DOUBT = 0.2, 4.0
"""The spread of the triangles' normals below which a surface is smooth, and how much the doubt grows there.

The spread of a class is 1 − |Σ area × normal| / Σ area. At a spread s the doubt is (SMOOTH / s)³ times
DOUBT, but at least DOUBT, and at most MOST_DOUBT times it. Triangles that lie nearly in one plane stand for a
smooth surface, and the gradient follows that surface better than they do.
"""

EVEN = 1e-4
"""A pull at every slot, a share of that of all turns. It decides where no turn parts two slots."""

FAINT = 0.1
"""The presence below which a joint's gradient is pulled harder, by the inverse square of the presence.

The presence of a joint at a vertex is its weight there, plus its share of the gradients' lengths. A joint
that is hardly there would make up for errors of others, at the end of a long lever.
"""

UNFELT = 1e-4
"""The presence up to which a joint is not fitted."""

FLAT = 1e-6
"""The sine between the two derivatives of the positions below which a class has no normal of its own."""


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
    ascending. adopted (A, K) integer is the joint that each of their slots adopts, −1 if it stays. counts (P,
    4) float64 has, by primitive: the vertices that adopt; the vertices with more foreign joints than free
    slots (without adoption: all with any foreign joint); the lengths of all joints' gradients summed over the
    vertices, in 1 / length unit; and the part of that sum that no slot holds, which goes to s0.
    """

    alpha: Float32Array
    beta: Float32Array
    adopting: IntArray
    adopted: IntArray
    counts: Float64Array
