"""The mesh as ``verify`` measures it: joined primitives, their influences, and weld classes.

It welds by rules of its own. No option of bake chooses them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from skinbake.choices import Weighting
from skinbake.geometry.skinned import (
    TINY_WEIGHT,
    BoolArray,
    Float32Array,
    Float64Array,
    FloatArray,
    IntArray,
    SkinnedPrimitive,
    bincount,
    blocks,
)
from skinbake.gltf.budget import Cost
from skinbake.skinning.components import Vector, cross, dot
from skinbake.skinning.rest import RestPrimitive

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


def joint_weights(primitives: Sequence[SkinnedPrimitive | RestPrimitive]) -> tuple[Int64Array, Float64Array]:
    """Return each vertex's joints (V, N) int64, ascending and each once, and their weights (V, N) float64.

    If a joint is in several slots of a vertex, it has the sum of their weights. Slots that are left over have
    −1 in place of a joint, and the weight 0. Weights that move nothing count as 0 (``free_slots``): in the
    sum they could turn the last bit of the others.
    """
    count = sum(len(primitive.joints) for primitive in primitives)
    width = max((primitive.joints.shape[1] for primitive in primitives), default=0)
    joints, weights = np.full((count, width), -1, dtype=np.int64), np.zeros((count, width))
    # All primitives side by side, in as many slots as the widest has.
    start = 0
    for primitive in primitives:
        rows, slots = slice(start, start + len(primitive.joints)), slice(0, primitive.joints.shape[1])
        joints[rows, slots] = primitive.joints
        weights[rows, slots] = moving_weights(primitive.weights, primitive.joints)
        start = rows.stop
    # Joints ascend; equal ones are neighbours then, and the last one takes the sum.
    order = np.argsort(joints, axis=1, kind="stable")
    joints, weights = np.take_along_axis(joints, order, axis=1), np.take_along_axis(weights, order, axis=1)
    for slot in range(1, width):
        again = joints[:, slot] == joints[:, slot - 1]
        weights[again, slot] += weights[again, slot - 1]
        joints[again, slot - 1], weights[again, slot - 1] = -1, 0.0
    return joints, weights


class JointField(NamedTuple):
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
        # A slot outranks another with weight before one without, then by its place.
        mine, other = positive[:, :, None], positive[:, None, :]
        outranks = (other & ~mine) | ((other == mine) & earlier)
        same = joints[:, :, None] == joints[:, None, :]
        carries[rows] = ~(same & outranks).any(axis=2)
    return carries


MOST_NORMALS = 4096
"""The number of different normals at one point above which only equal ones weld, as in bake."""

LEAST_RIGID = np.float32(0.99)
"""The weight from which a joint moves a vertex as if alone (docs/reference/gradients.md)."""

HASH_FACTOR = np.uint64(0x9E3779B97F4A7C15)
"""2⁶⁴ divided by the golden ratio (Knuth, *The art of computer programming*, 6.4)."""


def weld_classes(
    primitives: Sequence[SkinnedPrimitive],
    *,
    crease_angle_degrees: float = 15.0,
    claim: Callable[[int], None] = lambda size: None,
) -> Int64Array:
    """Return the number of each vertex's weld class: (V,) int64 over all primitives, from 0 without gaps.

    Vertices of one class have equal positions (−0 is +0) and equal influences (joint → w / Σw, in any slot
    order, compared in float32). A chain of normals joins them: each differs from the next by at most
    ``crease_angle_degrees``, in any primitive of the mesh. Normals may have any length. A zero or non-finite
    normal welds only with an equal one: the same bits, but −0 is +0. So does any normal at a point with more
    than MOST_NORMALS different ones. ``claim`` is called with the number of bytes that the next pairs of
    normals to be listed take.
    """
    positions = np.concatenate([primitive.positions for primitive in primitives]).astype(np.float64)
    with np.errstate(invalid="ignore"):  # a NaN may be signalling
        normals = np.concatenate([primitive.normals for primitive in primitives]).astype(np.float64)
    joints, shares = influence_keys(primitives)
    # Adding zero turns −0 into +0. Then the rows are compared bit by bit, so that NaN is a value like any
    # other.
    places = row_numbers(np.hstack([(positions + 0.0).view(np.int64), joints, shares.view(np.int32)]))
    # Identical copies collapse here. Few pairs are left to compare by angle.
    nodes = row_numbers(np.column_stack([places, (normals + 0.0).view(np.int64)]))
    firsts = _first_rows(nodes)
    pairs = _close_pairs(places[firsts], normals[firsts], np.radians(crease_angle_degrees), claim)
    return _in_order(_components(pairs, len(firsts))[nodes])


def with_rigid_parts(
    classes: Int64Array, primitives: Sequence[SkinnedPrimitive], triangles: IntArray
) -> Int64Array:
    """Return the weld classes (V,) in which parts that cannot bend weld with none that can.

    classes are of ``weld_classes``, triangles (T, 3) index the vertices of all primitives. Triangles of one
    primitive that share a class are of one part. If a joint has at least LEAST_RIGID of the weight at all
    corners of a part, its normals move as it does, and are known.
    """
    owners = np.repeat(np.arange(len(primitives)), [len(primitive.positions) for primitive in primitives])
    copies = row_numbers(np.column_stack([classes, owners]))
    count = int(copies.max(initial=-1)) + 1
    if count == int(classes.max(initial=-1)) + 1:
        return classes  # no class has vertices of two primitives
    joints, weights = joint_weights(primitives)
    held = weights.astype(np.float32) >= LEAST_RIGID
    movers = np.where(held, joints, -1).max(axis=1)[triangles]
    bends = (movers[:, 0] < 0) | (movers.min(axis=1) < movers.max(axis=1))
    corners = copies[triangles]
    parts = _components(np.concatenate([corners[:, :2], corners[:, 1:]]), count)
    # Vertices without triangles are of neither kind. They stay with the bending ones.
    rigid = np.zeros(count, dtype=bool)
    rigid[corners[~np.isin(parts[corners[:, 0]], parts[corners[bends, 0]])]] = True
    meeting = np.isin(classes, classes[triangles[bends]])
    return _in_order(row_numbers(np.column_stack([classes, rigid[copies] & meeting])))


def _in_order(classes: Int64Array) -> Int64Array:
    """Return the classes (V,) in the order of their first vertices: neighbours are then near in memory."""
    firsts = _first_rows(classes)
    numbers = np.empty(len(firsts), dtype=np.int64)
    numbers[np.argsort(firsts)] = np.arange(len(firsts))
    return numbers[classes]


def _first_rows(numbers: Int64Array) -> Int64Array:
    """Return the first row that has each number (V,) from 0 without gaps."""
    firsts = np.full(int(numbers.max(initial=-1)) + 1, len(numbers))
    np.minimum.at(firsts, numbers, np.arange(len(numbers)))
    return firsts


def row_numbers(rows: Int64Array) -> Int64Array:
    """Give equal rows equal numbers, (V,) from 0 without gaps."""
    hashes = row_hashes(rows)
    # A sort by hash takes a tenth of the time of a sort by all columns.
    order = np.argsort(hashes)
    starts = _starts(rows[order])
    ordered = hashes[order]
    if (starts[1:] & (ordered[1:] == ordered[:-1])).any():
        # Unequal rows share a hash, so equal ones may lie apart.
        order = np.lexsort(rows.T)
        starts = _starts(rows[order])
    numbers = np.empty(len(rows), dtype=np.int64)
    numbers[order] = np.cumsum(starts) - 1
    return numbers


def _starts(ordered: Int64Array) -> BoolArray:
    """Mark each row that differs from the one before it, (V,)."""
    starts = np.ones(len(ordered), dtype=bool)
    starts[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    return starts


def row_hashes(rows: Int64Array) -> npt.NDArray[np.uint64]:
    """Return one number for each row, (V,). Equal rows have equal numbers, and others hardly ever."""
    found = np.zeros(len(rows), dtype=np.uint64)
    for column in rows.T:
        found ^= column.view(np.uint64)
        found *= HASH_FACTOR
        found ^= found >> np.uint64(29)
    return found


def _close_pairs(
    places: Int64Array, normals: Float64Array, angle: float, claim: Callable[[int], None]
) -> Int64Array:
    """List the pairs (N, 2) at one place whose normals differ by at most ``angle`` radians."""
    # Only points with several normals, and not too many.
    counts = bincount(places, minlength=len(places))
    counts[counts > MOST_NORMALS] = 0
    shared = np.flatnonzero(counts[places] > 1)
    with np.errstate(invalid="ignore", divide="ignore"):  # a normal of zeros has no direction
        # The scaling comes before the squaring, so that a normal of any finite length has a direction.
        scaled = normals[shared] / np.abs(normals[shared]).max(axis=1, initial=0.0, keepdims=True)
        units = scaled / np.linalg.norm(scaled, axis=1, keepdims=True)
    sound = np.isfinite(units).all(axis=1)
    candidates, directions = shared[sound], units[sound]
    # A chord of the unit sphere stands for the angle. The errors of normalising are far below the slack.
    chord = 2.0 * np.sin(min(angle, np.pi) / 2.0) + 1e-12
    # By place. Then a pair is so many steps apart, and each number of steps is looked at.
    order = np.argsort(places[candidates], kind="stable")
    candidates, directions = candidates[order], directions[order]
    at = places[candidates]
    found = [np.zeros((0, 2), dtype=np.int64)]
    first = np.arange(len(at))
    for step in range(1, int(counts.max(initial=0))):
        # A normal without another one so many steps ahead has none farther ahead either.
        first = first[first + step < len(at)]
        first = first[at[first] == at[first + step]]
        apart = np.linalg.norm(directions[first] - directions[first + step], axis=1)
        close = first[apart <= chord]
        claim(2 * Cost.WELDED_PAIR.bytes * len(close))
        found.append(np.column_stack([candidates[close], candidates[close + step]]))
    return np.concatenate(found)


def _components(pairs: Int64Array, count: int) -> Int64Array:
    """Return the number of each node's connected component: (V,) from 0 without gaps."""
    labels = np.arange(count)
    while True:
        # Each node takes the least label of its neighbours, and of the node that it names.
        lowest = labels[pairs].min(axis=1, initial=count)
        before = labels.copy()
        for end in range(2):
            np.minimum.at(labels, pairs[:, end], lowest)
        labels = labels[labels]
        if np.array_equal(labels, before):
            return np.unique(labels, return_inverse=True)[1].astype(np.int64)


