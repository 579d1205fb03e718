"""A coarse tube with a rig, for the fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skinbake.choices import FrameChoice
from skinbake.geometry.poses import rotation_matrices
from skinbake.geometry.rig import NO_PARENT, Rig
from skinbake.geometry.skinned import Float64Array, IntArray, SkinnedPrimitive
from tests.support.baking import bake_settings

SETTINGS = bake_settings(frame=FrameChoice.NORMAL)


BRANCHES = (NO_PARENT, 0, 1, 1, 0, 4)

CHAIN = (NO_PARENT, 0, 1, 2, 3, 4, 5)


def tube(
    rings: int = 9, around: int = 8, seed: int = 3, slots: int = 4, parents: Sequence[int] = BRANCHES[:4]
) -> tuple[SkinnedPrimitive, Rig]:
    """Return a coarse tube along z with uneven radii and random smooth weights, and a rig."""
    joints = len(parents)
    random = np.random.default_rng(seed)
    angle = np.tile(np.arange(around) / around * 2.0 * np.pi, rings)
    height = np.repeat(np.linspace(-2.0, 2.0, rings), around)
    radius = 1.0 + 0.2 * np.cos(3.0 * angle + height) + 0.05 * random.normal(size=len(angle))
    positions = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)
    ring, place = np.divmod(np.arange((rings - 1) * around), around)
    here, beside = ring * around + place, ring * around + (place + 1) % around
    triangles = np.concatenate(
        [
            np.stack([here, beside, here + around], axis=1),
            np.stack([beside, beside + around, here + around], axis=1),
        ]
    )
    logits = 2.5 * np.cos(
        np.arange(joints) + 0.9 * height[:, None] + 0.4 * random.normal(size=(len(angle), joints))
    )
    weights = np.exp(logits) / np.exp(logits).sum(axis=1, keepdims=True)
    order = np.argsort(-weights, axis=1)[:, :slots]
    kept = np.take_along_axis(weights, order, axis=1)
    primitive = SkinnedPrimitive(
        positions=positions.astype(np.float32),
        normals=weighted_normals(positions, triangles, corner_angles(positions, triangles)).astype(
            np.float32
        ),
        tangents=None,
        joints=order.astype(np.uint16),
        weights=kept / kept.sum(axis=1, keepdims=True),
        triangles=triangles.astype(np.uint32),
    )
    return primitive, Rig(np.array(parents, dtype=np.int32), random.normal(scale=1.5, size=(joints, 3)))


def bent(rig: Rig, angle: float, seed: int = 5) -> Rig:
    """Return a rig with a pose that has every joint turned by an angle about a random axis through it."""
    random = np.random.default_rng(seed)
    matrices = np.tile(np.eye(4), (len(rig.parents), 1, 1))
    for joint, parent in enumerate(rig.parents):
        axis = random.normal(size=3)
        half = 0.5 * angle
        turned = rotation_matrices(np.append(np.cos(half), np.sin(half) * axis / np.linalg.norm(axis)))
        matrices[joint, :3, :3] = turned
        matrices[joint, :3, 3] = rig.pivots[joint] - turned @ rig.pivots[joint]
        if parent != NO_PARENT:
            matrices[joint] = matrices[parent] @ matrices[joint]
    return replace(
        rig, poses=np.concatenate([rig.poses.reshape(-1, *matrices[:, :3].shape), matrices[None, :, :3]])
    )


def steepest_slopes(primitive: SkinnedPrimitive) -> Float64Array:
    """Return the largest change of a joint's weight along an edge from each vertex, over its length (V,)."""
    count = len(primitive.positions)
    weights = np.zeros((count, int(primitive.joints.max()) + 1))
    np.add.at(weights, (np.arange(count)[:, None], primitive.joints), primitive.weights)
    weights /= weights.sum(axis=1, keepdims=True)
    found = np.zeros(count)
    for triangle in primitive.triangles.astype(int):
        for here in triangle:
            for there in triangle[triangle != here]:
                length = np.linalg.norm(primitive.positions[there].astype(float) - primitive.positions[here])
                found[here] = max(found[here], np.abs(weights[there] - weights[here]).max() / length)
    return found


def corner_angles(points: Float64Array, triangles: IntArray) -> Float64Array:
    angles = np.empty(triangles.shape)
    for corner in range(3):
        origin, one, other = np.roll(triangles, -corner, axis=1).T
        e1, e2 = points[one] - points[origin], points[other] - points[origin]
        cosine = (e1 * e2).sum(axis=1) / np.linalg.norm(e1, axis=1) / np.linalg.norm(e2, axis=1)
        angles[:, corner] = np.arccos(cosine)
    return angles


def weighted_normals(points: Float64Array, triangles: IntArray, angles: Float64Array) -> Float64Array:
    """Return the sums of the unit normals of the triangles at each vertex, with given weights (T, 3)."""
    sums = np.zeros_like(points)
    p, q, r = points[triangles].transpose(1, 0, 2)
    normal = np.cross(q - p, r - p)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    for corner in range(3):
        np.add.at(sums, triangles[:, corner], normal * angles[:, corner : corner + 1])
    return sums
