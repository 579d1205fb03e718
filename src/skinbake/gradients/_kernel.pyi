"""Types of the compiled loops: arrays are contiguous, of the element types named, filled where so said.

V vertices, K slots, T triangles, P primitives. Raises TypeError for another element type, ValueError for
another shape or number, IndexError for an index that is out of range.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from skinbake.geometry.skinned import FloatArray

BY_MAX: Final[int]
BY_ANGLE: Final[int]
BY_AREA: Final[int]
BY_ANGLE_AREA: Final[int]

class CollisionError(RuntimeError):
    """The hashes of rows collide beyond all chance: comparing the rows would take too long."""

def label_equal_rows(
    rows: npt.NDArray[np.generic],
    labels: npt.NDArray[np.int32],
    /,
) -> int:
    """Fill labels (V,): rows (V, M) that are equal have the same, numbered as they are met; return how many.

    rows holds float32, float64 (both with −0 = +0), int32, uint32 or uint64. Raises CollisionError, and
    leaves labels without meaning, where hashes collide.
    """

def normalise_influences(
    joints: npt.NDArray[np.int32],
    weights: npt.NDArray[np.float64],
    free: npt.NDArray[np.bool_],
    adopting_sum: float,
    tolerance: float,
    /,
) -> dict[str, int]:
    """Make stored influences (V, K) a weight field in place, fill free (V, K), and return the defects.

    The defects have the names of the fields of ``WeightDefects``.
    """

def mark_proper(
    positions: FloatArray,
    triangles: npt.NDArray[np.uint32],
    mask: npt.NDArray[np.bool_],
    least: float,
    /,
) -> None:
    """Fill mask (T,): which triangles (T, 3) have an area over ``least``."""

def bake_surface(
    *,
    positions: FloatArray,
    triangles: npt.NDArray[np.uint32],
    joints: npt.NDArray[np.int32],
    weights: npt.NDArray[np.float64],
    free: npt.NDArray[np.bool_],
    classes: npt.NDArray[np.int32],
    normals: FloatArray,
    tangents: FloatArray,
    bitangents: FloatArray,
    alpha: npt.NDArray[np.float32],
    beta: npt.NDArray[np.float32],
    adopted: npt.NDArray[np.int32],
    ends: npt.NDArray[np.uint64],
    sums: npt.NDArray[np.float64],
    class_count: int,
    weighting: int,
    adopts: bool,
    negligible: float,
) -> None:
    """Fill alpha, beta (V, K − 1) of a surface of P primitives, whose rows end at ``ends`` (P,).

    adopted (V, K) comes as zeros; 1 + joint is written where a slot adopts one. tangents and bitangents are
    (V, 3), or (0, 3) where the frame comes from normals. Fill sums (P, 4): vertices that adopt, vertices that
    overflow, summed gradient magnitude, its part that no slot holds. weighting is one of BY_MAX, BY_ANGLE,
    BY_AREA and BY_ANGLE_AREA.
    """
