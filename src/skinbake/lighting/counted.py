"""The count of a block of errors: what the kernel returns of it, and what a tally adds up."""

from __future__ import annotations

from dataclasses import dataclass

from skinbake.geometry.skinned import Float64Array, FloatArray


@dataclass(frozen=True, slots=True)
class CountedErrors:
    """A block of errors in degrees, counted.

    samples are counted, among them undefined ones without a measured normal. weight is the weight of the
    samples, total the weighted sum of their errors. largest is the largest error, −1 if there are no samples.
    pose and vertex are the first place of it in the block, by pose. tail and tail_weights (N,) are the errors
    that are large enough to be kept.
    """

    samples: int
    undefined: int
    weight: float
    total: float
    largest: float
    pose: int
    vertex: int
    tail: FloatArray
    tail_weights: Float64Array
