"""The operations of verify's kernel by whole arrays of numpy. They define the compiled loops' results."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skinbake.geometry.skinned import BoolArray, Float32Array, Float64Array, FloatArray
from skinbake.skinning.components import Rows, Vector, cofactors, cross, dot, linear, quotient, scaled
from skinbake.skinning.rest import Algorithm
from skinbake.skinning.run import Skinning
from skinbake.truth.areas import angles_of_units, units_or_nan
from skinbake.truth.mesh import Int32Array, WeldedMesh, weights_of_corners
from skinbake.truth.normals import (
    ClassBlock,
    ClassSums,
    RestFrames,
    block_sums,
    posed_tangents,
    sums_of_classes,
    tangent_normals,
    triangle_normals,
)
from skinbake.truth.values import BINS, CountedErrors, Forms, SparseRows, bin_of

__all__ = [
    "angles",
    "blend",
    "blended_normals",
    "class_sums",
    "count_errors",
    "dqs_normals",
    "dqs_positions",
    "gradient_rows",
    "true_normals",
]


def blend(forms: Forms, table: Float64Array, out: Float64Array, first_row: int = 0) -> None:
    """Write F of B vertices to the rows of out (F, 3, V, P) from ``first_row`` on.

    Row 4 j + i of table (R, 3, P) is column i of the matrices of joint j.
    """
    # What F multiplies the table with: w u + c p̃ for each slot, (F, B, 4 K); u = p̃ without directions.
    points = np.concatenate([forms.points, np.ones((len(forms.points), 1))], axis=1)
    directions = points[None]
    if forms.directions is not None:
        directions = np.concatenate([forms.directions, np.zeros((*forms.directions.shape[:2], 1))], axis=2)
    by_slot = forms.weights[:, :, None] * directions[:, :, None]
    if forms.changes is not None:
        by_slot = by_slot + forms.changes[..., None] * points[:, None]
    entries = np.asarray(by_slot.reshape(*by_slot.shape[:2], -1), dtype=np.float64)
    # The rows of the table that the entries multiply, (B, 4 K).
    numbers = 4 * forms.joints.astype(np.int32)[:, :, None] + np.arange(4, dtype=np.int32)
    columns: Int32Array = np.asarray(numbers.reshape(len(numbers), -1), dtype=np.int32)
    flat = table.reshape(len(table), -1)
    from scipy.sparse import csr_array

    # One row for each form and vertex. Dense products are twice as fast, but BLAS adds in any order.
    ends = np.arange(len(entries) * len(columns) + 1, dtype=np.int32) * np.int32(columns.shape[1])
    names = np.tile(columns.ravel(), len(entries))
    found = csr_array((entries.ravel(), names, ends), shape=(len(ends) - 1, len(table))) @ flat
    found = found.reshape(*entries.shape[:2], 3, -1)
    # Components are contiguous in out. Arithmetic takes three times as long on those that are not.
    out[:, :, first_row : first_row + len(columns)] = np.swapaxes(found, 1, 2)


def blended_normals(forms: Forms, table: Float64Array, normals: FloatArray | None = None) -> Float64Array:
    """Return the cross product of two forms of B vertices: (3, B, P).

    With normals (B, 3), the forms are the three columns of a matrix M. The result is M⁻ᵀ n, or cof(M) n if
    det M is 0.
    """
    found = np.empty((2 if normals is None else 3, 3, len(forms.joints), table.shape[2]))
    blend(forms, table, found)
    if normals is None:
        return np.stack(cross(*found))
    # M⁻ᵀ n = cof(M) n / det M.
    rows: Rows = tuple(zip(*found, strict=True))
    cofactor = cofactors(rows)
    reciprocal = quotient(1.0, dot(rows[0], cofactor[0]))
    return np.stack(scaled(reciprocal, linear(cofactor, tuple(normals.T[:, :, None]))))


def dqs_positions(
    skinning: Skinning, pose: slice, part: slice, out: Float64Array, first_row: int = 0
) -> None:
    """Write p' by dual quaternions for some vertices to the rows of out (3, V, P) from ``first_row`` on."""
    rows = slice(first_row, first_row + part.stop - part.start)
    (posed,) = skinning.run((Algorithm.DQS_STANDARD,), pose, part)
    for component, moved in zip(out, posed.position, strict=True):
        component[rows] = moved.T


def dqs_normals(skinning: Skinning, pose: slice, part: slice) -> Float64Array:
    """Return the normals of algorithms 4–6 for some vertices: (3, 3, B, P). They are not of unit length."""
    algorithms = [algorithm for algorithm in Algorithm if algorithm.uses_dual_quaternions]
    found = skinning.run(algorithms, pose, part)
    return np.stack([np.stack([component.T for component in posed.normal]) for posed in found])


