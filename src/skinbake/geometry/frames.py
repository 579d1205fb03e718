"""Tangent frames at rest: from TANGENT, or from NORMAL alone (Duff et al. 2017)."""

from __future__ import annotations

import numpy as np

from skinbake.geometry.skinned import Float32Array, Float64Array, FloatArray

TANGENT_FRAME = "tangent"
NORMAL_FRAME = "normal"


def unit_vectors(vectors: FloatArray) -> Float64Array:
    """Return vectors (V, 3) normalised, float64; one without a length becomes (0, 0, 1)."""
    wide = vectors.astype(np.float64)
    length = np.linalg.norm(wide, axis=1, keepdims=True)
    unit = np.divide(wide, length, out=np.tile([0.0, 0.0, 1.0], (len(wide), 1)), where=length > 0)
    return np.asarray(unit)


def unit_normals(normals: FloatArray) -> Float32Array:
    """Return NORMAL (V, 3) normalised, float32; a vector without a length becomes (0, 0, 1)."""
    return unit_vectors(normals).astype(np.float32)


def frame_from_normal(normals: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Return the tangents and bitangents (V, 3) float32 of an orthonormal frame around unit normals.

    Duff, Burgess, Christensen, Hery, Kensler, Liani, Villemin, *Building an Orthonormal Basis, Revisited*,
    JCGT 6(1), 2017. The sign of n.z is taken as +1 at 0 and −0 alike. The order of operations is part of
    the contract: in float32 every shader that keeps it gets the same bits.
    """
    x, y, z = normals.T
    one = np.float32(1.0)
    sign = np.where(z >= 0, one, -one)
    a = -one / (sign + z)
    b = (x * y) * a
    tangents = np.stack([one + sign * ((x * x) * a), sign * b, -sign * x], axis=1)
    bitangents = np.stack([b, sign + (y * y) * a, -y], axis=1)
    return tangents, bitangents


def frame_from_tangent(normals: Float32Array, tangents: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return t0 = TANGENT.xyz and b0 = (n0 × t0) · TANGENT.w, each (V, 3), of tangents (V, 4)."""
    tangent, handedness = tangents[:, :3], tangents[:, 3:]
    return tangent, np.cross(normals, tangent) * handedness


def tangent_deviation(normals: Float32Array, tangents: FloatArray) -> Float64Array:
    """Return how far t0 × b0 (turned by the handedness) leans from n0: (V,) degrees.

    180 where TANGENT has no length, or a handedness other than 1 or −1.
    """
    tangent, bitangent = frame_from_tangent(normals, tangents.astype(np.float64))
    handedness = tangents[:, 3].astype(np.float64)
    rebuilt = np.cross(tangent, bitangent) * handedness[:, None]
    sine = np.linalg.norm(np.cross(normals, rebuilt), axis=1)
    cosine = np.einsum("ij,ij->i", normals.astype(np.float64), rebuilt)
    degrees = np.degrees(np.arctan2(sine, cosine))
    usable = (np.abs(handedness) == 1.0) & (np.linalg.norm(rebuilt, axis=1) > 0)
    return np.where(usable, degrees, 180.0)
