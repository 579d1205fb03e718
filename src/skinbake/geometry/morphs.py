"""Morph targets as sparse differences, and the rest frame that follows them (glTF 2.0, §3.7.2.2).

α and β stay exact under a morph if t and b are the images of t0 and b0 under the differential of the morph.
glTF itself has no differential, only a morphed normal and perhaps a morphed tangent. The frame follows these
by a rule, whose error docs/morphs.md measures. ``bake --morph-frames`` stores the differential of each target
along t0 and b0. It is linear in the weights: t = t0 + Σ w ∇Δp t0, and b likewise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from skinbake.geometry.frames import dot
from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray, IntArray

Kind: TypeAlias = Literal["positions", "normals", "tangents", "in_plane", "upward"]

COMPONENTS: dict[str, int] = {"in_plane": 4, "upward": 2}
"""The numbers of a vertex by kind, where they are not 3."""

STEEP = 0.2
"""|n0 · n| below which numbers in the plane of n0 tell too little of tangents: n is within 12° of that plane.

Of 0.05 to 0.35, this has the smallest error on the analytic surface of the tests.
"""

OPPOSITE = 1e-4
"""|n0 + n|² below which n counts as −n0: within 0.6° of it.

Nearer to −n0, a TANGENT that leans by 0.1° would stretch the frame.
"""

CANCELLED = 1e-4
"""|t|² / |t0|² below which targets have cancelled a tangent: the 1 % that is left is only its lean."""


class Differences(NamedTuple):
    """The differences of one target in one attribute: values (R, C) at vertices rows (R,), otherwise 0.

    The rows ascend.
    """

    rows: IntArray
    values: FloatArray

    @classmethod
    def of(cls, dense: FloatArray) -> Differences:
        """Keep the rows of (V, C) that are finite and not zero: most targets of a face move few vertices."""
        rows = np.flatnonzero(dense.any(axis=1) & np.isfinite(dense).all(axis=1))
        return cls(rows, dense[rows])


NO_DIFFERENCES = Differences(np.zeros(0, np.int64), np.zeros((0, 3), np.float32))


class MorphTarget(NamedTuple):
    """One morph target of a primitive: differences to POSITION, NORMAL and the xyz of TANGENT.

    in_plane (R, 4) are the derivatives of what it adds to POSITION: those along t0 by their parts along t0
    and b0, then those along b0. upward (R, 2) are the parts of both along n0.
    """

    positions: Differences = NO_DIFFERENCES
    normals: Differences = NO_DIFFERENCES
    tangents: Differences = NO_DIFFERENCES
    in_plane: Differences = NO_DIFFERENCES
    upward: Differences = NO_DIFFERENCES


class MorphTargets(NamedTuple):
    """The targets of a primitive, in mesh space.

    with_tangents says that the frame is from TANGENT and that targets morph it. Only then are their tangents
    read. numbers is how many numbers of the differential each target has: 6, or the 4 in the plane, or 0.
    """

    targets: tuple[MorphTarget, ...]
    with_tangents: bool = False
    numbers: int = 0

    def summed(self, kind: Kind, weights: FloatArray, count: int) -> Float64Array:
        """Return Σ weight · difference, (V, C) float64 for ``count`` vertices; each target has one weight."""
        total = np.zeros((count, COMPONENTS.get(kind, 3)))
        for weight, target in zip(weights.tolist(), self.targets, strict=True):
            differences: Differences = getattr(target, kind)
            if weight != 0.0 and len(differences.rows):
                # Without a look-up the rows of a target that moves all take half the time.
                rows = slice(None) if len(differences.rows) == count else differences.rows
                total[rows] += weight * differences.values.astype(np.float64)
        return total


def carried_by_normal(
    normals: FloatArray, vectors: Sequence[FloatArray], morphed: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return t0 and b0 after the smallest rotation that takes n0 to the morphed normal n.

    normals n0, vectors t0 and b0, and morphed n are each (V, 3) of one floating type. n0 and n have length 1.
    With s = n0 + n, a vector v at right angles to n0 becomes v − s (2 (n − n0) · v / s · s). This is v
    itself, bit for bit, if n = n0. The lean of v against n0 stays. If n is opposite to n0, any half turn is a
    smallest rotation. Then it is the half turn about t0, so that t × b still points along n.
    """
    s, d = normals + morphed, morphed - normals
    square = dot(s, s)
    opposite = square < OPPOSITE
    # 2 / s · s, and 0 where n0 and n are opposite: t0 stays there, and b0 turns over.
    factor = np.where(opposite, square.dtype.type(0), 2 / np.where(opposite, square.dtype.type(1), square))
    tangent, bitangent = (vector - s * (factor * dot(d, vector))[:, None] for vector in vectors)
    return tangent, np.where(opposite[:, None], -bitangent, bitangent)


