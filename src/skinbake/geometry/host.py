"""Joint matrices as a renderer passes them to the shaders of ``skinbake shader --method dqs``."""

from __future__ import annotations

import numpy as np

from skinbake.errors import UnsupportedFeatureError
from skinbake.geometry.dual_quaternions import RIGID_TOLERANCE, rigid_motions
from skinbake.geometry.skinned import BoolArray, Float32Array, FloatArray

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
    common scale, within ``tolerance``: use linear blend skinning then. Raises ValueError for another shape.
    """
    matrices = np.asarray(joint_matrices)
    if matrices.ndim < 3 or matrices.shape[-2:] != (4, 4):
        raise ValueError(f"joint matrices have shape {matrices.shape}, expected (..., J, 4, 4)")
    *poses, joints = matrices.shape[:-2]
    motions = rigid_motions(matrices.reshape(-1, joints, 4, 4), tolerance=tolerance, in_use=in_use)
    if not motions.is_rigid:
        shown = ", ".join(str(joint) for joint in motions.not_rigid[:8])
        raise UnsupportedFeatureError(
            f"joints {shown}{(', …' if motions.not_rigid.size > 8 else '')} are not rigid, even "
            "with one scale for all joints: use linear blend skinning for them"
        )
    parts = motions.dual_quaternions.reshape(*poses, joints, 2, 4)[..., _X_Y_Z_W]
    return motions.scale.reshape(poses).astype(np.float32), parts.astype(np.float32)
