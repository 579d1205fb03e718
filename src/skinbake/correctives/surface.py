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
from dataclasses import dataclass

import numpy as np

from skinbake.geometry.skinned import BoolArray, Float32Array, Float64Array
from skinbake.measure.draws import POSES, Draw, PosedBlock, Surface
from skinbake.skinning.components import Vector, cross, dot, scaled
from skinbake.skinning.rest import Algorithm, RestPrimitive
from skinbake.threads import Threads, thread_count
from skinbake.truth import kernel
from skinbake.truth.morphing import Morphing
from skinbake.truth.truths import Truths, VertexBlock

LARGEST = 2.0
"""The longest δ: it turns a normal by 63°. A longer one changes the angle little, and its targets much."""

STEEP = 0.3
"""A sum of morphed normals whose part along the mean is shorter than this has no δ: it stands too steep."""

GRID = 2.0**-16
"""δ is rounded to multiples of this number, 0.001°. What processors compute differently is far smaller."""


@dataclass(frozen=True, slots=True)
class CorrectedBlock:
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
class CorrectedSurface:
    """A surface whose normals at rest are to be corrected, and its truths at rest.

    The primitives have a frame from NORMAL; their α and β come from a bake where they are aimed at.
    morphing are their morph targets, if any, with the weights of one pose: a mean of all. frames are the
    primitives under these weights: δ is along their tangents.
    """

    surface: Surface
    truths: Truths
    morphing: Morphing | None
    frames: Sequence[RestPrimitive]

    @classmethod
    def of(cls, surface: Surface, mean: Float64Array | None = None) -> CorrectedSurface:
        """Measure a surface at rest. mean (1, N) are the mean weights of the morph targets that move it."""
        rest, morphing = surface.rest, surface.morphing(mean)
        frames = rest if morphing is None else morphing.primitives(rest, 0)
        return cls(surface, Truths.of(surface.operator, rest, POSES), morphing, frames)

    @property
    def count(self) -> int:
        """The number of vertices of all primitives."""
        return self.surface.vertices

    @property
    def rest(self) -> Sequence[RestPrimitive]:
        """The primitives before skinning."""
        return self.surface.rest

    def posed(self, draw: Draw, *, accurate: bool = False) -> Iterator[tuple[slice, CorrectedBlock]]:
        """Yield all vertices in all poses of a draw: the poses, and the block.

        accurate asks for the normals of α and β, too.
        """
        algorithm = Algorithm.LBS_ACCURATE if accurate else Algorithm.LBS_STANDARD

        def measured(block: PosedBlock) -> tuple[slice, CorrectedBlock]:
            every, rows = slice(0, block.poses.stop - block.poses.start), block.at.rows
            drawn = block.skinned.normals([algorithm], every, rows)[0]
            if accurate and block.side is not None:
                drawn = scaled(block.side, drawn)
            summed = block.rest.summed_normals(rows).T.astype(np.float64)
            columns = block.skinned.columns(every, rows)
            return block.poses, CorrectedBlock(block.at, summed, block.normals, block.exist, columns, drawn)

        with Threads(thread_count()) as threads:
            yield from draw.true_normals(self.truths, measured, threads)

    def normals(self, draw: Draw) -> Float32Array:
        """Return the normals that morph targets add up to in the poses of a draw: (P, V, 3).

        They are along the frames in whose plane δ is, with the normal last.
        """
        morphing = draw.morphing
        assert morphing is not None
        found = np.empty((len(draw.matrices), self.count, 3), dtype=np.float32)
        for pose, of_pose in enumerate(found):
            start = 0
            for one, frame in zip(morphing.primitives(self.rest, pose), self.frames, strict=True):
                end = start + len(one.positions)
                summed = one.summed_normals(slice(None)).astype(np.float64)
                for axis, vectors in enumerate((frame.tangents, frame.bitangents, frame.normals)):
                    of_pose[start:end, axis] = (summed * vectors).sum(axis=1)
                start = end
        return found

    def changes(self, draw: Draw, *, accurate: bool = False) -> Float32Array:
        """Return δ in the poses along t0 and b0 of the frame from NORMAL: (P, V, 2), NaN without a truth.

        accurate: toward the normals of α and β, not the true ones.
        """
        found = np.empty((len(draw.matrices), self.count, 2), dtype=np.float32)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # without a truth: NaN
            for poses, block in self.posed(draw, accurate=accurate):
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
