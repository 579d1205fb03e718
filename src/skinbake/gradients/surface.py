"""One surface to bake: the primitives that are baked together, their weight field, and the result."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from skinbake.geometry.rig import Rig
from skinbake.geometry.skinned import BoolArray, Float32Array, Float64Array, FloatArray, IntArray

NEGLIGIBLE = 1e-4
"""The share of a vertex's gradient below which a neighbour's joint is not worth a slot.

It changes the correction of a tangent by a ten-thousandth. At a correction as long as the tangent itself,
that is less than 0.01°.
"""


class Surface(NamedTuple):
    """One surface of P primitives, with their V vertices one after the other.

    positions (V, 3) are in mesh space. triangles (T, 3) index them, and all have an area. field has the
    normalised weights (V, K). classes (V,) is each vertex's weld class. normals (V, 3) are of any length.
    frame has the tangents and bitangents at rest, each (V, 3) and of one type. None means that they follow
    from the normals. ends (P,) is the index after each primitive's last vertex. If there is a rig, the
    gradients are fitted to its poses and turns. It has all joints of the field.
    """

    positions: FloatArray
    triangles: IntArray
    field: WeightField
    classes: IntArray
    normals: FloatArray
    frame: tuple[FloatArray, FloatArray] | None
    ends: Sequence[int]
    rig: Rig | None = None


class SurfaceSlots(NamedTuple):
    """α and β of every slot but the first, and the gradients that the slots could not hold.

    alpha, beta (V, K − 1) are float32, 1 / length unit. adopting (A,) lists the vertices that adopt,
    ascending. adopted (A, K) integer is the joint that each of their slots adopts, −1 if it stays. sums (P,
    4) float64 are over the vertices of each primitive: the number of vertices that adopt; the number of those
    with more foreign joints than free slots (without adoption: with any foreign joint); the lengths of all
    joints' gradients, in 1 / length unit; and the part of these lengths that no slot holds, which goes to s0.
    """

    alpha: Float32Array
    beta: Float32Array
    adopting: IntArray
    adopted: IntArray
    sums: Float64Array


NO_JOINT = -1


class WeightField(NamedTuple):
    """The normalised weights of V vertices: joints (V, K) int32, weights (V, K) float64, Σ over K is 1.

    Every joint has only one slot of a vertex. A repeat gets joint −1 and weight 0, and the slot that keeps
    the joint gets its weight. Slots keep the places that they have in the file. free (V, K) tells which slots
    may adopt a joint: those stored with weight 0, or with so little that it counts as 0
    (``influences.LEAST_WEIGHT``). A vertex whose stored weights sum to at most ``influences.ADOPTING_SUM``
    has none. The weight that an adopted slot gets would be a visible part of so small a sum. A vertex with a
    negative weight has none either, since its slot may already name the joint. Nor has a vertex whose sum is
    valid only by weights that count as 0 (``influences.needs_tiny_weights``).
    """

    joints: npt.NDArray[np.int32]
    weights: Float64Array
    free: BoolArray

    def rows(self, vertices: IntArray | slice) -> WeightField:
        """Return the field of some vertices."""
        return WeightField(self.joints[vertices], self.weights[vertices], self.free[vertices])


class WeightDefects(NamedTuple):
    """The number of vertices of a primitive that needed each assumption."""

    negative: int
    all_zero: int
    not_normalised: int
    repeated_joint: int


def concatenate_fields(fields: Sequence[WeightField]) -> WeightField:
    """Return the weight fields of several primitives as one, filled to the largest number of slots."""
    if len(fields) == 1:
        return fields[0]
    influences = max(field.joints.shape[1] for field in fields)
    joints, weights, free = [], [], []
    for field in fields:
        missing = ((0, 0), (0, influences - field.joints.shape[1]))
        joints.append(np.pad(field.joints, missing, constant_values=NO_JOINT))
        weights.append(np.pad(field.weights, missing))
        free.append(np.pad(field.free, missing))
    return WeightField(np.concatenate(joints), np.concatenate(weights), np.concatenate(free))


Labels = IntArray


def first_rows(labels: Labels) -> npt.NDArray[np.int64]:
    """Return the first row of each label. np.unique would import masked arrays, which takes 0.1 s."""
    first = np.empty(int(labels.max(initial=-1)) + 1, dtype=np.int64)
    first[labels[::-1]] = np.arange(len(labels))[::-1]
    return first


def number_as_met(labels: Labels) -> Labels:
    """Return the labels renumbered in the order in which rows meet them.

    Neighbours on the surface then stay neighbours in memory. Gathering by labels in hash order took three
    times as long.
    """
    leader = first_rows(labels)[labels]
    leads = np.zeros(len(labels), dtype=np.bool_)
    leads[leader] = True
    return np.asarray((np.cumsum(leads) - 1)[leader])


def bit_patterns(values: npt.NDArray[Any]) -> npt.NDArray[np.unsignedinteger]:
    """Return the bit patterns of floats as unsigned integers, with −0 made +0."""
    with np.errstate(invalid="ignore"):  # a signalling NaN becomes a quiet one
        flat = np.ascontiguousarray(values + values.dtype.type(0))
    return flat.view(np.uint32 if flat.dtype == np.float32 else np.uint64)
