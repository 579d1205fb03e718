"""Accurate normals of a baked file, vertex by vertex as a shader makes them, by the tests' own reader."""

from __future__ import annotations

import zlib
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from tests.support.baked_arrays import StoredPrimitive, baked_meshes_of
from tests.support.gltf_reading import GltfFile, read

Array = npt.NDArray[np.float64]

POSES, LARGEST = 4, 0.7
"""Poses, and the radians by which a joint turns at most about each axis."""


def accurate_normals(path: Path) -> list[Array]:
    """Return unit normals (P, V, 3) of each baked primitive in poses that follow from the joints' names."""
    file = read(path)
    return [
        np.stack([_normals(primitive, matrices) for matrices in _poses(file, mesh)])
        for mesh, primitives in baked_meshes_of(path).items()
        for primitive in primitives
    ]


def largest_angle(found: list[Array], wanted: list[Array]) -> float:
    """Return the largest angle in degrees between normals of any vertex and pose, 180 where one is lost."""
    largest = 0.0
    for first, second in zip(found, wanted, strict=True):
        sound = np.isfinite(second).all(axis=2)
        chord = np.linalg.norm(first[sound] - second[sound], axis=1)
        angles = np.degrees(2.0 * np.arcsin(np.clip(chord / 2.0, 0.0, 1.0)))
        largest = max(largest, float(np.nan_to_num(angles, nan=180.0).max(initial=0.0)))
    return largest


def _poses(file: GltfFile, mesh: int) -> list[Array]:
    """Return joint matrices (J, 4, 4): each joint turned about its own place in the rest pose."""
    node = next(n for n in file.content["nodes"] if n.get("mesh") == mesh and "skin" in n)
    skin = file.content["skins"][node["skin"]]
    binds = file.matrices(skin["inverseBindMatrices"])
    names = [file.content["nodes"][joint].get("name", "") for joint in skin["joints"]]
    result = []
    for pose in range(POSES):
        matrices = np.tile(np.eye(4), (len(names), 1, 1))
        for number, (name, bind) in enumerate(zip(names, binds, strict=True)):
            matrices[number] = np.linalg.inv(bind) @ _turn(name, pose) @ bind
        result.append(matrices)
    return result


@cache
def _turn(name: str, pose: int) -> Array:
    rng = np.random.default_rng([pose, zlib.crc32(name.encode())])
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec(rng.uniform(-LARGEST, LARGEST, 3)).as_matrix()
    return turn


def _normals(primitive: StoredPrimitive, matrices: Array) -> Array:
    """Algorithm 3 of the paper, weights divided by their sum; none where the frame needs a TANGENT."""
    arrays = primitive.arrays
    if primitive.frame == "tangent" and arrays.tangents is None:
        return np.full(arrays.positions.shape, np.nan)
    each = matrices[np.minimum(arrays.joints, len(matrices) - 1)]
    weights = arrays.weights / arrays.weights.sum(axis=1, keepdims=True)
    moved = np.einsum("vkij,vj->vki", each[..., :3, :3], arrays.positions) + each[..., :3, 3]
    blend = np.einsum("vk,vkij->vij", weights, each[..., :3, :3])
    corrections = moved[:, 1:] - moved[:, :1]
    frame = []
    for rest, slots in zip(primitive.rest_frame, (primitive.alpha, primitive.beta), strict=True):
        turned = np.einsum("vij,vj->vi", blend, rest.astype(np.float64))
        frame.append(turned + np.einsum("vs,vsi->vi", slots, corrections))
    normals = np.cross(frame[0], frame[1])
    if primitive.frame == "tangent" and arrays.tangents is not None:
        normals *= arrays.tangents[:, 3:]
    with np.errstate(invalid="ignore"):  # a normal of zeros is NaN
        return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))
