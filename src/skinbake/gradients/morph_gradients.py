"""The differential of morph targets at welded vertices, and the normals that it gives.

A target moves a point p of the surface by Δ(p). Its differential along a tangent is the derivative of Δ. It
is taken as that of a weight is (``weight_gradients``): on each triangle, and then as the mean over the
corners of a weld class.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from skinbake.geometry.frames import dot, unit_vectors
from skinbake.geometry.morphs import Differences
from skinbake.geometry.poses import product
from skinbake.geometry.skinned import Float64Array, FloatArray, IntArray, bincount
from skinbake.gradients.weight_gradients import WEIGHTINGS, Corners, corners_of, summed_rows

FLAT = 1e-6
"""The sine between two tangents below which they have no normal. float32 positions leave no exact digit."""


class Differential(NamedTuple):
    """The derivatives of one target along t0 and b0 at vertices rows (R,): (R, 3) each, otherwise 0."""

    rows: IntArray
    along_t: Float64Array
    along_b: Float64Array


@dataclass(frozen=True, slots=True)
class MorphSurface:
    """One mesh at rest, of which targets are differentiated.

    triangles (T, 3) have an area, corners are theirs. classes (V,) are the weld classes, totals (C,) the
    summed weights of their corners. normals (V, 3) have length 1, tangents and bitangents (V, 3) are t0 and
    b0. along (2, V, 3) are the derivatives of the positions themselves: t0 and b0, as the triangles see them.
    """

    triangles: IntArray
    corners: tuple[Corners, ...]
    classes: IntArray
    totals: Float64Array
    normals: Float64Array
    tangents: Float64Array
    bitangents: Float64Array
    along: Float64Array

    @classmethod
    def of(
        cls,
        positions: FloatArray,
        triangles: IntArray,
        classes: IntArray,
        normals: FloatArray,
        frame: tuple[FloatArray, FloatArray],
        *,
        weighting: str,
    ) -> MorphSurface:
        """Take a mesh: positions, normals and the frame (V, 3), triangles (T, 3) that have an area.

        classes (V,) are numbered from 0. weighting is a key of WEIGHTINGS.
        """
        corners = tuple(corners_of(positions, triangles, WEIGHTINGS[weighting]))
        totals = np.zeros(int(classes.max(initial=-1)) + 1)
        for one in corners:
            totals += bincount(classes[one.origin], one.weight, len(totals))
        tangents, bitangents = (vectors.astype(np.float64) for vectors in frame)
        found = cls(
            triangles,
            corners,
            classes,
            totals,
            unit_vectors(normals),
            tangents,
            bitangents,
            np.zeros((2, len(positions), 3)),
        )
        rest = found.differential(Differences(np.arange(len(positions)), positions))
        found.along[:, rest.rows] = rest.along_t, rest.along_b
        return found

    def differential(self, target: Differences) -> Differential:
        """Differentiate what a target adds to POSITION."""
        moved = np.zeros(len(self.classes), dtype=np.bool_)
        moved[target.rows] = True
        added = np.zeros((len(self.classes), 3))
        added[target.rows] = target.values
        # Only the triangles with a vertex that moves; their classes are numbered anew.
        near = np.flatnonzero(moved[self.triangles].any(axis=1))
        touched = np.zeros(len(self.totals), dtype=np.bool_)
        touched[self.classes[self.triangles[near]]] = True
        numbers = np.cumsum(touched) - 1
        # The sum over the corners of each class: the change of Δ along each edge times ∇ of the hat there.
        count = int(np.count_nonzero(touched))
        total = np.zeros((count, 9))
        for corner in self.corners:
            origin = corner.origin[near]
            for end, coefficients in zip((corner.first, corner.second), corner.coefficients, strict=True):
                change = added[end[near]] - added[origin]
                products = change[:, :, None] * coefficients[near][:, None, :]
                total += summed_rows(numbers[self.classes[origin]], products.reshape(-1, 9), count)
        gradients = (total / self.totals[touched][:, None]).reshape(-1, 3, 3)
        rows = np.flatnonzero(touched[self.classes])
        own = gradients[numbers[self.classes[rows]]]
        along = (product(own, axis[rows, :, None])[:, :, 0] for axis in (self.tangents, self.bitangents))
        return Differential(rows, *along)

    def normals_at(self, change: Differential) -> Float64Array:
        """Return the unit normals (R, 3) of the surface at the rows of a differential, at weight 1.

        A normal is a covector: it is the image of n0 under the cofactor of the map F of the rest onto the
        morphed surface. F maps a and b, the derivatives of the positions, onto a' and b', and their normal
        a × b / |a × b| onto that of a' and b', times the root of the change of area. So it does not stretch
        along the normal where the surface only grows. Where the surface has no normal, n0 stays.
        """
        a, b = self.along[:, change.rows]
        n0 = self.normals[change.rows]
        c = np.cross(a, b)
        moved_a, moved_b = a + change.along_t, b + change.along_b
        moved_c = np.cross(moved_a, moved_b)
        area, moved_area = (np.linalg.norm(one, axis=1) for one in (c, moved_c))
        lengths = [np.linalg.norm(one, axis=1) for one in (a, b, moved_a, moved_b)]
        sound = (area > FLAT * lengths[0] * lengths[1]) & (moved_area > FLAT * lengths[2] * lengths[3])
        sound &= moved_area > FLAT**2 * area  # else what is left is rounding
        area, moved_area = np.where(sound, area, 1.0), np.where(sound, moved_area, 1.0)
        # cof(F) n0 by the columns of the cofactor of [a' b' m], times [a b c/|c|]ᵀ n0.
        m = moved_c / np.sqrt(area * moved_area)[:, None]
        by_a, by_b, by_c = (dot(one, n0)[:, None] for one in (a, b, c / area[:, None]))
        found = by_a * np.cross(moved_b, m) + by_b * np.cross(m, moved_a) + by_c * moved_c
        length = np.linalg.norm(found, axis=1)
        sound &= (length > 0.0) & np.isfinite(length)
        return np.where(sound[:, None], found / np.where(sound, length, 1.0)[:, None], n0)

    def numbers_of(self, change: Differential) -> Float64Array:
        """Return the parts of a differential along the frame (R, 6): in its plane, then along n0.

        The first two are those of the derivative along t0, by t0 and b0, the next two those along b0. The
        last two are both along n0. They are NaN where the frame is flat.
        """
        t0, b0, n0 = (vectors[change.rows] for vectors in (self.tangents, self.bitangents, self.normals))
        across = np.cross(t0, b0)
        volume = dot(across, n0)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            duals = np.cross(b0, n0) / volume, np.cross(n0, t0) / volume, across / volume
        along = (change.along_t, change.along_b)
        parts = [[dot(d, dual) for dual in duals] for d in along]
        (tt, tb, tn), (bt, bb, bn) = parts
        return np.stack([tt, tb, bt, bb, tn, bn], axis=1)
