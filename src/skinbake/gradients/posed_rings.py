"""How the neighbourhoods of weld classes lie in a pose, from the sums over their rings (fit.py).

All that a pose does to the derivatives of a mesh is linear in its joint matrices, so no mesh is posed.
``loops/posed_ring.h`` does the same, for several poses at once; this module is the definition.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skinbake.geometry.frames import parts_along
from skinbake.geometry.poses import determinants
from skinbake.geometry.skinned import Float64Array, bincount
from skinbake.gradients.fit_rules import FLAT
from skinbake.gradients.ring_turns import RingTurns
from skinbake.gradients.surface import Surface, first_rows
from skinbake.gradients.weight_gradients import summed_rows


@dataclass(frozen=True, slots=True)
class PosedRings:
    """C weld classes in one pose.

    normals (C, 3) are n', the unit normals of the mesh in the pose, 0 where the pose does not count: where
    the surface shrinks to a line, or no weight changes. still (C, 2, 3) are Σ w_i M_i (t, 0) for both
    tangents t of a class. rigid (C,) is the mean squared length of a direction under the joints alone.
    """

    normals: Float64Array
    still: Float64Array
    rigid: Float64Array


def posed_rings(surface: Surface, turns: RingTurns, matrices: Float64Array) -> PosedRings:
    """Return all classes in the pose with the joint matrices (J, 3, 4)."""
    changes, derivatives, count = turns.changes, turns.derivatives, len(turns.derivatives)
    first = first_rows(surface.classes)
    positions, weights = surface.positions[first].astype(np.float64), surface.field.weights[first]
    # A matrix that is not finite must not count where its joint has no weight: 0 times NaN is NaN.
    own = matrices[np.maximum(surface.field.joints[first], 0)]
    own = np.where((weights > 0.0)[:, :, None, None], own, 0.0)
    blended = np.einsum("ck,ckij->cij", weights, own)
    points = moved(blended, positions)
    # The posed derivatives: L D + Σ_j (Δw g L_j e + Δw g (M_j p − p')).
    at, by = changes.classes, matrices[changes.joints]
    turned = np.einsum("eij,enj->eni", by[:, :, :3], changes.edges)
    ends = moved(by, positions[at])
    added = turned + changes.coefficients[:, :, None] * (ends - points[at])[:, None]
    posed = np.einsum("cij,cnj->cni", blended[:, :, :3], derivatives)
    posed += summed_rows(at, added.reshape(-1, 6), count).reshape(-1, 2, 3)
    # A bound of the terms, whose share is the rounding of their sum: 0 where no weight changes.
    reach = np.einsum("ck,ck->c", weights, _terms(own, moved(own, positions[:, None])))
    bounds = np.abs(turned).sum(axis=(1, 2))
    bounds += np.abs(changes.coefficients).sum(axis=1) * (reach[at] + _terms(by, ends))
    bound = bincount(at, bounds, count)
    rigid = np.einsum("ck,ck->c", weights, np.square(own[..., :3]).sum(axis=(2, 3))) / 3.0
    # F maps both derivatives, and the unit vector across them to that across the posed ones, by the root of
    # how the area grows. Where joints mirror, it points to the other side.
    # What has no area gets NaN, and does not count.
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        across, posed_across = (np.cross(both[:, 0], both[:, 1]) for both in (derivatives, posed))
        area, posed_area = _lengths(across), _lengths(posed_across)
        side = np.where(determinants(blended) < 0.0, -1.0, 1.0)
        third = posed_across * (side * np.sqrt(posed_area / area) / posed_area)[:, None]
        mapped = np.empty_like(turns.tangents)
        for number in range(2):
            t = turns.tangents[:, number]
            parts = parts_along(t, derivatives[:, 0], derivatives[:, 1])
            along = np.einsum("ci,ci->c", t, across / area[:, None])
            mapped[:, number] = np.einsum("ct,cti->ci", parts, posed) + along[:, None] * third
        # n' is across F t and F b. A small difference of large terms is rounding.
        normals = np.cross(mapped[:, 0], mapped[:, 1])
        normals /= _lengths(normals)[:, None]
        least = FLAT * FLAT * (bound + np.sqrt(rigid)) * _lengths(posed.reshape(-1, 6))
        counts = turns.sound & (bound > 0.0) & (posed_area > least) & np.isfinite(normals).all(axis=1)
        counts &= np.isfinite(rigid)
    still = np.einsum("cij,cnj->cni", blended[:, :, :3], turns.tangents)
    return PosedRings(
        np.where(counts[:, None], normals, 0.0), np.where(counts[:, None, None], still, 0.0), rigid
    )


def moved(matrices: Float64Array, positions: Float64Array) -> Float64Array:
    """Return positions (…, 3) moved by the upper rows of matrices (…, 3, 4)."""
    found: Float64Array = np.einsum("...ij,...j->...i", matrices[..., :3], positions) + matrices[..., 3]
    return found


def _terms(matrices: Float64Array, ends: Float64Array) -> Float64Array:
    """Return a bound (…) of the numbers that make moved positions: the rounding is a share of it."""
    return np.asarray(np.abs(ends).sum(axis=-1) + np.abs(matrices[..., 3]).sum(axis=-1))


def _lengths(vectors: Float64Array) -> Float64Array:
    return np.asarray(np.sqrt(np.square(vectors).sum(axis=-1)))
