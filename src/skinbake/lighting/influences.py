"""The meaning of stored joints and weights: weights that sum to one, as a field over a mesh.

Source: real files hold weights that glTF does not allow. Their sums are not one, some vertices have no
weight, a joint is twice at one vertex, or weights are negative.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import numpy.typing as npt

from skinbake.format.adoption import TINY_WEIGHT
from skinbake.geometry.skinned import (
    BoolArray,
    Float32Array,
    Float64Array,
    FloatArray,
    IntArray,
    SkinnedPrimitive,
)

if TYPE_CHECKING:
    from scipy.sparse import csr_array

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


def weight_field(primitives: Sequence[SkinnedPrimitive]) -> csr_array:
    """Return the weight of every joint at every vertex of a mesh: sparse (V, J) float64, rows summing to 1.

    If a joint is in several slots of a vertex, it gets their sum. J is one more than the largest joint index
    in any slot, used or not.
    """
    from scipy.sparse import csr_array

    weights = [normalised_weights(primitive.weights, primitive.joints) for primitive in primitives]
    counts = [len(primitive.joints) for primitive in primitives]
    slots = [primitive.joints.shape[1] for primitive in primitives]
    data = np.concatenate([block.ravel() for block in weights])
    columns = np.concatenate([primitive.joints.ravel().astype(np.int64) for primitive in primitives])
    rows = np.repeat(np.arange(sum(counts)), np.repeat(slots, counts))
    field = csr_array((data, (rows, columns)), shape=(sum(counts), int(columns.max(initial=-1)) + 1))
    field.eliminate_zeros()
    return field


def influence_keys(primitives: Sequence[SkinnedPrimitive]) -> tuple[Int64Array, Float32Array]:
    """Write each vertex's influences in one canonical way.

    Returns joints (V, N) int64, ascending, and −1 if a vertex has fewer than N. Returns their weights (V, N)
    float32, with 0 there. Influences of the weight that FLOAT slots adopt are left out: copies of a vertex in
    two meshes may have adopted other joints, and are one point all the same.
    """
    field = weight_field(primitives).astype(np.float32)
    field.data[field.data < 1.5 * TINY_WEIGHT] = 0.0
    field.eliminate_zeros()
    lengths = np.diff(field.indptr)
    rows = np.repeat(np.arange(field.shape[0]), lengths)
    slots = np.arange(field.nnz) - field.indptr[rows]
    width = int(lengths.max(initial=0))
    joints = np.full((field.shape[0], width), -1, dtype=np.int64)
    shares = np.zeros((field.shape[0], width), dtype=np.float32)
    joints[rows, slots] = field.indices
    shares[rows, slots] = field.data
    return joints, shares


def carrying_slots(primitive: SkinnedPrimitive) -> BoolArray:
    """Mark, (V, K), the one slot of each joint that carries its gradient."""
    joints = primitive.joints
    positive = normalised_weights(primitive.weights, joints) > 0.0
    earlier = np.tril(np.ones((joints.shape[1],) * 2, dtype=bool), -1)
    mine, other = positive[:, :, None], positive[:, None, :]
    outranks = (other & ~mine) | ((other == mine) & earlier)
    same = joints[:, :, None] == joints[:, None, :]
    carries: BoolArray = ~(same & outranks).any(axis=2)
    return carries
