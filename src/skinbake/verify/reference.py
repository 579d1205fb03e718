"""The normals that skinned surfaces should have, measured on the deformed mesh and owing nothing to α and β.

The discrete gradient of ``operator`` is applied to the deformed positions and to the rest positions alike:
two tangents before, two after. F maps the one frame onto the other, and the reference normal is cof(F) n0,
the image of the authored normal under the cofactor of F. Morph targets act before skinning: the mesh that
they give takes the place of the rest pose, and its morphed normal that of n0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray
from skinbake.verify.operator import GradientOperator

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Below this sine between its two tangents a frame has no normal: float32 positions leave no digit of it.
_FLAT = 1e-6
# Vertices × poses in flight: the dozen temporaries of a block stay in the cache and memory stays bounded.
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
    a, b = _tangents(along, np.asarray(positions, dtype=np.float64)[None])
    with np.errstate(all="ignore"):
        c = _cross(a, b)
        areas = _length(c)[:, 0]
        n0 = np.asarray(normals, dtype=np.float64).T[:, :, None]
        # cof([a b ĉ])⁻¹ n0 = [a b ĉ]ᵀ n0 / det, and det = |c|.
        coefficients = np.stack([_dot(a, n0), _dot(b, n0), _dot(c, n0) / areas[:, None]])[:, :, 0] / areas
        flat = areas <= _FLAT * (_length(a) * _length(b))[:, 0]
    valid = ~flat & np.isfinite(coefficients).all(axis=0) & coefficients.any(axis=0)
    return RestFrames(along, coefficients, areas, valid)


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
    count = max(1, _BLOCK // max(1, deformed.shape[1]))
    normals = np.empty(deformed.shape)
    for start in range(0, len(deformed), count):
        block = slice(start, start + count)
        side = 1.0 if sides is None else np.asarray(sides[block], dtype=np.float64).T
        normals[block] = _block_normals(rest, np.asarray(deformed[block], dtype=np.float64), side)
    return normals, np.isfinite(normals[..., 0])


def _block_normals(rest: RestFrames, deformed: Float64Array, side: Float64Array | float) -> Float64Array:
    """Compute (P, V, 3) reference normals, NaN where undefined."""
    along_a, along_b, along_c = rest.coefficients[:, :, None]
    with np.errstate(all="ignore"):
        a, b = _tangents(rest.tangents, deformed)
        c = _cross(a, b)
        area = _length(c)
        # The third column ĉ1 sqrt(|c1| / |c0|).
        m = c / np.sqrt(area * rest.areas[:, None])
        # The columns of the cofactor matrix are the cross products of the other two; the third column's
        # side turns the first two of them, and the normal's turns all three.
        normal = along_a * _cross(b, m) + along_b * _cross(m, a) + along_c * side * c
        normal /= _length(normal)
        # Not "flat if below": a comparison with NaN is false, and a broken position leaves no normal.
        sound = area > _FLAT * _length(a) * _length(b)
    normal[:, ~(sound & rest.valid[:, None])] = np.nan
    poses_first: Float64Array = normal.transpose(2, 1, 0)
    return poses_first


def _tangents(along: csr_array, positions: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Differentiate (P, V, 3) positions: two (3, V, P) arrays, so that a component is one plane."""
    poses, count, _ = positions.shape
    columns = np.ascontiguousarray(positions.transpose(1, 2, 0)).reshape(count, 3 * poses)
    both = (along @ columns).reshape(2, count, 3, poses)
    return both[0].transpose(1, 0, 2), both[1].transpose(1, 0, 2)


def _cross(first: Float64Array, second: Float64Array) -> Float64Array:
    """Cross (3, ...) arrays along the first axis."""
    x, y, z = first
    u, v, w = second
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u])


def _dot(first: Float64Array, second: Float64Array) -> Float64Array:
    """Dot (3, ...) arrays along the first axis."""
    products: Float64Array = first[0] * second[0] + first[1] * second[1] + first[2] * second[2]
    return products


def _length(vectors: Float64Array) -> Float64Array:
    """Measure (3, ...) arrays along the first axis."""
    lengths: Float64Array = np.sqrt(_dot(vectors, vectors))
    return lengths
