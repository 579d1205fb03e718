"""Rigid joint matrices for a shader, and what its dual quaternions must be."""

from __future__ import annotations

import numpy as np

from skinbake.geometry.dual_quaternions import dual_quaternions_from_matrices, joint_scaled_motions
from tests.shaders.running import Single
from tests.shaders.scenes import shader_order
from tests.support.analytic import rotation_matrix
from tests.support.rigid_motions import matrices_from_dual_quaternions

REACH = 3.0
"""The longest translation."""


TOLERANCE = 1e-6


def joint_matrices() -> Single:
    """Rigid matrices, column by column, (R, 16): random ones, and turns of 0° and 180° round every axis."""
    rng = np.random.default_rng(0)
    axes = rng.normal(size=(2_000, 3))
    angles = rng.uniform(0, 2 * np.pi, len(axes))
    angles[:600:2], angles[1:600:2] = np.pi, 0.0
    axes[:6] = [[1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1], [1, 1, 1]]
    axes[600:700] = [1, -1, 0]
    angles[600:700] = np.pi * np.linspace(0.999, 1.001, 100)
    angles[[0, 2, 4, 6]] = np.pi
    # Nearly round one axis by nearly 180°: three of the four components are too small to divide by.
    nearly = slice(700, 1_000)
    axes[nearly] = np.repeat(np.eye(3), 100, axis=0) + rng.normal(scale=1e-3, size=(300, 3))
    angles[nearly] = np.pi + rng.normal(scale=1e-4, size=300)
    matrices = np.tile(np.eye(4), (len(axes), 1, 1))
    matrices[:, :3, :3] = [rotation_matrix(*pair) for pair in zip(axes, angles, strict=True)]
    directions = rng.normal(size=(len(axes), 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    matrices[:, :3, 3] = directions * rng.uniform(0, REACH, (len(axes), 1))
    return np.swapaxes(matrices, 1, 2).reshape(-1, 16).astype(np.float32)


def assert_like_the_library(found: Single, given: Single) -> None:
    """Up to the sign, which is the same motion; and the motion itself, given back as a matrix."""
    matrices = np.swapaxes(given.reshape(-1, 4, 4), 1, 2).astype(np.float64)
    wanted = shader_order(dual_quaternions_from_matrices(matrices)).astype(np.float64)
    sign = np.sign(np.sum(found[:, :4] * wanted[:, :4], axis=1, keepdims=True))
    apart = np.abs(sign * found - wanted)
    assert apart[:, :4].max() <= TOLERANCE
    assert apart[:, 4:].max() <= TOLERANCE * REACH
    scalars_first = found[:, [3, 0, 1, 2, 7, 4, 5, 6]]
    np.testing.assert_allclose(
        matrices_from_dual_quaternions(scalars_first), matrices, atol=4 * TOLERANCE * REACH
    )


def stretched_matrices() -> Single:
    """Matrices of any stretch, column by column, (R, 16): turned by any angle, every other mirrored.

    Some flatten, by a scale of 0 or nearly 0 along one axis or more, as clips do to hide a part.
    """
    given = joint_matrices().reshape(-1, 4, 4)
    rng = np.random.default_rng(1)
    turns = np.linalg.qr(rng.normal(size=(len(given), 3, 3))).Q
    scales = rng.uniform(0.2, 3.0, (len(given), 3))
    scales[100:200, 0], scales[200:300, 1], scales[300:400, 2] = 0.0, 1e-9, 1e-4
    scales[400:440, :2] = scales[440:460] = 0.0
    stretches = np.einsum("nij,nj,nkj->nik", turns, scales, turns)
    stretches[::2] *= -0.01
    # Columns are rows here: S acts first, so it stands on the left.
    given[:, :3, :3] = stretches @ given[:, :3, :3]
    return given.reshape(-1, 16)


def assert_like_scaled_motions(found: Single, given: Single) -> None:
    """found (R, 20), up to the sign."""
    matrices = np.swapaxes(given.reshape(-1, 4, 4), 1, 2)
    wanted = joint_scaled_motions(matrices).reshape(-1, 20).astype(np.float64)
    sign = np.where(np.sum(found[:, 16:] * wanted[:, 16:], axis=1, keepdims=True) < 0, -1.0, 1.0)
    apart = np.abs(sign * found - wanted)
    assert apart[:, 16:].max() <= 4 * TOLERANCE
    assert apart[:, :16].max() <= 4 * TOLERANCE * REACH
