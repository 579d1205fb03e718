"""What a replay reads of a baked primitive as the file stores it."""

from __future__ import annotations

import numpy as np

from skinbake.geometry.frames import unit_normals
from skinbake.lighting.baked_views import BakedView
from skinbake.lighting.influences import normalised_weights
from skinbake.skinning.rest import RestPrimitive


def rest_primitive(view: BakedView) -> RestPrimitive:
    """Return the data of a baked primitive that a replay reads. Joints past the skin's become 0.

    float32 data of the file stays float32. A replay computes in float64, and a million vertices fit in
    memory.
    """
    joints = np.where(view.now.joints < view.source.joint_count, view.now.joints, 0)
    return RestPrimitive(
        positions=view.now.positions.astype(np.float64),
        normals=unit_normals(view.now.normals),
        tangents=view.tangents,
        bitangents=view.bitangents,
        joints=joints,
        weights=normalised_weights(view.now.weights, joints),
        alpha=view.alpha,
        beta=view.beta,
    )
