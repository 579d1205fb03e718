"""α and β of influence slots from gradients of joints. Free slots adopt joints of neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skinbake.geometry.skinned import Float64Array, FloatArray, IntArray, blocks
from skinbake.gradients.surface import NEGLIGIBLE, NO_JOINT, WeightField
from skinbake.gradients.weight_gradients import VertexGradients

BLOCK = 1 << 15
"""The vertices in work at a time. The arrays of a block stay in the processor's cache."""


@dataclass(frozen=True, slots=True)
class SlotGradients:
    """α and β of every slot, and the gradients that the slots could not hold.

    alpha, beta (V, K) float64 include slot 0. adopted (V, K) int64 is the joint that a slot adopts, −1
    elsewhere. named (V, K) int64 is the joint whose gradient a slot holds, −1 for none. overflowing is the
    number of vertices with more foreign joints than free slots. Without adoption, it is the number of
    vertices with any foreign joints. magnitude is the length of all joints' gradients summed over the
    vertices, in 1 / length unit. unheld is the part of that sum that no slot holds, and that goes to s0.
    """

    alpha: Float64Array
    beta: Float64Array
    adopted: IntArray
    named: IntArray
    overflowing: int
    magnitude: float
    unheld: float


def assign(
    gradients: VertexGradients,
    classes: IntArray,
    field: WeightField,
    frame: tuple[FloatArray, FloatArray],
    capacity: IntArray | None,
) -> SlotGradients:
    """Return α and β per slot of V vertices.

    classes (V,) names each vertex's row of ``gradients``. field holds its normalised influences (V, K). frame
    holds its t0 and b0, each (V, 3). A slot has the gradient of the joint that it names. capacity (V,) is the
    number of joints that each vertex may adopt (see ``shared_capacity``), None for no adoption. Joints that
    vary around the vertex, but are not among its influences of positive weight, move into free slots, the
    largest gradients first.
    """
    alpha, beta = np.empty(field.joints.shape), np.empty(field.joints.shape)
    adopted = np.full(field.joints.shape, NO_JOINT, dtype=np.int64)
    named = np.full(field.joints.shape, NO_JOINT, dtype=np.int64)
    overflowing, magnitude, unheld = 0, 0.0, 0.0
    for rows in blocks(len(classes), BLOCK):
        entries = _Entries(gradients, classes[rows])
        part = field.rows(rows)
        foreign = _foreign(entries, part)
        # Without adoption a slot holds the gradient of the joint that it names.
        named[rows] = part.joints
        if capacity is not None and len(foreign.vertices):
            # The n-th foreign joint of a vertex takes its n-th free slot. They go by vertex, then the largest
            # gradient first; of equal ones the lower joint.
            order = np.lexsort((foreign.joints, -foreign.magnitudes, foreign.vertices))
            vertices, joints = foreign.vertices[order], foreign.joints[order]
            rank = np.arange(len(vertices)) - np.searchsorted(vertices, vertices)
            free_first = np.argsort(~part.free[vertices], axis=1, kind="stable")
            fits = rank < capacity[rows][vertices]
            taken = adopted[rows]
            taken[vertices[fits], free_first[fits, rank[fits]]] = joints[fits]
            # A slot that adopts no joint keeps the joint that it names in the file, even at weight zero,
            # unless that joint has moved into another slot.
            named[rows] = np.where(taken != NO_JOINT, taken, part.joints)
            some = np.flatnonzero((taken != NO_JOINT).any(axis=1))
            moved = (part.joints[some, :, None] == taken[some, None, :]).any(axis=2)
            moved &= taken[some] == NO_JOINT
            named[rows][some] = np.where(moved, NO_JOINT, named[rows][some])
        # α and β, and what they leave out.
        alpha[rows], beta[rows], left = _project(entries, named[rows], (frame[0][rows], frame[1][rows]))
        placed = (named[rows][foreign.vertices] == foreign.joints[:, None]).any(axis=1)
        overflowing += len(np.unique(foreign.vertices[~placed]))
        magnitude, unheld = magnitude + float(entries.sums.sum()), unheld + left
    return SlotGradients(alpha, beta, adopted, named, overflowing, magnitude, unheld)


