"""The neighbours of vertices that a recompute of normals needs, and how authored normals stand to them.

Copies of a vertex at a seam have one position and one normal of the surface. Each class of copies is
represented by its first vertex, so that seams do not show.

The surface frame of a vertex is made of n, the mean of its triangles' unit normals weighted by their angles
there, and of the edge to its first neighbour. In the rest pose the frame of the authored normal is a turned
surface frame. The recompute applies the same turn to the surface frame of the pose. ``skinbake verify``
carries the authored normal along in this way too, with a tangent in place of the edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skinbake.geometry import frames
from skinbake.geometry.dual_quaternions import dual_quaternions_from_matrices

START = np.uint32(1 << 31)
"""The mark of the first neighbour of a fan."""

Floats = npt.NDArray[np.floating]
Integers = npt.NDArray[np.integer]
Unsigned = npt.NDArray[np.uint32]


@dataclass(frozen=True, slots=True)
class Adjacency:
    """What the two ways of recomputing read.

    triangles (T, 3): the first copies of the corners. places (V, 2): the first copy of a vertex, and its
    first neighbour. ranges (V, 2): where the neighbours of a vertex begin and end in ``ring``. ring (R,): the
    neighbours in turn; two in sequence and the vertex are a triangle, unless the second has the mark START.
    turns (V, 4): the quaternions (x, y, z, w) from the surface frame to the frame of the authored normal.
    """

    triangles: Unsigned
    places: Unsigned
    ranges: Unsigned
    ring: Unsigned
    turns: npt.NDArray[np.float32]

    @classmethod
    def of(cls, positions: Floats, normals: Floats, triangles: Integers, classes: Integers) -> Adjacency:
        """Find the neighbours in a mesh at rest."""
        _, firsts, numbers = np.unique(classes, return_index=True, return_inverse=True)
        copies = firsts[numbers]
        welded = copies[triangles]
        ring, ranges = _rings(welded, len(positions))
        # A vertex without triangles gets itself as a neighbour, and with it no normal.
        starts = np.minimum(ranges[:, 0], max(len(ring) - 1, 0))
        alone = ranges[:, 0] == ranges[:, 1]
        edges = np.where(alone, np.arange(len(positions)), ring[starts] & ~START)[copies]
        turns = _turns(positions.astype(np.float64), normals, welded, copies, edges)
        return cls(
            welded.astype(np.uint32),
            np.column_stack([copies, edges]).astype(np.uint32),
            ranges[copies].astype(np.uint32),
            ring,
            turns,
        )


def _rings(triangles: Integers, count: int) -> tuple[Unsigned, Integers]:
    """Return the neighbours of every vertex in turn, and where those of each begin and end (V, 2)."""
    centres, following, preceding = (np.roll(triangles, -turn, axis=1).ravel() for turn in range(3))
    fans, places = _fans(centres * count + following, centres * count + preceding)
    # A fan has one neighbour more than triangles, and fans lie vertex by vertex.
    sizes = np.bincount(fans) + 1 if fans.size else np.zeros(0, np.int64)
    owners = np.zeros(len(sizes), np.int64)
    owners[fans] = centres
    order = np.argsort(owners, kind="stable")
    begins = np.empty(len(sizes), np.int64)
    begins[order] = np.cumsum(sizes[order]) - sizes[order]
    ring = np.empty(int(sizes.sum()), np.uint32)
    ring[begins[fans] + places + 1] = preceding
    first = places == 0
    ring[begins[fans[first]]] = following[first].astype(np.uint32) | START
    ends = np.cumsum(np.bincount(owners, sizes, minlength=count)).astype(np.int64)
    return ring, np.column_stack([np.concatenate([[0], ends[:-1]]), ends])


def _fans(begins: Integers, ends: Integers) -> tuple[Integers, Integers]:
    """Chain corners whose end is another one's begin: the number of each corner's fan, and its place there.

    begins and ends (N,) tell the vertex and one of its edges. A closed fan starts at any of its corners.
    A fan ends where more than two triangles share an edge.
    """
    order = np.argsort(begins, kind="stable")
    found = np.minimum(np.searchsorted(begins[order], ends), len(begins) - 1)
    successors = np.where(begins[order][found] == ends, order[found], -1) if len(begins) else found
    # Of several corners before one, only the last keeps it.
    before = np.full(len(begins) + 1, -1)
    before[successors] = np.arange(len(begins))
    successors = np.where(before[successors] == np.arange(len(begins)), successors, -1)
    has_predecessor = np.zeros(len(begins) + 1, np.bool_)
    has_predecessor[successors] = True
    fans, places = np.full(len(begins), -1), np.zeros(len(begins), np.int64)
    count = 0
    for closed in (False, True):
        # Open fans start at the corners that follow none. All corners that are left then are in loops.
        starts = _one_of_each_loop(fans, successors) if closed else np.flatnonzero(~has_predecessor[:-1])
        current, numbers, place = starts, np.arange(count, count + len(starts)), 0
        while current.size:
            fans[current], places[current] = numbers, place
            current, place = successors[current], place + 1
            goes_on = (current >= 0) & (fans[current] < 0)
            current, numbers = current[goes_on], numbers[goes_on]
        count += len(starts)
    return fans, places


def _one_of_each_loop(fans: Integers, successors: Integers) -> Integers:
    """Return the lowest corner of each closed fan that has no number yet."""
    left = np.flatnonzero(fans < 0)
    lowest, jump = np.arange(len(fans)), successors.copy()
    # Each step looks twice as far ahead: 32 steps see the largest fan that there can be.
    while left.size:
        further = np.minimum(lowest[left], lowest[jump[left]])
        if (further == lowest[left]).all():
            break
        lowest[left], jump[left] = further, jump[jump[left]]
    first: Integers = left[lowest[left] == left]
    return first


def _turns(
    positions: npt.NDArray[np.float64],
    normals: Floats,
    triangles: Integers,
    copies: Integers,
    edges: Integers,
) -> npt.NDArray[np.float32]:
    """Return the quaternions from the surface frames at rest to the frames of the authored normals."""
    surface = _surface_frames(positions, triangles, copies, edges)
    tangents, bitangents = frames.frame_from_normal(normals)
    authored = np.stack([tangents, bitangents, normals], axis=2).astype(np.float64)
    matrices = np.tile(np.eye(4), (len(positions), 1, 1))
    matrices[:, :3, :3] = np.swapaxes(surface, 1, 2) @ authored
    broken = ~np.isfinite(matrices).all(axis=(1, 2))
    matrices[broken] = np.eye(4)
    return dual_quaternions_from_matrices(matrices).reshape(-1, 8)[:, [1, 2, 3, 0]].astype(np.float32)


def _surface_frames(
    positions: npt.NDArray[np.float64], triangles: Integers, copies: Integers, edges: Integers
) -> npt.NDArray[np.float64]:
    """Return the surface frames (V, 3, 3), axes in columns, NaN for a vertex without one."""
    sums = np.zeros_like(positions)
    with np.errstate(invalid="ignore", divide="ignore"):  # of a triangle without an area
        for turn in range(3):
            here, one, other = (positions[corner] for corner in np.roll(triangles, -turn, axis=1).T)
            normal = np.cross(one - here, other - here)
            area = np.linalg.norm(normal, axis=1)
            angle = np.arctan2(area, np.einsum("ti,ti->t", one - here, other - here))
            share = np.where(area > 0, angle / area, 0.0)[:, None] * normal
            for axis in range(3):
                sums[:, axis] += np.bincount(triangles[:, turn], share[:, axis], minlength=len(positions))
        n = sums[copies] / np.linalg.norm(sums[copies], axis=1, keepdims=True)
        edge = positions[edges] - positions[copies]
        t = edge - np.einsum("vi,vi->v", edge, n)[:, None] * n
        t /= np.linalg.norm(t, axis=1, keepdims=True)
    return np.stack([t, np.cross(n, t), n], axis=2)
