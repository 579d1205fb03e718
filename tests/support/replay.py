"""Skin a whole surface in many poses by one algorithm: the oracle for shaders and for measured lighting."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skinbake.choices import Baseline
from skinbake.geometry.dual_quaternions import RIGID_TOLERANCE
from skinbake.geometry.skinned import FloatArray
from skinbake.skinning.blended import BlendedSkinning
from skinbake.skinning.components import PosedVertex
from skinbake.skinning.rest import Algorithm, Options, RestPrimitive
from skinbake.skinning.run import Skinning

BLOCK_BYTES = 65536
"""Bytes of one component of a block, some sixty of which are alive at a time.

Measured at 10,000 vertices × 100 poses: flat from 32 to 256 KiB, half as long again at 16, where the
interpreter begins to show.
"""

BLOCK_POSES = 64
"""Poses of a block, where there are as many: gathering a joint's motion then copies a row of them."""


@dataclass(frozen=True, slots=True)
class SkinnedSurface:
    """The surface in P poses: positions, normals, tangents, bitangents, each (P, V, 3).

    Normals are *not* unit, and neither are the tangents, which are images under the differential of skinning.
    cotangents and cobitangents, likewise, are there if the replay was asked for a normal map.
    """

    positions: FloatArray
    normals: FloatArray
    tangents: FloatArray
    bitangents: FloatArray
    cotangents: FloatArray | None = None
    cobitangents: FloatArray | None = None


def replay(
    algorithm: Algorithm,
    rest: RestPrimitive,
    joint_matrices: FloatArray,
    *,
    dtype: npt.DTypeLike = np.float64,
    cap: float | None = None,
    baseline: Baseline = Baseline.BLENDED,
    tolerance: float = RIGID_TOLERANCE,
    normal_map: bool = False,
) -> SkinnedSurface:
    """Skin a rest surface by joint matrices (P, J, 4, 4), with the frame that the algorithm gives it.

    Every number is converted to ``dtype`` (float32 or float64) first, and so is the result, in mesh space
    moved by the joint matrices. Normals are not unit. ``cap`` limits the length of the correction of t' and
    of b' to cap × |T t| and cap × |T b| in algorithms 3, 5 and 6 (PUBLISHED_CAP is the published figure; None
    is off); ``baseline`` chooses the normal of algorithm 1. Both are ignored by the algorithms that they do
    not concern. ``normal_map`` asks for cotangents.

    Algorithms 4–6 apply the scale common to all joints of a pose to p, t and b first. If a joint in use is
    not rigid beyond it, within ``tolerance``, they take the form of ``dqs_scaled``. A vertex without weight
    collapses to the origin, but under dual quaternions of rigid joints it stays in place.
    """
    skinning = Skinning.of(
        rest,
        joint_matrices,
        dual_quaternions=algorithm.uses_dual_quaternions,
        dtype=dtype,
        options=Options(cap, baseline, normal_map),
        tolerance=tolerance,
    )
    shape = len(joint_matrices), len(rest.positions)
    return _posed(skinning, algorithm, shape, dtype, normal_map=normal_map)


def blended_replay(
    algorithm: Algorithm,
    rest: RestPrimitive,
    joint_matrices: FloatArray,
    *,
    dtype: npt.DTypeLike = np.float64,
    cap: float | None = None,
    baseline: Baseline = Baseline.BLENDED,
) -> SkinnedSurface:
    """Skin a rest surface between an algorithm of dual quaternions and its like, by its blend weights."""
    both = (
        Skinning.of(rest, joint_matrices, dual_quaternions=dual, dtype=dtype, options=Options(cap, baseline))
        for dual in (False, True)
    )
    shape = len(joint_matrices), len(rest.positions)
    return _posed(BlendedSkinning(rest, *both), algorithm, shape, dtype, normal_map=False)


def _posed(
    skinning: Skinning | BlendedSkinning,
    algorithm: Algorithm,
    shape: tuple[int, int],
    dtype: npt.DTypeLike,
    *,
    normal_map: bool,
) -> SkinnedSurface:
    """Return all poses and vertices (P, V), block by block."""
    poses, count = shape
    posed = [np.empty((poses, count, 3), dtype=dtype) for _ in range(6 if normal_map else 4)]
    for pose, part in _blocks(poses, count, np.dtype(dtype).itemsize):
        (vertex,) = skinning.run((algorithm,), pose, part)
        _write(posed, pose, part, vertex)
    return SkinnedSurface(*posed)


def _blocks(poses: int, vertices: int, itemsize: int) -> Iterator[tuple[slice, slice]]:
    """Cut poses × vertices into blocks of one size: some poses of some vertices, more of a small mesh."""
    size = BLOCK_BYTES // itemsize
    pose_step = max(1, min(poses, max(BLOCK_POSES, size // max(1, vertices))))
    vertex_step = max(1, size // pose_step)
    for vertex in range(0, vertices, vertex_step):
        for pose in range(0, poses, pose_step):
            yield slice(pose, pose + pose_step), slice(vertex, vertex + vertex_step)


def _write(posed: Sequence[FloatArray], pose: slice, part: slice, vertex: PosedVertex) -> None:
    """Write the components of a block into arrays (P, V, 3)."""
    vectors = [vertex.position, vertex.normal, vertex.tangent, vertex.bitangent]
    vectors += [vertex.cotangent, vertex.cobitangent] if vertex.cotangent else []
    for array, vector in zip(posed, vectors, strict=True):
        for axis, component in enumerate(vector):
            array[pose, part, axis] = component
