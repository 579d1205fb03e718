"""The operations of the kernel by whole arrays of numpy. They define the results of the compiled loops."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from skinbake.geometry.frames import frame_from_normal, unit_normals
from skinbake.geometry.skinned import Float32Array, FloatArray
from skinbake.geometry.triangles import mark_proper
from skinbake.gradients.fit import FittedVertices, fitted
from skinbake.gradients.ring_turns import ring_turns
from skinbake.gradients.slots import assign, shared_capacity
from skinbake.gradients.surface import (
    NO_JOINT,
    Labels,
    Surface,
    SurfaceSlots,
    WeightDefects,
    WeightField,
    bit_patterns,
    number_as_met,
)
from skinbake.gradients.weight_gradients import weight_gradients

__all__ = ["bake_surface", "label_equal_rows", "mark_proper", "normalise_influences"]


def label_equal_rows(rows: npt.NDArray[np.generic]) -> Labels:
    """Return a label (V,) from 0 for every row (V, M), numbered as rows meet them. Equal rows have one label.

    rows holds float32, float64 (both with −0 = +0), or integers of 4 or 8 bytes. A 64-bit hash brings equal
    rows together, and then they are compared in full. So a collision costs time, not correctness.
    """
    bits = bit_patterns(rows) if rows.dtype.kind == "f" else rows
    keys = bits.astype(np.uint64, copy=False)
    hashed = row_hashes(keys)
    order = np.argsort(hashed)
    differs = np.any(keys[order[1:]] != keys[order[:-1]], axis=1)
    same_hash = hashed[order[1:]] == hashed[order[:-1]]
    if (differs & same_hash).any():
        order = np.lexsort(keys.T)
        differs = np.any(keys[order[1:]] != keys[order[:-1]], axis=1)
    labels = np.empty(len(keys), dtype=np.int64)
    labels[order] = np.concatenate([[0], np.cumsum(differs)]) if len(keys) else order
    return number_as_met(labels)


def row_hashes(keys: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """Mix every row into 64 bits (multiply and xor-shift, as in splitmix64)."""
    state = np.full(len(keys), 0x9E3779B97F4A7C15, dtype=np.uint64)
    for column in keys.T:
        state = (state ^ column) * np.uint64(0xBF58476D1CE4E5B9)
        state ^= state >> np.uint64(29)
    return state


def normalise_influences(
    joints: npt.NDArray[Any],
    weights: npt.NDArray[Any],
    *,
    adopting_sum: float,
    adopting_weight: float,
    tolerance: float,
    least: float,
) -> tuple[WeightField, WeightDefects]:
    """Return the weight field of stored influences (V, K), with the assumptions made.

    A vertex may adopt if its weights sum to more than ``adopting_sum``, its largest weight is more than
    ``adopting_weight``, and none is negative. It counts as not normalised if the sum is further than
    ``tolerance`` from 1. Weights below ``least`` of the vertex's largest count as 0.
    ``influences.weight_field`` has the policy.
    """
    joints, weights = joints.astype(np.int32), weights.astype(np.float64)
    # Weights that move nothing count as 0, and so do negative ones.
    largest = weights.max(axis=1, keepdims=True, initial=0.0)
    weights[(weights > 0) & (weights < least * largest)] = 0.0
    negative = weights < 0
    free = (weights == 0) & (largest > adopting_weight) & ~negative.any(axis=1, keepdims=True)
    weights[negative] = 0.0
    total = weights.sum(axis=1)
    free &= (total > adopting_sum)[:, None]
    # Without any weight the first joint has all of it.
    empty = total == 0
    weights[empty, 0] = 1.0
    total[empty] = 1.0
    # What was assumed, counted by vertex.
    # A joint that is named twice keeps the sum of its weights, in one slot.
    influences = joints.shape[1]
    merged = np.zeros(len(joints), dtype=np.bool_)
    for later in range(1, influences):
        for earlier in range(later):
            same = (joints[:, later] == joints[:, earlier]) & (joints[:, later] != NO_JOINT)
            if not same.any():
                continue
            merged |= same & (weights[:, later] > 0) & (weights[:, earlier] > 0)
            # The slot with a weight keeps the joint; of two such slots the earlier one takes both weights.
            moves_back = same & (weights[:, earlier] == 0) & (weights[:, later] > 0)
            keeps_first = same & ~moves_back
            weights[keeps_first, earlier] += weights[keeps_first, later]
            weights[keeps_first, later] = 0.0
            joints[keeps_first, later] = NO_JOINT
            joints[moves_back, earlier] = NO_JOINT
    repeated = int(np.count_nonzero(merged))
    defects = WeightDefects(
        negative=int(np.count_nonzero(negative.any(axis=1))),
        all_zero=int(np.count_nonzero(empty)),
        not_normalised=int(np.count_nonzero(np.abs(total - 1.0) > tolerance)),
        repeated_joint=repeated,
    )
    weights /= total[:, None]
    return WeightField(joints, weights, free), defects


def bake_surface(surface: Surface, *, weighting: str, adopt: bool) -> SurfaceSlots:
    """Return α and β of a surface. weighting is a key of ``corner.WEIGHTINGS``.

    With ``adopt``, joints of neighbours that vary around a vertex move into its free slots.
    """
    with np.errstate(
        over="ignore", invalid="ignore", divide="ignore"
    ):  # the compiled loops do not warn of NaN either
        # Bake the primitives one after the other, with the gradients of the whole surface.
        field, classes = surface.field, surface.classes
        # Gradients and turns are those of the weld classes, over all primitives.
        gradients = weight_gradients(
            surface.positions, surface.triangles, field, classes, weighting=weighting
        )
        capacity = shared_capacity(field, classes) if adopt else None
        tangents, bitangents = surface.frame or frame_from_normal(unit_normals(surface.normals))
        parts, start = [], 0
        for end in surface.ends:
            rows = slice(start, end)
            frame = (tangents[rows], bitangents[rows])
            room = None if capacity is None else capacity[rows]
            # The slots of the primitive: α, β and adopted joints.
            parts.append(assign(gradients, classes[rows], field.rows(rows), frame, room))
            start = end
        alpha, beta, adopted, named = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("alpha", "beta", "adopted", "named")
        )
        # The fit changes α and β of all primitives, and no slot.
        if surface.rig is not None:
            frame = tangents, bitangents
            vertices = FittedVertices(classes, field, named, surface.positions, frame, alpha, beta)
            alpha, beta = fitted(vertices, surface, gradients, ring_turns(surface))
        takes = (adopted != NO_JOINT).any(axis=1)
        adopting = np.flatnonzero(takes)
        takers = np.add.reduceat(takes, [0, *surface.ends[:-1]], dtype=np.int64)
        return SurfaceSlots(
            alpha=_stored(alpha),
            beta=_stored(beta),
            adopting=adopting,
            adopted=adopted[adopting],
            sums=np.array(
                [
                    [count, part.overflowing, part.magnitude, part.unheld]
                    for count, part in zip(takers, parts, strict=True)
                ]
            ),
        )


def _stored(slots: FloatArray) -> Float32Array:
    """Return the derivatives (V, K − 1) of all slots but the first as they are stored: no zero has a sign."""
    return slots[:, 1:].astype(np.float32) + np.float32(0.0)
