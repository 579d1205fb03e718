"""The change of a normal at rest that makes standard lighting right in a pose, and the error with it.

Standard lighting draws T n with T = Σ w M, also of a normal that morph targets have changed. So the normal
n0 + δ is drawn as the true normal n* if T (n0 + δ) is parallel to n*:

    δ = T⁻¹ n* / (n0 · T⁻¹ n*) − n0        with |n0| = 1, and where n0 · T⁻¹ n* > 0

δ is at right angles to n0. Its length is the tangent of the angle θ by which the normal must turn at rest.
Where a fold turns the normal by 90° or more, no δ reaches it: the longest one of ``LARGEST`` is taken, in the
right direction. The fit then counts it little, by its cosine (``fit``).

Under morph targets, n0 is the sum of the normals that they give, of any length, and changes from pose to
pose. δ then stays in one plane, at right angles to the mean of these sums over the poses.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from skinbake.geometry.frames import frame_from_normal, unit_normals
from skinbake.geometry.skinned import BoolArray, Float32Array, Float64Array, SkinnedPrimitive
from skinbake.skinning.components import Vector, cross, dot, scaled
from skinbake.skinning.rest import Algorithm, Options, RestPrimitive
from skinbake.threads import Threads, thread_count
from skinbake.truth import kernel
from skinbake.truth.blending import BlendedPrimitive, sides_of
from skinbake.truth.mesh import normalised_weights
from skinbake.truth.morphing import Morphing
from skinbake.truth.normals import ClassSums
from skinbake.truth.operator import GradientOperator
from skinbake.truth.truths import Truths, VertexBlock

POSES = 32
"""The poses in work at a time."""

LARGEST = 2.0
"""The longest δ: it turns a normal by 63°. A longer one changes the angle little, and its targets much."""

STEEP = 0.3
"""A sum of morphed normals whose part along the mean is shorter than this has no δ: it stands too steep."""

GRID = 2.0**-16
"""δ is rounded to multiples of this number, 0.001°. What processors compute differently is far smaller."""


def rest_of(primitive: SkinnedPrimitive, joint_count: int) -> RestPrimitive:
    """Return the data of a primitive for a replay, float64, with a frame from NORMAL and without gradients.

    Joints past the skin's become 0.
    """
    joints = np.where(primitive.joints < joint_count, primitive.joints, 0)
    normals = unit_normals(primitive.normals)
    tangents, bitangents = frame_from_normal(normals)
    none = np.zeros((len(joints), joints.shape[1] - 1))
    return RestPrimitive(
        positions=primitive.positions.astype(np.float64),
        normals=normals.astype(np.float64),
        tangents=tangents.astype(np.float64),
        bitangents=bitangents.astype(np.float64),
        joints=joints,
        weights=normalised_weights(primitive.weights, joints),
        alpha=none,
        beta=none,
    )


@dataclass(frozen=True, slots=True)
class PosedBlock:
    """Some vertices of a surface in P poses.

    at_rest (3, B) are the normals that correctives change, as morph targets add them up. normals (U, 3, B, P)
    are the true ones by each of ``USUAL_TRUTHS``, whose mean is n*, and exist (U, B, P) tells where. columns
    (3, 3, B, P) are those of T: the column first, then its component. accurate are components (P, B) of the
    normals that α and β give, or standard lighting without gradients.
    """

    at: VertexBlock
    at_rest: Float64Array
    normals: Float64Array
    exist: BoolArray
    columns: Float64Array
    accurate: Vector

    def drawn(self, changed: Float64Array) -> Vector:
        """Return the normals, components (P, B), that standard lighting draws of (3, B, P) or (3, B, 1)."""
        found = (self.columns * changed[:, None]).sum(axis=0)
        return tuple(component.T for component in found)

    def errors(self, drawn: Vector) -> Float32Array:
        """Return the angles in degrees (U, B, P) between drawn and true normals, NaN where there are none."""
        found = kernel.angles(drawn, self.normals)
        return np.where(self.exist, found, np.float32(np.nan))


@dataclass(frozen=True, slots=True)
class Surface:
    """The primitives of a mesh that are lit as one surface, and their truths at rest.

    rest have a frame from NORMAL; their α and β come from a bake where they are aimed at or compared.
    morphing are their morph targets, if any, with the weights of one pose: a mean of all. frames are those of
    the primitives under these weights: δ is along their tangents.
    """

    rest: Sequence[RestPrimitive]
    truths: Truths
    morphing: Morphing | None
    frames: Sequence[RestPrimitive]

    @classmethod
    def of(
        cls, operator: GradientOperator, rest: Sequence[RestPrimitive], morphing: Morphing | None = None
    ) -> Surface:
        """Measure a mesh at rest."""
        frames = rest if morphing is None else morphing.primitives(rest, 0)
        return cls(rest, Truths.of(operator, rest, POSES), morphing, frames)

    @property
    def count(self) -> int:
        """The number of vertices of all primitives."""
        return sum(len(one.positions) for one in self.rest)

    def posed(
        self, matrices: Float64Array, weights: Float64Array, *, accurate: bool = False
    ) -> Iterator[tuple[slice, PosedBlock]]:
        """Yield all vertices in all poses of joint matrices (P, J, 4, 4): the poses, and the block.

        weights (P, N) belong to the morph targets. accurate asks for the normals of α and β, too. The
        order does not depend on the number of threads.
        """
        sides = sides_of(self.rest, matrices)
        algorithm = Algorithm.LBS_ACCURATE if accurate else Algorithm.LBS_STANDARD
        with Threads(thread_count()) as threads:
            for poses, rest, truths in self._at_rest(weights):
                blended = [BlendedPrimitive(one, matrices[poses], Options()) for one in rest]
                count = poses.stop - poses.start
                deformed = np.empty((3, self.count, count))
                for block in truths.vertex_blocks:
                    rows, first = block.rows, block.part.start
                    blended[block.primitive].put_positions(slice(0, count), rows, deformed, first)
                sums = truths.sums(deformed, threads)

                def measured(
                    block: VertexBlock,
                    poses: slice = poses,
                    rest: Sequence[RestPrimitive] = rest,
                    truths: Truths = truths,
                    blended: Sequence[BlendedPrimitive] = blended,
                    deformed: Float64Array = deformed,
                    sums: ClassSums | None = sums,
                ) -> PosedBlock:
                    side = None if sides is None else sides[poses, block.part]
                    one, every = blended[block.primitive], slice(0, poses.stop - poses.start)
                    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                        normals, exist = truths.normals(block.number, deformed, sums, side)
                        drawn = one.normals([algorithm], every, block.rows)[0]
                        if accurate and side is not None:
                            drawn = scaled(side, drawn)
                        summed = rest[block.primitive].summed_normals(block.rows).T.astype(np.float64)
                        columns = one.columns(every, block.rows)
                        return PosedBlock(block, summed, normals, exist, columns, drawn)

                for found in threads.each(measured, truths.vertex_blocks):
                    yield poses, found

    def _at_rest(self, weights: Float64Array) -> Iterator[tuple[slice, Sequence[RestPrimitive], Truths]]:
        """Yield some poses of all, and the primitives and truths that morph targets make of those at rest."""
        edges = (np.flatnonzero((weights[1:] != weights[:-1]).any(axis=1)) + 1).tolist()
        for first, last in pairwise([0, *edges, len(weights)]):
            rest, truths = self.rest, self.truths
            if self.morphing is not None:
                rest, truths = replace(self.morphing, weights=weights).posed(rest, truths, first)
            for start in range(first, last, POSES):
                yield slice(start, min(start + POSES, last)), rest, truths

    def normals(self, weights: Float64Array) -> Float32Array:
        """Return the normals that morph targets of weights (P, N) add up to: (P, V, 3).

        They are along the frames in whose plane δ is, with the normal last.
        """
        assert self.morphing is not None
        morphing = replace(self.morphing, weights=weights)
        found = np.empty((len(weights), self.count, 3), dtype=np.float32)
        for pose, of_pose in enumerate(found):
            start = 0
            for one, frame in zip(morphing.primitives(self.rest, pose), self.frames, strict=True):
                end = start + len(one.positions)
                summed = one.summed_normals(slice(None))
                for axis, vectors in enumerate((frame.tangents, frame.bitangents, frame.normals)):
                    of_pose[start:end, axis] = (summed * vectors).sum(axis=1)
                start = end
        return found

    def changes(
        self, matrices: Float64Array, weights: Float64Array, *, accurate: bool = False
    ) -> Float32Array:
        """Return δ in the poses along t0 and b0 of the frame from NORMAL: (P, V, 2), NaN without a truth.

        matrices are joint matrices (P, J, 4, 4), and weights (P, N) belong to the morph targets. accurate:
        toward the normals of α and β, not the true ones.
        """
        found = np.empty((len(matrices), self.count, 2), dtype=np.float32)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # without a truth: NaN
            for poses, block in self.posed(matrices, weights, accurate=accurate):
                if accurate:
                    aim = np.stack([component.T for component in block.accurate])
                else:
                    aim = np.where(block.exist[:, None], block.normals, 0.0).sum(axis=0)
                # T⁻¹ n* up to its length: cross products of the columns of T, over its determinant.
                a, b, c = (tuple(column) for column in block.columns)
                axes = cross(b, c), cross(c, a), cross(a, b)
                side = np.sign(dot(axes[0], a))
                turned = np.stack([side * dot(axis, tuple(aim)) for axis in axes])
                rows, rest = block.at.rows, self.frames[block.at.primitive]
                before = [np.zeros(1), np.zeros(1), np.ones(1)]
                if self.morphing is not None:
                    before = [
                        dot(tuple(block.at_rest), tuple(vectors[rows].T))[:, None]
                        for vectors in (rest.tangents, rest.bitangents, rest.normals)
                    ]
                along = [
                    dot(tuple(turned), tuple(vectors[rows].T[:, :, None]))
                    for vectors in (rest.tangents, rest.bitangents, rest.normals)
                ]
                flat = np.sqrt(np.square(along[0]) + np.square(along[1]))
                # tan θ, and the largest where θ is larger, also over 90°.
                length = np.where(along[2] * LARGEST > flat, flat / along[2], LARGEST)
                scale = np.where(flat > 0.0, length / flat, 0.0 * flat)
                scale = np.where((turned != 0.0).any(axis=0) & (before[2] > STEEP), scale, np.nan)
                for axis in range(2):
                    change = along[axis] * scale * before[2] - before[axis]
                    found[poses, block.at.part, axis] = (np.rint(change / GRID) * GRID).T.astype(np.float32)
        return found
