"""Normals at which frames are hard to compute, and the frames that bake gives them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from skinbake.geometry import frames
from tests.shaders.running import Single


def awkward_normals() -> Single:
    """Random unit normals, and those where the formula is at its edges: n.z = 0, −0, ±1 and near −1."""
    rng = np.random.default_rng(0)
    wide = rng.normal(size=(100_000, 3))
    flat = rng.normal(size=(1_000, 3)) * [1, 1, 0]
    down = np.column_stack(
        [np.geomspace(1e-8, 0.1, 1_000)[:, None] * rng.normal(size=(1_000, 2)), -np.ones(1_000)]
    )
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    units = frames.unit_normals(np.concatenate([wide, flat, down, down * [1, 1, -1], axes]))
    below = flat.astype(np.float32)
    below = frames.unit_normals(below)
    below[:, 2] = -0.0
    return np.concatenate([units, below])


def expected(normals: Single) -> Single:
    return np.stack([normals, *frames.frame_from_normal(normals)], axis=1)


def different(found: Single, wanted: Single) -> npt.NDArray[np.bool_]:
    """Tell which vectors differ in a bit, the sign of a zero included."""
    bits = [np.ascontiguousarray(vectors).view(np.uint32) for vectors in (found, wanted)]
    return np.asarray((bits[0] != bits[1]).any(axis=2))
