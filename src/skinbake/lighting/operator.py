"""The gradient at a mesh's vertices as a sparse matrix: libigl's triangle gradients, averaged over welds.

Source: Max, *Weights for computing vertex normals from facet normals* (1999), for the average; Tarini,
Panozzo, Sorkine-Hornung, *Accurate and efficient lighting for skinned models* (2014), for α and β. It
shares no code with the kernel that bakes: an error in one must not hide in both.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from skinbake.choices import Weighting
from skinbake.errors import InputError
from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray, SkinnedPrimitive
from skinbake.lighting.influences import Int64Array, carrying_slots, weight_field
from skinbake.lighting.welds import weld_classes
from skinbake.skinning.components import Vector, cross, dot, minus, scaled

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Frame: TypeAlias = tuple[FloatArray, FloatArray]

# A triangle is a line or a point when its doubled area is at most this share of its longest squared edge.
_DEGENERATE = 1e-10


@dataclass(frozen=True, slots=True)
class GradientOperator:
    """The linear map from a field on a mesh's vertices to the field's gradient at the same vertices.

    x, y, z: sparse (V, V) float64, 1 / length unit of POSITION. V runs over the vertices of all primitives,
    concatenated in order; counts holds the number of each. The row of a vertex without triangles is zero.
    """

    x: csr_array
    y: csr_array
    z: csr_array
    counts: tuple[int, ...]

    def along(self, directions: FloatArray) -> csr_array:
        """Return the sparse (V, V) float64 derivative along one direction per vertex.

        directions (V, 3), mesh space; a direction's length scales its derivative.
        """
        scale = np.asarray(directions, dtype=np.float64)
        return _scaled(self.x, scale[:, 0]) + _scaled(self.y, scale[:, 1]) + _scaled(self.z, scale[:, 2])

    @property
    def slices(self) -> list[slice]:
        """Where each primitive's vertices lie among the mesh's."""
        ends = np.cumsum(self.counts).tolist()
        return [slice(end - count, end) for end, count in zip(ends, self.counts, strict=True)]


def gradient_operator(
    primitives: Sequence[SkinnedPrimitive],
    *,
    weighting: Weighting = Weighting.MAX,
    crease_angle_degrees: float = 15.0,
    claim: Callable[[int], None] = lambda size: None,
) -> GradientOperator:
    """Build the gradient operator over the welded vertices of one mesh.

    A vertex takes the weighted mean of libigl's gradients over the corners of its weld class
    (``weld_classes``), divided by the total weight of *all* of them, so that the gradients of weights that
    sum to one sum to zero. With e1, e2 a corner's edges, θ its angle and A = |e1 × e2|, its weight is A /
    (|e1|² |e2|²) for ``max``, θ for ``angle``, A for ``area``, θ A for ``angle-area``.

    Triangles that are lines or points, or have a non-finite corner, are ignored. Raises InputError for an
    index outside its primitive, which libigl would not survive, and ValueError for an unknown weighting.
    ``claim`` is told how many bytes welding adds, before it does.
    """
    if weighting not in list(Weighting):
        raise ValueError(f"weighting {weighting!r}, expected one of {', '.join(Weighting)}")
    import igl
    from scipy.sparse import csr_array

    counts = tuple(len(primitive.positions) for primitive in primitives)
    positions = np.concatenate([primitive.positions for primitive in primitives]).astype(np.float64)
    triangles = _sound_triangles(positions, _all_triangles(primitives))
    classes = weld_classes(primitives, crease_angle_degrees=crease_angle_degrees, claim=claim)
    claim(_welding_size(triangles, classes))
    averages = _averages(_corner_weights(positions, triangles, weighting), classes[triangles], classes)
    if not len(triangles):
        empty = csr_array((len(positions), len(positions)), dtype=np.float64)
        return GradientOperator(empty, empty, empty, counts)

    per_triangle = csr_array(igl.grad(positions, triangles))
    n = len(triangles)
    x, y, z = ((averages @ per_triangle[axis * n : (axis + 1) * n])[classes] for axis in range(3))
    return GradientOperator(x, y, z, counts)


def _welding_size(triangles: Int64Array, classes: Int64Array) -> int:
    """Return the bytes by which welding makes the operator larger: every copy gets the row of its class.

    A row has an entry for each neighbour, and is kept, or on its way, eight times. A fan whose triangles have
    each their own copy of its centre has as many long rows as triangles.
    """
    corners = np.bincount(classes[triangles].ravel(), minlength=int(classes.max(initial=-1)) + 1)
    entries = int((1 + 2 * corners[classes]).sum()) - len(classes) - 2 * triangles.size
    return max(entries, 0) * 12 * 8


def expected_alpha_beta(
    operator: GradientOperator,
    primitives: Sequence[SkinnedPrimitive],
    frames: Sequence[Frame],
    *,
    named: Sequence[SkinnedPrimitive] | None = None,
) -> list[tuple[Float64Array, Float64Array]]:
    """Return α = ∇w · t0 and β = ∇w · b0 of the joint in every slot: per primitive two (V, K) float64.

    frames: per primitive t0 and b0, each (V, 3), mesh space. Where a joint stands in several slots of a
    vertex, the first slot with a positive weight, or else the first, carries its gradient and the others
    hold 0. Slot 0 holds its own joint's gradient; a file stores minus the sum of the other slots there, and
    the two differ at vertices with neighbours' joints outside their own set. ``named`` are the same
    primitives with the joints that the slots name now, where that is no longer what the weights come from:
    after adoption.
    """
    field = weight_field(primitives)
    alpha, beta = (
        operator.along(np.concatenate([frame[axis] for frame in frames])) @ field for axis in range(2)
    )
    result = []
    for primitive, rows in zip(named or primitives, operator.slices, strict=True):
        carries = carrying_slots(primitive)
        result.append(
            (_named_entries(alpha[rows], primitive, carries), _named_entries(beta[rows], primitive, carries))
        )
    return result


def _named_entries(derivatives: csr_array, primitive: SkinnedPrimitive, carries: BoolArray) -> Float64Array:
    """Look up, in a (V, J) sparse matrix, the entry of the joint that each slot names."""
    rows = np.broadcast_to(np.arange(len(primitive.joints))[:, None], primitive.joints.shape)
    joints = primitive.joints.astype(np.int64)
    carries = carries & (joints < derivatives.shape[1])
    found = np.zeros(joints.shape)
    found[carries] = np.asarray(derivatives[rows[carries], joints[carries]]).ravel()
    return found


def _all_triangles(primitives: Sequence[SkinnedPrimitive]) -> Int64Array:
    """Concatenate the triangles, with indices into the concatenated vertices."""
    parts = [np.zeros((0, 3), dtype=np.int64)]
    offset = 0
    for number, primitive in enumerate(primitives):
        count, triangles = len(primitive.positions), primitive.triangles.astype(np.int64)
        if triangles.size and not (triangles.min() >= 0 and triangles.max() < count):
            raise InputError(
                f"primitive {number}: indices from {triangles.min()} to {triangles.max()}, "
                f"expected 0 to {count - 1}"
            )
        parts.append(triangles + offset)
        offset += count
    return np.concatenate(parts)


def _edges(positions: Float64Array, triangles: Int64Array) -> list[Vector]:
    """Return the edges from corner 0 to 1, 1 to 2 and 2 to 0, each by components (T,)."""
    axes = [np.ascontiguousarray(axis) for axis in positions.T]
    corners = [tuple(axis[triangles[:, corner]] for axis in axes) for corner in range(3)]
    return [minus(corners[(corner + 1) % 3], corners[corner]) for corner in range(3)]


def _sound_triangles(positions: Float64Array, triangles: Int64Array) -> Int64Array:
    """Keep the triangles that have an area; a comparison with NaN is false and drops the triangle."""
    with np.errstate(invalid="ignore", over="ignore"):
        edges = _edges(positions, triangles)
        normal = cross(edges[0], edges[1])
        longest = np.maximum(np.maximum(*(dot(edge, edge) for edge in edges[:2])), dot(edges[2], edges[2]))
        sound: Int64Array = triangles[np.sqrt(dot(normal, normal)) > _DEGENERATE * longest]
    return sound


def _corner_weights(positions: Float64Array, triangles: Int64Array, weighting: Weighting) -> Float64Array:
    """Weigh each corner (T, 3) of sound triangles."""
    edges = _edges(positions, triangles)
    weights = np.empty(triangles.shape)
    for corner in range(3):
        following, preceding = edges[corner], scaled(-1.0, edges[corner - 1])
        normal = cross(following, preceding)
        area = np.sqrt(dot(normal, normal))
        if weighting == "max":
            weights[:, corner] = area / (dot(following, following) * dot(preceding, preceding))
        elif weighting == "area":
            weights[:, corner] = area
        else:
            angle = np.arctan2(area, dot(following, preceding))
            weights[:, corner] = angle if weighting == "angle" else angle * area
    return weights


def _averages(weights: Float64Array, corner_classes: Int64Array, classes: Int64Array) -> csr_array:
    """Build the sparse (classes, T) matrix averaging over each class's corners: rows sum to 1 or are 0."""
    from scipy.sparse import csr_array

    count = int(classes.max(initial=-1)) + 1
    totals = np.bincount(corner_classes.ravel(), weights.ravel(), minlength=count)
    columns = np.repeat(np.arange(len(weights)), 3)
    shares = weights.ravel() / totals[corner_classes.ravel()]
    return csr_array((shares, (corner_classes.ravel(), columns)), shape=(count, len(weights)))


def _scaled(matrix: csr_array, rows: Float64Array) -> csr_array:
    """Multiply each row of a sparse matrix by a number."""
    from scipy.sparse import csr_array

    data = matrix.data * np.repeat(rows, np.diff(matrix.indptr))
    return csr_array((data, matrix.indices, matrix.indptr), shape=matrix.shape)
