"""Dual quaternion skinning: algorithms 4 and 5 of Tarini et al. 2014 (supplement, §4–5), and our 6.

A dual quaternion Q[s] is given by its eight components (r₀, r, d₀, d): real part, dual part, each scalar
first. A uniform scale that all joints share is not part of it: position, tangent and bitangent arrive scaled.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from skinbake.skinning.components import (
    Component,
    LineMark,
    PosedVertex,
    RestVertex,
    Vector,
    corrected,
    cross,
    dot,
    minus,
    minus_scaled,
    plus_cross,
    plus_scaled,
    quotient,
    reciprocal_root,
    scaled,
    sign_of,
    weighted_sum,
)
from skinbake.skinning.lbs import plus_gradient, with_normal_map
from skinbake.skinning.rest import Options


def standard(
    vertex: RestVertex, quaternions: Sequence[Vector], options: Options, line: LineMark
) -> PosedVertex:
    """Run algorithm 4: move the frame by the normalised mix, as if the weights were constant.

    The paper calls it approximated lighting. A mix of length zero leaves the vertex where it is. ``options``
    have no effect here.
    """
    line(1)  # Q = Σ w[s] σ[s] Q[s]
    mixed = weighted_sum(signed(vertex.weights, hemispheres(quaternions)), quaternions)
    line(2)  # Q / |r|
    unit = _normalised(mixed)
    line(3)  # p' = Q(p)
    position = plus_scaled(vertex.position, 2.0, _half_displacement(unit, vertex.position))
    line(4)  # n' = R n
    normal = _rotated(unit, vertex.normal)
    line(5)  # t' = R t
    tangent = _rotated(unit, vertex.tangent)
    line(6)  # b' = R b
    bitangent = _rotated(unit, vertex.bitangent)
    return PosedVertex(position, normal, tangent, bitangent)


def accurate(
    vertex: RestVertex, quaternions: Sequence[Vector], options: Options, line: LineMark
) -> PosedVertex:
    """Run algorithm 5: t' = Q(t) + Σ α (Q[s](p) − Q[s₀](p)), as if skinning blended positions.

    Line 4 computes Q[s](p) − p, from which the same differences follow. b', n' and the cap as in algorithm 3.
    """
    line(1)  # Q = Σ w[s] σ[s] Q[s]
    mixed = weighted_sum(signed(vertex.weights, hemispheres(quaternions)), quaternions)
    line(2)  # Q / |r|
    unit = _normalised(mixed)
    line(3)  # p' = Q(p)
    position = plus_scaled(vertex.position, 2.0, _half_displacement(unit, vertex.position))
    line(4)  # Q[s](p) − p
    moved = [scaled(2.0, _half_displacement(quaternion, vertex.position)) for quaternion in quaternions]
    line(5)  # Q[s](p) − Q[s₀](p)
    differences = [minus(displacement, moved[0]) for displacement in moved[1:]]
    line(6)  # t' = R t + Σ α[s] (Q[s](p) − Q[s₀](p))
    tangent = plus_gradient(_rotated(unit, vertex.tangent), vertex.alpha, differences, options.cap)
    line(7)  # b' likewise, with β
    bitangent = plus_gradient(_rotated(unit, vertex.bitangent), vertex.beta, differences, options.cap)
    line(8)  # n' = ± t' × b'
    normal = scaled(vertex.handedness, cross(tangent, bitangent))
    posed = PosedVertex(position, normal, tangent, bitangent)
    if not options.normal_map:
        return posed
    line(9)  # R n0, for normal maps
    return with_normal_map(posed, _rotated(unit, vertex.normal), vertex.handedness, line, first=10)


def exact(vertex: RestVertex, quaternions: Sequence[Vector], options: Options, line: LineMark) -> PosedVertex:
    """Run algorithm 6: differentiate the dual-quaternion blend itself.

    The mix b = Σ w σ Q = (r₀, r, d₀, d), σ the hemisphere signs, moves p without ever being normalised:

        i = r × p + r₀ p + d            h = r × i + r₀ d − d₀ r
        k = 2 / (r₀² + |r|²)            p' = p + δ,  δ = k h

    (with a unit b this is Kavan's p + 2 r × (r × p + r₀ p) + 2 (r₀ d − d₀ r + r × d)). Along a curve with
    tangent t the weights change by α, hence b by ḃ = Σ α σ Q = Σ α (σ Q[s] − Q[s₀]), since Σ α = 0. The
    product rule gives

        i̇ = ṙ × p + ṙ₀ p + ḋ + r × t + r₀ t
        ḣ = ṙ × i + r × i̇ + ṙ₀ d + r₀ ḋ − ḋ₀ r − d₀ ṙ
        k̇ = −k² (r₀ ṙ₀ + r · ṙ)
        t' = t + k ḣ + k̇ h = t + k (ḣ − (r₀ ṙ₀ + r · ṙ) δ)

    and b' likewise with β. With ω = 2 vec(ṙ r*), ρ = 2 r · ṙ, ν = 2 vec(ḋ r*), τ = 2 vec(d r*), all of the
    unit mix, it is

        t' = R t + ω × (p' − τ/2) + ν − (ρ/2) τ − (r · d) ω

    The last term is easily overlooked: r · d is 0 for each joint and for planar motions, but not for a mix of
    spatial ones. With ``options.cap``, the correction t' − R t is limited. A mix of length zero
    leaves the vertex where it is.
    """
    line(1)  # b = Σ w σ Q
    signs = hemispheres(quaternions)
    mixed = weighted_sum(signed(vertex.weights, signs), quaternions)
    line(2)  # k = 2 / (r₀² + |r|²)
    factor = quotient(2.0, dot(mixed[:4], mixed[:4]))
    line(3)  # i, δ = k h and p' = p + δ
    lever = _lever(mixed, vertex.position)
    displacement = scaled(factor, _half_turn(mixed, lever))
    position = tuple(value + by for value, by in zip(vertex.position, displacement, strict=True))
    line(4)  # σ Q[s] − Q[s₀]
    differences = [
        minus(scaled(sign, quaternion), quaternions[0])
        for sign, quaternion in zip(signs, quaternions[1:], strict=True)
    ]
    line(5)  # ḃ along t: Σ α (σ Q[s] − Q[s₀])
    along_tangent = _rate(vertex.alpha, differences)
    line(6)  # ḃ along b, with β
    along_bitangent = _rate(vertex.beta, differences)
    blend = _Blend(mixed, factor, vertex.position, lever, displacement)
    line(7)  # t' = t + k (ḣ − (r₀ ṙ₀ + r · ṙ) δ)
    tangent = blend.derivative(vertex.tangent, along_tangent, options.cap)
    line(8)  # b' likewise
    bitangent = blend.derivative(vertex.bitangent, along_bitangent, options.cap)
    line(9)  # n' = ± t' × b'
    normal = scaled(vertex.handedness, cross(tangent, bitangent))
    posed = PosedVertex(position, normal, tangent, bitangent)
    if not options.normal_map:
        return posed
    line(10)  # the mix applied to n0, for normal maps
    carried = plus_scaled(vertex.normal, factor, blend.turn(vertex.normal))
    return with_normal_map(posed, carried, vertex.handedness, line, first=11)


class _Blend(NamedTuple):
    """The terms of algorithm 6 that both tangents share, in the letters of ``exact``: b, k, p, i and δ."""

    mixed: Vector
    factor: Component
    position: Vector
    lever: Vector
    displacement: Vector

    def derivative(self, tangent: Vector, rate: Vector, cap: float | None) -> Vector:
        """Return t' = t + k (ḣ − (r₀ ṙ₀ + r · ṙ) δ) for the rate ḃ at which the mix changes along t."""
        real, vector, dual, dual_vector = _parts(self.mixed)
        real_rate, vector_rate, dual_rate, dual_vector_rate = _parts(rate)
        # Terms with t come first: they have the shape of the whole block, also if a single influence makes
        # ḃ = 0.
        lever_rate = plus_scaled(dual_vector_rate, real, tangent)
        lever_rate = plus_cross(lever_rate, vector, tangent)
        lever_rate = plus_scaled(lever_rate, real_rate, self.position)
        lever_rate = plus_cross(lever_rate, vector_rate, self.position)
        # ḣ, by the product rule; the lines before are those of i̇.
        turn_rate = scaled(real, dual_vector_rate)
        turn_rate = plus_cross(turn_rate, vector, lever_rate)
        turn_rate = plus_cross(turn_rate, vector_rate, self.lever)
        turn_rate = plus_scaled(turn_rate, real_rate, dual_vector)
        turn_rate = minus_scaled(turn_rate, dual_rate, vector)
        turn_rate = minus_scaled(turn_rate, dual, vector_rate)
        # k̇ h, divided by k.
        turn_rate = minus_scaled(turn_rate, dot(self.mixed[:4], rate[:4]), self.displacement)
        if cap is None:
            return plus_scaled(tangent, self.factor, turn_rate)
        # t' − R t is limited to cap × |R t|.
        turned = self.turn(tangent)
        correction = scaled(self.factor, minus(turn_rate, turned))
        return corrected(plus_scaled(tangent, self.factor, turned), correction, cap)

    def turn(self, vector: Vector) -> Vector:
        """Return r × (r × v + r₀ v): the mix rotates v by k times it."""
        real, axis, _, _ = _parts(self.mixed)
        return cross(axis, plus_cross(scaled(real, vector), axis, vector))


