"""Random surfaces that no modelling tool would make: all that readers of a mesh may forget to think of."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from skinbake.geometry.skinned import Float64Array, SkinnedPrimitive

Random = np.random.Generator


def odd_surface(seed: int) -> list[SkinnedPrimitive]:
    """Return one or two primitives of 4 to 60 vertices, in a unit from 1e-6 to 1e6.

    Points coincide or lie on a line, triangles meet in any number, and some vertices have none. Normals are
    opposite, zero of either sign, or NaN. Slots repeat joints; weights are negative, tiny, or all 0. Copies
    of a vertex have its influences in other slots.
    """
    random = np.random.default_rng(seed)
    unit, slots = 10.0 ** random.integers(-6, 7), int(random.choice([4, 8, 12]))
    return [_primitive(random, unit, slots) for _ in range(random.integers(1, 3))]


def _primitive(random: Random, unit: float, slots: int) -> SkinnedPrimitive:
    count = int(random.integers(4, 40))
    positions = _positions(random, count) * unit
    triangles = random.integers(0, count - random.integers(0, 3), (int(random.integers(1, 80)), 3))
    normals = _normals(random, count)
    joints = random.integers(0, random.choice([1, 2, 5, 20]), (count, slots))
    weights = _weights(random, count, slots)
    of = random.integers(0, count, count // 2)
    order = random.permuted(np.tile(np.arange(slots), (len(of), 1)), axis=1)
    copy = np.full(count, -1)
    copy[of] = count + np.arange(len(of))
    moves = (random.random(triangles.shape) < 0.3) & (copy[triangles] >= 0)
    return SkinnedPrimitive(
        np.concatenate([positions, positions[of]]).astype(np.float32),
        np.concatenate([normals, normals[of] * random.choice([-1.0, 1.0])]).astype(np.float32),
        None,
        np.concatenate([joints, np.take_along_axis(joints[of], order, axis=1)]),
        np.concatenate([weights, np.take_along_axis(weights[of], order, axis=1)]).astype(np.float32),
        np.where(moves, copy[triangles], triangles).astype(np.uint32),
    )


def _positions(random: Random, count: int) -> Float64Array:
    """Return points (V, 3): in space, near a line, on a grid, or on a grid in a plane."""
    if random.random() < 0.5:
        return np.asarray(random.normal(size=(count, 3)) * [1.0, *random.choice([[1.0, 1.0], [1e-4, 1e-8]])])
    return np.asarray(random.integers(0, 4, (count, 3)) * [1.0, 1.0, random.choice([0.0, 1.0])])


def _normals(random: Random, count: int) -> Float64Array:
    """Return normals (V, 3), all of one kind."""
    normals = random.normal(size=(count, 3))
    some = random.random(count) < 0.2
    match random.integers(0, 5):
        case 0:
            return np.asarray([0.0, 0.0, 1.0] * random.choice([-1.0, 1.0], (count, 1)))
        case 1:
            normals = np.round(normals)
            normals[some] = 0.0
        case 2:
            normals[some] = np.nan
        case 3:
            normals *= 10.0 ** random.integers(-30, 30, (count, 1))
        case _:
            normals[:] = normals[0]
    return normals


def _weights(random: Random, count: int, slots: int) -> Float64Array:
    """Return weights (V, K), as stored."""
    weights = random.random((count, slots))
    weights[_cells(random, weights, random.choice([0.0, 0.3, 0.7, 0.95]))] = 0.0
    weights[_cells(random, weights, random.choice([0.0, 0.1]))] = -0.1
    weights[_cells(random, weights, random.choice([0.0, 0.2]))] *= random.choice([1e-4, 1e-11])
    if random.random() < 0.5:
        return weights
    sums = weights.sum(axis=1, keepdims=True)
    return weights / np.where(sums > 0.0, sums, 1.0)


def _cells(random: Random, table: Float64Array, share: float) -> npt.NDArray[np.bool_]:
    return np.asarray(random.random(table.shape) < share)
