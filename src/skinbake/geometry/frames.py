"""Tangent frames at rest: from TANGENT, or from NORMAL alone (Duff et al. 2017)."""

from __future__ import annotations

import numpy as np

from skinbake.geometry.skinned import BoolArray, Float32Array, Float64Array, FloatArray, blocks

ALONG = 1e-3
"""The part of a tangent in the surface, relative to its length, below which its direction is rounding."""

HUGE = 1e30
"""The length from which on a tangent is too long: float32 cannot hold what is made of it."""

TINY_SQUARE = 1e-280
"""A squared length below which underflow may have taken digits. No float32 vector has one, except zero."""

NO_DIRECTION = 180.0
"""The deviation in degrees of a tangent without a direction or a handedness. Any other is at most 90."""


def unit_vectors(vectors: FloatArray) -> Float64Array:
    """Return vectors (V, 3) normalised, float64; a vector without a direction becomes (0, 0, 1)."""
    with np.errstate(invalid="ignore"):  # a signalling NaN
        wide = vectors.astype(np.float64)
    sound = has_direction(vectors)
    # Squares of very long or short vectors overflow or lose digits: these are scaled first.
    square = _squared_lengths(wide)
    extreme = sound & ~((square >= TINY_SQUARE) & np.isfinite(square))
    if extreme.any():
        wide[extreme] /= np.abs(wide[extreme]).max(axis=1, keepdims=True)
        square[extreme] = _squared_lengths(wide[extreme])
    length, sound = np.sqrt(square)[:, None], sound[:, None]
    if sound.all():
        return np.asarray(wide / length)
    return np.where(sound, wide / np.where(sound, length, 1.0), [0.0, 0.0, 1.0])


def _squared_lengths(vectors: Float64Array) -> Float64Array:
    """Return the squared lengths (V,) of vectors (V, 3); inf if a square is too large for a float."""
    x, y, z = vectors.T
    with np.errstate(over="ignore"):
        return np.asarray(x * x + y * y + z * z)


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a · b (…) of (…, 3) arrays, summed in the order x, y, z as in the shaders.

    In which order np.einsum adds, and whether it fuses operations, depends on how numpy was built.
    """
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def parts_along(vectors: Float64Array, a: Float64Array, b: Float64Array) -> Float64Array:
    """Return the parts (C, 2) of vectors along a and b, all (C, 3). NaN where a × b is 0.

    With a part along a × b, the vector is their sum.
    """
    across = np.cross(a, b)
    found = np.empty((len(vectors), 2))
    found[:, 0] = dot(np.cross(vectors, b), across)
    found[:, 1] = dot(np.cross(a, vectors), across)
    found /= np.square(np.linalg.norm(across, axis=1, keepdims=True))
    return found


def has_direction(vectors: FloatArray) -> BoolArray:
    """Tell which vectors (V, 3) have finite components and a length other than zero."""
    x, y, z = vectors.T
    finite = np.isfinite(x) & np.isfinite(y) & np.isfinite(z)
    return np.asarray(finite & ((x != 0) | (y != 0) | (z != 0)))


def without_direction(vectors: FloatArray) -> int:
    """Return the number of vectors (V, 3) without a direction."""
    return sum(int(np.count_nonzero(~has_direction(vectors[rows]))) for rows in blocks(len(vectors)))


def unit_normals(normals: FloatArray) -> Float32Array:
    """Return NORMAL (V, 3) normalised, float32; a normal without a direction becomes (0, 0, 1)."""
    return unit_vectors(normals).astype(np.float32)


def frame_from_normal(normals: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Return the tangents and bitangents (V, 3) float32 of an orthonormal frame around unit normals.

    Duff, Burgess, Christensen, Hery, Kensler, Liani, Villemin, *Building an Orthonormal Basis, Revisited*,
    JCGT 6(1), 2017. The sign of n.z counts as +1 at 0 and at −0. The order of operations is part of the
    contract: every shader that keeps it in float32 gets the same bits.
    """
    x, y, z = normals.T
    # The paper's listing, with every operation in float32.
    one = np.float32(1.0)
    sign = np.where(z >= 0, one, -one)
    a = -one / (sign + z)
    b = (x * y) * a
    tangents = np.stack([one + sign * ((x * x) * a), sign * b, -sign * x], axis=1)
    bitangents = np.stack([b, sign + (y * y) * a, -y], axis=1)
    return tangents, bitangents


def frame_from_tangent(normals: Float32Array, tangents: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return t0 = TANGENT.xyz and b0 = (n0 × t0) · TANGENT.w, each (V, 3), of tangents (V, 4).

    A tangent that is not finite counts as zero, so nothing is baked along it.
    """
    sound = np.where(np.isfinite(tangents).all(axis=1, keepdims=True), tangents, tangents.dtype.type(0))
    tangent, handedness = sound[:, :3], sound[:, 3:]
    with np.errstate(over="ignore", invalid="ignore"):  # a huge TANGENT; the result is checked
        return tangent, np.cross(normals, tangent) * handedness


def straightened(normals: Float32Array, tangents: FloatArray) -> Float32Array:
    """Return tangents (V, 4) made orthogonal to unit normals (V, 3): t − n (n · t) with the length of t.

    A tangent without a length, too long for float32, or along the normal, becomes that of
    ``frame_from_normal``. A handedness other than 1 and −1 becomes 1.
    """
    with np.errstate(invalid="ignore", over="ignore"):  # a signalling NaN, or a huge TANGENT
        wide, upward = tangents.astype(np.float64), normals.astype(np.float64)
        tangent = wide[:, :3]
        # The part across the normal, at the length of the whole.
        flat = tangent - upward * dot(upward, tangent)[:, None]
        before, after = np.linalg.norm(tangent, axis=1), np.linalg.norm(flat, axis=1)
        usable = (before < HUGE) & (after > ALONG * before)
        scaled = flat * (before / np.where(usable, after, 1.0))[:, None]
        # A tangent without such a part is made from the normal.
        found = np.where(usable[:, None], scaled, frame_from_normal(normals)[0])
        handedness = np.where(np.abs(wide[:, 3:]) == 1.0, wide[:, 3:], 1.0)
    return np.concatenate([found, handedness], axis=1).astype(np.float32)


def tangent_deviation(normals: Float32Array, tangents: FloatArray) -> Float64Array:
    """Return the angle between t0 × b0 (turned by the handedness) and n0: (V,) degrees.

    It is NO_DIRECTION if TANGENT has no finite length, or a handedness other than 1 or −1.
    """
    with np.errstate(invalid="ignore", over="ignore"):  # a signalling NaN, or a huge TANGENT
        wide = tangents.astype(np.float64)
        tangent, bitangent = frame_from_tangent(normals, wide)
        handedness = np.nan_to_num(wide[:, 3])
        # The normal that TANGENT stands for, and its angle to NORMAL.
        rebuilt = np.cross(tangent, bitangent) * handedness[:, None]
        sine = np.linalg.norm(np.cross(normals, rebuilt), axis=1)
        cosine = dot(normals.astype(np.float64), rebuilt)
        degrees = np.degrees(np.arctan2(sine, cosine))
        usable = (np.abs(handedness) == 1.0) & (np.linalg.norm(rebuilt, axis=1) > 0)
    return np.where(usable & np.isfinite(degrees), degrees, NO_DIRECTION)
