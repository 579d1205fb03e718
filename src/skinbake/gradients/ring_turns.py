"""How the tangents of a mesh turn with its joints: the geometry of fit.py, once for each weld class.

The true normal of a deformed mesh tilts against the tangents of algorithm 3. This module finds the tilt r for
small turns of all joints, to first order, from the rest pose alone. ``fit`` fits α and β to it. The
letters are those of that page. ``loops/ring.h`` does the same; this module is the definition.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from skinbake.geometry.frames import frame_from_normal, has_direction, parts_along, unit_normals
from skinbake.geometry.skinned import BoolArray, Float64Array, IntArray, bincount
from skinbake.gradients.fit_rules import FLAT, NARROW
from skinbake.gradients.surface import Surface
from skinbake.gradients.weight_gradients import (
    ROOT,
    corner_differences,
    corners_of,
    steepest_slopes,
    summed_by_key,
    summed_rows,
)

MOST_CORNERS = 4096
"""The corners of triangles at one point. With more of them, its vertices keep their gradients."""


@dataclass(frozen=True, slots=True)
class RingTurns:
    """How the neighbourhoods of C weld classes turn with their joints, in rows like CSR.

    Class c has the entries offsets[c] … offsets[c + 1]. An entry is a joint i, and what its weight adds to r,
    the turn of the class's two tangents. With Δw = w_ki − w_i for the neighbours k, arms (E, 2, 3) are Σ Δw
    a_k, in 1 / length unit, and act through the lever from the pivot. spins (E, 2, 3) are Σ Δw e_k × a_k, and
    act by themselves. normals (C, 3) and tangents (C, 2, 3) are the orthonormal frames in which this holds.
    sound (C,) tells which classes can be fitted. slopes (C,) are the ``steepest_slopes``. areas (C,) are the
    summed lengths of the triangles' normals, twice their areas. derivatives (C, 2, 3) of the positions along
    the tangents and changes are what a pose needs of the ring.
    """

    offsets: IntArray
    joints: IntArray
    arms: Float64Array
    spins: Float64Array
    normals: Float64Array
    tangents: Float64Array
    sound: BoolArray
    slopes: Float64Array
    areas: Float64Array
    derivatives: Float64Array
    changes: WeightChanges


@dataclass(frozen=True, slots=True)
class WeightChanges:
    """How the weights change around C weld classes: E entries, each of a class and a joint.

    With the change Δw of the joint's weight along each edge e, and the coefficients g and h of the edge in
    both derivatives, coefficients (E, 2) are Σ Δw (g, h), and edges (E, 2, 3) are Σ Δw g e and Σ Δw h e.
    """

    classes: IntArray
    joints: IntArray
    coefficients: Float64Array
    edges: Float64Array


def ring_turns(surface: Surface) -> RingTurns:
    """Return the turns of all classes of a surface.

    The turn is that of the normal across the two derivatives of the positions. These are means over the
    triangles, with the weights ROOT: between those of both truths of verify.
    """
    classes = surface.classes.astype(np.int64)
    count = int(classes.max(initial=-1)) + 1
    # A unit normal (C, 3) of each class, and whether it has one.
    units = np.where(has_direction(surface.normals)[:, None], unit_normals(surface.normals), 0.0)
    corners = surface.triangles.ravel().astype(np.int64)
    sums = summed_rows(classes[corners], units[corners].astype(np.float64), count)
    lengths = np.linalg.norm(sums, axis=1)
    directed = lengths > FLAT * bincount(classes[corners], minlength=count)
    sums[~directed] = 0.0, 0.0, 1.0
    normals = unit_normals(sums).astype(np.float64)
    tangents = np.stack(frame_from_normal(normals.astype(np.float32)), axis=1).astype(np.float64)
    ring = _ring_sums(surface, classes, tangents)
    # In a class without an area all of this is NaN, and it is not sound.
    derivatives = ring.derivatives / ring.weights[:, None, None]
    # u and v of both tangents, and whether the ring has a plane at all.
    # The leverage: u and v of both tangents (C, 2, 2, 3), and the area between the derivatives (C,).
    a, b = derivatives[:, 0], derivatives[:, 1]
    c = np.cross(a, b)
    area = np.linalg.norm(c, axis=1)
    unit = c / area[:, None]
    # q without its factor t · ĉ / |c|: n less half of its part along ĉ.
    lean = normals - 0.5 * unit * np.einsum("ci,ci->c", unit, normals)[:, None]
    leverage = np.empty((len(a), 2, 2, 3))
    for number in range(2):
        t = tangents[:, number]
        # The parts of t along a and b.
        t_a, t_b = parts_along(t, a, b).T
        q = (np.einsum("ci,ci->c", t, unit) / area)[:, None] * lean
        # u = t_a n + b × q, v = t_b n + q × a.
        leverage[:, number, 0] = t_a[:, None] * normals + np.cross(b, q)
        leverage[:, number, 1] = t_b[:, None] * normals + np.cross(q, a)
    alignment = np.nan_to_num(np.linalg.norm(ring.faces, axis=1) / ring.areas)
    sound = (area > NARROW) & (alignment > FLAT) & (ring.areas > FLAT * ring.lengths) & directed
    sound &= bincount(classes[surface.triangles.ravel()], minlength=count) <= MOST_CORNERS
    # What the turn of a joint does by Δw g (arms) and by Δw g e (spins).
    owner = np.repeat(np.arange(count), np.diff(ring.offsets))
    changes = np.where(sound[owner, None], ring.changes / ring.weights[owner, None], 0.0)
    by_coefficient, by_edge = changes[:, :2], changes[:, 2:].reshape(-1, 2, 3)
    own = np.where(sound[owner, None, None, None], leverage[owner], 0.0)
    arms = np.einsum("ed,etdi->eti", by_coefficient, own)
    spins = np.cross(by_edge[:, None], own).sum(axis=2)
    # Joints whose weight does not change take no part in a pose.
    some = np.flatnonzero(changes.any(axis=1))
    return RingTurns(
        ring.offsets,
        ring.joints,
        arms,
        spins,
        normals,
        tangents,
        sound,
        slopes=steepest_slopes(surface.positions, surface.triangles, surface.field, classes),
        areas=ring.areas,
        derivatives=derivatives,
        changes=WeightChanges(owner[some], ring.joints[some], by_coefficient[some], by_edge[some]),
    )


@dataclass(frozen=True, slots=True)
class _RingSums:
    """Sums over the corners of C weld classes, not yet divided by the weights of the corners (C,).

    derivatives (C, 2, 3) are those of the positions along both tangents. faces (C, 3) is the sum of the
    triangles' normals, each as long as twice its area, and areas (C,) that of their lengths. lengths (C,) is
    the sum of the products of both edges' lengths. Class c has the entries offsets[c] … offsets[c + 1], each
    of a joint. changes (E, 8) sum up the change Δw of its weight along each edge e, times the coefficients
    of the edge: Σ Δw (g, h), then Σ Δw g e and Σ Δw h e.
    """

    weights: Float64Array
    derivatives: Float64Array
    faces: Float64Array
    areas: Float64Array
    lengths: Float64Array
    offsets: IntArray
    joints: IntArray
    changes: Float64Array


def _ring_sums(surface: Surface, classes: IntArray, tangents: Float64Array) -> _RingSums:
    """Sum up the corners of all classes, whose tangents are (C, 2, 3)."""
    count = len(tangents)
    weights, areas, lengths = np.zeros(count), np.zeros(count), np.zeros(count)
    derivatives, faces = np.zeros((count, 2, 3)), np.zeros((count, 3))
    keys, values = [], []
    joint_count = int(surface.field.joints.max(initial=0)) + 1
    for corners in corners_of(surface.positions, surface.triangles, ROOT):
        at = classes[corners.origin]
        # Sums over the corner itself.
        weights += bincount(at, corners.weight, count)
        areas += bincount(at, np.linalg.norm(corners.faces, axis=1), count)
        lengths += bincount(at, np.linalg.norm(corners.edges, axis=2).prod(axis=0), count)
        faces += _summed(at, corners.faces, count)
        for neighbour, edges, coefficients in corners.ends():
            along = np.einsum("cti,ci->ct", tangents[at], coefficients)  # g and h
            products = along[:, :, None] * edges[:, None, :]
            derivatives += _summed(at, products, count)
            # The change of each joint's weight along the edge.
            corner, joints, difference = corner_differences(surface.field, corners.origin, neighbour)
            added = np.concatenate([along, products.reshape(-1, 6)], axis=1)
            # The eight numbers of a joint: Δw (g, h), then Δw g e and Δw h e.
            keys.append(at[corner] * joint_count + joints)
            values.append(added[corner] * difference[:, None])
    offsets, joints, changes = summed_by_key(keys, values, joint_count, count)
    return _RingSums(weights, derivatives, faces, areas, lengths, offsets, joints, changes)


def _summed(at: IntArray, values: Float64Array, count: int) -> Float64Array:
    """Sum rows of values (N, …) by their class."""
    flat = values.reshape(len(values), math.prod(values.shape[1:]))
    sums = summed_rows(at, flat, count)
    return sums.reshape(count, *values.shape[1:])
