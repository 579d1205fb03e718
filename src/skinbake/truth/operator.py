"""The gradient at a mesh's vertices as a sparse matrix: triangle gradients, averaged over welds.

Source: Max, *Weights for computing vertex normals from facet normals* (1999), for the average; Tarini,
Panozzo, Sorkine-Hornung, *Accurate and efficient lighting for skinned models* (2014), for α and β. It shares
neither code nor formulas with the kernel that bakes, because an error in one must not hide in both. Rows of
the matrix are made block by block. All of them would take gigabytes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from skinbake.choices import Weighting
from skinbake.errors import InputError
from skinbake.geometry.skinned import (
    BoolArray,
    Float64Array,
    FloatArray,
    IntArray,
    SkinnedPrimitive,
    bincount,
    blocks,
)
from skinbake.skinning.components import Vector, cross, dot, minus, scaled
from skinbake.truth import kernel
from skinbake.truth.mesh import (
    JointField,
    WeldedMesh,
    carrying_slots,
    weights_of_corners,
    weld_classes,
    with_rigid_parts,
)
from skinbake.truth.values import SparseRows

Frame: TypeAlias = tuple[FloatArray, FloatArray]

# A triangle is a line or a point if its doubled area is at most this share of its longest squared edge. The
# bake's own is DEGENERATE_AREA in geometry/triangles.py, of which verify takes no code.
_DEGENERATE = 1e-10

TABLE_CELLS = 1 << 21
"""The rows × joints whose derivatives are summed up at a time: 16 MiB."""

TRUE_WEIGHTING = Weighting.MAX
TRUE_CREASE_ANGLE = 15.0
"""The truths' weighting of triangles, and their hard edges in degrees. No option of bake changes them.

Of all four weightings, Max's weights are the nearest to analytic surfaces (docs/lighting.md).
"""


@dataclass(frozen=True, slots=True)
class GradientOperator(WeldedMesh):
    """The linear map from a field on a mesh's vertices to the field's gradient at the same vertices.

    Rows of the matrix are made when they are needed, because all of them take a gigabyte for a million
    vertices. The row of a vertex without triangles is zero.
    """

    def reach(self) -> Float64Array:
        """Return the sum of all magnitudes in the rows along x, y and z, (V,).

        Of a field of values from −1 to 1, no derivative in a unit direction is larger.
        """
        ones = np.ones(len(self.positions))
        axes = [np.broadcast_to(axis, self.positions.shape) for axis in np.eye(3)]
        return np.asarray(self.reach_along(axes, ones).sum(axis=0))

    def reach_along(self, directions: Sequence[FloatArray], field: FloatArray) -> Float64Array:
        """Return Σ |entry| × field (V,) over the rows of D directions (V, 3): (D, V)."""
        total = np.zeros((len(directions), len(self.positions)))
        for part in self.row_blocks():
            rows = self.rows(part, [direction[part] for direction in directions])
            total[:, part] = rows.magnitudes().times(field).reshape(len(directions), -1)
        return total

    def rows(self, part: slice, directions: Sequence[FloatArray]) -> SparseRows:
        """Return the derivatives of a block's vertices along D directions (B, 3): sparse (D B, V)."""
        return kernel.gradient_rows(self, part, directions)


def gradient_operator(
    primitives: Sequence[SkinnedPrimitive],
    *,
    weighting: Weighting = Weighting.MAX,
    crease_angle_degrees: float = 15.0,
    claim: Callable[[int], None] = lambda size: None,
) -> GradientOperator:
    """Build the gradient operator over the welded vertices of one mesh.

    A vertex takes the weighted mean of the triangles' gradients over the corners of its weld class
    (``weld_classes``, ``with_rigid_parts``). The mean divides by the total weight of *all* corners, so that
    the gradients of weights that sum to one sum to zero. With e1, e2 a corner's edges, θ its angle and A =
    |e1 × e2|, its weight is A / (|e1|² |e2|²) for ``max``, θ for ``angle``, A for ``area``, θ A for
    ``angle-area``.

    Triangles that are lines or points, or have a non-finite corner, are ignored. Raises InputError for an
    index outside its primitive, and ValueError for an unknown weighting. ``claim`` is called with the number
    of bytes that welding adds, before it adds them.
    """
    if weighting not in list(Weighting):
        raise ValueError(f"weighting {weighting!r}, expected one of {', '.join(Weighting)}")
    counts = tuple(len(primitive.positions) for primitive in primitives)
    positions = np.concatenate([primitive.positions for primitive in primitives])
    positions = np.ascontiguousarray(positions, dtype=np.float64)
    # The triangles that have an area, over all primitives: with the numbers of the concatenated vertices.
    parts = [np.zeros((0, 3), dtype=np.int64)]
    starts = np.cumsum([0, *counts])
    for number, (primitive, size) in enumerate(zip(primitives, counts, strict=True)):
        own = primitive.triangles.astype(np.int64)
        if own.size and not (own.min() >= 0 and own.max() < size):
            found = f"indices from {own.min()} to {own.max()}"
            raise InputError(f"primitive {number}: {found}, expected 0 to {size - 1}")
        parts.append(own + starts[number])
    triangles = np.concatenate(parts)
    triangles = triangles[is_sound(positions, triangles)]
    # Which vertices are one point.
    classes = weld_classes(primitives, crease_angle_degrees=crease_angle_degrees, claim=claim)
    classes = with_rigid_parts(classes, primitives, triangles)
    # The corners of each class.
    places = classes[triangles].ravel()
    count = int(classes.max(initial=-1)) + 1
    met = bincount(places, minlength=count)
    # Every copy of a vertex gets the row of its class, with an entry for each neighbour; up to eight copies
    # of a row are in memory. If each triangle of a fan has its own copy of the centre, there are as many long
    # rows as triangles.
    entries = int((1 + 2 * met[classes]).sum()) - len(classes) - 2 * triangles.size
    claim(max(entries, 0) * 12 * 8)
    # The weight of each corner (T, 3) of sound triangles.
    edges = _edges(positions, triangles)
    weights = np.empty(triangles.shape)
    for corner in range(3):
        # The two edges at the corner, both leading away from it.
        following, preceding = edges[corner], scaled(-1.0, edges[corner - 1])
        weights[:, corner] = weights_of_corners(following, preceding, weighting)
    # The mean of a class divides by the sum over all of its corners.
    totals = bincount(places, weights.ravel(), minlength=count).astype(np.float64)
    ends = np.concatenate([[0], np.cumsum(met, dtype=np.int64)])
    corners = np.argsort(places, kind="stable").astype(np.int32)
    return GradientOperator(
        counts=counts,
        positions=positions,
        triangles=triangles.astype(np.int32),
        classes=classes.astype(np.int32),
        weighting=weighting,
        totals=totals,
        corners=corners,
        ends=ends,
    )


