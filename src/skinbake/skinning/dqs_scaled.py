"""Algorithms 4 to 6 where joints scale, shear or mirror: dual quaternion skinning about the vertex itself.

A joint matrix M[s] has the polar decomposition ± R S. r[s] is the unit quaternion of its rotation R; the
minus is for a joint that mirrors. A vector is a quaternion of scalar part 0, and σ are the hemisphere signs.
A vertex moves by the quotient of two linear blends:

    B = Σ w σ r[s]        G = Σ w σ (M[s] p) r[s]        P = G B⁻¹        p' = vec P

For rigid joints p' is where the mix of dual quaternions takes p, because (M[s] p) r[s] = r[s] p + 2 d[s]
then (Kavan et al. 2007). No origin enters: moving all M[s] p by c adds c B to G, and so c to P. Put
otherwise, each joint scales about the vertex, then turns and moves it rigidly. So does Blender (*Preserve
Volume*), but where a joint shears or mirrors it takes another R, which keeps the direction of the bone.

Along a curve with tangent t the weights change by α. The derivative of P B = G is, exactly,

    Ḃ = Σ α σ r[s]        Ġ = Σ w σ (M[s] t) r[s] + Σ α σ (M[s] p) r[s]        t' = vec((Ġ − P Ḃ) B⁻¹)

A joint that leaves a line or a point, as at scale 0, has no rotation of its own. It brings none into the mix:
at each vertex it takes that of the first slot that has one (``with_rotations``).

A joint is a matrix of four rows, the scalar part first, and five columns (``scaled_motions``): columns 0 to 2
are the columns of M[s] times r[s], column 3 is the translation times r[s], and column 4 is r[s].
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skinbake.skinning.components import (
    Component,
    LineMark,
    PosedVertex,
    RestVertex,
    Rows,
    Vector,
    affine,
    corrected,
    cross,
    dot,
    linear,
    minus,
    minus_scaled,
    plus_cross,
    plus_weighted,
    quotient,
    scaled,
    weighted_sum,
)
from skinbake.skinning.dqs import hemispheres, signed
from skinbake.skinning.lbs import plus_gradient, with_normal_map
from skinbake.skinning.rest import Options


def standard(vertex: RestVertex, motions: Sequence[Rows], options: Options, line: LineMark) -> PosedVertex:
    """Run algorithm 4: move the frame as if the weights were constant, v' = vec((Σ w σ (M[s] v) r[s]) B⁻¹).

    A mix B of length zero takes the vertex to the origin. ``options`` have no effect here.
    """
    line(1)  # the mix: Σ w σ of all columns, B the last one
    mixed = _mixed(vertex.weights, motions, hemispheres(list(map(_rotation, motions))))
    line(2)  # B / |B|²
    divisor = _divisor(_rotation(mixed))
    line(3)  # p' = vec(G B⁻¹), G = Σ w σ (M[s] p) r[s]
    position = _over(affine(mixed, vertex.position), divisor)
    line(4)  # n' = vec((Σ w σ (M[s] n) r[s]) B⁻¹)
    normal = _over(linear(mixed, vertex.normal), divisor)
    line(5)  # t' likewise
    tangent = _over(linear(mixed, vertex.tangent), divisor)
    line(6)  # b' likewise
    bitangent = _over(linear(mixed, vertex.bitangent), divisor)
    return PosedVertex(position, normal, tangent, bitangent)


def accurate(vertex: RestVertex, motions: Sequence[Rows], options: Options, line: LineMark) -> PosedVertex:
    """Run algorithm 5: t' of algorithm 4 plus Σ α (M[s] p − M[s₀] p), as if skinning blended positions."""
    line(1)  # the mix: Σ w σ of all columns, B the last one
    mixed = _mixed(vertex.weights, motions, hemispheres(list(map(_rotation, motions))))
    line(2)  # B / |B|²
    divisor = _divisor(_rotation(mixed))
    line(3)  # p' = vec(G B⁻¹)
    position = _over(affine(mixed, vertex.position), divisor)
    line(4)  # M[s] p
    # r[s] has length 1, so it is its own divisor.
    moved = [_over(affine(motion, vertex.position), _rotation(motion)) for motion in motions]
    line(5)  # M[s] p − M[s₀] p
    differences = [minus(point, moved[0]) for point in moved[1:]]
    line(6)  # t' = vec((Σ w σ (M[s] t) r[s]) B⁻¹) + Σ α (M[s] p − M[s₀] p)
    tangent = _over(linear(mixed, vertex.tangent), divisor)
    tangent = plus_gradient(tangent, vertex.alpha, differences, options.cap)
    line(7)  # b' likewise, with β
    bitangent = _over(linear(mixed, vertex.bitangent), divisor)
    bitangent = plus_gradient(bitangent, vertex.beta, differences, options.cap)
    line(8)  # n' = ± t' × b'
    normal = scaled(vertex.handedness, cross(tangent, bitangent))
    posed = PosedVertex(position, normal, tangent, bitangent)
    if not options.normal_map:
        return posed
    line(9)  # the mix applied to n0, for normal maps
    carried = _over(linear(mixed, vertex.normal), divisor)
    return with_normal_map(posed, carried, vertex.handedness, line, first=10)


