"""The weights of errors: the area around each vertex, in the rest pose of the skin that draws it.

Mesh space has its own units. Quantisation gives every mesh another unit, and its inverse bind matrices undo
that. After skinning into the rest pose, all meshes of a file are in one space, the space of its scene.
"""

from __future__ import annotations

import numpy as np

from skinbake.geometry.blocks import blocks
from skinbake.geometry.skinned import Float64Array, SkinnedPrimitive
from skinbake.gltf.animation import Skeleton, read_skeleton, rest_pose
from skinbake.gltf.document import Document
from skinbake.lighting.influences import normalised_weights
from skinbake.lighting.metrics import vertex_areas

_COLLAPSED = 1e-12
"""A surface is collapsed by its joints below this share of its largest squared coordinate."""


class RestAreas:
    """The areas around vertices in the rest pose of one skin."""

    def __init__(self, document: Document, skin: int) -> None:
        self._skeleton: Skeleton = read_skeleton(document, skin)
        with np.errstate(over="ignore", invalid="ignore"):  # such poses are refused elsewhere
            self._matrices: Float64Array = rest_pose(self._skeleton)[0]

    def of(self, primitive: SkinnedPrimitive) -> Float64Array:
        """Return the area around each vertex of a primitive, (V,) float64, squared unit of the scene.

        The rest pose may hide a surface with a scale of 0. Then the area comes from the inverse bind matrices
        of its joints alone, because the animation may show the surface.
        """
        joints = np.where(primitive.joints < len(self._matrices), primitive.joints, 0)
        weights = normalised_weights(primitive.weights, joints)
        positions = primitive.positions.astype(np.float64)
        posed = np.zeros_like(positions)
        with np.errstate(over="ignore", invalid="ignore"):  # past all numbers: the matrices alone decide
            for rows in blocks(len(posed)):
                for joint, weight in zip(joints[rows].T, weights[rows].T, strict=True):
                    matrices = self._matrices[joint, :3]
                    moved = np.einsum("vij,vj->vi", matrices[..., :3], positions[rows]) + matrices[..., 3]
                    posed[rows] += weight[:, None] * moved
            areas = vertex_areas(posed, primitive.triangles)
            in_use = np.zeros(len(posed), dtype=np.bool_)
            in_use[primitive.triangles] = True
            extent = float(np.abs(posed[in_use]).max(initial=0.0))
            if _COLLAPSED * extent * extent < areas.sum() < np.inf:
                return areas
            scales = np.abs(np.linalg.det(self._skeleton.inverse_bind[joints[:, 0], :3, :3])) ** (2.0 / 3.0)
            return np.asarray(vertex_areas(positions, primitive.triangles) * np.nan_to_num(scales, nan=1.0))