def _parts(dual_quaternion: Vector) -> tuple[Component, Vector, Component, Vector]:
    """Split eight components into r₀, r, d₀, d."""
    return dual_quaternion[0], dual_quaternion[1:4], dual_quaternion[4], dual_quaternion[5:8]


def hemispheres(quaternions: Sequence[Vector]) -> list[Component]:
    """Return σ of slots 1 … K − 1: −1 where a real part points away from slot 0's, whose Q then means −Q."""
    pivot = quaternions[0][:4]
    return [sign_of(dot(quaternion[:4], pivot)) for quaternion in quaternions[1:]]


def signed(weights: Sequence[Component], signs: Sequence[Component]) -> list[Component]:
    """Return w σ of every slot, with the signs of ``hemispheres``."""
    return [weights[0], *(sign * weight for sign, weight in zip(signs, weights[1:], strict=True))]


def _rate(derivatives: Sequence[Component], differences: Sequence[Vector]) -> Vector:
    """Return ḃ = Σ derivative · difference; for a single influence the mix is constant."""
    return weighted_sum(derivatives, differences) if differences else (0.0,) * 8


def _normalised(dual_quaternion: Vector) -> Vector:
    """Return Q / |r|; zero stays zero."""
    return scaled(reciprocal_root(dot(dual_quaternion[:4], dual_quaternion[:4])), dual_quaternion)


def _rotated(unit: Vector, vector: Vector) -> Vector:
    """Return v + 2 r × (r × v + r₀ v)."""
    real, axis, _, _ = _parts(unit)
    return plus_scaled(vector, 2.0, cross(axis, plus_cross(scaled(real, vector), axis, vector)))


def _half_displacement(unit: Vector, position: Vector) -> Vector:
    """Return (Q(p) − p) / 2."""
    return _half_turn(unit, _lever(unit, position))


def _lever(dual_quaternion: Vector, position: Vector) -> Vector:
    """Return i = r × p + r₀ p + d."""
    real, vector, _, dual_vector = _parts(dual_quaternion)
    return plus_cross(plus_scaled(dual_vector, real, position), vector, position)


def _half_turn(dual_quaternion: Vector, lever: Vector) -> Vector:
    """Return h = r × i + r₀ d − d₀ r."""
    real, vector, dual, dual_vector = _parts(dual_quaternion)
    return plus_cross(minus_scaled(scaled(real, dual_vector), dual, vector), vector, lever)