def carried_by_tangent(
    normals: FloatArray,
    vectors: Sequence[FloatArray],
    morphed: FloatArray,
    tangents: FloatArray,
    handedness: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return t and b of a morphed TANGENT: t = T − n (n · T − n0 · t0), b = (n × t) · handedness.

    n0, t0 and b0 (vectors), n (length 1) and T = t0 + Σ w ΔT are (V, 3) of one floating type, handedness
    (V,). If several targets morph a tangent, it leans out of the surface; t leans as much as t0 does, and
    equals t0 bit for bit if nothing moves. Its length is that of the sum. If targets are isometric, this is
    the length of the image. If targets cancel t0 (CANCELLED), the frame is ``carried_by_normal``.
    """
    # T may lean from the plane across n only as much as t0 leans from that across n0.
    lean = dot(morphed, tangents) - dot(normals, vectors[0])
    tangent = tangents - morphed * lean[:, None]
    bitangent = np.cross(morphed, tangent) * handedness[:, None]
    # Where targets have cancelled the tangent, its rest has no direction.
    cancelled = dot(tangent, tangent) < tangent.dtype.type(CANCELLED) * dot(vectors[0], vectors[0])
    if not cancelled.any():
        return tangent, bitangent
    instead = carried_by_normal(normals, vectors, morphed)
    return (
        np.where(cancelled[:, None], instead[0], tangent),
        np.where(cancelled[:, None], instead[1], bitangent),
    )


def carried_in_space(
    normals: FloatArray, vectors: Sequence[FloatArray], in_plane: FloatArray, upward: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return t and b, the images of t0 and b0 (``vectors``) under the differential of the morph, exactly.

    n0, t0 and b0 are (V, 3) of one floating type, in_plane (V, 4) and upward (V, 2) are Σ w of the numbers of
    the targets.
    """
    t, b = _in_plane(vectors, in_plane)
    return t + normals * upward[:, :1], b + normals * upward[:, 1:]


def carried_in_plane(
    normals: FloatArray, vectors: Sequence[FloatArray], morphed: FloatArray, in_plane: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return t and b of the numbers in the plane alone: the part along n0 follows from the morphed normal n.

    t and b are at right angles to n (length 1). Arguments are as for ``carried_in_space``. Where n stands
    nearly at right angles to n0 (STEEP), or the numbers turn the surface to the other side, the frame is
    ``carried_by_normal``.
    """
    cosine = dot(normals, morphed)
    tt, tb, bt, bb = in_plane.T
    turned_over = cosine * ((1 + tt) * (1 + bb) - tb * bt) <= 0
    steep = (np.abs(cosine) < cosine.dtype.type(STEEP)) | turned_over
    safe = np.where(steep, cosine.dtype.type(1), cosine)
    t, b = (
        vector - normals * (dot(vector, morphed) / safe)[:, None] for vector in _in_plane(vectors, in_plane)
    )
    if not steep.any():
        return t, b
    instead = carried_by_normal(normals, vectors, morphed)
    return np.where(steep[:, None], instead[0], t), np.where(steep[:, None], instead[1], b)


def normals_of_frames(
    normals: FloatArray, frame: Sequence[FloatArray], handedness: FloatArray, moved: BoolArray
) -> FloatArray:
    """Return the unit normals (V, 3) of t and b, each (V, 3), of a handedness (V,).

    n0 stays where nothing has ``moved`` (V,), or t × b is 0.
    """
    tangents, bitangents = frame
    c: FloatArray = np.cross(tangents, bitangents) * handedness[:, None]
    return _units(c, normals, moved)[0]


def _in_plane(vectors: Sequence[FloatArray], in_plane: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return t0 and b0 plus what the numbers (V, 4) add to them in their plane."""
    t0, b0 = vectors
    t = t0 + t0 * in_plane[:, :1] + b0 * in_plane[:, 1:2]
    return t, b0 + t0 * in_plane[:, 2:3] + b0 * in_plane[:, 3:]


def morphed_normals(normals: FloatArray, differences: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return n0 + Σ w ΔN, each (V, 3), at length 1, and the length (V,) of the sum.

    If nothing is added or the sum is 0, they are n0 and 1.
    """
    return _units(normals + differences, normals, np.asarray(differences.any(axis=1)))


def _units(vectors: FloatArray, normals: FloatArray, moved: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return vectors (V, 3) at length 1, and their lengths (V,); n0 and 1 where they have none, or stay."""
    square = dot(vectors, vectors)
    sound = (square > 0) & np.isfinite(square) & moved
    root = np.sqrt(np.where(sound, square, square.dtype.type(1)))
    return np.where(sound[:, None], vectors / root[:, None], normals), root
