"""Types of the compiled loops. Arrays are contiguous and have the named element types.

V vertices, K slots, T triangles, P primitives. Raises TypeError for another element type, ValueError for
another shape or number, IndexError for an index that is out of range.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from skinbake.geometry.skinned import FloatArray

VECTOR_BITS: Final[int]
"""128, 256 with AVX2, 512 with AVX-512: what the processor and the system have. Results are the same bits."""
BY_MAX: Final[int]
BY_ANGLE: Final[int]
BY_AREA: Final[int]
BY_ANGLE_AREA: Final[int]

class CollisionError(RuntimeError):
    """The hashes of rows collide more often than by chance. Comparing the rows would take too long."""

def label_equal_rows(
    rows: npt.NDArray[np.generic],
    labels: npt.NDArray[np.int32],
    /,
) -> int:
    """Fill labels (V,), and return their number. Equal rows (V, M) have the same label, in order from 0.

    rows holds float32, float64 (both with −0 = +0), int32, uint32 or uint64. Raises CollisionError if
    hashes collide. Then labels mean nothing.
    """

def normalise_influences(
    joints: npt.NDArray[np.int32],
    weights: npt.NDArray[np.float64],
    free: npt.NDArray[np.bool_],
    adopting_sum: float,
    adopting_weight: float,
    tolerance: float,
    least: float,
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
    """Fill mask (T,): whether each of the triangles (T, 3) has an area over ``least``."""

class Grouped:
    """The corners and vertices of a surface by weld class, a capsule. Only bake_surface reads it."""

def group_surface(
    triangles: npt.NDArray[np.uint32],
    joints: npt.NDArray[np.int32],
    weights: npt.NDArray[np.float64],
    classes: npt.NDArray[np.int32],
    class_count: int,
    /,
) -> Grouped:
    """Return the corners and vertices by weld class, for any number of calls of bake_surface."""

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
    parents: npt.NDArray[np.int32],
    ranks: npt.NDArray[np.int32],
    pivots: npt.NDArray[np.float64],
    chains: npt.NDArray[np.int32],
    poses: npt.NDArray[np.float64],
    shares: npt.NDArray[np.float64],
    class_count: int,
    weighting: int,
    adopts: bool,
    negligible: float,
    stiffness: float,
    turn: float,
    together: float,
    collapsed: float,
    ray: float,
    even: float,
    unfelt: float,
    narrow: float,
    flat: float,
    flat_tilt: float,
    bounded: float,
    small: float,
    grouped: Grouped | None,
    first: int,
    last: int,
) -> None:
    """Fill alpha, beta (V, K − 1) of a surface of P primitives, whose rows end at ``ends`` (P,).

    adopted (V, K) comes as zeros. If a slot adopts a joint, 1 + joint is written. tangents and bitangents are
    (V, 3), or (0, 3) if the frame comes from normals. Add to sums (P, 4): vertices that adopt, vertices that
    overflow, summed gradient magnitude, its part that no slot holds. weighting is one of BY_MAX, BY_ANGLE,
    BY_AREA and BY_ANGLE_AREA. poses (J, 48 G) are the upper rows of joint matrices in G groups of four poses,
    of which shares (4 G,) have parts in the mean. With groups of the surface, only the classes from first up
    to last are baked, and several threads may bake different classes at a time. Without, all are.
    """
