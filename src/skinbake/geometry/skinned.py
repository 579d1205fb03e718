"""The arrays that the parts exchange: a skinned primitive before and after baking.

docs/reference/units.md defines units and frames, CONTRIBUTING.md the letters of axes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

FloatArray: TypeAlias = npt.NDArray[np.floating]
Float64Array: TypeAlias = npt.NDArray[np.float64]
Float32Array: TypeAlias = npt.NDArray[np.float32]
IntArray: TypeAlias = npt.NDArray[np.integer]
BoolArray: TypeAlias = npt.NDArray[np.bool_]

TINY_WEIGHT = np.float32(2.0**-30)
"""FLOAT weight of an adopted slot. Other weights stay; the sum grows by a billionth for each slot."""

UNIT = 65535
"""Integer weights are stored as unsigned shorts. An adopted slot has 1, and the largest weight loses 1."""


def bincount(
    groups: IntArray, weights: FloatArray | None = None, minlength: int = 0
) -> npt.NDArray[np.intp | np.float64]:
    """Return numpy's ``bincount`` of integers of any size: systems of 32 bits do not take those of 64."""
    return np.bincount(groups.astype(np.intp, copy=False), weights, minlength)


def not_finite(vector: FloatArray) -> str:
    """Return which component (C ≤ 4) of a vector is the first that is not a finite number: "y is NaN"."""
    number = int(np.isfinite(vector).argmin())
    return f"{'xyzw'[number]} is {'NaN' if np.isnan(vector[number]) else 'infinite'}"


class Straightened(NamedTuple):
    """The vertices whose tangents were straightened, and the largest lean of any before that, in degrees.

    not_finite are those of them whose tangent was not finite, each with words that tell of its component.
    unhanded are those of the others whose w was neither 1 nor −1. Neither count for the lean.
    """

    vertices: tuple[int, ...]
    lean: float
    unhanded: tuple[int, ...] = ()
    not_finite: tuple[tuple[int, str], ...] = ()


@dataclass(frozen=True, slots=True)
class SkinnedPrimitive:
    """One skinned primitive of a mesh, as the vertex shader reads it, in mesh space.

    positions (V, 3) float32 or float64, length unit of POSITION. normals (V, 3), any length. tangents (V, 4),
    w is the handedness, or None. joints (V, K) integer. weights (V, K) as stored: normalised integers are
    decoded, and the sum is not corrected yet. triangles (T, 3) integer, every index < V, with strips and fans
    unrolled in winding order. K is 4 × the number of influence sets. straightened tells of tangents that are
    not those of the file. stored_joints are the file's joints, if a vertex without weight counts for another.
    """

    positions: FloatArray
    normals: FloatArray
    tangents: FloatArray | None
    joints: IntArray
    weights: FloatArray
    triangles: IntArray
    straightened: Straightened | None = None
    stored_joints: IntArray | None = None

    def with_influences(self, joints: IntArray, weights: FloatArray) -> SkinnedPrimitive:
        """Return the primitive with other joints and weights, each (V, K)."""
        return replace(self, joints=joints, weights=weights, stored_joints=None)


class BakedPrimitive(NamedTuple):
    """The bake of one primitive.

    alpha, beta (V, K − 1) float32, 1 / length unit of POSITION: ∇w · t0 and ∇w · b0 of slots 1 … K − 1. The
    values of slot 0 are minus their sum. adopting (A,) are the vertices that adopt joints, ascending. adopted
    (A, K) integer is the joint that each of their slots adopts, −1 for none. frame is ``tangent`` or
    ``normal``. classes (V,) are the weld classes of the vertices, as numbered over the whole surface.
    """

    alpha: Float32Array
    beta: Float32Array
    adopting: IntArray
    adopted: IntArray
    frame: str
    classes: IntArray

    @property
    def adopted_joints(self) -> IntArray:
        """Return the joint that each slot of each vertex (V, K) adopts, −1 for none."""
        joints = np.full((len(self.alpha), self.alpha.shape[1] + 1), -1, dtype=np.int32)
        joints[self.adopting] = self.adopted
        return joints

    def with_slots(self, alpha: FloatArray, beta: FloatArray) -> BakedPrimitive:
        """Return the bake with other α and β (V, K − 1), stored as float32."""
        with np.errstate(over="ignore"):  # the bake checks that all are finite
            return self._replace(alpha=alpha.astype(np.float32), beta=beta.astype(np.float32))

    @property
    def adopts(self) -> bool:
        """Tell whether any slot adopts a joint."""
        return len(self.adopting) > 0


ROWS = 1 << 14


def blocks(count: int, rows: int = ROWS) -> Iterator[slice]:
    """Yield slices that cover ``count`` rows in order."""
    for start in range(0, count, rows):
        yield slice(start, min(start + rows, count))