def gradient_rows(mesh: WeldedMesh, part: slice, directions: Sequence[FloatArray]) -> SparseRows:
    """Return the derivatives of a block's vertices along D directions (B, 3): sparse (D B, V), stacked.

    libigl gives the gradients of the hat functions in the triangle of each corner. A vertex takes their mean.
    """
    import igl
    from scipy.sparse import csr_array, vstack

    # The corners of each vertex, and their triangles from the corner on.
    owners, corners = mesh.corners_of(part)
    flat, first = mesh.triangles.ravel(), corners - corners % 3
    faces = np.stack([flat[first + (corners + turn) % 3] for turn in range(3)], axis=1)
    size = part.stop - part.start
    if len(corners) == 0:
        empty = np.zeros(0, dtype=np.int32)
        return SparseRows(np.zeros(len(directions) * size + 1, dtype=np.int32), empty, np.zeros(0))
    # The share of each corner in the mean of its class.
    here, one, other = mesh.positions[faces].transpose(1, 2, 0)
    share = weights_of_corners(tuple(one - here), tuple(other - here), mesh.weighting)
    share /= mesh.totals[mesh.classes[part]][owners]
    # libigl's gradients of the hats, in the triangles that are met.
    met, triangle = np.unique(corners // 3, return_inverse=True)
    local, numbers = np.unique(mesh.triangles[met], return_inverse=True)
    gradients = csr_array(igl.grad(mesh.positions[local], numbers.reshape(-1, 3).astype(np.int64)))
    # The mean of the gradients along each direction, as a product of sparse matrices.
    ends = np.searchsorted(owners, np.arange(size + 1))
    places = (triangle[:, None] + len(met) * np.arange(3)).ravel()
    found = []
    for direction in directions:
        weighted = np.asarray(direction, dtype=np.float64)[owners] * share[:, None]
        mean = csr_array((weighted.ravel(), places, 3 * ends), shape=(size, 3 * len(met)))
        found.append(mean @ gradients)
    stacked = vstack(found, format="csr")
    # Columns by the numbers of the whole mesh.
    columns = local[stacked.indices].astype(np.int32)
    return SparseRows(stacked.indptr.astype(np.int32, copy=False), columns, stacked.data)


def class_sums(mesh: WeldedMesh, positions: Float64Array, block: ClassBlock, sums: FloatArray) -> None:
    """Fill the sums (3, C, P) of a block of weld classes: Σ angle × unit normal over their corners.

    sums are of all classes, float32 or float64. float32 halves the memory. Sums of unit vectors lose a
    millionth of a degree.
    """
    sums[:, block.part] = sums_of_classes(mesh, positions, block.part)


def true_normals(
    rest: RestFrames,
    number: int,
    positions: Float64Array,
    sides: Float64Array | None = None,
    by_triangles: ClassSums | None = None,
) -> tuple[Float64Array, BoolArray]:
    """Return the true normals (U, 3, B, P) of a block of vertices, and where they exist (U, B, P).

    The last are by tangents, the first, if there are sums of classes, by triangles. positions (3, V, P) are
    those of all vertices after deformation. sides (P, B) is −1 if the joints mirror a vertex.
    """
    part = rest.parts[number]
    tangents = posed_tangents(rest.derivatives[number], positions)
    found = []
    if by_triangles is not None:
        sums = block_sums(by_triangles.classes, by_triangles.sums, part)
        found.append(triangle_normals(by_triangles.carried, part, tangents, sums, sides))
    found.append(tangent_normals(rest, part, tangents, sides))
    normals = np.stack([np.stack([component.T for component in vector]) for vector, _ in found])
    return normals, np.stack([exist.T for _, exist in found])


def angles(measured: Vector, expected: Float64Array) -> Float32Array:
    """Return the angles (U, B, P), in degrees, between vectors of any length and unit vectors.

    The vectors are components (P, B), and expected is (U, 3, B, P).
    """
    units = [component.T for component in units_or_nan(measured)]
    return np.stack([angles_of_units(units, list(one)) for one in expected])


def count_errors(errors: FloatArray, weights: Float64Array, valid: BoolArray | None = None) -> CountedErrors:
    """Count errors (P, B) in degrees, or other values, as float32, with weights (B,).

    valid (P, B), all true by default, tells where the *expected* normal exists. Samples outside it, and
    vertices without weight, are left out. A NaN inside it means that the measured normal does not exist. It
    counts as 180°: a method that yields no normal must not look better for it.
    """
    counted = np.broadcast_to(weights > 0.0, errors.shape)
    if valid is not None:
        counted = counted & valid
    # A normal that does not exist is as bad as can be, and what does not count is below all.
    undefined = counted & np.isnan(errors)
    values = np.where(undefined, 180.0, np.where(counted, errors, -1.0)).astype(np.float32)
    sums = np.sum(values, axis=0, dtype=np.float64, where=counted)
    positive = np.where(weights > 0.0, weights, 0.0)
    # The largest error; of equal ones the first by pose.
    largest = float(values.max(initial=-1.0))
    pose, vertex = divmod(int(values.argmax()) if values.size else 0, max(1, errors.shape[1]))
    bins = np.zeros(BINS)
    np.add.at(bins, bin_of(values[counted]), np.broadcast_to(positive, errors.shape)[counted])
    return CountedErrors(
        samples=int(np.count_nonzero(counted)),
        undefined=int(np.count_nonzero(undefined)),
        weight=float(counted.sum(axis=0) @ positive),
        total=float(sums @ positive),
        largest=largest,
        pose=pose,
        vertex=vertex,
        bins=bins,
    )
