"""The true normals of skinned surfaces by their tangents, measured without any use of α and β.

The discrete gradient of ``operator`` is applied to the deformed positions and to the rest positions. It gives
two tangents before and two tangents after. F maps the first frame onto the second. The true normal is
cof(F) n0, the image of the authored normal under the cofactor of F. ``triangle_normals`` has the other truth,
which is found independently. Morph targets act before skinning. The morphed mesh takes the place of the rest
pose, and its morphed normal takes the place of n0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray
from skinbake.lighting.sparse_rows import SparseRows
from skinbake.skinning.components import Vector, cross, dot, scaled

FLAT_FRAME = 1e-6
"""The sine between two tangents below which they have no normal. float32 positions leave no exact digit."""


@dataclass(frozen=True, slots=True)
class RestFrames:
    """The data of the rest pose that the truth by tangents needs.

    parts are blocks of B vertices. derivatives are two operators of each block, along t0 and b0: sparse (B,
    V). They make a and b of the positions. coefficients (3, V) are those of n0 in the frame (a, b, ĉ) at
    rest, with c = a × b, divided by |c|. areas (V,) are |c|. valid (V,) tells where the frame and n0 are
    usable. Under morph targets all fields but the first two change.
    """

    parts: tuple[slice, ...]
    derivatives: tuple[tuple[SparseRows, SparseRows], ...]
    coefficients: Float64Array
    areas: Float64Array
    valid: BoolArray


def morphed_frames(rest: RestFrames, positions: FloatArray, normals: FloatArray) -> RestFrames:
    """Measure the mesh under morph targets, before skinning, like ``rest_frames`` without targets.

    positions, normals (V, 3) are the results of the targets. The frame is measured along the same curves on
    the surface as t0 and b0 at rest. So it is their image under the differential of the morph. If skinning is
    the identity, this truth returns these normals exactly.
    """
    return measured_frames(rest.parts, rest.derivatives, positions, normals)


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
