"""Linear blend skinning: algorithms 1, 2 and 3 of Tarini et al. 2014 (supplement, §1–3), line by line.

Joint matrices M[s] come as their upper three rows, one matrix for each slot. ``line(n)`` marks line n of the
paper. Where its lines cannot be meant as printed, they are read so:

- 2, 2: ``M^t[s] p_i^t`` as ``M^t[s] p_i^0``, because lines 5 and 7 find p_i^t later; ``q_j^t(i)`` as
  ``q_i^t[s]``, and M̃ as M with its translation.
- 2, 3: T as its 3 × 3 part, summed over all influences, s0 too.
- 2, 6: ``J_i^t n_i^0`` as ``J'_i n_i^0``, with the inverse transpose of line 4.
- 3, 5: the sum over ``j ∈ B*`` as over ``s ∈ B*``.
- 3, 6 and 5, 8: ``t_i^t × b_i^t`` times h, the sign of (t0 × b0) · n0: mirrored textures have left-handed
  frames.
- 5, requirements: α and β of all influences but s0 too. 5, 4: less p_i^0, which line 5 does not see.
"""

from __future__ import annotations

from collections.abc import Sequence

from skinbake.choices import Baseline
from skinbake.skinning.components import (
    Component,
    LineMark,
    PosedVertex,
    RestVertex,
    Rows,
    Vector,
    affine,
    cofactors,
    corrected,
    cross,
    inverse_transpose,
    linear,
    minus,
    plus_scaled,
    plus_weighted,
    scaled,
    weighted_sum,
)
from skinbake.skinning.rest import Options


def standard(vertex: RestVertex, matrices: Sequence[Rows], options: Options, line: LineMark) -> PosedVertex:
    """Run algorithm 1: move the frame by the blended matrix, as if the weights were constant.

    The paper calls it approximated lighting. The normal of line 3 is that of ``options.baseline``. The paper
    uses ``Baseline.BLENDED``.
    """
    line(1)  # T = Σ w[s] M[s]
    blended = _blend(vertex.weights, matrices, columns=4)
    line(2)  # p' = T p
    position = affine(blended, vertex.position)
    line(3)  # n': T n (three.js), T⁻ᵀ n (Bevy) or Σ w[s] cof(M[s]) n (Filament)
    if options.baseline is Baseline.INVERSE_TRANSPOSE:
        normal = linear(inverse_transpose(blended), vertex.normal)
    elif options.baseline is Baseline.COFACTOR:
        turned = [linear(cofactors(matrix), vertex.normal) for matrix in matrices]
        normal = weighted_sum(vertex.weights, turned)
    else:
        normal = linear(blended, vertex.normal)
    line(4)  # t' = T t
    tangent = linear(blended, vertex.tangent)
    line(5)  # b' = T b
    bitangent = linear(blended, vertex.bitangent)
    return PosedVertex(position, normal, tangent, bitangent)


def direct(vertex: RestVertex, matrices: Sequence[Rows], options: Options, line: LineMark) -> PosedVertex:
    """Run algorithm 2: build the Jacobian J = T + Σ q aᵀ of the skinned position, and invert it.

    The text of the paper applies J to every vector of lines 6–8. In fact only the tangents of lines 7 and 8
    go through J. The normal of line 6 goes through the inverse transpose J' of line 4. J⁻ᵀ n stays on the
    side of J n. If a fold or a mirrored joint makes det J negative, it is opposite to algorithm 3's t' × b' =
    det J · J⁻ᵀ n. If det J is 0, cof(J) n is returned. ``options`` have no effect here.
    """
    line(1)  # T = Σ w[s] M[s]
    blended = _blend(vertex.weights, matrices, columns=4)
    line(2)  # q[s] = M[s] p
    moved = [affine(matrix, vertex.position) for matrix in matrices]
    line(3)  # J = T + Σ q[s] a[s]ᵀ, a[s] = ∇w[s]
    jacobian: Rows = tuple(row[:3] for row in blended)
    for position, gradient in zip(moved, vertex.gradients, strict=True):
        jacobian = tuple(
            plus_scaled(row, value, gradient) for row, value in zip(jacobian, position, strict=True)
        )
    line(4)  # J' = J⁻ᵀ
    inverted = inverse_transpose(jacobian)
    line(5)  # p' = T p
    position = affine(blended, vertex.position)
    line(6)  # n' = J' n
    normal = linear(inverted, vertex.normal)
    line(7)  # t' = J t
    tangent = linear(jacobian, vertex.tangent)
    line(8)  # b' = J b
    bitangent = linear(jacobian, vertex.bitangent)
    return PosedVertex(position, normal, tangent, bitangent)


def accurate(vertex: RestVertex, matrices: Sequence[Rows], options: Options, line: LineMark) -> PosedVertex:
    """Run algorithm 3: t' = T t + Σ α (M[s] p − M[s₀] p), b' likewise with β, n' = ± t' × b'.

    The sign is the handedness of the rest frame. ``options.cap`` limits the length of the two sums.
    """
    line(1)  # T = Σ w[s] M[s], 3 × 3
    blended = _blend(vertex.weights, matrices, columns=3)
    line(2)  # q[s] = M[s] p
    moved = [affine(matrix, vertex.position) for matrix in matrices]
    line(3)  # q[s] − q[s₀]
    differences = [minus(position, moved[0]) for position in moved[1:]]
    line(4)  # t' = T t + Σ α[s] (q[s] − q[s₀])
    tangent = plus_gradient(linear(blended, vertex.tangent), vertex.alpha, differences, options.cap)
    line(5)  # b' = T b + Σ β[s] (q[s] − q[s₀])
    bitangent = plus_gradient(linear(blended, vertex.bitangent), vertex.beta, differences, options.cap)
    line(6)  # n' = ± t' × b'
    normal = scaled(vertex.handedness, cross(tangent, bitangent))
    line(7)  # p' = q[s₀] + Σ w[s] (q[s] − q[s₀])
    position = plus_weighted(moved[0], vertex.weights[1:], differences)
    posed = PosedVertex(position, normal, tangent, bitangent)
    if not options.normal_map:
        return posed
    line(8)  # T n0, for normal maps
    return with_normal_map(posed, linear(blended, vertex.normal), vertex.handedness, line, first=9)


def with_normal_map(
    posed: PosedVertex, carried: Vector, handedness: Component, line: LineMark, *, first: int
) -> PosedVertex:
    """Return a vertex with its cotangents ± b' × T n0 and ± T n0 × t', beside n' = ± t' × b'.

    ``carried`` is T n0, by which skinning moves what stands out of the surface along n0. The three are the
    columns of a cofactor matrix: see ``normal_maps``. ``first`` is the number of the first of two lines.
    """
    line(first)
    cotangent = scaled(handedness, cross(posed.bitangent, carried))
    line(first + 1)
    cobitangent = scaled(handedness, cross(carried, posed.tangent))
    return posed._replace(cotangent=cotangent, cobitangent=cobitangent)


def plus_gradient(
    base: Vector, derivatives: Sequence[Component], differences: Sequence[Vector], cap: float | None
) -> Vector:
    """Return base + Σ derivative · difference, with the sum limited to cap × |base| if there is a cap."""
    if cap is None or not differences:
        return plus_weighted(base, derivatives, differences)
    return corrected(base, weighted_sum(derivatives, differences), cap)


def _blend(weights: Sequence[Component], matrices: Sequence[Rows], *, columns: int) -> Rows:
    """Return T = Σ w[s] M[s], its first three or all four columns."""
    return tuple(weighted_sum(weights, [matrix[row][:columns] for matrix in matrices]) for row in range(3))
