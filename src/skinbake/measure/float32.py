"""Whether accurate lighting holds in float32, as GPUs compute it, at the distances of a file's own poses.

Algorithm 3 takes differences of positions times α and β. Far from the origin, or where α and β are very
large, what float32 leaves of the differences is rounding. Doubles, in which all else is measured, hide that.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skinbake.geometry.skinned import Float64Array
from skinbake.skinning.components import dot
from skinbake.skinning.rest import Algorithm, RestPrimitive
from skinbake.skinning.run import Skinning
from skinbake.truth.areas import angles_between

TOLERANCE = 0.5
"""Degrees by which rounding may turn a normal."""

VERTICES, POSES = 1024, 8
"""The vertices that are replayed, of the largest α and β; the poses, evenly spread, and the farthest."""

SUSPECT = 0.01
"""The share of the tolerance that rounding must reach by an estimate, before anything is replayed."""

WELL_CONDITIONED, COLLAPSED = 1e-3, 1e-4
"""What is below has no normal: |t' × b'| over the area of the standard frame, and that over the largest."""


class Rounding(NamedTuple):
    """The largest angle in degrees by which float32 turns normals, and at how many vertices it is too large.

    is_steep tells whether it would be too large at the origin. distance is how far poses take it from there.
    """

    angle: float
    vertices: int
    is_steep: bool
    distance: float


def rounding_of(rest: RestPrimitive, joint_matrices: Float64Array) -> Rounding | None:
    """Replay a primitive in poses, joint matrices (P, J, 4, 4), in float32. None: all is within TOLERANCE."""
    if not len(joint_matrices) or not rest.alpha.size:
        return None
    slopes = np.maximum(np.abs(rest.alpha), np.abs(rest.beta)).sum(axis=1)
    moved, lengths = np.abs(joint_matrices[..., :3, 3]), np.linalg.norm(joint_matrices[..., :3, :3], axis=-1)
    reach = float(lengths.max() * np.abs(rest.positions).max(initial=0.0) + moved.max())
    steepest = np.degrees(np.finfo(np.float32).eps) * float(slopes.max(initial=0.0))
    if steepest * reach / float(lengths.min()) < SUSPECT * TOLERANCE:
        return None
    # Much is rounded far from the origin, and it shows where joints move little against one another.
    rows = np.argsort(-slopes, kind="stable")[:VERTICES]
    spread = np.linspace(0, len(moved) - 1, min(POSES, len(moved))).astype(np.int64)
    farthest = np.argsort(-moved.max(axis=(1, 2)), kind="stable")[:POSES]
    poses = np.array(sorted({*spread.tolist(), *farthest.tolist()}))
    every = slice(0, len(poses)), slice(0, len(rows))
    algorithms = Algorithm.LBS_STANDARD, Algorithm.LBS_ACCURATE
    (standard, exact), (_, rounded) = (
        Skinning.of(rest.rows(rows), joint_matrices[poses], dual_quaternions=False, dtype=dtype).run(
            algorithms, *every
        )
        for dtype in (np.float64, np.float32)
    )
    angles = angles_between(tuple(axis.astype(np.float64) for axis in rounded.normal), exact.normal)
    # Folds have no normal to compare, and parts that joints collapse are hidden.
    frame = dot(standard.tangent, standard.tangent) * dot(standard.bitangent, standard.bitangent)
    sound = dot(exact.normal, exact.normal) > WELL_CONDITIONED**2 * frame
    sound &= frame > COLLAPSED**2 * frame.max(initial=0.0)
    found = np.where(sound, np.nan_to_num(angles, nan=180.0), 0.0).max(axis=0, initial=0.0)
    if not found.max() > TOLERANCE:
        return None
    extent = float(np.ptp(rest.positions, axis=0).max())
    return Rounding(
        angle=float(found.max()),
        vertices=int(np.count_nonzero(found > TOLERANCE)),
        is_steep=bool(steepest * extent > SUSPECT * TOLERANCE),
        distance=float(max(np.abs(axis).max() for axis in exact.position)),
    )
