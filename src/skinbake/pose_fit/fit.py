"""Weight gradients fitted to poses: the tangents of algorithm 3 follow the true normals of each pose.

docs/fitted.md has the derivation. Let δ be the changes of the gradients at a vertex, which sum to 0. In a
pose they move a tangent t' of algorithm 3 by d = Σ δ[s] M[s] p̃. The fit minimises the sum over both groups
of poses, and in each group the mean over its poses, of

    v w ((n' · (t' + d))² + POSE_STIFFNESS |d|²)

plus EVEN X Σ δ[s]², the pull of each slot to its given gradient.

- n' is the mean of the true normals, by their parts in AIM.
- w is 2 / (|t'|² + |b'|²) at the given gradients, with a bound where tangents collapse.
- v is the group's share of the fit, divided by the mean squared tilt of its poses at the given gradients. So
  gentle clips and wide random poses count by their shares.
- X is the sum of v w times the ``_spread`` of the joints.

All terms are quadratic in δ with the same matrix for both tangents, so the direction of TANGENT does not
matter.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from skinbake.choices import Truth
from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray, IntArray, blocks
from skinbake.gltf.budget import Work
from skinbake.gradients.fit_rules import EVEN, UNFELT
from skinbake.gradients.rig_fit import bounded
from skinbake.gradients.surface import WeightField
from skinbake.gradients.weight_gradients import steepest_slopes
from skinbake.skinning.rest import Options, RestPrimitive, all_slots
from skinbake.threads import Threads, thread_count
from skinbake.truth.blending import BLOCK_VERTICES, BlendedPrimitive, chunks, sides_of
from skinbake.truth.fine import FineMesh
from skinbake.truth.mesh import free_slots, joint_weights
from skinbake.truth.operator import GradientOperator
from skinbake.truth.truths import PosedSurface, Truths

POSE_STIFFNESS = 0.08
"""λ': the share of a tangent's whole motion that pulls the fitted gradients to the given ones."""

COLLAPSED = 0.1
"""The squared length of a tangent, relative to its length under single joints, from which w grows no more.

Where a fold collapses, a short tangent may have any direction, and would outweigh all other poses.
"""

Slots: TypeAlias = tuple[Float64Array, Float64Array]
"""α and β (V, K − 1) of the slots after the first."""


AIM = {Truth.TANGENTS: 0.5, Truth.TRIANGLES: 0.1, Truth.FINE: 0.4}
"""The parts of the truths in the normal that the tangents follow.

The truths of the drawn mesh have a little more than half, as in clips they gain more than *fine* loses.
"""

DRAWN_AIM = {Truth.TANGENTS: 0.7, Truth.TRIANGLES: 0.3}
"""The parts of the truths in the normal by which ``tilts`` judges a fit to a rig or to any poses."""

ADDED_TILT = float(np.radians(0.3)) ** 2
"""The squared sine that is added to the mean squared tilt of a group. Otherwise rounding would be fitted."""


@dataclass(frozen=True, slots=True)
class FitPoses:
    """A group of poses that count alike: joint matrices (P, J, 4, 4), and the group's share in the fit."""

    joint_matrices: Float64Array
    share: float


def fit_work(vertices: int, influences: int) -> Work:
    """Return the memory that the least squares of so many vertices take."""
    return Work(bytes=8 * vertices * influences * (5 * influences + 10))


def fitted_to_poses(
    operator: GradientOperator, primitives: Sequence[RestPrimitive], groups: Sequence[FitPoses]
) -> list[Slots]:
    """Return α and β of each primitive of one surface, fitted to poses. They stay near the given ones.

    primitives are in the operator's order. A joint that has neither weight nor gradient at a vertex gets
    none. A vertex without true normals keeps its gradients.
    """
    # A vertex without true normals has NaN on the way.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        fitted = [_LeastSquares.of(primitive) for primitive in primitives]
        # A vertex of a single joint keeps what it has, in any pose.
        open_ones = [np.asarray(system.unknown().any(axis=1)) for system in fitted]
        for group in groups:
            # The equations of one group, over all of its poses.
            systems = [_LeastSquares.of(primitive) for primitive in primitives]
            for seen in _seen(operator, primitives, group, open_ones, AIM):
                system = systems[seen.primitive]
                system.add(seen, seen.moved(primitives, group, system.last))
            # Groups count by their shares, however many poses they have.
            for system, of_group in zip(fitted, systems, strict=True):
                system.take(of_group, group.share)
        joints, weights = joint_weights(primitives)
        field = WeightField(joints.astype(np.int32), weights, free_slots(weights))
        slopes = steepest_slopes(operator.positions, operator.triangles, field, operator.classes)
        steepest = [slopes[operator.classes[rows]] for rows in operator.slices]
        return [system.solved(own) for system, own in zip(fitted, steepest, strict=True)]


