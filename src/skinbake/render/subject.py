"""What is drawn: the arrays of one primitive as a skin draws it, and a camera around all of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from skinbake.geometry.skinned import BoolArray, Float32Array, Float64Array, FloatArray, IntArray
from skinbake.render.materials import Material
from skinbake.skinning.rest import RestPrimitive

ANGLE = np.radians(32.0)
YAW, PITCH = 0.45, 0.16
FILLED = 0.84


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """One primitive under one skin.

    triangles (T, 3). texcoords (V, 2) belong to each image of the material, by its use. colours (V, 4) are
    None if they are not drawn. is_mirrored: joints mirror the surface. tangents (V, 4) are TANGENT, to which
    normal maps belong, None without it. in_their_frame: α and β belong to it too. pose_set is the number of
    its joint matrices among those of a ``Shot``. is_rigid: one joint moves all of it.
    """

    rest: RestPrimitive
    triangles: IntArray
    pose_set: int
    material: Material = field(default_factory=Material)
    texcoords: Mapping[str, FloatArray] = field(default_factory=dict)
    colours: FloatArray | None = None
    is_mirrored: bool = False
    tangents: FloatArray | None = None
    in_their_frame: bool = False
    is_rigid: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A camera that looks at ``middle``, so far away that it shows all points (N, 3) at all its angles."""

    middle: Float64Array
    radius: float
    points: Float64Array
    yaws: tuple[float, ...]
    pitch: float = PITCH
    _distances: dict[float, float] = field(default_factory=dict, init=False)

    def axes(self, yaw: float) -> Float64Array:
        """Return the camera's right, up and backward directions (3, 3) for an angle around the vertical."""
        flat = np.cos(self.pitch)
        z = np.array([flat * np.sin(yaw), np.sin(self.pitch), flat * np.cos(yaw)])
        x = np.array([np.cos(yaw), 0.0, -np.sin(yaw)])
        return np.stack([x, np.cross(z, x), z])

    def distance(self, aspect: float) -> float:
        """Return the distance from the middle at which the points fill the picture but for a margin."""
        if aspect not in self._distances:
            slope = FILLED * np.tan(ANGLE / 2)
            found = 0.0
            for yaw in self.yaws:
                x, y, z = self.axes(yaw) @ (self.points - self.middle).T
                found = max(found, float((z + np.maximum(np.abs(x) / aspect, np.abs(y)) / slope).max()))
            self._distances[aspect] = found or 1.0
        return self._distances[aspect]

    def eye(self, yaw: float, aspect: float) -> Float64Array:
        """Return the camera's place."""
        return np.asarray(self.middle + self.distance(aspect) * self.axes(yaw)[2])

    def projected(self, yaw: float, aspect: float) -> Float64Array:
        """Return the matrix (4, 4) from the scene to the screen, with depths from 0 to 1."""
        distance = self.distance(aspect)
        view = np.eye(4)
        view[:3, :3] = self.axes(yaw)
        view[:3, 3] = -view[:3, :3] @ self.middle - [0.0, 0.0, distance]
        near, far = max(distance - 2 * self.radius, distance / 200), distance + 2 * self.radius
        f = 1.0 / np.tan(ANGLE / 2)
        lens = np.zeros((4, 4))
        lens[0, 0], lens[1, 1] = f / aspect, f
        lens[2, 2:] = far / (near - far), near * far / (near - far)
        lens[3, 2] = -1.0
        return np.asarray(lens @ view)


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """One picture: joint matrices (J, 4, 4) of each pose set, an angle of the camera.

    errors holds, for each lighting, the errors (V,) in degrees of each subject, and where they are known.
    morphed holds, for each lighting, subjects by their number as their morph targets make them, before
    skinning.
    """

    matrices: tuple[Float64Array, ...]
    yaw: float = YAW
    errors: Mapping[str, tuple[tuple[Float32Array, BoolArray], ...]] = field(default_factory=dict)
    morphed: Mapping[str, Mapping[int, RestPrimitive]] = field(default_factory=dict)
