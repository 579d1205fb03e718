"""What a normal map shows on a skinned surface: the mapped normal, and the frames in which engines find it.

A normal map stands for a relief of height h over the surface, displaced along n0. Skinning moves it with the
surface, so its map is the one whose columns are t', b' and T n0: t' and b' are how the surface's points move
along t0 and b0, and T n0 is how its height moves. The normal of a relief is a covector. It is carried by the
cofactors of that map:

    m' = ± cof[t' b' T n0] m = ± (m_x b' × T n0 + m_y T n0 × t' + m_z t' × b')

m is the normal of the texel in the frame (t0, b0, n0), of unit vectors. The third column is n' itself, so all
three take its signs. Here the first two are called cotangents. Engines rebuild their frame from n' and t'
alone instead (``engine_mapped_normal``), and lose how the surface is stretched and sheared.
"""

from __future__ import annotations

from skinbake.skinning.components import (
    Component,
    PosedVertex,
    Vector,
    cross,
    dot,
    plus_scaled,
    reciprocal_root,
    scaled,
)


def engine_mapped_normal(normal: Vector, tangent: Vector, handedness: Component, texel: Vector) -> Vector:
    """Return the normal m_x t + m_y b + m_z n that three.js draws, of any length: b is w n × t at length 1.

    normal and tangent are what skinning gives, of any length, and of any angle to each other. ``handedness``
    is w, that of TANGENT. ``texel`` is the normal m of a texel.
    """
    n, t = _unit(normal), _unit(tangent)
    b = scaled(handedness, _unit(cross(n, t)))
    return plus_scaled(plus_scaled(scaled(texel[0], t), texel[1], b), texel[2], n)


def in_frame(vector: Vector, tangent: Vector, bitangent: Vector, normal: Vector) -> Vector:
    """Return the parts of a vector along t0, b0 and n0, which are at right angles and of any length."""
    return dot(vector, _unit(tangent)), dot(vector, _unit(bitangent)), dot(vector, _unit(normal))


def mapped_normal(posed: PosedVertex, tangent_length: Component, texel: Vector) -> Vector:
    """Return the normal m', of any length, that a relief of this normal has on the deformed surface.

    ``texel`` is what the map shows at rest, in the frame of unit t0, b0, n0. If the texture follows t0, it is
    the texel itself. Otherwise ``engine_mapped_normal`` says what engines draw at rest, and ``in_frame``
    gives its parts: α and β of any frame serve, because derivatives are linear. ``tangent_length`` is
    |t0| = |b0| as given to the algorithm. For dual quaternions this includes the common scale of the joints:
    t' and b' have it once each, and n' twice.
    """
    found = scaled(texel[2], posed.normal)
    found = plus_scaled(found, tangent_length * texel[0], posed.cotangent)
    return plus_scaled(found, tangent_length * texel[1], posed.cobitangent)


def _unit(vector: Vector) -> Vector:
    """Return a vector at length 1; zero stays zero."""
    return scaled(reciprocal_root(dot(vector, vector)), vector)