def tilts(
    operator: GradientOperator, primitives: Sequence[RestPrimitive], groups: Sequence[FitPoses]
) -> list[Float64Array]:
    """Return by how much the tangents of each primitive leave the drawn surface: (V,), mean squared sines."""
    found = [np.zeros(len(primitive.positions)) for primitive in primitives]
    every_one = [np.ones(len(of_one), dtype=np.bool_) for of_one in found]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # likewise
        for group in groups:
            share = group.share / sum(each.share for each in groups)
            for seen in _seen(operator, primitives, group, every_one, DRAWN_AIM):
                moved = seen.moved(primitives, group, np.zeros(len(found[seen.primitive]), dtype=np.int64))
                found[seen.primitive][seen.rows] += share * seen.tilt(moved)
    return found


@dataclass(frozen=True, slots=True)
class _Seen:
    """Some vertices of a primitive in some poses of a group.

    primitive is its number in the surface. rows (B,) are its vertices, and poses P poses. normals (B, 3, P)
    are the mean true normals, 0 where there is none. share is that of one pose in the group.
    """

    primitive: int
    rows: IntArray
    poses: slice
    normals: Float64Array
    share: float

    def moved(self, primitives: Sequence[RestPrimitive], group: FitPoses, last: IntArray) -> _Moved:
        """Return the vertices in the poses. last (V,) is a slot of each vertex of the primitive."""
        part = primitives[self.primitive].rows(self.rows)
        return _Moved.of(part, group.joint_matrices[self.poses], last[self.rows])

    def tilt(self, moved: _Moved) -> Float64Array:
        """Return the mean squared sines (B,) by which both tangents leave the true surface."""
        tilt = np.einsum("bitp,bip->btp", moved.tangents, self.normals)
        return np.asarray(self.share * np.einsum("btp,bp->b", tilt * tilt, moved.emphasis) / 2.0)


def _seen(
    operator: GradientOperator,
    primitives: Sequence[RestPrimitive],
    group: FitPoses,
    chosen: Sequence[BoolArray],
    aim: Mapping[Truth, float],
) -> Iterator[_Seen]:
    """Yield the chosen vertices, (V,) of each primitive, in all poses of a group.

    aim has the parts of the truths in the normals: of both ``USUAL_TRUTHS``, or of all three.
    Every vertex meets each pose once, and its poses in order, so that sums do not depend on the number of
    threads.
    """
    if not any(of_one.any() for of_one in chosen):
        return
    matrices, count = group.joint_matrices, len(operator.positions)
    widest = max(primitive.joints.shape[1] for primitive in primitives)
    # The truths of the surface, measured at rest.
    mesh = FineMesh.of(operator) if Truth.FINE in aim else None
    parts = chunks(count if mesh is None else mesh.size, len(matrices))
    truths = Truths.of(operator, primitives, (parts[0].stop if parts else 0) * widest, fine=mesh)
    sides = sides_of(primitives, matrices)
    blended = [BlendedPrimitive(primitive, matrices, Options()) for primitive in primitives]
    points = None if truths.fine is None else BlendedPrimitive(truths.fine.points, matrices, Options())
    with Threads(thread_count()) as threads:
        for poses in parts:
            # All positions in some poses, and the sums of the triangles there.
            deformed = np.empty((3, count, poses.stop - poses.start))
            for block in truths.vertex_blocks:
                blended[block.primitive].put_positions(poses, block.rows, deformed, block.part.start)
            surfaces = [PosedSurface.of(truths, deformed, threads)]
            if truths.fine is not None and points is not None:
                moved = np.empty((3, truths.fine.mesh.size, deformed.shape[2]))
                moved[:, :count] = deformed
                for part in blocks(moved.shape[1] - count, BLOCK_VERTICES):
                    points.put_positions(poses, part, moved, count + part.start)
                surfaces += [PosedSurface.of(truths.fine.truths, moved, threads)]
            for block in truths.vertex_blocks:
                rows = block.rows.start + np.flatnonzero(chosen[block.primitive][block.rows])
                if not len(rows):
                    continue
                # The true normals of the chosen vertices.
                side = None if sides is None else sides[poses, block.part]
                found = [surface.normals(block.number, side) for surface in surfaces]
                normals, exist = (np.concatenate(values) for values in zip(*found, strict=True))
                # The unit mean of those that exist, 0 if there is none.
                mean = np.where(
                    exist[:, None], np.reshape(list(aim.values()), (-1, 1, 1, 1)) * normals, 0.0
                ).sum(axis=0)
                mean /= np.sqrt(np.einsum("ibp,ibp->bp", mean, mean))
                normals = np.where(np.isfinite(mean), mean, 0.0).transpose(1, 0, 2)
                own = normals[rows - block.rows.start]
                yield _Seen(block.primitive, rows, poses, own, 1.0 / len(matrices))


