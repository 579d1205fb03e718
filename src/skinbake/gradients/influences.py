"""From stored influences to a weight field: a partition of unity (docs/reference/gradients.md)."""

from __future__ import annotations

import numpy as np

from skinbake.geometry.skinned import SkinnedPrimitive
from skinbake.gradients import kernel
from skinbake.gradients.field import WeightDefects, WeightField

SUM_TOLERANCE = 1e-3
"""The distance of Σw from 1 that gives a warning. A smaller distance is rounding of stored weights."""

ADOPTING_SUM = 1e-3
"""The Σw above which a vertex may adopt. Its largest weight must afford ``SLOT_COST`` for each slot too."""

SLOT_COST = 1 / 65535
"""What an adopted slot of integer weight takes from the largest weight."""


LEAST_WEIGHT = 2.0**-30
"""The share of a vertex's largest weight below which a weight counts as 0. Adopted slots have as much.

Some exporters leave weights of 1e-11, which move nothing and take slots from joints of neighbours.
"""


def weight_field(primitive: SkinnedPrimitive) -> tuple[WeightField, WeightDefects]:
    """Return the weight field of a primitive's stored influences, and the assumptions made.

    Negative weights count as 0. A vertex whose weights are all zero belongs to the joint of slot 0, as in
    three.js. Weights that move nothing count as 0, and all are divided by their sum. A joint in several slots
    keeps the first slot with a positive weight (or the first of all), with the sum of the weights.
    """
    joints = primitive.joints.astype(np.int32, order="C")
    weights = primitive.weights.astype(np.float64, order="C")
    return kernel.normalise_influences(
        joints,
        weights,
        adopting_sum=ADOPTING_SUM,
        adopting_weight=SLOT_COST * joints.shape[1],
        tolerance=SUM_TOLERANCE,
        least=LEAST_WEIGHT,
    )
