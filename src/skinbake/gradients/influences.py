"""From stored influences to a weight field: a partition of unity (docs/reference/gradients.md)."""

from __future__ import annotations

import numpy as np

from skinbake.geometry.skinned import SkinnedPrimitive
from skinbake.gradients import kernel
from skinbake.gradients.field import WeightDefects, WeightField

SUM_TOLERANCE = 1e-3
"""How far Σw may be from 1 before it is worth a warning: below, it is the rounding of stored weights."""

ADOPTING_SUM = 1e-3
"""Σw above which a vertex may adopt: its largest weight must afford 1/65535 for each adopted slot."""


def weight_field(primitive: SkinnedPrimitive) -> tuple[WeightField, WeightDefects]:
    """Return the weight field of a primitive's stored influences, and what had to be assumed.

    Negative weights count as 0. A vertex whose weights are all zero belongs to slot 0's joint, as in
    three.js. Weights are divided by their sum. A joint that stands in several slots keeps
    the first slot with a positive weight (or the first of all), with the sum of the weights.
    """
    joints = primitive.joints.astype(np.int32, order="C")
    weights = primitive.weights.astype(np.float64, order="C")
    return kernel.normalise_influences(joints, weights, adopting_sum=ADOPTING_SUM, tolerance=SUM_TOLERANCE)
