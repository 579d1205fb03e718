"""Joint matrices as dual quaternions and back (Kavan et al., *Skinning with dual quaternions*, 2007)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skinbake.errors import UnsupportedFeatureError
from skinbake.geometry.skinned import BoolArray, Float32Array, Float64Array, FloatArray, IntArray

RIGID_TOLERANCE = 1e-3
"""The largest entry of |MᵀM / s² − I| at which a joint matrix M still counts as rigid.

Ignoring a deviation of ε turns a normal by about ε radians. 1e-3 is about 0.06°, and gradients from a mesh
have errors of 0.2° and more. Rounding is far smaller: the float32 inverse bind matrices of sixteen public
models deviate by at most 1e-5.
"""


@dataclass(frozen=True, slots=True)
class RigidMotions:
    """Joint matrices as a uniform scale of each pose, then a rigid motion of each joint: p' = Q(scale · p).

    scale (P,) float64. dual_quaternions (P, J, 8) float64, real part then dual part, scalar first. Joints in
    ``not_rigid`` and joints that are not in use have the identity. not_rigid, 1-D, are the indices of joints
    in use that are not rigid up to the common scale in every pose, ascending. deviation (J,) float64 is the
    largest entry of |MᵀM / s² − I| of each joint over the poses: 0 for a joint that is not in use, infinite
    for a mirrored matrix or one that is not finite.
    """

    scale: Float64Array
    dual_quaternions: Float64Array
    not_rigid: IntArray
    deviation: Float64Array

    @property
    def is_rigid(self) -> bool:
        """Tell whether the dual quaternions describe every joint in use, so that DQS is valid."""
        return self.not_rigid.size == 0


def rigid_motions(
    joint_matrices: FloatArray, *, tolerance: float = RIGID_TOLERANCE, in_use: BoolArray | None = None
) -> RigidMotions:
    """Split joint matrices (P, J, 4, 4) into a uniform scale common to all joints and one rigid motion each.

    A dual quaternion carries no scale: the algorithms of Tarini et al. 2014, §4–5, assume rigid joints. The
    scale of a pose is the median of ∛det M over the joints, which a few deviating joints do not move. The
    rest of the matrix must be a rotation within ``tolerance`` (see RIGID_TOLERANCE). Nothing is removed
    silently: a joint with another scale, with shear, mirrored (det M ≤ 0) or not finite is listed in
    ``not_rigid`` and gets the identity. ``in_use`` (J,) restricts check and median to the joints that carry
    weight. The bottom row is assumed to be (0, 0, 0, 1). With no joint in use, or none with det M > 0, the
    scale is 1. Raises nothing.
    """
    matrices = np.asarray(joint_matrices, dtype=np.float64)
    poses, joints = matrices.shape[:2]
    used = np.ones(joints, dtype=np.bool_) if in_use is None else in_use
    scale, deviation = _scale_and_deviation(matrices, used)
    rigid = used & (deviation <= tolerance)
    # What is left of the matrix without the common scale; the identity where it is not a rotation.
    motions = np.tile(np.eye(4), (poses, joints, 1, 1))
    motions[:, rigid] = matrices[:, rigid]
    motions[:, rigid, :3, :3] /= scale[:, None, None, None]
    not_rigid = np.flatnonzero(used & ~rigid)
    return RigidMotions(scale, dual_quaternions_from_matrices(motions), not_rigid, deviation)


def not_rigid_joints(joint_matrices: FloatArray, in_use: BoolArray) -> IntArray:
    """Return ``rigid_motions(…).not_rigid`` in half the time, because no dual quaternion is made."""
    _, deviation = _scale_and_deviation(np.asarray(joint_matrices, dtype=np.float64), in_use)
    return np.flatnonzero(in_use & ~(deviation <= RIGID_TOLERANCE))


def _scale_and_deviation(matrices: Float64Array, used: BoolArray) -> tuple[Float64Array, Float64Array]:
    """Return the common scale (P,), and the largest deviation (J,) of each joint in use, 0 for the others."""
    finite = np.all(np.isfinite(matrices), axis=(2, 3))
    linear = np.where(finite[..., None, None], matrices[..., :3, :3], 0.0)
    # A mirrored matrix has a negative determinant, and one that is not finite 0: neither is rigid.
    determinant = np.linalg.det(linear)
    # The scale of most joints: the lower median of ∛det over positive determinants.
    scale = np.ones(len(determinant))
    for pose, values in enumerate(determinant[:, used]):
        candidates = np.sort(np.cbrt(values[values > 0]))
        if candidates.size:
            scale[pose] = candidates[(candidates.size - 1) // 2]
    # The largest entry of |MᵀM / s² − I|.
    unscaled = linear / scale[:, None, None, None]
    gram = np.swapaxes(unscaled, -1, -2) @ unscaled
    by_pose = np.where(determinant > 0, np.abs(gram - np.eye(3)).max(axis=(-1, -2)), np.inf)
    return scale, np.where(used, by_pose.max(axis=0, initial=0.0), 0.0)


def quaternions_from_rotations(rotations: FloatArray) -> Float64Array:
    """Convert rotation matrices (..., 3, 3) to unit quaternions (..., 4), scalar part first, float64.

    The entries of R give the whole matrix 4 q qᵀ (Shepperd 1978, *Quaternion from rotation matrix*). The row
    with the largest diagonal entry, which is at least 1, is 4 qᵢ q. Normalised, this row is q without
    cancellation at any angle. Its component qᵢ is positive; the other sign of q is the same rotation. A
    matrix that is a rotation only within a tolerance ε gives a quaternion within about ε.
    """
    r = np.asarray(rotations, dtype=np.float64)
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = (
        tuple(r[..., row, col] for col in range(3)) for row in range(3)
    )
    # The matrix 4 q qᵀ, row by row.
    outer = np.stack(
        [
            np.stack([1 + xx + yy + zz, zy - yz, xz - zx, yx - xy], axis=-1),
            np.stack([zy - yz, 1 + xx - yy - zz, xy + yx, xz + zx], axis=-1),
            np.stack([xz - zx, xy + yx, 1 - xx + yy - zz, yz + zy], axis=-1),
            np.stack([yx - xy, xz + zx, yz + zy, 1 - xx - yy + zz], axis=-1),
        ],
        axis=-2,
    )
    # Its longest row, at unit length.
    largest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    row = np.take_along_axis(outer, largest[..., None, None], axis=-2)[..., 0, :]
    unit: Float64Array = row / np.linalg.norm(row, axis=-1, keepdims=True)
    return unit


def dual_quaternions_from_matrices(matrices: FloatArray) -> Float64Array:
    """Convert rigid matrices (..., 4, 4) to unit dual quaternions (..., 8), float64.

    The real part r comes from the rotation, the dual part d = ½ (0, τ) r from the translation τ (Kavan et al.
    2007), in the length unit of the matrices. The linear part must be a rotation; ``rigid_motions`` checks
    it.
    """
    wide = np.asarray(matrices, dtype=np.float64)
    real = quaternions_from_rotations(wide[..., :3, :3])
    translation = wide[..., :3, 3]
    # The product (0, τ) r of two quaternions, by scalar and vector parts.
    scalar, vector = real[..., :1], real[..., 1:]
    dual_scalar = -np.sum(translation * vector, axis=-1, keepdims=True)
    dual_vector = scalar * translation + np.cross(translation, vector)
    return np.concatenate([real, 0.5 * dual_scalar, 0.5 * dual_vector], axis=-1)


FLATTENED = 1e-6
"""The least over the largest stretch of a joint, below which rounding decides whether it mirrors."""


def polar_quaternions(linear: FloatArray) -> Float64Array:
    """Return the rotations of matrices (..., 3, 3) as unit quaternions (..., 4), scalar first, float64.

    M = R S is the polar decomposition, with a rotation R and a symmetric S. If M mirrors, R is that of −M:
    then a mirror that all joints share turns all of them alike, and leaves their relative rotations. A matrix
    that flattens has an R too: it does not mirror. One that leaves a line or a point has many, of which none
    follows from it: it gets zeros. One that is not finite gets the identity.
    """
    matrices = np.asarray(linear, dtype=np.float64)
    finite = np.all(np.isfinite(matrices), axis=(-2, -1))[..., None, None]
    left, stretches, right = np.linalg.svd(np.where(finite, matrices, np.eye(3)))
    mirrors = np.linalg.det(left @ right) < 0
    flat = stretches[..., 2] <= FLATTENED * stretches[..., 0]
    # A joint that flattens does not mirror: its last axis may take either sign.
    signs = np.where((mirrors & ~flat)[..., None], -np.ones(3), np.ones(3))
    signs[..., 2] = np.where(mirrors, -1.0, 1.0)
    has_plane = (stretches[..., 1] > FLATTENED * stretches[..., 0])[..., None, None]
    rotations = np.where(finite & has_plane, (left * signs[..., None, :]) @ right, np.eye(3))
    return np.where(has_plane[..., 0], quaternions_from_rotations(rotations), 0.0)


def scaled_motions(joint_matrices: FloatArray) -> Float64Array:
    """Return joint matrices (..., 4, 4) as what ``skinning.dqs_scaled`` blends: (..., 4, 5) float64.

    Row k is component k of five quaternions, the scalar part first: of the columns of M times r, vectors with
    scalar part 0, and of r itself, that of ``polar_quaternions``. Any matrix will do: of one without a
    rotation, the columns are times 1, and r is 0.
    """
    matrices = np.asarray(joint_matrices, dtype=np.float64)
    turns = polar_quaternions(matrices[..., :3, :3])
    rotation = np.where(turns.any(axis=-1, keepdims=True), turns, [1.0, 0.0, 0.0, 0.0])
    # (0, v) r = (−v · r, r₀ v + v × r) for the four columns v.
    columns = np.swapaxes(matrices[..., :3, :], -1, -2)
    scalar, vector = rotation[..., None, :1], rotation[..., None, 1:]
    real = -np.sum(columns * vector, axis=-1, keepdims=True)
    products = np.concatenate([real, scalar * columns + np.cross(columns, vector)], axis=-1)
    return np.swapaxes(np.concatenate([products, turns[..., None, :]], axis=-2), -1, -2)


_X_Y_Z_W = (1, 2, 3, 0)


def joint_dual_quaternions(
    joint_matrices: FloatArray, *, in_use: BoolArray | None = None, tolerance: float = RIGID_TOLERANCE
) -> tuple[Float32Array, Float32Array]:
    """Return the uniform scale of each pose and the dual quaternion of each joint, float32.

    joint_matrices (..., J, 4, 4), floating, indexed [row, column], are the global transforms of the joints
    times their inverse bind matrices, of one pose or of several. The scale is (...). The dual quaternions are
    (..., J, 2, 4): real part, then dual part, each (x, y, z, w) with the scalar last. These are the columns
    of mat2x4 in the shaders. With them a shader skins scale · p, scale · t0 and scale · b0, because a dual
    quaternion carries no scale (Kavan et al. 2007). ``in_use`` (J,) restricts the check to joints that carry
    weight; the others get the identity. Raises UnsupportedFeatureError if a joint is not rigid up to the
    common scale, within ``tolerance``: use ``joint_scaled_motions`` then. Raises ValueError for another
    shape.
    """
    matrices = _checked(joint_matrices)
    *poses, joints = matrices.shape[:-2]
    motions = rigid_motions(matrices.reshape(-1, joints, 4, 4), tolerance=tolerance, in_use=in_use)
    if not motions.is_rigid:
        shown = ", ".join(str(joint) for joint in motions.not_rigid[:8])
        raise UnsupportedFeatureError(
            f"joints {shown}{(', …' if motions.not_rigid.size > 8 else '')} are not rigid, even "
            "with one scale for all joints: use joint_scaled_motions and shader --scaled-joints"
        )
    # Shaders take the scalar last.
    parts = motions.dual_quaternions.reshape(*poses, joints, 2, 4)[..., _X_Y_Z_W]
    return motions.scale.reshape(poses).astype(np.float32), parts.astype(np.float32)


def joint_scaled_motions(joint_matrices: FloatArray) -> Float32Array:
    """Return what shaders of ``--scaled-joints`` read for each joint: (..., J, 5, 4) float32.

    joint_matrices (..., J, 4, 4), floating, indexed [row, column], may scale, shear and mirror. The first
    four quaternions are the columns of the matrix times its rotation, the fifth is the rotation, of length 1,
    or 0 if the matrix has none (``scaled_motions``). Each is (x, y, z, w) with the scalar last. These are
    ``moved`` and ``turn`` of the shaders. Raises ValueError for another shape.
    """
    rows = scaled_motions(_checked(joint_matrices))
    return np.swapaxes(rows, -1, -2)[..., _X_Y_Z_W].astype(np.float32)


def _checked(joint_matrices: FloatArray) -> FloatArray:
    """Return joint matrices as an array. Raises ValueError unless it is (..., J, 4, 4)."""
    matrices = np.asarray(joint_matrices)
    if matrices.ndim < 3 or matrices.shape[-2:] != (4, 4):
        raise ValueError(f"joint matrices have shape {matrices.shape}, expected (..., J, 4, 4)")
    return matrices
