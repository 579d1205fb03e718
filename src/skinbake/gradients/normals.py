"""Normals that do not belong to their surface, and smooth normals for primitives without normals.

A normal leans from the triangles at its vertex. α and β turn the authored normal along with the surface, in
any rest direction. A wrong normal is lit wrongly in every pose. A figure that is measured against that
normal does not show it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from skinbake.errors import Notice, Place
from skinbake.geometry.frames import has_direction, unit_vectors
from skinbake.geometry.skinned import (
    BoolArray,
    Float64Array,
    FloatArray,
    IntArray,
    SkinnedPrimitive,
    bincount,
)
from skinbake.geometry.triangles import cross_products, smooth_normals
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

FEWEST_SAMPLED = 1 << 6
"""The vertices of a primitive that are compared with its mesh, at least, where it has so many.

The primitives of a mesh share the work.
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


@dataclass(slots=True)
class _Sample:
    """The sampled vertices (N,) of a primitive, and the degrees (N,) by which their normals lean.

    step is the number of the primitive's vertices for each sampled one.
    """

    rows: IntArray
    leans: Float64Array
    step: int

    @property
    def suspects(self) -> BoolArray:
        """Return the sampled vertices (N,) whose normals lean far from all directions so far."""
        return self.leans > FAR

    @property
    def suspect_rows(self) -> IntArray:
        """Return the numbers of these vertices."""
        return self.rows[self.suspects]

    def admit(self, leans: Float64Array) -> None:
        """Take the leans of the suspects from another direction, where they are smaller."""
        self.leans[self.suspects] = np.fmin(self.leans[self.suspects], leans)

    def thin_out(self, most: int) -> None:
        """Keep so many vertices, or half of them."""
        step = _step(len(self.rows), most)
        self.rows, self.leans, self.step = self.rows[::step], self.leans[::step], self.step * step

    @property
    def lean(self) -> NormalLean:
        """Return the numbers of the sample."""
        far = self.leans[self.suspects]
        middle = float(np.median(far)) if len(far) else 0.0
        return NormalLean(len(far), len(self.rows), middle, float(self.step))


def normal_leans(primitives: Sequence[SkinnedPrimitive]) -> list[NormalLean]:
    """Return how NORMAL (V, 3) of each primitive of one mesh fits the triangles.

    A normal is far if it leans over FAR from three directions. The first is the mean plane of the vertex's
    own triangles, weighted by angle. The second is the mean plane of all triangles at the vertex's position:
    hard edges and seams have copies of a vertex, smooth ones share a normal. The third is the normal that
    ``--generate-normals`` makes, which weights triangles in another way. The second and the third are looked
    for in the primitive, then in the mesh: materials cut a smooth surface into primitives. Vertices without
    an area or a normal are not sampled.
    """
    samples = [_sampled(primitive) for primitive in primitives]
    for primitive, sample in zip(primitives, samples, strict=True):
        if not sample.lean.is_plain:
            sample.admit(_leans_from_all(primitive, sample.suspect_rows))
    if len(primitives) > 1:
        _admit_the_mesh(primitives, samples)
    return [sample.lean for sample in samples]