@dataclass(frozen=True, slots=True)
class _Moved:
    """B vertices in P poses.

    levers (B, K, 3, P) are M[s] p̃ less that of the vertex's last fitted slot. tangents (B, 3, 2, P) are t'
    and b'. emphasis (B, P) is w.
    """

    levers: Float64Array
    tangents: Float64Array
    emphasis: Float64Array

    @classmethod
    def of(cls, rest: RestPrimitive, matrices: Float64Array, last: IntArray) -> _Moved:
        """Move vertices by joint matrices (P, J, 4, 4). last (B,) is a slot of each."""
        count, slots = rest.joints.shape
        poses = len(matrices)
        # By joint, then row and pose: the matrices of a slot are one piece of memory.
        table = np.ascontiguousarray(matrices[:, :, :3].transpose(1, 2, 0, 3)).reshape(-1, 3 * poses, 4)
        joints = table[rest.joints]
        points = np.concatenate([rest.positions, np.ones((count, 1))], axis=1)
        # M[s] p̃ of all slots, and the levers from the last fitted one.
        ends = np.matmul(joints, points[:, None, :, None]).reshape(count, slots, 3, poses)
        levers = ends - ends[np.arange(count), last][:, None]
        # t' = T t0 + Σ α lever, and b' likewise.
        frame = np.stack([rest.tangents, rest.bitangents], axis=2)
        blended = np.einsum("bk,bkxi->bxi", rest.weights, joints[..., :3])
        tangents = np.matmul(blended, frame).reshape(count, 3, poses, 2).swapaxes(2, 3)
        tangents = tangents + np.einsum("bkt,bkip->bitp", _pairs_of_slots(rest), levers)
        # The emphasis: 2 / (|t'|² + |b'|²), bounded where joints collapse the frame.
        rigid = np.einsum("bk,bkxi->bx", rest.weights, np.square(joints[..., :3]))
        rigid = rigid.reshape(count, 3, poses).sum(axis=1) / 3.0
        lengths = np.maximum(np.einsum("bitp,bitp->bp", tangents, tangents), 2.0 * COLLAPSED * rigid)
        emphasis = 2.0 / lengths
        return cls(levers, tangents, np.where(np.isfinite(emphasis), emphasis, 0.0))


