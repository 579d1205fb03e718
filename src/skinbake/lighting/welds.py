"""The vertices of a mesh that are one point of its surface. glTF splits a vertex if any attribute differs.

Rows are numbered by sorting. Chains of similar normals are the connected components of a graph.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from skinbake.geometry.skinned import BoolArray, Float64Array, SkinnedPrimitive
from skinbake.lighting.influences import Int64Array, influence_keys

BYTES_A_PAIR = 64
"""The bytes of a pair of vertices that may be one: two indices, four times over."""

CROWDED = 32
"""The number of vertices at one place from which SciPy looks for pairs, because all pairs are too many.

Real meshes have only a few. Importing SciPy takes longer than the welding of most meshes.
"""

MOST_NORMALS = 4096
"""The number of different normals at one point above which only equal ones weld, as in bake."""

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
    than MOST_NORMALS different ones. ``claim`` is called with the number of bytes that the pairs at crowded
    places take, before they are listed.
    """
    positions = np.concatenate([primitive.positions for primitive in primitives]).astype(np.float64)
    with np.errstate(invalid="ignore"):  # a NaN may be signalling
        normals = np.concatenate([primitive.normals for primitive in primitives]).astype(np.float64)
    joints, shares = influence_keys(primitives)
    # Adding zero turns −0 into +0. Then the rows are compared bit by bit, so that NaN is a value like any
    # other.
    places = _row_numbers(np.hstack([(positions + 0.0).view(np.int64), joints, shares.view(np.int32)]))
    # Identical copies collapse here. Few pairs are left to compare by angle.
    nodes = _row_numbers(np.column_stack([places, (normals + 0.0).view(np.int64)]))
    firsts = _first_rows(nodes)
    pairs = _close_pairs(places[firsts], normals[firsts], np.radians(crease_angle_degrees), claim)
    return _by_first_vertex(_components(pairs, len(firsts))[nodes])


def _by_first_vertex(classes: Int64Array) -> Int64Array:
    """Renumber classes in the order of their first vertices: neighbours are then near in memory too."""
    firsts = _first_rows(classes)
    numbers = np.empty(len(firsts), dtype=np.int64)
    numbers[np.argsort(firsts)] = np.arange(len(firsts))
    return numbers[classes]


def _first_rows(numbers: Int64Array) -> Int64Array:
    """Return the first row that has each number (V,) from 0 without gaps."""
    firsts = np.full(int(numbers.max(initial=-1)) + 1, len(numbers))
    np.minimum.at(firsts, numbers, np.arange(len(numbers)))
    return firsts


def _row_numbers(rows: Int64Array) -> Int64Array:
    """Give equal rows equal numbers, (V,) from 0 without gaps."""
    hashes = _hashes(rows)
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


def _hashes(rows: Int64Array) -> npt.NDArray[np.uint64]:
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
    counts = np.bincount(places, minlength=len(places))
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
    if counts.max(initial=0) > CROWDED:
        return _pairs_in_crowds(candidates, places[candidates], directions, chord, claim)
    order = np.argsort(places[candidates], kind="stable")
    candidates, directions = candidates[order], directions[order]
    at = places[candidates]
    found = [np.zeros((0, 2), dtype=np.int64)]
    for step in range(1, int(counts.max(initial=0))):
        first = np.flatnonzero(at[:-step] == at[step:])
        apart = np.linalg.norm(directions[first] - directions[first + step], axis=1)
        first = first[apart <= chord]
        found.append(np.column_stack([candidates[first], candidates[first + step]]))
    return np.concatenate(found)


def _pairs_in_crowds(
    candidates: Int64Array,
    at: Int64Array,
    directions: Float64Array,
    chord: float,
    claim: Callable[[int], None],
) -> Int64Array:
    """List pairs of candidates, by their places and unit normals, without a look at all of them."""
    from scipy.spatial import cKDTree

    # Places lie 4 apart on the first axis, and normals within 2 of each other. So only pairs at one place are
    # near.
    tree = cKDTree(np.column_stack([4.0 * at, directions]))
    claim(BYTES_A_PAIR * int(tree.count_neighbors(tree, chord)) // 2)
    close: Int64Array = candidates[tree.query_pairs(chord, output_type="ndarray")]
    return close


def _components(pairs: Int64Array, count: int) -> Int64Array:
    """Return the number of each node's connected component: (V,) from 0 without gaps."""
    labels = np.arange(count)
    if len(pairs) > CROWDED * count:
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
        return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)
    while True:
        lowest = labels[pairs].min(axis=1, initial=count)
        before = labels.copy()
        for end in range(2):
            np.minimum.at(labels, pairs[:, end], lowest)
        labels = labels[labels]
        if np.array_equal(labels, before):
            return np.unique(labels, return_inverse=True)[1].astype(np.int64)
