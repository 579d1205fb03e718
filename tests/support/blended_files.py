"""Models whose vertices have blend weights of linear blending and dual quaternions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tests.support.baked_files import Editable

NAME = "_BLEND"

Wave = Callable[[npt.NDArray[np.float64]], npt.NDArray[np.float64]]


def waves(positions: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Blend weights (V,) from 0.1 to 0.9 that vary over the model a few times."""
    size = np.ptp(positions, axis=0).max()
    found: npt.NDArray[np.float64] = 0.5 + 0.4 * np.sin(positions @ [7.0, 5.0, 4.0] / size)
    return found


def with_blend_weights(
    path: Path, target: Path, weights: Wave = waves, *, without: tuple[int, ...] = ()
) -> Path:
    """Write a model whose first mesh has blend weights, but for the primitives ``without``."""
    file = Editable(path)
    for number, primitive in enumerate(file.content["meshes"][0]["primitives"]):
        if number not in without:
            positions = file.array("POSITION", number).astype(np.float64)
            accessor = file.add(weights(positions).astype(np.float32)[:, None])
            primitive["attributes"][NAME] = accessor
    return file.write(target)
