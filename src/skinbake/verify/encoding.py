"""What an encoding of α and β costs: the angle between the accurate normals with and without it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray
from skinbake.replay.algorithms import Algorithm
from skinbake.replay.run import replay
from skinbake.replay.surface import RestSurface
from skinbake.verify.lighting import BLOCK_SAMPLES
from skinbake.verify.metrics import angular_errors, summarise


@dataclass(frozen=True, slots=True)
class EncodedSurface:
    """One primitive in P poses: as stored, with alpha and beta (V, K − 1) from before they were stored.

    surface has the stored α and β; areas (V,) are rest areas, joint_matrices (P, J, 4, 4).
    """

    surface: RestSurface
    alpha: FloatArray
    beta: FloatArray
    areas: FloatArray
    joint_matrices: Float64Array


@dataclass(frozen=True, slots=True)
class AddedError:
    """The angle in degrees that an encoding adds, over poses and vertices, weighted by rest area."""

    mean: float
    p99: float


def added_error(surfaces: Iterable[EncodedSurface]) -> AddedError | None:
    """Measure the angle between algorithm 3's normals with stored and with unrounded α and β.

    All samples count together, each pose alike. A sample whose unrounded normal vanishes is left out, and one
    whose stored normal alone does counts as 180°; None where no sample is left.
    """
    angles, valid, weights = [], [], []
    for item in surfaces:
        found, exists = _angles(item)
        angles.append(found.ravel())
        valid.append(exists.ravel())
        weights.append(np.tile(item.areas, len(found)))
    if not angles:
        return None
    together, counted = np.concatenate(angles)[None], np.concatenate(valid)[None]
    summary = summarise(together, np.concatenate(weights), valid=counted)
    return None if summary is None else AddedError(summary.mean, summary.p99)


def _angles(item: EncodedSurface) -> tuple[FloatArray, BoolArray]:
    """Return the angles of one primitive (P, V) float32, and where the unrounded normal exists."""
    exact = replace(item.surface, alpha=item.alpha, beta=item.beta)
    poses, count = len(item.joint_matrices), len(item.areas)
    angles, valid = np.empty((poses, count), np.float32), np.empty((poses, count), np.bool_)
    size = max(1, BLOCK_SAMPLES // max(count, 1))
    for start in range(0, poses, size):
        block = slice(start, start + size)
        stored, unrounded = (
            replay(Algorithm.LBS_ACCURATE, surface, item.joint_matrices[block]).normals
            for surface in (item.surface, exact)
        )
        angles[block] = angular_errors(stored, unrounded)
        valid[block] = unrounded.any(axis=2) & np.isfinite(unrounded).all(axis=2)
    return angles, valid
