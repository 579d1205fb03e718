"""The true normals of skinned surfaces, in two ways, both without any use of α and β.

By tangents: the discrete gradient of ``operator`` is applied to the deformed positions and to the rest
positions. It gives two tangents before and two tangents after. F maps the first frame onto the second. The
true normal is cof(F) n0, the image of the authored normal under the cofactor of F. Morph targets act before
skinning. The morphed mesh takes the place of the rest pose, and its morphed normal takes the place of n0.

By triangles: angle-weighted vertex normals, as tools shade. Source: Thürmer, Wüthrich, *Computing vertex
normals from polygonal facets*, Journal of Graphics Tools 3(1), 1998. The normal of a vertex is the mean of
the unit normals of its triangles. Each is weighted by the triangle's angle at the vertex. The mean runs
over the corners of its weld class, so not across hard edges. The authored normal n0 may lean away from that
normal. It is carried to the deformed mesh by the cofactor of the map that the triangles measure: F maps two
tangents in the triangles' plane onto those after deformation, and their normal n̂ onto n̂' times the root
of the change of area.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skinbake.geometry.skinned import BoolArray, Float32Array, Float64Array, FloatArray, IntArray
from skinbake.skinning.components import Vector, cross, dot, scaled
from skinbake.truth.mesh import Int32Array, WeldedMesh
from skinbake.truth.values import SparseRows

FLAT_FRAME = 1e-6
"""The sine between two tangents below which they have no normal. float32 positions leave no exact digit."""


class RestFrames(NamedTuple):
    """The data of the rest pose that the truth by tangents needs.

    parts are blocks of B vertices. derivatives are two operators of each block, along t0 and b0: sparse (B,
    V). They make a and b of the positions. coefficients (3, V) belong to n0 in the frame (a, b, ĉ) at
    rest, with c = a × b, divided by |c|. areas (V,) are |c|. valid (V,) tells where the frame and n0 are
    usable. Under morph targets all fields but the first two change.
    """

    parts: tuple[slice, ...]
    derivatives: tuple[tuple[SparseRows, SparseRows], ...]
    coefficients: Float64Array
    areas: Float64Array
    valid: BoolArray


def measured_frames(
    parts: tuple[slice, ...],
    along: tuple[tuple[SparseRows, SparseRows], ...],
    positions: FloatArray,
    normals: FloatArray,
) -> RestFrames:
    """Measure the frames (a, b, ĉ) of all blocks, and find the coefficients of the normals n0 in them.

    along has the rows of each part of ``parts``, as ``RestFrames.derivatives``. positions and normals (V, 3)
    are those of the mesh before skinning, the normals of any length.
    """
    components = np.ascontiguousarray(np.asarray(positions, dtype=np.float64).T)[:, :, None]
    count = len(positions)
    coefficients, areas, valid = np.zeros((3, count)), np.zeros(count), np.zeros(count, dtype=np.bool_)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # what is not finite is not valid
        for part, derivatives in zip(parts, along, strict=True):
            a, b = posed_tangents(derivatives, components)
            c = cross(a, b)
            n0 = tuple(np.asarray(normals[part], dtype=np.float64).T[:, None])
            areas[part] = area = np.sqrt(dot(c, c))[0]
            # cof([a b ĉ])⁻¹ n0 = [a b ĉ]ᵀ n0 / det, and det = |c|.
            found = np.concatenate([dot(a, n0), dot(b, n0), dot(c, n0) / area]) / area
            coefficients[:, part] = found
            flat = area <= FLAT_FRAME * np.sqrt(dot(a, a) * dot(b, b))[0]
            valid[part] = ~flat & np.isfinite(found).all(axis=0) & found.any(axis=0)
    return RestFrames(parts, along, coefficients, areas, valid)


def tangent_normals(
    rest: RestFrames, part: slice, tangents: tuple[Vector, Vector], sides: FloatArray | None = None
) -> tuple[Vector, BoolArray]:
    """Return the true normals of a block of vertices by tangents, components (P, B), and a mask of them.

    tangents are a' and b', the block's tangents after deformation (``posed_tangents``). With c' = a' × b' and
    m = c' / sqrt(|c'| |c|), F is [a' b' m] [a b ĉ]⁻¹. So cof(F) n0 is cof([a' b' m]) times the coefficients
    of ``RestFrames``. A uniform scale of the joints scales m as it scales a' and b'. sides (P, B) is −1 if
    the joints mirror a vertex, because c' points inside there. All arrays are stored vertex by vertex.
    """
    along_a, along_b, along_c = rest.coefficients[:, part]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # what is not finite is not sound
        a, b = tangents
        c = cross(a, b)
        aa, ab, bb, square = dot(a, a), dot(a, b), dot(b, b), dot(c, c)
        # Each column of the cofactor matrix is the cross product of the other two columns. The products with
        # the third column, m = c / sqrt(|c| |c0|), are b × m and m × a by the triple product.
        reciprocal = 1.0 / np.sqrt(np.sqrt(square) * rest.areas[part])
        by_a = (along_a * bb - along_b * ab) * reciprocal
        by_b = (along_b * aa - along_a * ab) * reciprocal
        # The side of the third column changes the sign of the first two, and the normal's side changes all
        # three.
        by_c = along_c if sides is None else along_c * sides
        found = tuple(by_a * a[i] + by_b * b[i] + by_c * c[i] for i in range(3))
        # A comparison with NaN is false, so a broken position is not sound.
        sound = (square > FLAT_FRAME**2 * aa * bb) & rest.valid[part]
    return unit_or_nan(found, sound)


def unit_or_nan(vector: Vector, sound: BoolArray) -> tuple[Vector, BoolArray]:
    """Return unit vectors, NaN if they are not sound or have no length, and a mask of the others."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # likewise
        length = 1.0 / np.sqrt(dot(vector, vector))
        found = scaled(length, vector)
        sound = sound & np.isfinite(found[0])
    if not sound.all():
        for component in found:
            component[~sound] = np.nan
    return found, sound


