"""Types of verify's compiled loops: arrays are contiguous and aligned, of the named element types.

B vertices of a block, V all vertices, P poses, C weld classes, T triangles, U truths. Raises
TypeError for another element type, ValueError for another shape, IndexError for an index out of range.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from skinbake.geometry.skinned import BoolArray, Float32Array, Float64Array, FloatArray

VECTOR_BITS: Final[int]
"""As in ``gradients/_kernel.pyi``."""

def blend(
    joints: npt.NDArray[np.int32],
    weights: Float64Array,
    points: Float64Array,
    directions: Float64Array | None,
    changes: Float64Array | None,
    table: Float64Array,
    out: Float64Array,
    first_row: int,
    /,
) -> None:
    """Fill the rows of out (F, 3, V, P) from ``first_row`` on with F forms of B vertices, those of ``Forms``.

    joints, weights (B, K), points (B, 3), directions (F, B, 3), changes (F, B, K). Row 4 j + i of table
    (R, 3, P) is column i of the matrices of joint j.
    """

def blended_normals(
    joints: npt.NDArray[np.int32],
    weights: Float64Array,
    points: Float64Array,
    directions: Float64Array | None,
    changes: Float64Array | None,
    table: Float64Array,
    normals: Float64Array | None,
    out: Float64Array,
    /,
) -> None:
    """Fill out (3, B, P) with the cross product of two forms, each blended as by ``blend``.

    With normals (B, 3), the forms are the three columns of a matrix M, and out is M⁻ᵀ n, or cof(M) n if
    det M is 0. One of directions and changes must be given.
    """

def dqs_positions(
    motions: Float64Array,
    scales: Float64Array | None,
    joints: npt.NDArray[np.int32],
    weights: Float64Array,
    positions: Float64Array,
    out: Float64Array,
    first: int,
    first_row: int,
    /,
) -> None:
    """Fill the rows of out (3, V, P) from ``first_row`` on with the positions by dual quaternions.

    The poses are the P from ``first`` on. motions (8, J, Q) are dual quaternions in Q poses, scales (Q,) the
    scale of each pose. Or motions (20, J, Q) are ``scaled_motions``, row by row, and scales are ignored.
    joints and weights (B, K). positions (B, 3).
    """

def dqs_normals(
    motions: Float64Array,
    scales: Float64Array | None,
    joints: npt.NDArray[np.int32],
    weights: Float64Array,
    positions: Float64Array,
    out: Float64Array,
    frame: Float64Array,
    alpha: Float64Array,
    beta: Float64Array,
    handedness: Float64Array,
    first: int,
    /,
) -> None:
    """Fill out (3, 3, B, P) with the normals of algorithms 4, 5 and 6, in P poses from ``first`` on.

    frame (3, 3, B) has the components of normals, tangents and bitangents. alpha and beta (B, K − 1).
    handedness (B,) is 1 or −1. The other arguments are those of ``dqs_positions``.
    """

def gradient_rows(
    positions: Float64Array,
    triangles: npt.NDArray[np.int32],
    corners: npt.NDArray[np.int32],
    ends: npt.NDArray[np.int64],
    classes: npt.NDArray[np.int32],
    totals: Float64Array,
    directions: Float64Array,
    starts: npt.NDArray[np.int32],
    columns: npt.NDArray[np.int32],
    values: Float64Array,
    weighting: int,
    /,
) -> None:
    """Fill the rows of B vertices: columns and, by direction, values, from starts[b] to starts[b + 1].

    positions (V, 3), triangles (T, 3), corners (N,), ends (C + 1,), totals (C,) are those of an operator,
    classes (B,) those of the vertices. directions (D, B, 3). starts (B + 1,), columns (M,), values (D, M).
    Each corner of a class takes at most three entries. weighting is the number of a ``Weighting``.
    """

def class_sums(
    positions: Float64Array,
    triangles: npt.NDArray[np.int32],
    met: npt.NDArray[np.int32],
    classes: npt.NDArray[np.int32],
    sums: FloatArray,
    first_class: int,
    class_count: int,
    flat: float,
    /,
) -> None:
    """Fill the sums (3, C, P) of ``class_count`` classes from ``first_class`` on: Σ angle × unit normal.

    sums are of all classes. With float64, angles are good to a few units of the last place; with float32, to
    a few units of float32. positions (3, V, P). triangles (T, 3). classes (V,). met (N,) are the triangles
    with a corner in these classes, each once, in ascending order. A triangle with a larger cotangent than
    ``flat`` adds nothing.
    """

def true_normals(
    t_starts: npt.NDArray[np.int32],
    t_columns: npt.NDArray[np.int32],
    t_values: Float64Array,
    b_starts: npt.NDArray[np.int32],
    b_columns: npt.NDArray[np.int32],
    b_values: Float64Array,
    positions: Float64Array,
    coefficients: Float64Array,
    areas: Float64Array,
    valid: BoolArray,
    carried: Float64Array | None,
    classes: npt.NDArray[np.int32] | None,
    sums: Float32Array | None,
    sides: Float64Array | None,
    normals: Float64Array,
    exist: BoolArray,
    flat: float,
    /,
) -> None:
    """Fill normals (U, 3, B, P) and exist (U, B, P): by tangents, and by triangles if ``carried`` is given.

    starts (B + 1,), columns and values are the sparse rows of the derivatives along t0 and b0. positions
    (3, V, P). coefficients (3, B), areas and valid (B,) are those of ``RestFrames``. carried (3, B) are the
    coordinates of ``CarriedNormals``, classes (B,) the rows of the vertices in sums (3, C, P). sides (B, P).
    """

def angles(
    x: Float64Array, y: Float64Array, z: Float64Array, expected: Float64Array, angles: Float32Array, /
) -> None:
    """Fill angles (U, B, P), degrees, between vectors of components (B, P) and unit ones (U, 3, B, P)."""

def count_errors(
    errors: Float32Array,
    weights: Float64Array,
    valid: BoolArray | None,
    bins: Float64Array,
    /,
) -> tuple[int, int, float, float, float, int, int]:
    """Count errors (B, P) with weights (B,), and add the weight of each to its bin.

    Return samples, undefined ones, the counted weight, the weighted sum, the largest error (−1: none), its
    pose and its row.
    """