@dataclass(frozen=True, slots=True)
class _LeastSquares:
    """The normal equations of all vertices of a primitive.

    given (V, K, 2) are α and β of all slots. presence (V, K) is the weight of each slot's joint, plus its
    share of the gradients. last (V,) is the last fitted slot, which takes minus the sum of the others. The
    other fields are means over the poses of a group, or sums of these over the groups. matrix (V, K, K) and
    right (V, K, 2) are the equations for δ. reach (V,) is w times the ``_spread``. error (V,) is the mean
    squared tilt at the given gradients.
    """

    given: Float64Array
    presence: FloatArray
    last: IntArray
    matrix: Float64Array
    right: Float64Array
    reach: Float64Array
    error: Float64Array

    @classmethod
    def of(cls, primitive: RestPrimitive) -> _LeastSquares:
        """Prepare the equations of a primitive. Joints with presence above UNFELT are fitted."""
        given = _pairs_of_slots(primitive)
        lengths = np.hypot(given[..., 0], given[..., 1])
        total = lengths.sum(axis=1, keepdims=True)
        share = np.divide(lengths, total, out=np.zeros_like(lengths), where=total > 0.0)
        presence = primitive.weights + share
        count, slots = presence.shape
        return cls(
            given=given,
            presence=presence,
            last=slots - 1 - (presence > UNFELT)[:, ::-1].argmax(axis=1),
            matrix=np.zeros((count, slots, slots)),
            right=np.zeros((count, slots, 2)),
            reach=np.zeros(count),
            error=np.zeros(count),
        )

    def unknown(self) -> BoolArray:
        """Tell for each slot (V, K) whether δ is to be found: its joint is fitted, and not the last one."""
        unknown = self.presence > UNFELT
        unknown[np.arange(len(unknown)), self.last] = False
        return unknown

    def add(self, seen: _Seen, moved: _Moved) -> None:
        """Add some poses of some vertices."""
        rows, normals = seen.rows, seen.normals
        weight = np.where((normals != 0.0).any(axis=1), moved.emphasis * seen.share, 0.0)
        # How far a unit of δ lifts a tangent out of the surface, and how far it is out.
        tilt = np.einsum("bkip,bip->bkp", moved.levers, normals)
        aim = np.einsum("bitp,bip->bpt", moved.tangents, normals)
        flat = moved.levers.reshape(*moved.levers.shape[:2], -1)
        weighted = (moved.levers * weight[:, None, None]).reshape(flat.shape)
        # Squared tilts, and the pull of the tangents to where they are.
        self.matrix[rows] += np.matmul(tilt * weight[:, None], tilt.swapaxes(1, 2))
        self.matrix[rows] += POSE_STIFFNESS * np.matmul(weighted, flat.swapaxes(1, 2))
        self.right[rows] -= np.matmul(tilt * weight[:, None], aim)
        self.reach[rows] += np.einsum("bp,bp->b", weight, _spread(self.presence[rows], moved.levers))
        self.error[rows] += seen.tilt(moved)

    def take(self, group: _LeastSquares, share: float) -> None:
        """Add the equations of a group of poses, by its share over its error."""
        scale = share / (group.error + ADDED_TILT)
        self.matrix[:] += scale[:, None, None] * group.matrix
        self.right[:] += scale[:, None, None] * group.right
        self.reach[:] += scale * group.reach

    def solved(self, steepest: Float64Array) -> Slots:
        """Return α and β (V, K − 1). The last fitted slot takes minus the sum, and is pulled too.

        steepest (V,) are the ``steepest_slopes``, which bound the change as in a fit to the rig.
        """
        count, slots = self.presence.shape
        vertices, diagonal = np.arange(count), np.arange(slots)
        # The pull of each slot. That of the last slot is on all unknowns.
        unknown = self.unknown()
        pull = EVEN * self.reach
        matrix = self.matrix + pull[:, None, None]
        matrix[:, diagonal, diagonal] += pull[:, None]
        solvable = np.isfinite(matrix).all(axis=(1, 2)) & (self.reach > 0.0)
        unknown &= solvable[:, None]
        # Slots without an equation get the identity, so that one call solves all vertices.
        matrix = np.where(unknown[:, :, None] & unknown[:, None], matrix, 0.0)
        matrix[:, diagonal, diagonal] += ~unknown
        # δ, and minus their sum for the last slot.
        change = np.linalg.solve(matrix, np.where(unknown[..., None], self.right, 0.0))
        change = np.where(np.isfinite(change).all(axis=(1, 2), keepdims=True), change, 0.0)
        change[vertices, self.last] -= change.sum(axis=1)
        found = self.given + bounded(np.asarray(change, dtype=np.float64), steepest)
        return found[:, 1:, 0], found[:, 1:, 1]


def _spread(presence: FloatArray, levers: Float64Array) -> Float64Array:
    """Return the mean squared distance (B, P) of M[s] p̃ from their mean. Joints count by their presence.

    By their weight, a vertex with a single influence would have none, however far its adopted joints go.
    """
    share = presence / presence.sum(axis=1, keepdims=True)
    middle = np.einsum("bk,bkip->bip", share, levers)
    return np.asarray(np.einsum("bk,bkip->bp", share, np.square(levers - middle[:, None])))


def _pairs_of_slots(primitive: RestPrimitive) -> Float64Array:
    """Return α and β of all slots (V, K, 2)."""
    return all_slots(np.stack([primitive.alpha, primitive.beta], axis=2).astype(np.float64))