def shared_capacity(field: WeightField, classes: IntArray) -> IntArray:
    """Return the number of joints that each vertex (V,) may adopt: the least of all copies of its point.

    Copies that adopted differently would no longer be one vertex to a reader of the baked file.
    """
    free = np.count_nonzero(field.free, axis=1)
    # The least number of free slots in each class.
    least = np.full(int(classes.max(initial=-1)) + 1, field.free.shape[1])
    np.minimum.at(least, classes, free)
    return np.asarray(least[classes])


@dataclass(frozen=True, slots=True)
class _Rank:
    """The entries of one rank: their vertices, their indices, and the lengths of their gradients."""

    vertices: IntArray
    numbers: IntArray
    magnitudes: Float64Array


class _Entries:
    """The entries of the gradients as V vertices see them, by rank: all first ones, then all second ones.

    sums (V,) are the lengths of the gradients of all joints, added up for each vertex.
    """

    def __init__(self, gradients: VertexGradients, classes: IntArray) -> None:
        start = gradients.offsets[classes]
        count = gradients.offsets[classes + 1] - start
        self.gradients = gradients
        self.sums = np.zeros(len(classes))
        self.ranks: list[_Rank] = []
        for rank in range(int(count.max(initial=0))):
            vertices = np.flatnonzero(count > rank)
            numbers = start[vertices] + rank
            x, y, z = gradients.gradients[numbers].T
            self.ranks.append(_Rank(vertices, numbers, np.sqrt(x * x + y * y + z * z)))
            self.sums[vertices] += self.ranks[-1].magnitudes


@dataclass(frozen=True, slots=True)
class _Foreign:
    """The foreign joints of some vertices: vertex, joint, length of the gradient there, all (F,).

    A foreign joint is one that only neighbours of the vertex have (docs/reference/gradients.md).
    """

    vertices: IntArray
    joints: IntArray
    magnitudes: Float64Array


def _foreign(entries: _Entries, field: WeightField) -> _Foreign:
    """Return the entries whose joints have no positive weight at their vertex, but for negligible ones."""
    empty = np.empty(0, dtype=np.int64)
    found: list[tuple[IntArray, IntArray, Float64Array]] = [(empty, empty, np.empty(0))]
    own_joints = np.ascontiguousarray(np.where(field.weights > 0, field.joints, NO_JOINT).T)
    for rank in entries.ranks:
        joints = entries.gradients.joints[rank.numbers]
        # Tiny gradients are rounding: they are not a reason to take a slot.
        foreign = rank.magnitudes > NEGLIGIBLE * entries.sums[rank.vertices]
        for column in own_joints:
            foreign &= column[rank.vertices] != joints
        found.append((rank.vertices[foreign], joints[foreign], rank.magnitudes[foreign]))
    return _Foreign(*(np.concatenate(column) for column in zip(*found, strict=True)))


def _project(
    entries: _Entries, named: IntArray, frame: tuple[FloatArray, FloatArray]
) -> tuple[Float64Array, Float64Array, float]:
    """Return α, β (V, K), and the gradient magnitude that no slot holds, summed over vertices."""
    alpha, beta = np.zeros(named.shape), np.zeros(named.shape)
    unheld = 0.0
    for rank in entries.ranks:
        # The slots that hold the gradients of this rank.
        at = named[rank.vertices] == entries.gradients.joints[rank.numbers][:, None]
        row, slot = np.divmod(np.flatnonzero(at), named.shape[1])
        held = rank.vertices[row]
        gradients = entries.gradients.gradients[rank.numbers[row]]
        # α = ∇w · t0, β = ∇w · b0.
        alpha[held, slot] = np.einsum("ij,ij->i", gradients, frame[0][held])
        beta[held, slot] = np.einsum("ij,ij->i", gradients, frame[1][held])
        unheld += float(rank.magnitudes.sum() - rank.magnitudes[row].sum()) if len(row) < len(at) else 0.0
    return alpha, beta, unheld
