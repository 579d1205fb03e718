"""The normals that skinned surfaces should have, measured on the deformed mesh and owing nothing to α and β.

The discrete gradient of ``operator`` is applied to the deformed positions and to the rest positions alike:
two tangents before, two after. F maps the one frame onto the other, and the reference normal is cof(F) n0,
the image of the authored normal under the cofactor of F. Morph targets act before skinning: the mesh that
they give takes the place of the rest pose, and its morphed normal that of n0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray
from skinbake.lighting.operator import GradientOperator
from skinbake.skinning.components import Vector, cross, dot

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Below this sine between its two tangents a frame has no normal: float32 positions leave no digit of it.
_FLAT = 1e-6
# Vertices × poses that ``reference_normals`` has in flight: memory stays bounded.
_BLOCK = 1 << 16


@dataclass(frozen=True, slots=True)
class RestFrames:
    """What the reference needs of the rest pose.

    tangents: sparse (2V, V), the derivative along t0, then along b0. coefficients (3, V): n0 in the rest
    frame (a, b, ĉ), with c = a × b, divided by |c|. areas (V,): |c|. valid (V,): the frame and n0 are
    usable. Under morph targets all but the first change.
    """

    tangents: csr_array
    coefficients: Float64Array
    areas: Float64Array
    valid: BoolArray


def rest_frames(
    operator: GradientOperator,
    positions: FloatArray,
    normals: FloatArray,
    tangents: FloatArray,
    bitangents: FloatArray,
) -> RestFrames:
    """Measure the rest pose, once for any number of poses.

    All arrays are (V, 3) over the mesh's concatenated vertices, in mesh space: the rest positions, n0 of
    any length, t0 and b0. A vertex without triangles, with a flat frame, or with a zero or non-finite n0 is
    not valid.
    """
    from scipy.sparse import vstack

    along = vstack([operator.along(tangents), operator.along(bitangents)], format="csr")
    return _measured(along, positions, normals)


def morphed_frames(rest: RestFrames, positions: FloatArray, normals: FloatArray) -> RestFrames:
    """Measure the mesh under morph targets, before skinning, as ``rest_frames`` does the one without.

    positions, normals (V, 3): those that the targets give. The frame is measured along the same curves on
    the surface, those of t0 and b0 at rest, so that it is their image under the morph's own differential;
    where skinning is the identity, the reference returns these normals exactly.
    """
    return _measured(rest.tangents, positions, normals)


def _measured(along: csr_array, positions: FloatArray, normals: FloatArray) -> RestFrames:
    a, b = _tangents(along, np.asarray(positions, dtype=np.float64)[:, :, None])
    with np.errstate(all="ignore"):
        c = cross(a, b)
        n0 = tuple(np.asarray(normals, dtype=np.float64).T[:, None])
        square = dot(c, c)
        areas = np.sqrt(square)
        # cof([a b ĉ])⁻¹ n0 = [a b ĉ]ᵀ n0 / det, and det = |c|.
        coefficients = np.concatenate([dot(a, n0), dot(b, n0), dot(c, n0) / areas]) / areas
        flat = areas <= _FLAT * np.sqrt(dot(a, a) * dot(b, b))
    valid = ~flat[0] & np.isfinite(coefficients).all(axis=0) & coefficients.any(axis=0)
    return RestFrames(along, coefficients, areas[0], valid)


def reference_normals(
    rest: RestFrames, deformed: FloatArray, sides: FloatArray | None = None
) -> tuple[Float64Array, BoolArray]:
    """Return the reference normals of a deformed mesh, and where they are valid.

    deformed (P, V, 3): the skinned positions over the mesh's concatenated vertices, in any one space per
    pose. The normals are (P, V, 3) float64 unit vectors in that space, the mask is (P, V). It is false, and
    the normal NaN, where the rest frame is not valid or the deformed one is flat.

    With c = a × b of the tangents a, b and ĉ its direction, F takes a0, b0, ĉ0 to a1, b1,
    ĉ1 sqrt(|c1| / |c0|). The factor keeps a uniform scale uniform: joint matrices with an overall 0.01 are
    common. So at rest, and under any rotation and uniform scale, cof(F) n0 is n0 or its image up to
    rounding, authored normals included. sides (P, V) is −1 where the joints mirror a vertex, 1 elsewhere and
    by default: its third column points to the other side of the surface, so that F is the mirror, and the
    normal is −cof(F) n0, which stays outside.
    """
    every = slice(0, deformed.shape[1])
    (along,) = tangent_blocks(rest, [every])
    count = max(1, _BLOCK // max(1, deformed.shape[1]))
    normals = np.empty(deformed.shape)
    for start in range(0, len(deformed), count):
        block = slice(start, start + count)
        posed = np.ascontiguousarray(np.transpose(deformed[block], (1, 2, 0)), dtype=np.float64)
        found, _ = block_normals(rest, along, every, posed, None if sides is None else sides[block])
        normals[block] = np.stack(found, axis=2)
    return normals, np.isfinite(normals[..., 0])


def tangent_blocks(rest: RestFrames, parts: Sequence[slice]) -> list[csr_array]:
    """Return the derivatives of blocks of vertices: sparse (2B, V) each, along t0, then along b0."""
    from scipy.sparse import csr_array

    along, count = rest.tangents, rest.tangents.shape[1]
    blocks = []
    for part in parts:
        ends = [along.indptr[part.start + first : part.stop + first + 1] for first in (0, count)]
        pieces = [slice(int(rows[0]), int(rows[-1])) for rows in ends]
        rows = np.concatenate([ends[0] - ends[0][0], ends[1][1:] - ends[1][0] + (ends[0][-1] - ends[0][0])])
        data, columns = (
            np.concatenate([values[piece] for piece in pieces]) for values in (along.data, along.indices)
        )
        blocks.append(csr_array((data, columns, rows), shape=(len(rows) - 1, count)))
    return blocks


def block_normals(
    rest: RestFrames,
    along: csr_array,
    part: slice,
    deformed: Float64Array,
    sides: FloatArray | None = None,
) -> tuple[Vector, BoolArray]:
    """Return what ``reference_normals`` does for a block of vertices, by components (P, B).

    along are the block's derivatives (``tangent_blocks``), deformed (V, 3, P) all vertices' positions; sides
    (P, B) is of the block. All of it is stored vertex by vertex.
    """
    along_a, along_b, along_c = rest.coefficients[:, part]
    with np.errstate(all="ignore"):
        a, b = _tangents(along, deformed)
        c = cross(a, b)
        aa, ab, bb, square = dot(a, a), dot(a, b), dot(b, b), dot(c, c)
        # The columns of the cofactor matrix are the cross products of the other two, and the third of those
        # is m = c / sqrt(|c| |c0|): b × m and m × a by the triple product.
        reciprocal = 1.0 / np.sqrt(np.sqrt(square) * rest.areas[part])
        by_a = (along_a * bb - along_b * ab) * reciprocal
        by_b = (along_b * aa - along_a * ab) * reciprocal
        # The third column's side turns the first two of them, and the normal's turns all three.
        by_c = along_c if sides is None else along_c * sides
        x, y, z = (by_a * a[i] + by_b * b[i] + by_c * c[i] for i in range(3))
        length = 1.0 / np.sqrt(dot((x, y, z), (x, y, z)))
        # Not "flat if below": a comparison with NaN is false, and a broken position leaves no normal.
        sound = (square > _FLAT**2 * aa * bb) & rest.valid[part]
        x *= length
        y *= length
        z *= length
        sound &= np.isfinite(x)
    if not sound.all():
        for component in (x, y, z):
            component[~sound] = np.nan
    return (x, y, z), sound


def _tangents(along: csr_array, positions: Float64Array) -> tuple[Vector, Vector]:
    """Differentiate positions (V, 3, P): two tangents, components (P, B)."""
    count, _, poses = positions.shape
    both = (along @ positions.reshape(count, -1)).reshape(2, -1, 3, poses)
    a, b = (tuple(component.T for component in np.ascontiguousarray(np.swapaxes(v, 0, 1))) for v in both)
    return a, b