def _admit_the_mesh(primitives: Sequence[SkinnedPrimitive], samples: Sequence[_Sample]) -> None:
    """Compare the normals that their primitives cannot explain with the triangles of the whole mesh."""
    left = [number for number, sample in enumerate(samples) if not sample.lean.is_plain]
    for number in left:
        samples[number].thin_out(max(FEWEST_SAMPLED, SAMPLED_VERTICES // len(left)))
    rows = [sample.rows[:0] for sample in samples]
    for number in left:
        rows[number] = samples[number].suspect_rows
    if not any(len(one) for one in rows):
        return
    # The part of a mesh around some vertices of each primitive, and their numbers (N,) in it.
    starts = np.cumsum([0, *(len(primitive.positions) for primitive in primitives)])
    positions = np.concatenate([primitive.positions for primitive in primitives])
    points = kernel.label_equal_rows(positions)
    # All vertices at the positions of the chosen ones.
    chosen = np.concatenate([part + start for part, start in zip(rows, starts, strict=False)])
    wanted = np.zeros(len(positions), dtype=np.bool_)
    wanted[points[chosen]] = True
    at_points = np.split(wanted[points], starts[1:-1])
    # The triangles at them, renumbered.
    corners = [
        primitive.triangles[wanted_here[primitive.triangles].any(axis=1)].ravel() + start
        for primitive, wanted_here, start in zip(primitives, at_points, starts, strict=False)
    ]
    kept, numbers = np.unique(np.concatenate([chosen, *corners]), return_inverse=True)
    own, triangles = numbers[: len(chosen)], numbers[len(chosen) :].reshape(-1, 3)
    normals = np.zeros((len(kept), 3), dtype=np.float32)
    normals[own] = np.concatenate(
        [primitive.normals[part] for primitive, part in zip(primitives, rows, strict=True)]
    )
    joints, weights = np.zeros((len(kept), 0), dtype=np.uint8), np.zeros((len(kept), 0))
    mesh = SkinnedPrimitive(positions[kept], normals, None, joints, weights, triangles)
    leans = _leans_from_all(mesh, own)
    parts = np.split(leans, np.cumsum([len(one) for one in rows])[:-1])
    for number in left:
        samples[number].admit(parts[number])


def _sampled(primitive: SkinnedPrimitive) -> _Sample:
    """Sample a primitive, and measure its normals by the triangles of each vertex."""
    if not len(primitive.normals) or not _is_doubtful(primitive):
        return _Sample(np.zeros(0, dtype=np.int64), np.zeros(0), 1)
    step = _step(len(primitive.positions), SAMPLED_VERTICES)
    rows = np.arange(0, len(primitive.positions), step)
    rows = rows[has_direction(primitive.normals[rows])]
    leans = _leans(primitive, rows, None)
    return _Sample(rows[np.isfinite(leans)], leans[np.isfinite(leans)], step)


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
        # n · c < cos FAR |n| |c| is a lean of more than FAR, without an arccosine.
        near = np.cos(np.radians(FAR)) * np.sqrt(np.einsum("tj,tj->t", cross, cross) * squares)
    return bool(np.count_nonzero(dots < near) > MOST * dots.size)


def lean_notices(primitives: Iterable[tuple[SkinnedPrimitive, Place]]) -> list[Notice]:
    """Return a notice for each primitive whose normals do not belong to the surface of its mesh."""
    meshes: dict[int | None, list[tuple[SkinnedPrimitive, Place]]] = {}
    for primitive, place in primitives:
        meshes.setdefault(place.mesh, []).append((primitive, place))
    return [
        _notice(primitive, lean, place)
        for mesh in meshes.values()
        for (primitive, place), lean in zip(mesh, normal_leans([one for one, _ in mesh]), strict=True)
        if not lean.is_plain
    ]


def _notice(primitive: SkinnedPrimitive, lean: NormalLean, place: Place) -> Notice:
    found, of = (
        min(round(number * lean.vertices), len(primitive.normals)) for number in (lean.far, lean.looked_at)
    )
    about = "about " if lean.vertices > 1 else ""
    message = (
        f"normals lean over {FAR:.0f}° from the surface at {about}{found:,} of "
        f"{counted(of, 'vertex', 'vertices')}, by "
        f"{lean.degrees:.0f}° in the median: it is lit like another shape, baked or not. "
    )
    return Notice("normals-off-surface", message + _advice(lean), place.at("NORMAL"), found)


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
    # Number the planes that are asked for from 1; 0 is any other.
    numbers = np.zeros(len(primitive.positions), dtype=np.int32)
    numbers[own] = 1
    numbers = np.cumsum(numbers, dtype=np.int32) * numbers
    corners = numbers[primitive.triangles if labels is None else labels[primitive.triangles]]
    # Only the triangles that touch one of them.
    touching = corners.any(axis=1)
    corners, triangles = corners[touching], primitive.triangles[touching]
    sides = _sides(primitive, triangles)
    cross = _normals(sides)
    # The angle at each corner over twice the area: its share of the triangle's normal.
    doubled = np.sqrt(np.einsum("ij,ij->i", cross, cross))
    dots = -np.einsum("tij,tij->ti", sides, sides[[2, 0, 1]])
    shares = np.divide(np.arctan2(doubled, dots), doubled, out=np.zeros_like(dots), where=doubled > 0)
    # Each plane is the sum over its corners.
    planes = np.zeros((int(numbers.max(initial=0)) + 1, 3))
    for axis in range(3):
        planes[:, axis] = bincount(corners.T.ravel(), (shares * cross[:, axis]).ravel(), len(planes))
    planes[np.einsum("ij,ij->i", planes, planes) < CANCELLED**2] = 0.0
    return _degrees(planes[numbers[own]], primitive.normals[rows])


def _leans_from_all(primitive: SkinnedPrimitive, rows: IntArray) -> Float64Array:
    """Return the smaller lean of some vertices (N,): from all triangles at the position, or generated."""
    shared = _leans(primitive, rows, kernel.label_equal_rows(primitive.positions))
    # The degrees by which the normals of some vertices (N,) lean from generated ones (N,).
    [generated] = with_smooth_normals([replace(primitive, normals=primitive.normals[:0])])
    return np.asarray(
        np.fmin(shared, _degrees(generated.normals[rows].astype(np.float64), primitive.normals[rows]))
    )


def _sides(primitive: SkinnedPrimitive, triangles: IntArray) -> Float64Array:
    """Return the sides of triangles (3, T, 3): from each corner to the next."""
    corners = primitive.positions[triangles.T].astype(np.float64)
    return corners[[1, 2, 0]] - corners


def _normals(sides: Float64Array) -> Float64Array:
    """Return the normals (T, 3) of triangles, as long as their doubled area."""
    return cross_products(sides[0], sides[1])


def _degrees(planes: Float64Array, normals: FloatArray) -> Float64Array:
    """Return the angle between vectors (N, 3) in degrees, NaN if one of them has no direction."""
    # The cosine between vectors (N, 3), NaN if one of them has no direction.
    units = unit_vectors(normals)
    lengths = np.where(has_direction(normals), np.linalg.norm(planes, axis=1), 0.0)
    dots = np.einsum("ij,ij->i", planes, units)
    cosines = np.divide(dots, lengths, out=np.full(len(planes), np.nan), where=lengths > 0)
    return np.asarray(np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0))))


def with_smooth_normals(primitives: Sequence[SkinnedPrimitive]) -> list[SkinnedPrimitive]:
    """Return the primitives of one mesh. A primitive without normals gets smooth ones, float32.

    Vertices at one position share a normal, across the primitives that lack them. Tangents are dropped,
    because they mean nothing without normals. A vertex of no proper triangle gets (0, 0, 1).
    """
    lacking = [primitive for primitive in primitives if len(primitive.normals) == 0]
    if not lacking:
        return list(primitives)
    starts = np.cumsum([0, *(len(primitive.positions) for primitive in lacking)])
    positions = np.concatenate([primitive.positions for primitive in lacking])
    triangles = np.concatenate(
        [primitive.triangles + start for primitive, start in zip(lacking, starts, strict=False)]
    )
    triangles = triangles[kernel.mark_proper(positions, triangles)]
    points = kernel.label_equal_rows(positions)
    normals = smooth_normals(positions, triangles, points).astype(np.float32)
    made = iter(np.split(normals, starts[1:-1]))
    return [
        replace(primitive, normals=next(made), tangents=None) if len(primitive.normals) == 0 else primitive
        for primitive in primitives
    ]
