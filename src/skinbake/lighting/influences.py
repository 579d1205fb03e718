"""The meaning of stored joints and weights: weights that sum to one.

Source: real files hold weights that glTF does not allow. Their sums are not one, some vertices have no
weight, a joint is twice at one vertex, or weights are negative.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from skinbake.format.adoption import TINY_WEIGHT
from skinbake.geometry.blocks import blocks
from skinbake.geometry.skinned import (
    BoolArray,
    Float32Array,
    Float64Array,
    FloatArray,
    IntArray,
    SkinnedPrimitive,
)

PAIRS = 1 << 22
"""The pairs of slots that are compared at a time."""

LEAST_SHARE = 2.0**-30
"""The share of a vertex's largest weight below which a weight moves nothing (docs/reference/gradients.md)."""

Int32Array: TypeAlias = npt.NDArray[np.int32]
Int64Array: TypeAlias = npt.NDArray[np.int64]


def normalised_weights(weights: FloatArray, joints: IntArray) -> Float64Array:
    """Return the weights as gradients and skinning use them: w / Σw, (V, K) float64.

    weights (V, K) as stored, joints (V, K). Negative and NaN weights count as 0. If no weight is positive,
    slot 0 gets 1, so the vertex follows the joint of that slot. Only the shape of joints is checked:
    ValueError.
    """
    if weights.shape != joints.shape:
        raise ValueError(f"weights {weights.shape} and joints {joints.shape} differ in shape")
    wide = np.asarray(weights, dtype=np.float64)
    positive: Float64Array = np.where(wide > 0.0, wide, 0.0)
    positive[~positive.any(axis=1), 0] = 1.0
    positive /= positive.sum(axis=1, keepdims=True)
    return positive


def moving_weights(weights: FloatArray, joints: IntArray) -> Float64Array:
    """Return the weights as bake reads them, (V, K) float64: normalised, and 0 where they move nothing.

    weights and joints (V, K) are as stored. Raises ValueError as ``normalised_weights`` does.
    """
    return normalised_weights(np.where(free_slots(weights), 0.0, weights), joints)


def free_slots(weights: FloatArray) -> BoolArray:
    """Tell which slots are free, (V, K): those of weight 0, or of a weight that moves nothing.

    weights (V, K) as stored.
    """
    # Few files have a weight that is so small even beside the largest of all vertices.
    least = LEAST_SHARE * float(weights.max(initial=0.0))
    free: BoolArray = (weights > 0.0) & (weights < least)
    if free.any():
        free &= weights < LEAST_SHARE * weights.max(axis=1, keepdims=True, initial=0.0).astype(np.float64)
    return np.asarray(free | (weights == 0.0))


def joint_weights(primitives: Sequence[SkinnedPrimitive]) -> tuple[Int64Array, Float64Array]:
    """Return each vertex's joints (V, N) int64, ascending and each once, and their weights (V, N) float64.

    If a joint is in several slots of a vertex, it has the sum of their weights. Slots that are left over have
    −1 in place of a joint, and the weight 0. Weights that move nothing count as 0 (``free_slots``): in the
    sum they could turn the last bit of the others.
    """
    count = sum(len(primitive.joints) for primitive in primitives)
    width = max((primitive.joints.shape[1] for primitive in primitives), default=0)
    joints, weights = np.full((count, width), -1, dtype=np.int64), np.zeros((count, width))
    start = 0
    for primitive in primitives:
        rows, slots = slice(start, start + len(primitive.joints)), slice(0, primitive.joints.shape[1])
        joints[rows, slots] = primitive.joints
        weights[rows, slots] = moving_weights(primitive.weights, primitive.joints)
        start = rows.stop
    order = np.argsort(joints, axis=1, kind="stable")
    joints, weights = np.take_along_axis(joints, order, axis=1), np.take_along_axis(weights, order, axis=1)
    for slot in range(1, width):
        again = joints[:, slot] == joints[:, slot - 1]
        weights[again, slot] += weights[again, slot - 1]
        joints[again, slot - 1], weights[again, slot - 1] = -1, 0.0
    return joints, weights


@dataclass(frozen=True, slots=True)
class JointField:
    """The weights of all vertices that are not 0: those of vertex v from starts[v] to starts[v + 1].

    starts are (V + 1,), joints and weights are (N,). Joints are below joint_count, also those that slots name
    at the weight 0.
    """

    starts: Int64Array
    joints: Int64Array
    weights: Float64Array
    joint_count: int

    @classmethod
    def of_surface(cls, primitives: Sequence[SkinnedPrimitive]) -> JointField:
        """Return the weights of the primitives of one surface."""
        joints, weights = joint_weights(primitives)
        held = weights != 0.0
        starts = np.concatenate([[0], np.cumsum(np.count_nonzero(held, axis=1))])
        most = max((int(primitive.joints.max(initial=0)) for primitive in primitives), default=0)
        return cls(starts, joints[held], weights[held], most + 1)

    def of(self, vertices: IntArray) -> tuple[Int64Array, Int64Array, Float64Array]:
        """Return the weights at some vertices (E,): each one's place among them, its joint, and its value."""
        counts = self.starts[vertices + 1] - self.starts[vertices]
        places = np.repeat(np.arange(len(vertices)), counts)
        before = np.cumsum(counts) - counts
        at = np.arange(len(places)) - np.repeat(before - self.starts[vertices], counts)
        return places, self.joints[at], self.weights[at]


def influence_keys(primitives: Sequence[SkinnedPrimitive]) -> tuple[Int64Array, Float32Array]:
    """Write each vertex's influences in one canonical way.

    Returns joints (V, N) int64, ascending, and −1 if a vertex has fewer than N. Returns their weights (V, N)
    float32, with 0 there. Influences of the weight that FLOAT slots adopt are left out: copies of a vertex in
    two meshes may have adopted other joints, and are one point all the same.
    """
    joints, weights = joint_weights(primitives)
    shares = weights.astype(np.float32)
    absent = shares < 1.5 * TINY_WEIGHT
    joints[absent], shares[absent] = -1, 0.0
    width = int((~absent).sum(axis=1).max(initial=0))
    order = np.argsort(absent, axis=1, kind="stable")[:, :width]
    return np.take_along_axis(joints, order, axis=1), np.take_along_axis(shares, order, axis=1)


def carrying_slots(primitive: SkinnedPrimitive) -> BoolArray:
    """Mark, (V, K), the one slot of each joint that carries its gradient.

    It is the first slot in which the joint has weight, or else the first of all. A weight that moves nothing
    is none (``free_slots``).
    """
    count, width = primitive.joints.shape
    carries = np.ones((count, width), dtype=np.bool_)
    earlier = np.tril(np.ones((width, width), dtype=bool), -1)
    step = max(1, PAIRS // max(width * width, 1))
    for rows in blocks(count, step):
        joints = primitive.joints[rows]
        positive = moving_weights(primitive.weights[rows], joints) > 0.0
        mine, other = positive[:, :, None], positive[:, None, :]
        outranks = (other & ~mine) | ((other == mine) & earlier)
        same = joints[:, :, None] == joints[:, None, :]
        carries[rows] = ~(same & outranks).any(axis=2)
    return carries
