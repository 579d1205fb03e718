"""The operations of verify's kernel by its compiled loops, with arrays of the layout that they read.

The same operations in numpy, ``by_numpy``, describe the results.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import numpy.typing as npt

from skinbake.choices import Weighting
from skinbake.geometry.skinned import BoolArray, Float32Array, Float64Array, FloatArray
from skinbake.skinning.components import Vector
from skinbake.skinning.rest import RestPrimitive
from skinbake.truth import _loops as loops
from skinbake.truth.mesh import WeldedMesh
from skinbake.truth.normals import FLAT_FRAME, FLAT_TRIANGLE, ClassBlock, ClassSums, RestFrames
from skinbake.truth.values import BINS, CountedErrors, Forms, SparseRows

if TYPE_CHECKING:
    from skinbake.skinning.run import Skinning


def blend(forms: Forms, table: Float64Array, out: Float64Array, first_row: int = 0) -> None:
    """Write F of B vertices to rows of out (F, 3, V, P)."""
    loops.blend(*_taken(forms), table, out, first_row)


def blended_normals(forms: Forms, table: Float64Array, normals: FloatArray | None = None) -> Float64Array:
    """Return F × G of B vertices, or M⁻ᵀ n: (3, B, P)."""
    out = np.empty((3, len(forms.joints), table.shape[2]))
    loops.blended_normals(
        *_taken(forms),
        table,
        None if normals is None else np.ascontiguousarray(normals, dtype=np.float64),
        out,
    )
    return out


_Taken: TypeAlias = tuple[
    npt.NDArray[np.int32], Float64Array, Float64Array, Float64Array | None, Float64Array | None
]


def _taken(forms: Forms) -> _Taken:
    """Return joints, weights, points, directions and changes, in the types that the loops read."""
    return (
        np.ascontiguousarray(forms.joints, dtype=np.int32),
        np.ascontiguousarray(forms.weights, dtype=np.float64),
        np.ascontiguousarray(forms.points, dtype=np.float64),
        None if forms.directions is None else np.ascontiguousarray(forms.directions, dtype=np.float64),
        None if forms.changes is None else np.ascontiguousarray(forms.changes, dtype=np.float64),
    )


def dqs_positions(
    skinning: Skinning, pose: slice, part: slice, out: Float64Array, first_row: int = 0
) -> None:
    """Write p' by dual quaternions for some vertices to rows of out (3, V, P)."""
    if skinning.lacks_rotations:
        from skinbake.truth import by_numpy  # few clips hide a part

        return by_numpy.dqs_positions(skinning, pose, part, out, first_row)
    rest = skinning.vertices.rest.rows(part)
    return loops.dqs_positions(*_moved_by_dqs(skinning, rest), out, pose.start, first_row)


def dqs_normals(skinning: Skinning, pose: slice, part: slice) -> Float64Array:
    """Return the normals of algorithms 4–6 for some vertices: (3, 3, B, P). They are not of unit length."""
    if skinning.options.cap is not None or skinning.lacks_rotations:
        from skinbake.truth import by_numpy  # few ask for it, and few clips hide a part

        return by_numpy.dqs_normals(skinning, pose, part)
    rest = skinning.vertices.rest.rows(part)
    out = np.empty((3, 3, len(rest.joints), pose.stop - pose.start))
    frame = [vectors.T for vectors in (rest.normals, rest.tangents, rest.bitangents)]
    loops.dqs_normals(
        *_moved_by_dqs(skinning, rest),
        out,
        np.ascontiguousarray(frame, dtype=np.float64),
        np.ascontiguousarray(rest.alpha, dtype=np.float64),
        np.ascontiguousarray(rest.beta, dtype=np.float64),
        np.ascontiguousarray(rest.handedness(), dtype=np.float64),
        pose.start,
    )
    return out


_Moved: TypeAlias = tuple[
    Float64Array, Float64Array | None, npt.NDArray[np.int32], Float64Array, Float64Array
]