def true_operator(
    primitives: Sequence[SkinnedPrimitive], *, claim: Callable[[int], None] = lambda size: None
) -> GradientOperator:
    """Build the operator of the truths. No option of bake changes it."""
    return gradient_operator(
        primitives, weighting=TRUE_WEIGHTING, crease_angle_degrees=TRUE_CREASE_ANGLE, claim=claim
    )


def expected_alpha_beta(
    operator: GradientOperator,
    primitives: Sequence[SkinnedPrimitive],
    frames: Sequence[Frame],
) -> list[tuple[Float64Array, Float64Array]]:
    """Return α = ∇w · t0 and β = ∇w · b0 of the joint in every slot: per primitive two (V, K) float64.

    frames are per primitive t0 and b0, each (V, 3), mesh space. If a joint is in several slots of a vertex,
    one of them has its gradient (``carrying_slots``), and the others hold 0. Slot 0 holds the gradient of its
    own joint. A reader of the file takes minus the sum of the other slots there. The two differ at vertices
    whose neighbours have joints outside the vertex's own set.
    """
    field = JointField.of_surface(primitives)
    result = []
    for primitive, rows, frame in zip(primitives, operator.slices, frames, strict=True):
        carries = carrying_slots(primitive)
        found = np.zeros((2, *primitive.joints.shape))
        for part in operator.row_blocks(rows):
            here = slice(part.start - rows.start, part.stop - rows.start)
            # ∇w · t0 and ∇w · b0 of every joint near a block of vertices, by slot.
            derivatives = operator.rows(part, [directions[here] for directions in frame])
            own = np.tile(primitive.joints[here], (2, 1))
            of_joints = _derivatives_of_joints(derivatives, field, own).reshape(
                2, *primitive.joints[here].shape
            )
            found[:, here] = np.where(carries[here], of_joints, 0.0)
        result.append((found[0], found[1]))
    return result


def _derivatives_of_joints(derivatives: SparseRows, field: JointField, named: IntArray) -> Float64Array:
    """Return the derivatives (B, K) of the weights of the joints that B rows name.

    The weights of all joints near some rows are summed up in one table (rows, joints). So the work grows with
    the influences, not with their square.
    """
    owners, columns = derivatives.owners(), derivatives.columns[derivatives.entries]
    values = derivatives.values[derivatives.entries]
    count, width = len(named), field.joint_count
    found = np.zeros(named.shape)
    step = max(1, TABLE_CELLS // max(width, 1))
    for rows in blocks(count, step):
        first, last = np.searchsorted(owners, (rows.start, rows.stop))
        entries, joints, weights = field.of(columns[first:last])
        # Each neighbour adds its entry times the weight of each of its joints.
        cells = (owners[first:last][entries] - rows.start) * width + joints
        table = bincount(cells, values[first:last][entries] * weights, (rows.stop - rows.start) * width)
        found[rows] = np.take_along_axis(table.reshape(-1, width), named[rows].astype(np.int64), axis=1)
    return found


def _edges(positions: Float64Array, triangles: IntArray) -> list[Vector]:
    """Return the edges from corner 0 to 1, 1 to 2 and 2 to 0, each by components (T,)."""
    axes = [np.ascontiguousarray(axis) for axis in positions.T]
    corners = [tuple(axis[triangles[:, corner]] for axis in axes) for corner in range(3)]
    return [minus(corners[(corner + 1) % 3], corners[corner]) for corner in range(3)]


def is_sound(positions: Float64Array, triangles: IntArray) -> BoolArray:
    """Tell which triangles (T, 3) have an area: (T,). One with a corner that is not finite has none."""
    with np.errstate(invalid="ignore", over="ignore"):
        edges = _edges(positions, triangles)
        normal = cross(edges[0], edges[1])
        longest = np.maximum(np.maximum(*(dot(edge, edge) for edge in edges[:2])), dot(edges[2], edges[2]))
        # A comparison with NaN is false.
        return np.asarray(np.sqrt(dot(normal, normal)) > _DEGENERATE * longest)