def exact(vertex: RestVertex, motions: Sequence[Rows], options: Options, line: LineMark) -> PosedVertex:
    """Run algorithm 6: t' = vec((Ġ − P Ḃ) B⁻¹), the derivative of the quotient itself, and b' by β.

    Because Σ α is 0, both sums over α take differences to slot 0. It costs 60 N + 83 multiply-adds for N ≥ 2
    (``counting``). With ``options.cap``, what depends on α is limited. A mix B of length zero takes the
    vertex to the origin.
    """
    line(1)  # r[s], σ, and the mix without translations
    turns = [_rotation(motion) for motion in motions]
    signs = hemispheres(turns)
    # No translation: line 5 needs every M[s] p by itself.
    mixed = _mixed(vertex.weights, motions, signs, columns=(0, 1, 2, 4))
    line(2)  # B / |B|²
    divisor = _divisor(_rotation(mixed))
    line(3)  # (M[s] p) r[s]
    moved = [affine(motion, vertex.position) for motion in motions]
    line(4)  # what α multiplies in Ġ and in Ḃ
    # σ (M[s] p) r[s] and σ r[s], less those of slot 0.
    moves = [minus(scaled(sign, one), moved[0]) for sign, one in zip(signs, moved[1:], strict=True)]
    turns = [minus(scaled(sign, one), turns[0]) for sign, one in zip(signs, turns[1:], strict=True)]
    line(5)  # P = G B⁻¹ and p' = vec P
    blend = plus_weighted(moved[0], vertex.weights[1:], moves)
    position = _over(blend, divisor)
    ratio = (dot(blend, divisor), *position)
    line(6)  # t' = vec((Ġ − P Ḃ) B⁻¹)
    tangent = _derivative(mixed, vertex.tangent, (vertex.alpha, moves, turns), ratio, divisor, options.cap)
    line(7)  # b' likewise
    bitangent = _derivative(mixed, vertex.bitangent, (vertex.beta, moves, turns), ratio, divisor, options.cap)
    line(8)  # n' = ± t' × b'
    normal = scaled(vertex.handedness, cross(tangent, bitangent))
    posed = PosedVertex(position, normal, tangent, bitangent)
    if not options.normal_map:
        return posed
    line(9)  # the mix applied to n0, for normal maps
    carried = _over(linear(mixed, vertex.normal), divisor)
    return with_normal_map(posed, carried, vertex.handedness, line, first=10)


def with_rotations(motions: Sequence[Rows]) -> Sequence[Rows]:
    """Return the motions of a vertex's slots, arrays, after each without a rotation has got another's."""
    turns = [_rotation(motion) for motion in motions]
    lacking = [np.logical_not(np.any(turn, axis=0)) for turn in turns]
    if not any(where.any() for where in lacking):
        return motions
    # The first that there is, or the identity.
    pivot: Vector = tuple(map(np.full_like, turns[0], (1, 0, 0, 0)))
    for turn, where in zip(reversed(turns), reversed(lacking), strict=True):
        pivot = tuple(map(np.where, [where] * 4, pivot, turn))
    found = []
    for motion, where in zip(motions, lacking, strict=True):
        columns = [_times(column[1:], pivot) for column in list(zip(*motion, strict=True))[:4]] + [pivot]
        rows = zip(motion, zip(*columns, strict=True), strict=True)
        found.append(tuple(tuple(map(np.where, [where] * 5, new, old)) for old, new in rows))
    return found


def _times(vector: Vector, rotation: Vector) -> Vector:
    """Return the quaternion (0, v) r."""
    real = -dot(vector, rotation[1:])
    return (real, *plus_cross(scaled(rotation[0], vector), vector, rotation[1:]))


_Rates = tuple[Sequence[Component], Sequence[Vector], Sequence[Vector]]
"""α (or β) of slots 1 … K − 1, and what they multiply in Ġ and in Ḃ."""


def _derivative(
    mixed: Rows, tangent: Vector, rates: _Rates, ratio: Vector, divisor: Vector, cap: float | None
) -> Vector:
    """Return t' = vec((Ġ − P Ḃ) B⁻¹); P is the ratio."""
    slopes, moves, turns = rates
    base = linear(mixed, tangent)
    if not moves:
        return _over(base, divisor)
    turn = weighted_sum(slopes, turns)
    if cap is None:
        return _over(_minus_product(plus_weighted(base, slopes, moves), ratio, turn), divisor)
    correction = _over(_minus_product(weighted_sum(slopes, moves), ratio, turn), divisor)
    return corrected(_over(base, divisor), correction, cap)


def _mixed(
    weights: Sequence[Component],
    motions: Sequence[Rows],
    signs: Sequence[Component],
    columns: Sequence[int] = range(5),
) -> Rows:
    """Return Σ w σ of some columns of the motions."""
    own = signed(weights, signs)
    return tuple(
        weighted_sum(own, [tuple(motion[row][column] for column in columns) for motion in motions])
        for row in range(4)
    )


def _rotation(motion: Rows) -> Vector:
    """Return the quaternion r[s] of a motion, or B of a mix: the last column."""
    return tuple(row[-1] for row in motion)


def _divisor(mix: Vector) -> Vector:
    """Return B / |B|², by whose conjugate a product is B⁻¹'s; zero stays zero."""
    return scaled(quotient(1.0, dot(mix, mix)), mix)


def _over(product: Vector, divisor: Vector) -> Vector:
    """Return vec(a b*) = b₀ a − a₀ b + b × a of a quaternion a and a divisor b."""
    vector, by_vector = product[1:], divisor[1:]
    found = minus_scaled(scaled(divisor[0], vector), product[0], by_vector)
    return plus_cross(found, by_vector, vector)


def _minus_product(base: Vector, a: Vector, b: Vector) -> Vector:
    """Return c − a b of quaternions, whose vector is c − a₀ b − b₀ a + b × a."""
    real, vector, by_vector = base[0] - a[0] * b[0], a[1:], b[1:]
    for left, right in zip(vector, by_vector, strict=True):
        real += left * right
    found = minus_scaled(minus_scaled(base[1:], a[0], by_vector), b[0], vector)
    return (real, *plus_cross(found, by_vector, vector))
