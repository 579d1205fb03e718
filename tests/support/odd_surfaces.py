"""Random surfaces that no modelling tool would make: all that readers of a mesh may forget to think of."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from skinbake.geometry.rig import Rig
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


def odd_rig(seed: int) -> Rig:
    """Return a rig of 20 joints in a chain, a star or a tree, stored in a pose that tears surfaces.

    Joint matrices are turned, mirror, flatten to a plane or a line, scale by 2, or by up to 1e15 either way.
    Pivots and translations are near, far, or both.
    """
    random, joints = np.random.default_rng(seed), 20
    above = np.arange(joints) - 1
    parents = [above, np.minimum(above, 0), random.integers(-1, above + 1)]
    far = 10.0 ** random.choice([0, 3, 6, 15])
    some, scales = random.random(joints) < 0.5, [0.0, 1.0, 1.0, -1.0, 2.0]
    matrices = np.tile(np.eye(3, 4), (joints, 1, 1))
    matrices[:, :, :3] *= random.choice(scales, (joints, 1, 3))
    matrices[some, :, :3] = np.linalg.qr(random.normal(size=(joints, 3, 3)))[0][some] @ matrices[some, :, :3]
    matrices[:, :, :3] *= random.choice([1.0, 1.0, 1.0, far, 1.0 / far], (joints, 1, 1))
    matrices[:, :, 3] = random.normal(size=(joints, 3)) * random.choice([0.0, 1.0, far], (joints, 1))
    return Rig(parents[seed % 3].astype(np.int32), random.normal(size=(joints, 3)), matrices[None])


def rough_sheet(seed: int) -> SkinnedPrimitive:
    """Return a bumpy sheet of 6 × 5 vertices, whose weights change at random between four of 20 joints."""
    random, count = np.random.default_rng(seed), 30
    x, y = np.meshgrid(np.arange(6.0), np.arange(5.0))
    corners = (np.arange(count).reshape(5, 6)[:-1, :-1]).reshape(-1, 1)
    weights = random.random((count, 4)) * (random.random((count, 4)) < random.choice([0.3, 0.7, 1.0]))
    return SkinnedPrimitive(
        np.stack([x.ravel(), y.ravel(), random.normal(size=count) * 0.3], axis=1).astype(np.float32),
        np.tile(np.array([0.0, 0.0, 1.0], dtype=np.float32), (count, 1)),
        None,
        random.integers(0, 20, (count, 4)),
        weights.astype(np.float32),
        np.concatenate([corners + np.array(offsets) for offsets in ([0, 1, 7], [0, 7, 6])]).astype(np.uint32),
    )