def _moved_by_dqs(skinning: Skinning, rest: RestPrimitive) -> _Moved:
    """Return motions, scales, joints, weights and positions, in the types that the loops read."""
    table, scale = skinning.motions.table, skinning.motions.scale
    return (
        np.ascontiguousarray(table, dtype=np.float64),
        None if scale is None else np.ascontiguousarray(scale, dtype=np.float64),
        np.ascontiguousarray(rest.joints, dtype=np.int32),
        np.ascontiguousarray(rest.weights, dtype=np.float64),
        np.ascontiguousarray(rest.positions, dtype=np.float64),
    )


def gradient_rows(mesh: WeldedMesh, part: slice, directions: Sequence[FloatArray]) -> SparseRows:
    """Return the derivatives of a block's vertices along D directions (B, 3): sparse (D B, V), stacked."""
    classes = mesh.classes[part]
    size, count = len(classes), len(directions)
    room = 3 * int((mesh.ends[classes + 1] - mesh.ends[classes]).sum())
    starts, columns = np.empty(size + 1, dtype=np.int32), np.empty(room, dtype=np.int32)
    values = np.empty((count, room))
    loops.gradient_rows(
        mesh.positions,
        mesh.triangles,
        mesh.corners,
        mesh.ends,
        classes,
        mesh.totals,
        np.ascontiguousarray(directions, dtype=np.float64),
        starts,
        columns,
        values,
        list(Weighting).index(mesh.weighting),
    )
    used = int(starts[-1])
    begins = np.concatenate([starts[:1], *(starts[1:] + number * used for number in range(count))])
    return SparseRows(begins, np.tile(columns[:used], count), values[:, :used].ravel())


def class_sums(mesh: WeldedMesh, positions: Float64Array, block: ClassBlock, sums: FloatArray) -> None:
    """Fill the sums (3, C, P) of a block of weld classes: Σ angle × unit normal over their corners."""
    loops.class_sums(
        np.ascontiguousarray(positions, dtype=np.float64),
        mesh.triangles,
        block.triangles,
        mesh.classes,
        sums,
        block.part.start,
        block.part.stop - block.part.start,
        FLAT_TRIANGLE,
    )


def true_normals(
    rest: RestFrames,
    number: int,
    positions: Float64Array,
    sides: Float64Array | None = None,
    by_triangles: ClassSums | None = None,
) -> tuple[Float64Array, BoolArray]:
    """Return the true normals (U, 3, B, P) of a block of vertices, and where they exist (U, B, P)."""
    part = rest.parts[number]
    shape = (1 if by_triangles is None else 2, 3, part.stop - part.start, positions.shape[2])
    normals, exist = np.empty(shape), np.empty((shape[0], *shape[2:]), dtype=np.bool_)
    along_t, along_b = rest.derivatives[number]
    loops.true_normals(
        along_t.starts,
        along_t.columns,
        along_t.values,
        along_b.starts,
        along_b.columns,
        along_b.values,
        np.ascontiguousarray(positions, dtype=np.float64),
        np.ascontiguousarray(rest.coefficients[:, part]),
        rest.areas[part],
        rest.valid[part],
        None if by_triangles is None else np.ascontiguousarray(by_triangles.carried[:, part]),
        None if by_triangles is None else by_triangles.classes[part],
        None if by_triangles is None else by_triangles.sums,
        None if sides is None else np.ascontiguousarray(sides.T, dtype=np.float64),
        normals,
        exist,
        FLAT_FRAME,
    )
    return normals, exist


def angles(measured: Vector, expected: Float64Array) -> Float32Array:
    """Return the angles (U, B, P), in degrees, between vectors of any length and unit vectors."""
    found = np.empty((expected.shape[0], *expected.shape[2:]), dtype=np.float32)
    x, y, z = (np.ascontiguousarray(component.T, dtype=np.float64) for component in measured)
    loops.angles(x, y, z, expected, found)
    return found


def count_errors(errors: FloatArray, weights: Float64Array, valid: BoolArray | None = None) -> CountedErrors:
    """Count errors (P, B) with weights (B,), where they are valid (P, B)."""
    bins = np.zeros(BINS)
    samples, undefined, weight, total, largest, pose, row = loops.count_errors(
        np.ascontiguousarray(errors.T, dtype=np.float32),
        np.ascontiguousarray(weights, dtype=np.float64),
        None if valid is None else np.ascontiguousarray(valid.T),
        bins,
    )
    return CountedErrors(samples, undefined, weight, total, largest, pose, row, bins)
