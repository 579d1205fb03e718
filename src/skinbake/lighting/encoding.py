"""The cost of an encoding of α and β: the angle between the accurate normals with and without it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from skinbake.geometry.skinned import Float64Array, FloatArray
from skinbake.lighting.blending import blended_blocks
from skinbake.lighting.metrics import angles_between, total_area
from skinbake.lighting.tally import ErrorTally
from skinbake.skinning.algorithms import Algorithm
from skinbake.skinning.components import dot
from skinbake.skinning.rest import RestPrimitive


@dataclass(frozen=True, slots=True)
class EncodedPrimitive:
    """One primitive in P poses with stored α and β, and with alpha and beta (V, K − 1) before storage.

    primitive has the stored α and β. areas (V,) are rest areas. joint_matrices are (P, J, 4, 4).
    """

    primitive: RestPrimitive
    alpha: FloatArray
    beta: FloatArray
    areas: FloatArray
    joint_matrices: Float64Array


@dataclass(frozen=True, slots=True)
class AddedError:
    """The angle in degrees that an encoding adds, over poses and vertices, weighted by rest area."""

    mean: float
    p99: float


def added_error(primitives: Iterable[EncodedPrimitive]) -> AddedError | None:
    """Measure the angle between algorithm 3's normals with stored and with unrounded α and β.

    All samples count together, and all poses count alike. If the unrounded normal of a sample vanishes, the
    sample is left out. If only its stored normal vanishes, the sample counts as 180°. None if no sample is
    left.
    """
    items = list(primitives)
    tally = ErrorTally(sum(len(item.joint_matrices) * total_area(item.areas) for item in items))
    for item in items:
        exact = replace(item.primitive, alpha=item.alpha, beta=item.beta)
        for pose, part, blended in blended_blocks((item.primitive, exact), item.joint_matrices):
            stored, unrounded = (one.normals((Algorithm.LBS_ACCURATE,), pose, part)[0] for one in blended)
            square = dot(unrounded, unrounded)
            angles = angles_between(stored, unrounded).astype(np.float32)
            tally.add(angles, item.areas[part], valid=(square > 0.0) & np.isfinite(square))
    summary = tally.summary()
    return None if summary is None else AddedError(summary.mean, summary.p99)