def posed_tangents(along: tuple[SparseRows, SparseRows], positions: Float64Array) -> tuple[Vector, Vector]:
    """Differentiate positions (3, V, P): two tangents, components (P, B), stored vertex by vertex."""
    along_t, along_b = along
    return posed_tangent(along_t, positions), posed_tangent(along_b, positions)


def posed_tangent(along: SparseRows, positions: Float64Array) -> Vector:
    """Differentiate positions (3, V, P) along one tangent: components (P, B), stored vertex by vertex."""
    if positions.shape[2] == 1:  # the rest pose
        return tuple(product[None] for product in along.times_each(positions[:, :, 0]))
    matrix = along.matrix(positions.shape[1])
    return tuple((matrix @ component).T for component in positions)


FLAT_TRIANGLE = 1e10
"""A deformed triangle with a corner of a larger cotangent is a line or a point, and has no normal."""

CORNER_SAMPLES = 1 << 15
"""The corners × poses in work at a time. The temporaries of a block stay in the processor's cache."""

CLASS_CORNERS = 1 << 13
"""The corners of a block of weld classes. A triangle at the edge of a block is measured in two of them."""


class ClassBlock(NamedTuple):
    """Some weld classes, and the triangles with a corner in them: (N,) int32, ascending, each once."""

    part: slice
    triangles: Int32Array

    @classmethod
    def of(cls, mesh: WeldedMesh, part: slice) -> ClassBlock:
        """Find the triangles that some weld classes meet."""
        met = np.sort(mesh.corners[mesh.ends[part.start] : mesh.ends[part.stop]] // 3)
        return cls(part, met[np.diff(met, prepend=-1) != 0])


def class_blocks(mesh: WeldedMesh) -> list[ClassBlock]:
    """Cut a mesh's weld classes into blocks."""
    ends, count = mesh.ends, len(mesh.ends) - 1
    found, start = [], 0
    while start < count:
        stop = int(np.searchsorted(ends, ends[start] + CLASS_CORNERS, side="right")) - 1
        stop = min(max(stop, start + 1), start + CLASS_CORNERS, count)
        found.append(ClassBlock.of(mesh, slice(start, stop)))
        start = stop
    return found


def sums_of_classes(mesh: WeldedMesh, positions: Float64Array, part: slice) -> Float64Array:
    """Return Σ angle × unit normal over the corners of some weld classes: (3, C, P).

    positions (3, V, P) belong to all vertices. Triangles without an area, or with a broken position, add
    nothing.
    """
    starts = mesh.ends[part.start : part.stop + 1]
    total = np.zeros((3, part.stop - part.start, positions.shape[2]))
    step = max(1, CORNER_SAMPLES // max(positions.shape[2], 1))
    for first in range(int(starts[0]), int(starts[-1]), step):
        corners = mesh.corners[first : min(first + step, int(starts[-1]))]
        bounds = np.clip(starts - first, 0, len(corners))
        rows = np.flatnonzero(np.diff(bounds))
        for axis, weighted in enumerate(_corner_normals(mesh, positions, corners)):
            total[axis, rows] += np.add.reduceat(weighted, bounds[rows], axis=0)
    return total


def _corner_normals(mesh: WeldedMesh, positions: Float64Array, corners: IntArray) -> Vector:
    """Return angle × unit normal of the triangles at some of their corners: components (N, P)."""
    first, second, third = mesh.triangles[corners // 3].T
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # what is not finite is not sound
        e1 = tuple(component[second] - component[first] for component in positions)
        e2 = tuple(component[third] - component[first] for component in positions)
        aa, ab = dot(e1, e1), dot(e1, e2)
        normal = cross(e1, e2)
        area = np.sqrt(dot(normal, normal))
        # The product of the two edges at the corner itself, which may be the second or the third.
        along = np.select(
            [corners[:, None] % 3 == 0, corners[:, None] % 3 == 1], [ab, aa - ab], dot(e2, e2) - ab
        )
        angle = np.arctan2(area, along)
        # A comparison with NaN is false, so a broken position is not sound. A flat triangle has a large
        # cotangent at the first or the second corner.
        sound = (np.abs(ab / area) < FLAT_TRIANGLE) & (np.abs((aa - ab) / area) < FLAT_TRIANGLE)
        return tuple(np.where(sound, angle / area * component, 0.0) for component in normal)


class ClassSums(NamedTuple):
    """The sums (3, C, P) of the weld classes of a deformed mesh, float32, and what carries normals there.

    carried (3, V) are the coordinates of unit n0 at rest, NaN if a vertex has no frame: a · n0 / √|A|,
    b · n0 / √|A| and n̂ · n0, all with the sign of A. n̂ is the normal by triangles, a and b are the two
    tangents of the operator, laid into the plane at right angles to n̂, and A is the signed area of a and b
    about n̂. classes (V,) are int32.
    """

    carried: Float64Array
    classes: Int32Array
    sums: Float32Array


def block_sums(classes: IntArray, sums: FloatArray, part: slice) -> Vector:
    """Return the sums of a block of vertices, components (P, B), from the sums of all classes (3, C, P)."""
    return tuple(component[classes[part]].astype(np.float64).T for component in sums)


def triangle_normals(
    carried: Float64Array,
    part: slice,
    tangents: tuple[Vector, Vector],
    sums: Vector,
    sides: FloatArray | None = None,
) -> tuple[Vector, BoolArray]:
    """Return the true normals of a block of vertices by triangles, components (P, B), and a mask of them.

    tangents are a' and b', the block's tangents after deformation (``posed_tangents``). sums are its
    ``block_sums``. sides (P, B) is −1 if the joints mirror a vertex, because the triangles' normals point
    inside there.
    """
    by_a, by_b, by_n = carried[:, part]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # what is not finite is not sound
        a, b = tangents
        n, area, flat = triangle_frame(a, b, sums)
        if sides is not None:
            by_n = by_n * sides
        # The columns of cof([a' b' n̂' √|A' / A|]), divided by |A' / A|, are b' × n̂' and n̂' × a' over √|A A'|,
        # and n̂' with the sign of A'. What a' and b' have along n̂' does not enter. Where a fold turns a' and
        # b' over, the normal is on the other side, as by tangents.
        reciprocal = 1.0 / np.sqrt(np.abs(area))
        by_n = by_n * np.sign(area)
        across_a, across_b = cross(b, n), cross(n, a)
        lean_a, lean_b = by_a * reciprocal, by_b * reciprocal
        found = tuple(lean_a * across_a[i] + lean_b * across_b[i] + by_n * n[i] for i in range(3))
    return unit_or_nan(found, ~flat)


def triangle_frame(a: Vector, b: Vector, sums: Vector) -> tuple[Vector, FloatArray, BoolArray]:
    """Return n̂, the signed area of two tangents in the plane of the triangles, and where it is flat."""
    n = scaled(1.0 / np.sqrt(dot(sums, sums)), sums)
    area = dot(cross(a, b), n)
    # A comparison with NaN is false, so a broken position counts as flat.
    return n, area, ~(area * area > FLAT_FRAME**2 * dot(a, a) * dot(b, b))
