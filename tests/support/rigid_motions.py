"""Rigid matrices from dual quaternions: the way back, for tests of the way there."""

from __future__ import annotations

import numpy as np

from skinbake.geometry.skinned import Float64Array, FloatArray


def matrices_from_dual_quaternions(dual_quaternions: FloatArray) -> Float64Array:
    """Convert dual quaternions (..., 8) of any length but zero to rigid matrices (..., 4, 4), float64.

    p' = R p + 2 vec(d r*) / |r|² with R the rotation of r / |r| (Kavan et al. 2007); a part of d along
    r moves nothing. The inverse of ``dual_quaternions_from_matrices``. A real part of length zero gives NaN.
    """
    wide = np.asarray(dual_quaternions, dtype=np.float64)
    wide = wide / np.linalg.norm(wide[..., :4], axis=-1, keepdims=True)
    scalar, vector = wide[..., 0, None, None], wide[..., 1:4]
    dual_scalar, dual_vector = wide[..., 4, None], wide[..., 5:8]
    cross_matrix = np.cross(np.eye(3), vector[..., None, :])
    matrices = np.zeros((*wide.shape[:-1], 4, 4))
    # Rodrigues' formula in half angles: R = I + 2 r0 [r]× + 2 [r]×².
    matrices[..., :3, :3] = np.eye(3) + 2 * (scalar * cross_matrix + cross_matrix @ cross_matrix)
    translation = wide[..., :1] * dual_vector - dual_scalar * vector + np.cross(vector, dual_vector)
    matrices[..., :3, 3] = 2 * translation
    matrices[..., 3, 3] = 1
    return matrices
