"""The tilt of tangents in the stored pose of a rig, against the mesh in that pose (docs/fitted.md).

Many files store their nodes in another pose than the bind pose. There the mesh has a true normal n', and
algorithm 3 has the tangents t' = Σ M_i (w_i t + α_i p, α_i), with the joint matrices M_i of the pose. So
n' · t' is linear in α, and ``rig_fit`` makes it small, beside the tilts by small turns.
``loops/stored_pose.h`` does the same; this module is the definition.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skinbake.geometry.frames import parts_along
from skinbake.geometry.skinned import Float64Array, FloatArray, IntArray
from skinbake.gradients.fit_rules import FLAT, STRETCHED
from skinbake.gradients.surface import Surface
from skinbake.gradients.weight_gradients import summed_rows


@dataclass(frozen=True, slots=True)
class WeightChanges:
    """How the weights change around C weld classes: E entries, each of a class and a joint.

    With the change Δw of the joint's weight along each edge e, and the coefficients g and h of the edge in
    both derivatives, coefficients (E, 2) are Σ Δw (g, h), and edges (E, 2, 3) are Σ Δw g e and Σ Δw h e.
    """

    classes: IntArray
    joints: IntArray
    coefficients: Float64Array
    edges: Float64Array

    @property
    def only_changing(self) -> WeightChanges:
        """Return the entries that are not all zeros."""
        kept = np.flatnonzero(self.coefficients.any(axis=1) | self.edges.any(axis=(1, 2)))
        return WeightChanges(self.classes[kept], self.joints[kept], self.coefficients[kept], self.edges[kept])


@dataclass(frozen=True, slots=True)
class StoredTilts:
    """How C weld classes tilt in the stored pose.

    matrices (J, 3, 4) are the upper rows of the joint matrices. normals (C, 3) are n', unit vectors. points
    (C, 3) are where the classes are. tilts (C, 2) are n' · Σ w_i M_i (t, 0) for both tangents t of a class.
    weights (C,) are v = 2 / (|F t|² + |F b|²), in which F t and F b are the tangents that the mesh has. They
    are 0 where the pose does not count: where it stretches the surface too much, or no weight changes.
    """

    matrices: Float64Array
    normals: Float64Array
    points: Float64Array
    tilts: Float64Array
    weights: Float64Array

    def displacements(self, classes: IntArray, joints: IntArray, positions: FloatArray) -> Float64Array:
        """Return where joints move V vertices, from the points of their classes: (V, K, 3), 0 for no joint.

        classes (V,), joints (V, K) and positions (V, 3) are those of the vertices.
        """
        moved = _moved(self.matrices[np.maximum(joints, 0)], positions.astype(np.float64)[:, None])
        counts = (joints >= 0) & (self.weights[classes] > 0.0)[:, None]
        return np.where(counts[:, :, None], moved - self.points[classes, None], 0.0)


def stored_tilts(
    surface: Surface, changes: WeightChanges, derivatives: Float64Array, tangents: Float64Array
) -> StoredTilts | None:
    """Return the tilts of all classes in the stored pose, None if the rig has none.

    derivatives (C, 2, 3) are those of the positions along both tangents (C, 2, 3), at rest.
    """
    matrices = None if surface.rig is None else surface.rig.stored
    if matrices is None:
        return None
    # Where there is no area, or a joint has no matrix, there is NaN on the way.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # Measure the classes in the stored pose, whose matrices are (J, 3, 4); see ``stored_tilts``.
        count, changes = len(derivatives), changes.only_changing
        first = np.zeros(count, dtype=np.int64)
        first[surface.classes[::-1]] = np.arange(len(surface.classes))[::-1]
        positions = surface.positions[first].astype(np.float64)
        weights, own = surface.field.weights[first], matrices[np.maximum(surface.field.joints[first], 0)]
        # A matrix that is not finite must not count where its joint has no weight: 0 times NaN is NaN.
        own = np.where((weights > 0.0)[:, :, None, None], own, 0.0)
        blended = np.einsum("ck,ckij->cij", weights, own)
        # Where the pose puts each class, and the derivatives of its positions.
        points = _moved(blended, positions)
        posed = np.einsum("cij,cnj->cni", blended[:, :, :3], derivatives)
        terms = np.einsum("ck,ck->c", weights, _terms(own, positions[:, None]))
        added, bounds = _added_by_changes(matrices, changes, positions, points, terms)
        posed += added
        # The tangents that the mesh has there, and their lengths with and without stretching.
        mapped = _mapped(derivatives, posed, tangents)
        lengths = np.square(mapped).sum(axis=(1, 2))
        turned = np.einsum("ckij,cnj->ckni", own[..., :3], tangents)
        unstretched = np.einsum("ck,ck->c", weights, np.square(turned).sum(axis=(2, 3)))
        # The normal of the posed surface, and how far the blended tangents leave it.
        normals = np.cross(mapped[:, 0], mapped[:, 1])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        tilts = np.einsum("cij,cnj,ci->cn", blended[:, :, :3], tangents, normals)
        # A class does not count where the pose stretches it too much.
        counts = (lengths <= STRETCHED * unstretched) & (unstretched <= STRETCHED * lengths)
        # Where the surface shrinks to a line, or large terms cancel, the normal is rounding.
        areas = np.linalg.norm(np.cross(posed[:, 0], posed[:, 1]), axis=1)
        counts &= areas > FLAT * FLAT * (bounds + np.sqrt(unstretched)) * np.linalg.norm(posed, axis=(1, 2))
        counts &= bounds > 0.0
        counts &= np.isfinite(normals).all(axis=1) & np.isfinite(tilts).all(axis=1)
        return StoredTilts(
            matrices,
            np.where(counts[:, None], normals, 0.0),
            np.where(counts[:, None], points, 0.0),
            np.where(counts[:, None], tilts, 0.0),
            np.where(counts, 2.0 / lengths, 0.0),
        )


def _added_by_changes(
    matrices: Float64Array,
    changes: WeightChanges,
    positions: Float64Array,
    points: Float64Array,
    terms: Float64Array,
) -> tuple[Float64Array, Float64Array]:
    """Return what changes of weights add to the derivatives of the posed positions, (C, 2, 3).

    A joint adds Σ Δw g L e, with the linear part L of its matrix, and Σ Δw g times where it moves the vertex.
    Return a bound (C,) of what is added, too, 0 where no weight changes. terms (C,) are those of the points.
    """
    at, own = changes.classes, matrices[changes.joints]
    # Δw g L e, and Δw g (M p − p').
    turned = np.einsum("eij,enj->eni", own[:, :, :3], changes.edges)
    moved = _moved(own, positions[at]) - points[at]
    added = turned + changes.coefficients[:, :, None] * moved[:, None]
    # A bound of their lengths: the rounding of the sum is a share of it.
    bounds = np.linalg.norm(turned, axis=(1, 2))
    bounds += np.linalg.norm(changes.coefficients, axis=1) * (terms[at] + _terms(own, positions[at]))
    summed = summed_rows(at, np.hstack([added.reshape(-1, 6), bounds[:, None]]), len(positions))
    return summed[:, :6].reshape(-1, 2, 3), summed[:, 6]


def _mapped(derivatives: Float64Array, posed: Float64Array, tangents: Float64Array) -> Float64Array:
    """Return F t of both tangents (C, 2, 3). NaN where the surface has no normal.

    F maps the derivatives a and b at rest to the posed ones, and the unit vector across a and b to the one
    across the posed ones times sqrt(|a' × b'| / |a × b|), as in the truth by tangents.
    """
    across, posed_across = (np.cross(both[:, 0], both[:, 1]) for both in (derivatives, posed))
    area, posed_area = (np.linalg.norm(vectors, axis=1)[:, None] for vectors in (across, posed_across))
    # The unit vector across the posed surface, by the root of how the area grows.
    third = posed_across / posed_area * np.sqrt(posed_area / area)
    found = np.empty_like(tangents)
    for number in range(2):
        t = tangents[:, number]
        # F t from the parts of t along a, b and across them.
        parts = parts_along(t, derivatives[:, 0], derivatives[:, 1])
        along_third = np.einsum("ci,ci->c", t, across / area)
        found[:, number] = np.einsum("ct,cti->ci", parts, posed) + along_third[:, None] * third
    return found


def _terms(matrices: Float64Array, positions: Float64Array) -> Float64Array:
    """Return a bound (…) of the terms that ``_moved`` adds up. The rounding is a share of it."""
    moved = np.linalg.norm(_moved(matrices, positions), axis=-1)
    return np.asarray(moved + np.linalg.norm(matrices[..., 3], axis=-1))


def _moved(matrices: Float64Array, positions: Float64Array) -> Float64Array:
    """Return positions (…, 3) moved by the upper rows of matrices (…, 3, 4)."""
    moved: Float64Array = np.einsum("...ij,...j->...i", matrices[..., :3], positions) + matrices[..., 3]
    return moved
