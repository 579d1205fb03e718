"""Joints that scale, shear or mirror, and dual quaternions of them by another definition.

The oracle makes a dual quaternion of each joint at each vertex: the joint's rotation, which the tests choose
themselves, and the translation that takes the vertex to where the joint's matrix does. It blends and applies
them by Hamilton products, as Kavan et al. 2007 do.
"""

from __future__ import annotations

import numpy as np

from tests.support import analytic
from tests.support.analytic import Array

STRETCHES = ("scaled", "sheared", "mirrored", "one mirrored")


def rotation_of(quaternion: Array) -> Array:
    """The matrix (3, 3) of a unit quaternion, column by column."""
    turned = analytic.hamilton(
        analytic.hamilton(quaternion, analytic.pure(np.eye(3))), analytic.conjugate(quaternion)
    )
    return turned[:, 1:].T


def stretched_joints(bend: str, stretch: str) -> tuple[Array, Array]:
    """Joint matrices (3, 4, 4) that scale, shear or mirror after a bend, and their rotations (3, 4)."""
    rng = np.random.default_rng(3)
    quaternions = analytic.joint_dual_quaternions(bend)[:, :4]
    matrices = analytic.joint_matrices(bend)
    for number, quaternion in enumerate(quaternions):
        scale = np.diag(rng.uniform(0.6, 1.6, 3))
        if stretch != "scaled":
            turn = np.linalg.qr(rng.normal(size=(3, 3))).Q
            scale = turn @ scale @ turn.T
        sign = -1.0 if stretch == "mirrored" or (stretch == "one mirrored" and number == 1) else 1.0
        matrices[number, :3, :3] = sign * rotation_of(quaternion) @ scale
    return matrices, quaternions


def blend_about_the_vertex(matrices: Array, quaternions: Array, pivots: np.ndarray) -> analytic.Skinning:
    """Skinning by joints that scale about each vertex; pivots (V,) is each vertex's slot 0."""

    def skinned(points: Array, weight: Array) -> Array:
        cosines = quaternions @ quaternions.T
        signs = np.where(cosines[pivots] < 0, -1.0, 1.0)
        real, dual = np.zeros((2, len(points), 4))
        for joint, (matrix, quaternion) in enumerate(zip(matrices, quaternions, strict=True)):
            moved = points @ matrix[:3, :3].T + matrix[:3, 3]
            shift = analytic.pure(moved - points @ rotation_of(quaternion).T)
            own = (weight * signs)[:, joint, None]
            real += own * quaternion
            dual += own * 0.5 * analytic.hamilton(shift, quaternion)
        length = np.linalg.norm(real, axis=1, keepdims=True)
        real, dual = real / length, dual / length
        turned = analytic.hamilton(analytic.hamilton(real, analytic.pure(points)), analytic.conjugate(real))
        found: Array = (turned + 2 * analytic.hamilton(dual, analytic.conjugate(real)))[:, 1:]
        return found

    return skinned
