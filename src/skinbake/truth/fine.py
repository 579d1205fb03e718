"""The smooth surface that a mesh stands for: the mesh of the truth *fine*, rounded and cut at rest.

Each triangle is rounded by its vertices' normals to a curved PN triangle, and its edges are halved LEVELS
times. Source: Vlachos, Peters, Boyd, Mitchell, *Curved PN triangles*, Symposium on Interactive 3D Graphics
2001, section 3.1. Weights are interpolated along the edges. Skinning moves the small triangles, and the truth
by triangles measures their normals at the vertices of the mesh. Only the small triangles with a corner there
count, so no others are made: one for each corner of the mesh, with the nearest point on each of its edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from skinbake.geometry.skinned import Float64Array, FloatArray, IntArray
from skinbake.skinning.components import dot
from skinbake.skinning.rest import RestPrimitive
from skinbake.truth.mesh import Int32Array, WeldedMesh, weights_of_corners
from skinbake.truth.operator import GradientOperator, is_sound

LEVELS = 3
"""How often edges are halved.

Weights are straight along each edge, so each further level brings the truth nearer to the gradients of the
surface: an error of 0.15° with three levels is 0.19° with two, and 0.13° with four. What the fit leaves moves
less.
"""

SHARE = 2.0**-LEVELS
"""Where a point lies on its edge, seen from its vertex, as a share of the edge's parameter."""


@dataclass(frozen=True, slots=True)
class FineMesh:
    """The points and small triangles around the V vertices of a mesh.

    A point (N,) lies on the edge from the vertex ``near`` to the vertex ``far``. Numbers from V on stand for
    the points in ``triangles`` (3 T, 3): one for each corner of the mesh, in the order of its corners, with
    the corner's vertex first.
    """

    mesh: WeldedMesh
    near: IntArray
    far: IntArray
    triangles: Int32Array

    @classmethod
    def of(cls, mesh: WeldedMesh) -> FineMesh:
        """Find the points of a mesh. Triangles that share an edge, and both of its vertices, share them."""
        count = len(mesh.positions)
        corners = mesh.triangles.astype(np.int64)
        following, preceding = (np.roll(corners, shift, axis=1) for shift in (-1, 1))
        ends = np.stack([following.ravel(), preceding.ravel()])
        edges, place = np.unique(corners.ravel() * count + ends, return_inverse=True)
        near, far = np.divmod(edges, count)
        triangles = np.column_stack([corners.ravel(), *(count + place.reshape(2, -1))])
        return cls(mesh, near, far, triangles.astype(np.int32))

    @property
    def size(self) -> int:
        """The number of vertices and points."""
        return len(self.mesh.positions) + len(self.near)

    def with_points(self, positions: FloatArray, normals: FloatArray) -> Float64Array:
        """Return the positions of all vertices, and then of all points: (V + N, 3).

        positions (V, 3) and normals (V, 3), of any length, are those before skinning. An edge is straight at
        an end whose normal has no direction.
        """
        wide = np.asarray(positions, dtype=np.float64)
        units = np.asarray(normals, dtype=np.float64)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # such normals count as zeros
            units = units / np.linalg.norm(units, axis=1, keepdims=True)
        units[~np.isfinite(units).all(axis=1)] = 0.0
        start, end = wide[self.near], wide[self.far]
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite has no true normal
            edge = end - start
            # A cubic curve. Its inner control points are a third of the edge away, laid into the tangent
            # planes of both ends.
            first, last = (edge - _along(edge, units[at]) for at in (self.near, self.far))
            near, far = 1.0 - SHARE, SHARE
            curve = near**3 * start + 3.0 * near**2 * far * (start + first / 3.0)
            curve += 3.0 * near * far**2 * (end - last / 3.0) + far**3 * end
        return np.concatenate([wide, curve])

    def operator(self, positions: Float64Array) -> GradientOperator:
        """Return the operator at the vertices, from the result of ``with_points`` at rest.

        It has the mesh's weld classes, and rows for the vertices only. Small triangles without an area are
        left out.
        """
        mesh = self.mesh
        sound = is_sound(positions, self.triangles)
        kept = mesh.corners[sound[mesh.corners]]
        classes = mesh.classes[self.triangles[kept, 0]]
        count = len(mesh.ends) - 1
        one, first, second = positions[self.triangles[kept]].transpose(1, 2, 0)
        weights = weights_of_corners(tuple(first - one), tuple(second - one), mesh.weighting)
        return GradientOperator(
            counts=mesh.counts,
            positions=positions,
            triangles=self.triangles,
            # A point belongs to a class of its own, which has no row.
            classes=np.concatenate([mesh.classes, np.full(len(self.near), count, dtype=np.int32)]),
            weighting=mesh.weighting,
            totals=np.bincount(classes, weights, minlength=count).astype(np.float64),
            corners=(3 * kept).astype(np.int32),
            ends=np.concatenate([[0], np.cumsum(np.bincount(classes, minlength=count))]),
        )

    def points(self, primitives: Sequence[RestPrimitive], positions: Float64Array) -> RestPrimitive:
        """Return all points (N,) as one primitive that can be skinned. primitives make up the mesh.

        A point has the slots of the vertex near it, and then those of the far one. So its first joint, which
        decides the signs of dual quaternions, is that of the vertex.
        """
        width = max(primitive.joints.shape[1] for primitive in primitives)
        joints, weights = (
            np.concatenate([_padded(getattr(primitive, name), width) for primitive in primitives])
            for name in ("joints", "weights")
        )
        ends = self.near, self.far
        shares = 1.0 - SHARE, SHARE
        none = np.zeros((len(self.near), 2 * width - 1))
        blend = np.concatenate(
            [np.zeros((len(one.positions), 3)) if one.blend is None else one.blend for one in primitives]
        )
        zeros = np.zeros((len(self.near), 3))
        return RestPrimitive(
            positions=positions[len(self.mesh.positions) :],
            normals=zeros,
            tangents=zeros,
            bitangents=zeros,
            joints=np.concatenate([joints[end] for end in ends], axis=1),
            weights=np.concatenate([s * weights[end] for s, end in zip(shares, ends, strict=True)], axis=1),
            alpha=none,
            beta=none,
            blend=shares[0] * blend[self.near] + shares[1] * blend[self.far],
        )


def _along(vectors: Float64Array, units: Float64Array) -> Float64Array:
    """Return the parts of vectors (N, 3) along unit vectors (N, 3)."""
    return np.asarray(dot(tuple(vectors.T), tuple(units.T))[:, None] * units)


def _padded(slots: Any, width: int) -> Any:
    """Return slots (V, K) of at least so many columns; further ones are 0."""
    return np.pad(slots, ((0, 0), (0, width - slots.shape[1])))
