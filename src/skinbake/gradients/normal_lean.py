"""Normals that do not belong to their surface: the lean of NORMAL from the triangles at each vertex.

α and β turn the authored normal along with the surface, in any rest direction. A wrong normal is lit
wrongly in every pose. A figure that is measured against that normal does not show it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from skinbake.errors import Notice, Place
from skinbake.geometry.frames import has_direction, unit_vectors
from skinbake.geometry.skinned import Float64Array, FloatArray, IntArray, SkinnedPrimitive
from skinbake.geometry.triangles import cross_products
from skinbake.gradients import kernel
from skinbake.wording import counted

FAR = 45.0
"""The degrees from which a normal does not look like its surface's.

Smooth normals of a cube lean 55° from each side, and 0° from the mean of the three.
"""

MOST = 0.05
"""The share of far normals that a sound model may have.

Of 114 primitives of real models, two have more, and both are broken. The next has 1.4 %.
"""

SAMPLED_TRIANGLES, SAMPLED_VERTICES = 1 << 8, 1 << 11
"""The number of triangles and of vertices that are sampled.

Triangles come first. Vertices follow if the triangles raise a doubt. In larger models every second, third …
is taken, so that the check takes only some milliseconds.
"""


CANCELLED = 1e-9
"""Radians. Triangles that sum to less at a point cancel out: each is there twice, once for each side."""


class NormalLean(NamedTuple):
    """The number of sampled vertices with a far normal, and their median lean in degrees.

    vertices is the number of the primitive's vertices for each sampled one.
    """

    far: int
    looked_at: int
    degrees: float
    vertices: float

    @property
    def is_plain(self) -> bool:
        """Tell whether so few normals are far that they can be a matter of style."""
        return self.far <= MOST * self.looked_at


def normal_lean(primitive: SkinnedPrimitive) -> NormalLean:
    """Return how NORMAL (V, 3) of a primitive fits its triangles.

    A normal is far if it leans over FAR from three directions. The first is the mean plane of the vertex's
    own triangles, weighted by angle. The second is the mean plane of all triangles at the vertex's position:
    hard edges and seams have copies of a vertex, smooth ones share a normal. The third is the normal that
    ``--generate-normals`` makes, which weights triangles in another way. Vertices without an area or a normal
    are not sampled.
    """
    if not _is_doubtful(primitive):
        return NormalLean(0, 0, 0.0, 0.0)
    step = _step(len(primitive.positions), SAMPLED_VERTICES)
    rows = np.arange(0, len(primitive.positions), step)
    rows = rows[has_direction(primitive.normals[rows])]
    leans = _leans(primitive, rows, None)
    rows, leans = rows[np.isfinite(leans)], leans[np.isfinite(leans)]
    suspects = leans > FAR
    if np.count_nonzero(suspects) > MOST * len(rows):
        shared = _leans(primitive, rows[suspects], kernel.label_equal_rows(primitive.positions))
        generated = _leans_from_generated(primitive, rows[suspects])
        leans[suspects] = np.fmin(np.fmin(leans[suspects], shared), generated)
    far = leans[leans > FAR]
    middle = float(np.median(far)) if len(far) else 0.0
    return NormalLean(len(far), len(rows), middle, float(step))


def _step(count: int, most: int) -> int:
    return max(1, -(-count // most))


def _is_doubtful(primitive: SkinnedPrimitive) -> bool:
    """Tell whether enough normals lean far from single triangles to check their planes, which takes long.

    A coarse smooth mesh is doubtful too.
    """
    triangles = primitive.triangles[:: _step(len(primitive.triangles), SAMPLED_TRIANGLES)]
    cross = _normals(_sides(primitive, triangles))
    with np.errstate(invalid="ignore"):  # normals that are not finite are not far
        normals = primitive.normals[triangles.T].astype(np.float64)
        dots, squares = np.einsum("tj,ctj->ct", cross, normals), np.einsum("ctj,ctj->ct", normals, normals)
        near = np.cos(np.radians(FAR)) * np.sqrt(np.einsum("tj,tj->t", cross, cross) * squares)
    return bool(np.count_nonzero(dots < near) > MOST * dots.size)


def lean_notices(primitive: SkinnedPrimitive, place: Place) -> list[Notice]:
    """Return a notice if the normals of a primitive do not belong to its surface, else none."""
    if not len(primitive.normals):
        return []
    lean = normal_lean(primitive)
    if lean.is_plain:
        return []
    found, of = (
        min(round(number * lean.vertices), len(primitive.normals)) for number in (lean.far, lean.looked_at)
    )
    about = "about " if lean.vertices > 1 else ""
    message = (
        f"normals lean over {FAR:.0f}° from the surface at {about}{found:,} of "
        f"{counted(of, 'vertex', 'vertices')}, by "
        f"{lean.degrees:.0f}° in the median: it is lit like another shape, baked or not. "
    )
    return [Notice("normals-off-surface", message + _advice(lean), place.at("NORMAL"), found)]


def _advice(lean: NormalLean) -> str:
    if lean.degrees > 180.0 - FAR and 2 * lean.far > lean.looked_at:
        return "Normals and triangles face opposite ways: turn the one or the other"
    return (
        "Make normals anew in the modelling tool, and the normal map that belongs to them. Without a normal "
        "map: remove the normals and bake with --generate-normals"
    )


def _leans(primitive: SkinnedPrimitive, rows: IntArray, labels: IntArray | None) -> Float64Array:
    """Return the degrees by which the normals of some vertices (N,) lean from their planes (N,).

    labels (V,) names the vertices that share one plane. None means that each has its own plane. The result is
    NaN if the triangles at a vertex have no area, or cancel out.
    """
    own = rows if labels is None else labels[rows]
    numbers = np.zeros(len(primitive.positions), dtype=np.int32)
    numbers[own] = 1
    numbers = np.cumsum(numbers, dtype=np.int32) * numbers
    corners = numbers[primitive.triangles if labels is None else labels[primitive.triangles]]
    touching = corners.any(axis=1)
    corners, triangles = corners[touching], primitive.triangles[touching]
    sides = _sides(primitive, triangles)
    cross = _normals(sides)
    doubled = np.sqrt(np.einsum("ij,ij->i", cross, cross))
    dots = -np.einsum("tij,tij->ti", sides, sides[[2, 0, 1]])
    shares = np.divide(np.arctan2(doubled, dots), doubled, out=np.zeros_like(dots), where=doubled > 0)
    planes = np.zeros((int(numbers.max(initial=0)) + 1, 3))
    for axis in range(3):
        planes[:, axis] = np.bincount(corners.T.ravel(), (shares * cross[:, axis]).ravel(), len(planes))
    planes[np.einsum("ij,ij->i", planes, planes) < CANCELLED**2] = 0.0
    return _degrees(planes[numbers[own]], primitive.normals[rows])


def _leans_from_generated(primitive: SkinnedPrimitive, rows: IntArray) -> Float64Array:
    """Return the degrees by which the normals of some vertices (N,) lean from generated ones (N,)."""
    from skinbake.gradients.normals import with_smooth_normals  # few models need it

    [generated] = with_smooth_normals([replace(primitive, normals=primitive.normals[:0])])
    return _degrees(generated.normals[rows].astype(np.float64), primitive.normals[rows])


def _sides(primitive: SkinnedPrimitive, triangles: IntArray) -> Float64Array:
    """Return the sides of triangles (3, T, 3): from each corner to the next."""
    corners = primitive.positions[triangles.T].astype(np.float64)
    return corners[[1, 2, 0]] - corners


def _normals(sides: Float64Array) -> Float64Array:
    """Return the normals (T, 3) of triangles, as long as their doubled area."""
    return cross_products(sides[0], sides[1])


def _degrees(planes: Float64Array, normals: FloatArray) -> Float64Array:
    """Return the angle between vectors (N, 3) in degrees, NaN if one of them has no direction."""
    return np.asarray(np.degrees(np.arccos(_cosines(planes, normals))))


def _cosines(planes: Float64Array, normals: FloatArray) -> Float64Array:
    """Return the cosine between vectors (N, 3), NaN if one of them has no direction."""
    units = unit_vectors(normals)
    lengths = np.where(has_direction(normals), np.linalg.norm(planes, axis=1), 0.0)
    dots = np.einsum("ij,ij->i", planes, units)
    cosines = np.divide(dots, lengths, out=np.full(len(planes), np.nan), where=lengths > 0)
    return np.asarray(np.clip(cosines, -1.0, 1.0))