ROWS = 1 << 13
"""The number of rows that are made at a time."""

CORNERS = 1 << 16
"""The number of triangle corners that are looked at for these rows. A vertex may have thousands of copies."""


@dataclass(frozen=True, slots=True)
class WeldedMesh:
    """The triangles of a mesh that have an area, and the corners at each point of its surface.

    V runs over the vertices of all primitives, concatenated in order. counts holds the number of each.
    positions (V, 3) are float64. triangles (T, 3) have an area. classes (V,) are the weld classes. totals
    (C,) are the weights of all corners of a class. corners (3 T,) lists them class by class, from ends[c] to
    ends[c + 1].
    """

    counts: tuple[int, ...]
    positions: Float64Array
    triangles: Int32Array
    classes: Int32Array
    weighting: Weighting
    totals: Float64Array
    corners: Int32Array
    ends: Int64Array

    @property
    def slices(self) -> list[slice]:
        """The slice of each primitive's vertices among the mesh's vertices."""
        ends = np.cumsum(self.counts).tolist()
        return [slice(end - count, end) for end, count in zip(ends, self.counts, strict=True)]

    def row_blocks(self, within: slice | None = None) -> list[slice]:
        """Cut the vertices, or some of them, into blocks whose rows are made together."""
        start, stop = (0, len(self.positions)) if within is None else (within.start, within.stop)
        total = self._corners_before(start, stop)
        found = []
        first = 0
        while first < stop - start:
            end = int(np.searchsorted(total, total[first] + CORNERS, side="right")) - 1
            end = min(max(end, first + 1), first + ROWS, stop - start)
            found.append(slice(start + first, start + end))
            first = end
        return found

    def together(self, parts: Sequence[slice]) -> list[list[slice]]:
        """Group consecutive blocks whose rows are made together."""
        if not parts:
            return []
        first = parts[0].start
        before = self._corners_before(first, parts[-1].stop)
        groups = [[parts[0]]]
        for part in parts[1:]:
            start = groups[-1][0].start
            corners = before[part.stop - first] - before[start - first]
            if part.stop - start <= ROWS and corners <= CORNERS:
                groups[-1].append(part)
            else:
                groups.append([part])
        return groups

    def _corners_before(self, start: int, stop: int) -> Int64Array:
        """Return the number of corners of the vertices from ``start`` up to each of the next ones."""
        lengths = np.diff(self.ends)[self.classes[start:stop]]
        return np.concatenate([[0], np.cumsum(lengths)])

    def corners_of(self, part: slice) -> tuple[IntArray, IntArray]:
        """Return the corners of a block's vertices and of their copies, each with its vertex in the block."""
        classes = self.classes[part]
        lengths = self.ends[classes + 1] - self.ends[classes]
        owners = np.repeat(np.arange(len(classes)), lengths)
        # The corners of each class stand in one piece of the list.
        offsets = np.arange(len(owners)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
        return owners, self.corners[np.repeat(self.ends[classes], lengths) + offsets]


def weights_of_corners(first: Vector, second: Vector, weighting: Weighting) -> Float64Array:
    """Return the weights of corners from their two edges, by components."""
    normal = cross(first, second)
    area: Float64Array = np.sqrt(dot(normal, normal))
    if weighting == "max":
        return np.asarray(area / (dot(first, first) * dot(second, second)))
    if weighting == "area":
        return area
    angle = np.arctan2(area, dot(first, second))
    return np.asarray(angle if weighting == "angle" else angle * area)
