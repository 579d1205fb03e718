"""Weld the copies that glTF makes of a surface point, without welding across hard edges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from skinbake.geometry.frames import has_direction, unit_vectors
from skinbake.geometry.skinned import BoolArray, FloatArray, IntArray, bincount, blocks
from skinbake.gradients import kernel
from skinbake.gradients.surface import (
    NO_JOINT,
    Labels,
    WeightField,
    bit_patterns,
    first_rows,
    number_as_met,
)

PAIRED_GROUP = 32
"""Groups of at most this many distinct normals are compared pair by pair. Larger groups grow step by step."""

PAIRS = 1 << 16
"""The pairs that are compared at a time. Their vectors and the results take 10 MB."""

LINKED_GROUP = 4096
"""Points with more distinct normals than this weld equal normals only. Comparing all would take minutes."""

RIGID = np.float32(0.99)
"""The weight of its joint at each vertex of a rigid part. Tools leave traces of other joints there."""

ROUNDING = 1e-12
"""The slack in the length of a chord. The sides of a prism of 24 meet at 15°, the crease angle itself."""


def weld(positions: FloatArray, normals: FloatArray, field: WeightField, *, crease_angle: float) -> Labels:
    """Return the weld class (V,) of every vertex, numbered from 0.

    positions (V, 3) are in mesh space, normals (V, 3) of any length. field has the normalised weights of the
    same vertices. crease_angle is in radians. Two vertices are copies of one surface point if position (−0 =
    +0) and influences are equal, in any order of the slots. Copies are one class if their normals differ by
    at most the crease angle, or if a chain of such copies joins them. A normal without a direction welds only
    with an equal one: the same bits, but −0 is +0. At a point with more than LINKED_GROUP different normals,
    only equal normals weld. The result depends on neither vertex nor slot order, except for the numbers of
    the classes.
    """
    # Equal positions. Most vertices are alone there.
    labels = kernel.label_equal_rows(positions)
    if int(labels.max(initial=-1)) + 1 == len(labels):
        return labels
    # Of the others: equal influences too, and then equal normals.
    copies = np.flatnonzero(bincount(labels)[labels] > 1)
    # The keys (N, 1 + K) of N copies, position and influences.
    keys = np.empty((len(copies), 1 + field.joints.shape[1]), dtype=np.uint64)
    for rows in blocks(len(copies)):
        keys[rows, 0] = labels[copies[rows]]
        # Joint and float32 weight of every influence, in joint order, other slots last.
        part = field.rows(copies[rows])
        weights = np.ascontiguousarray(part.weights.astype(np.float32)).view(np.uint32).astype(np.uint64)
        influences = (part.joints.astype(np.uint64) << np.uint64(32)) | weights
        influences[part.weights == 0] = np.iinfo(np.uint64).max
        keys[rows, 1:] = np.sort(influences, axis=1)
    points = kernel.label_equal_rows(keys)
    oriented = kernel.label_equal_rows(_oriented_keys(points, normals, copies))
    # One row for each normal of a point is left to compare by angle.
    first = first_rows(oriented)
    distinct = normals[copies[first]]
    directions = np.where(has_direction(distinct)[:, None], unit_vectors(distinct), np.nan)
    linked = _link_by_angle(points[first], directions, crease_angle)
    # The labels of copies come after all others, so that none is used twice.
    labels[copies] = len(labels) + linked[oriented]
    return number_as_met(labels)


def rigid_parts_apart(
    classes: Labels, triangles: IntArray, field: WeightField, ends: Sequence[int]
) -> Labels:
    """Return the weld classes (V,) of a surface, with the copies in rigid parts in classes of their own.

    A part is what the triangles of one primitive connect over its weld classes. It is rigid if one joint has
    RIGID of all its weights. No pose bends it, so its normals at rest, moved along, are the true ones, also
    where it meets a bending part of another primitive. classes, triangles (T, 3), field and ends are those of
    ``Surface``.
    """
    owners = np.repeat(np.arange(len(ends)), np.diff(ends, prepend=0))
    if np.array_equal(owners[first_rows(classes)][classes], owners):
        return classes  # usual: no two primitives meet
    # Parts get the least number of the copies that they connect.
    copies = number_as_met(classes.astype(np.int64) * len(ends) + owners).astype(np.int32)
    corners = copies[triangles]
    parts = np.arange(int(copies.max()) + 1, dtype=np.int32)
    while True:
        before = parts.copy()
        np.minimum.at(parts, corners, parts[corners].min(axis=1, keepdims=True))
        parts = parts[parts]
        if np.array_equal(parts, before):
            break
    # A triangle bends if not one and the same joint moves its corners.
    slot = field.weights.argmax(axis=1)[:, None]
    leads = np.take_along_axis(field.joints, slot, axis=1)[:, 0]
    leads[np.take_along_axis(field.weights, slot, axis=1)[:, 0].astype(np.float32) < RIGID] = NO_JOINT
    first, second, third = leads[triangles].T
    bends = (first == NO_JOINT) | (first != second) | (first != third)
    # Copies without triangles are not drawn, and stay with those that bend.
    bending, rigid, meets = np.zeros((3, len(classes)), np.bool_)
    bending[parts[corners[bends, 0]]] = True
    rigid[corners[~bending[parts[corners[:, 0]]]]] = True
    meets[classes[triangles[bends]]] = True
    return number_as_met(2 * classes.astype(np.int64) + (rigid[copies] & meets[classes]))


def _oriented_keys(points: Labels, normals: FloatArray, copies: IntArray) -> npt.NDArray[np.unsignedinteger]:
    """Return the keys (N, 4) of N copies: equal for those of a surface point with equal normals."""
    wide = normals.dtype != np.float32
    keys: npt.NDArray[np.unsignedinteger] = np.empty((len(copies), 4), np.uint64 if wide else np.uint32)
    for rows in blocks(len(copies)):
        keys[rows, 0] = points[rows]
        keys[rows, 1:] = bit_patterns(normals[copies[rows]])
    return keys


def _link_by_angle(points: Labels, normals: npt.NDArray[np.float64], crease_angle: float) -> Labels:
    """Return single-linkage classes of rows that share a point and have normals within the angle."""
    # The rows of each point, one after the other.
    order = np.argsort(points, kind="stable")
    starts = np.flatnonzero(np.diff(points[order], prepend=-1))
    sizes = np.diff(np.append(starts, len(order)))
    labels = np.arange(len(points))
    # Small points: all of one size at once, by all pairs. Every row takes the least label that it can reach.
    for size in range(2, PAIRED_GROUP + 1):
        alike = order[starts[sizes == size][:, None] + np.arange(size)]
        for part in blocks(len(alike), PAIRS // size**2):
            members = alike[part]
            near = _within(normals[members][:, :, None], normals[members][:, None, :], crease_angle)
            near |= np.eye(size, dtype=np.bool_)
            local = np.tile(np.arange(size), (len(members), 1))
            # Labels spread along chains until none changes.
            while True:
                reached = np.where(near, local[:, None, :], size).min(axis=2)
                if np.array_equal(reached, local):
                    break
                local = reached
            labels[members] = np.take_along_axis(members, local, axis=1)
    # Large points: one by one. A class grows from a seed until no remaining row is near it.
    for start, size in zip(starts[sizes > PAIRED_GROUP], sizes[sizes > PAIRED_GROUP], strict=True):
        remaining = order[start : start + size] if size <= LINKED_GROUP else order[:0]
        while len(remaining):
            seed, frontier, remaining = remaining[0], [remaining[0]], remaining[1:]
            while frontier and len(remaining):
                near = _within(normals[remaining], normals[frontier.pop()], crease_angle)
                labels[remaining[near]] = seed
                frontier.extend(remaining[near])
                remaining = remaining[~near]
    return labels


def _within(first: npt.NDArray[np.float64], second: npt.NDArray[np.float64], angle: float) -> BoolArray:
    """Tell whether two unit vectors differ by at most an angle. Small angles are exact; NaN never fits."""
    chord = np.linalg.norm(first - second, axis=-1)
    return np.asarray(chord <= 2.0 * np.sin(angle / 2.0) + ROUNDING, dtype=np.bool_)
