"""A bake that is in no file yet, as a replay reads it. It serves to measure costs of encodings and limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skinbake.geometry import frames
from skinbake.geometry.skinned import BakedPrimitive, SkinnedPrimitive
from skinbake.gltf.primitives import PrimitiveSource
from skinbake.gradients.tangents import frame_vectors
from skinbake.lighting.influences import normalised_weights
from skinbake.skinning.rest import RestPrimitive


@dataclass(frozen=True, slots=True)
class UnwrittenBake:
    """One primitive, the arrays that were baked, and the result of the bake."""

    source: PrimitiveSource
    primitive: SkinnedPrimitive
    baked: BakedPrimitive

    def rest_primitive(self) -> RestPrimitive:
        """Return it as float64. Adopted joints have weight 0, and joints past the skin become 0."""
        primitive, baked = self.primitive, self.baked
        tangents, bitangents = frame_vectors(primitive, baked.frame)
        named = np.where(baked.adopted_joints >= 0, baked.adopted_joints, primitive.joints)
        joints = np.where(named < self.source.joint_count, named, 0)
        return RestPrimitive(
            positions=primitive.positions.astype(np.float64),
            normals=frames.unit_normals(primitive.normals).astype(np.float64),
            tangents=tangents.astype(np.float64),
            bitangents=bitangents.astype(np.float64),
            joints=joints,
            weights=normalised_weights(primitive.weights, joints),
            alpha=baked.alpha.astype(np.float64),
            beta=baked.beta.astype(np.float64),
        )
