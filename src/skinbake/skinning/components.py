"""Vectors and matrices as tuples of components: an algorithm runs on arrays and on counting scalars.

A component is an elementwise value: an ndarray that broadcasts over (poses, vertices), or a
``counting.Count``. A sum is written so that each product meets an addition, which is one multiply-add for
Tarini et al. 2014 (supplemental material, §1). No function changes its arguments. ``+=`` only adds to a value
that the function itself made.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

Component: TypeAlias = Any
Vector: TypeAlias = tuple[Component, ...]
Rows: TypeAlias = tuple[Vector, ...]
LineMark: TypeAlias = Callable[[int], None]


class RestVertex(NamedTuple):
    """The input of an algorithm at one vertex: the fields of RestPrimitive, component by component.

    weights and gradients have one entry for each slot, alpha and beta one for each slot after the first.
    handedness is 1 or −1.
    """

    position: Vector
    normal: Vector
    tangent: Vector
    bitangent: Vector
    weights: Sequence[Component]
    alpha: Sequence[Component]
    beta: Sequence[Component]
    gradients: Sequence[Vector]
    handedness: Component


class PosedVertex(NamedTuple):
    """The output of every algorithm at one vertex; the normal does not have unit length.

    cotangent and cobitangent are there if ``Options.normal_map`` asks for them (``normal_maps``).
    """

    position: Vector
    normal: Vector
    tangent: Vector
    bitangent: Vector
    cotangent: Vector = ()
    cobitangent: Vector = ()


def dot(a: Vector, b: Vector) -> Component:
    """Return Σ aᵢ bᵢ over the components of two vectors of the same length."""
    total = a[0] * b[0]
    for left, right in zip(a[1:], b[1:], strict=True):
        total += left * right
    return total


def scaled(factor: Component, vector: Vector) -> Vector:
    """Return the vector times a factor."""
    return tuple(factor * value for value in vector)


def minus(a: Vector, b: Vector) -> Vector:
    """Return a − b."""
    return tuple(left - right for left, right in zip(a, b, strict=True))


def plus_scaled(base: Vector, factor: Component, vector: Vector) -> Vector:
    """Return base + factor · vector."""
    return tuple(value + factor * other for value, other in zip(base, vector, strict=True))


def minus_scaled(base: Vector, factor: Component, vector: Vector) -> Vector:
    """Return base − factor · vector."""
    return tuple(value - factor * other for value, other in zip(base, vector, strict=True))


def cross(a: Vector, b: Vector) -> Vector:
    """Return a × b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def plus_cross(base: Vector, a: Vector, b: Vector) -> Vector:
    """Return base + a × b."""
    x = base[0] + a[1] * b[2]
    y = base[1] + a[2] * b[0]
    z = base[2] + a[0] * b[1]
    x -= a[2] * b[1]
    y -= a[0] * b[2]
    z -= a[1] * b[0]
    return (x, y, z)


def weighted_sum(weights: Sequence[Component], terms: Sequence[Vector]) -> Vector:
    """Return Σ weight · term over at least one term, component by component."""
    total = list(scaled(weights[0], terms[0]))
    for weight, term in zip(weights[1:], terms[1:], strict=True):
        for index, value in enumerate(term):
            total[index] += weight * value
    return tuple(total)


def plus_weighted(base: Vector, weights: Sequence[Component], terms: Sequence[Vector]) -> Vector:
    """Return base + Σ weight · term; no terms leave the base."""
    for weight, term in zip(weights, terms, strict=True):
        base = plus_scaled(base, weight, term)
    return base


def linear(rows: Rows, vector: Vector) -> Vector:
    """Return the upper 3 × 3 part of a matrix, given by its rows, times a vector."""
    return tuple(dot(row[:3], vector) for row in rows)


def affine(rows: Rows, position: Vector) -> Vector:
    """Return a 3 × 4 matrix, given by its rows, times a position."""
    x, y, z = position
    return tuple(row[3] + row[0] * x + row[1] * y + row[2] * z for row in rows)


def cofactors(rows: Rows) -> Rows:
    """Return the cofactor matrix of the upper 3 × 3 part: it maps a cross product a × b to (M a) × (M b)."""
    first, second, third = (row[:3] for row in rows)
    return (cross(second, third), cross(third, first), cross(first, second))


def inverse_transpose(rows: Rows) -> Rows:
    """Return M⁻ᵀ = cof(M) / det M of the upper 3 × 3 part; cof(M) itself where det M is 0."""
    cofactor = cofactors(rows)
    reciprocal = quotient(1.0, dot(rows[0][:3], cofactor[0]))
    return tuple(scaled(reciprocal, row) for row in cofactor)


def quotient(numerator: float, denominator: Component) -> Component:
    """Return numerator / denominator, and the numerator itself where the denominator is 0."""
    if isinstance(denominator, np.ndarray):
        return numerator / np.where(denominator == 0, denominator.dtype.type(1), denominator)
    return numerator / denominator


def reciprocal_root(square: Component) -> Component:
    """Return 1 / √square, and 1 where the square is 0."""
    if isinstance(square, np.ndarray):
        return 1.0 / np.sqrt(np.where(square == 0, square.dtype.type(1), square))
    return square.reciprocal_root()


def sign_of(value: Component) -> Component:
    """Return −1 where the value is negative, otherwise 1."""
    if isinstance(value, np.ndarray):
        one = value.dtype.type(1)
        return np.where(value < 0, -one, one)
    return value.sign()


def corrected(base: Vector, correction: Vector, cap: float) -> Vector:
    """Return base + correction, the correction shortened to at most cap × |base|.

    This is the limit of the paper's published demo, relative to |base|. Beyond it a fold turns the normal
    inside out. If the base has no length, the correction stays as it is.
    """
    allowed = cap * cap * dot(base, base)
    length = dot(correction, correction)
    too_long = (length > allowed) & (allowed > 0)
    limit = np.sqrt(np.where(too_long, allowed, 1.0) / np.where(too_long, length, 1.0))
    return plus_scaled(base, limit.astype(length.dtype), correction)
