"""The forms of linear blend skinning: what is linear in the joint matrices (``blending``)."""

from __future__ import annotations

from dataclasses import dataclass

from skinbake.geometry.skinned import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Forms:
    """Forms F(u, c) = Σ w[s] M[s] u + Σ c[s] M[s] p̃ of B vertices, for any joint matrices M.

    joints, weights (B, K) and points (B, 3) are those of the vertices at rest. directions u are
    (F, B, 3), or None for the one form with u = p̃. changes c are (F, B, K), or None for zeros.
    """

    joints: IntArray
    weights: FloatArray
    points: FloatArray
    directions: FloatArray | None = None
    changes: FloatArray | None = None
