"""Angular errors of every algorithm's normals on one mesh, against true normals of the deformed surface."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np

from skinbake.choices import Truth
from skinbake.geometry import dual_quaternions
from skinbake.geometry.skinned import BoolArray, Float32Array, Float64Array
from skinbake.lighting import kernel
from skinbake.lighting.blending import BlendedPrimitive, chunks
from skinbake.lighting.identity import Compared, Identity, compared_normals, primitive_for_direct
from skinbake.lighting.morphing import Morphing
from skinbake.lighting.operator import GradientOperator
from skinbake.lighting.triangle_normals import ClassSums
from skinbake.lighting.truths import ChunkMemory, Truths, VertexBlock
from skinbake.skinning.algorithms import Algorithm
from skinbake.skinning.components import Vector, scaled
from skinbake.skinning.rest import Options, RestPrimitive
from skinbake.skinning.run import Skinning, joints_in_use
from skinbake.threads import Threads, thread_count
from skinbake.timing import stage

METHODS: dict[str, dict[str, Algorithm]] = {
    "lbs": {
        "approximated": Algorithm.LBS_APPROXIMATED,
        "direct": Algorithm.LBS_DIRECT,
        "accurate": Algorithm.LBS_ACCURATE,
    },
    "dqs": {
        "approximated": Algorithm.DQS_APPROXIMATED,
        "accurate": Algorithm.DQS_ACCURATE,
        "exact": Algorithm.DQS_EXACT,
    },
}

INSIDE_OUT = {"accurate", "exact"}
"""The lightings whose normal is t' × b'. A mirroring joint turns that normal to the inside."""

NOT_MEASURED = {(Truth.TRIANGLES, "direct")}
"""Direct lighting equals accurate lighting except for its side in folds. One truth is enough for it."""

IDENTITY_SAMPLES = 1 << 21
"""The approximate number of vertices × poses for algorithm 2: evenly spread, if there are more."""


@dataclass(frozen=True, slots=True)
class MeasuredBlock:
    """Errors of one lighting on a block of one primitive's vertices, in some poses, by one truth.

    primitive is its number in the mesh. pose and vertex are the first ones of the block. errors (P, V) are
    float32 degrees. valid (P, V) is true if the truth exists.
    """

    truth: str
    lighting: str
    primitive: int
    pose: int
    vertex: int
    errors: Float32Array
    valid: BoolArray


def not_rigid_joints(primitives: Sequence[RestPrimitive], joint_matrices: Float64Array) -> list[int]:
    """Return the joints in use that dual quaternions cannot represent, in joint matrices (P, J, 4, 4)."""
    in_use = joints_in_use(primitives, joint_matrices.shape[1])
    return [int(joint) for joint in dual_quaternions.not_rigid_joints(joint_matrices, in_use)]


def lighting_errors(  # noqa: PLR0913  # five arguments are optional, and by keyword
    operator: GradientOperator,
    primitives: Sequence[RestPrimitive],
    joint_matrices: Float64Array,
    method: str,
    record: Callable[[Any], None],
    *,
    count: Callable[[MeasuredBlock], Any] | None = None,
    options: Options | None = None,
    morphing: Morphing | None = None,
    at_rest: Truths | None = None,
    advance: Callable[[float], None] = lambda poses: None,
) -> float:
    """Run every algorithm of a method over all poses, and measure its normals block by block.

    primitives are those of one mesh in the operator's order. joint_matrices are (P, J, 4, 4). The
    truths are built from the positions that the method itself gives. record is called with every block, in an
    order that does not depend on the number of threads. With count, the thread that measured a block calls
    it, and record is called with its result instead. advance is called with poses done. With morphing, every
    pose starts from its own primitives, so poses are measured one at a time. at_rest is the result of
    ``truths_at_rest`` for the same mesh. Returns the largest angle in degrees between the normals of
    algorithms 2 and 3, or 0 if they are not compared.
    """
    vertices, poses = len(operator.positions), len(joint_matrices)
    truths = truths_at_rest(operator, primitives, poses, morphing) if at_rest is None else at_rest
    mesh = _PosedMesh(primitives, joint_matrices, method, options or Options(), truths)
    identity, memory = Identity(), ChunkMemory()
    with Threads(thread_count()) as threads:
        for chunk in mesh.in_chunks() if morphing is None else mesh.pose_by_pose(morphing):
            with stage("positions"):
                deformed = chunk.positions(threads, memory)
            with stage("truths"):
                sums = chunk.truths.sums(deformed, threads, memory)
            with stage("normals"):
                work = partial(chunk.measured, deformed, sums, count)
                found = threads.each(work, truths.vertex_blocks)
                for block, (results, compared) in zip(truths.vertex_blocks, found, strict=True):
                    for result in results:
                        record(result)
                    identity.take(compared)
                    advance(deformed.shape[2] * (block.part.stop - block.part.start) / vertices)
            identity.close()
    return identity.largest


def truths_at_rest(
    operator: GradientOperator,
    primitives: Sequence[RestPrimitive],
    poses: int,
    morphing: Morphing | None,
    names: Sequence[str] = tuple(Truth),
) -> Truths:
    """Measure a mesh at rest, for any number of calls of ``lighting_errors`` with so many poses."""
    parts = chunks(len(operator.positions), poses)
    most = max((part.stop - part.start for part in parts), default=0)
    with stage("truths"):
        # Under morph targets, poses are measured one at a time.
        return Truths.of(operator, primitives, min(most, 1) if morphing else most, names)


@dataclass(frozen=True, slots=True)
class _PosedMesh:
    """One mesh under a method of skinning: its primitives and truths at rest, joint matrices (P, J, 4, 4)."""

    primitives: Sequence[RestPrimitive]
    joint_matrices: Float64Array
    method: str
    options: Options
    truths: Truths

    def in_chunks(self) -> Iterator[_Chunk]:
        """Yield many poses at a time. All poses start from the same primitives.

        Algorithm 2 is only compared with algorithm 3. In millions of vertices × poses, a sample is enough.
        Then most chunks go without algorithm 2.
        """
        vertices, poses = len(self.truths.operator.positions), len(self.joint_matrices)
        stride = max(1, -(-vertices * poses // IDENTITY_SAMPLES))
        every = METHODS[self.method]
        without_direct = {lighting: every[lighting] for lighting in every if lighting != "direct"}
        sides = sides_of(self.primitives, self.joint_matrices)
        skinned = self._skinned(self.primitives, self.joint_matrices)
        for number, pose in enumerate(chunks(vertices, poses)):
            yield _Chunk(
                truths=self.truths,
                skinned=skinned,
                at=pose,
                first_pose=pose.start,
                algorithms=without_direct if number % stride else every,
                sides=None if sides is None else sides[pose],
                compares=self.options.cap is None,
            )

    def pose_by_pose(self, morphing: Morphing) -> Iterator[_Chunk]:
        """Yield one pose at a time. Morph targets give each pose its own primitives to start from."""
        sides = sides_of(self.primitives, self.joint_matrices)
        for pose in range(len(self.joint_matrices)):
            primitives, truths = morphing.posed(self.primitives, self.truths, pose)
            yield _Chunk(
                truths=truths,
                skinned=self._skinned(primitives, self.joint_matrices[pose : pose + 1]),
                at=slice(0, 1),
                first_pose=pose,
                algorithms=METHODS[self.method],
                sides=None if sides is None else sides[pose : pose + 1],
                compares=self.options.cap is None,
            )

    def _skinned(self, primitives: Sequence[RestPrimitive], joint_matrices: Float64Array) -> list[_Skinned]:
        if self.method == "dqs":
            return [
                SteppedPrimitive(one) for one in Skinning.of_mesh(primitives, joint_matrices, self.options)
            ]
        return [
            BlendedPrimitive(
                primitive, joint_matrices, self.options, direct=partial(primitive_for_direct, primitive)
            )
            for primitive in primitives
        ]


@dataclass(frozen=True, slots=True)
class _Chunk:
    """Some poses of one mesh that are measured together.

    at are these poses among those of the skinned primitives. first_pose is the first of them among all poses
    of the mesh. algorithms are named by their lighting. sides (P, V) are the result of ``sides_of`` in these
    poses. compares tells whether algorithms 2 and 3 are compared if both are there.
    """

    truths: Truths
    skinned: Sequence[_Skinned]
    at: slice
    first_pose: int
    algorithms: Mapping[str, Algorithm]
    sides: Float64Array | None
    compares: bool

    def positions(self, threads: Threads, memory: ChunkMemory) -> Float64Array:
        """Return the positions of all vertices: (3, V, P)."""
        shape = 3, len(self.truths.operator.positions), self.at.stop - self.at.start
        deformed: Float64Array = memory.array("positions", shape, np.float64)

        def place(block: VertexBlock) -> None:
            # A position may be past all numbers.
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                skinned = self.skinned[block.primitive]
                skinned.put_positions(self.at, block.rows, deformed, block.part.start)

        threads.done(place, self.truths.vertex_blocks)
        return deformed

    def measured(
        self,
        deformed: Float64Array,
        sums: ClassSums | None,
        count: Callable[[MeasuredBlock], Any] | None,
        block: VertexBlock,
    ) -> tuple[list[Any], Compared | None]:
        """Measure all lightings of a block by each truth, and count the errors if told how.

        Return the normals of algorithms 2 and 3 compared, too, or None if they are not.
        """
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # what has no normal gets NaN
            side = None if self.sides is None else self.sides[:, block.part]
            steps = tuple(self.algorithms.values())
            found = self.skinned[block.primitive].normals(steps, self.at, block.rows)
            normals = dict(zip(self.algorithms, found, strict=True))
            expected, exist = self.truths.normals(block.number, deformed, sums, side)
            measured = []
            for lighting, vectors in normals.items():
                outside = vectors if side is None or lighting not in INSIDE_OUT else scaled(side, vectors)
                names = _truths_of(lighting, self.truths.names)
                errors = kernel.angles(outside, expected[: len(names)])
                corner = block.primitive, self.first_pose, block.rows.start
                measured += [
                    MeasuredBlock(truth, lighting, *corner, errors[number].T, exist[number].T)
                    for number, truth in enumerate(names)
                ]
            compared = None
            if self.compares and "direct" in normals:
                compared = compared_normals(normals["direct"], normals["accurate"])
        return measured if count is None else list(map(count, measured)), compared


def _truths_of(lighting: str, names: Sequence[str]) -> list[str]:
    """Return the truths by which a lighting is measured. They come first among ``names``.

    The reason is that ``NOT_MEASURED`` leaves out no truth but the last one.
    """
    return [truth for truth in names if (truth, lighting) not in NOT_MEASURED]


class _Skinned(Protocol):
    """A primitive that is skinned block by block, by poses and vertices."""

    def put_positions(self, pose: slice, part: slice, out: Float64Array, first_row: int) -> None:
        """Write the positions of some vertices to the rows of out (3, V, P) from ``first_row`` on."""

    def normals(self, algorithms: Sequence[Algorithm], pose: slice, part: slice) -> list[Vector]:
        """Return the normals that algorithms give a block."""


class SteppedPrimitive:
    """A primitive under dual quaternions, as in algorithms 4–6: the counterpart of ``BlendedPrimitive``."""

    def __init__(self, skinning: Skinning) -> None:
        self._skinning = skinning

    def put_positions(self, pose: slice, part: slice, out: Float64Array, first_row: int) -> None:
        """Write the positions of some vertices to the rows of out (3, V, P) from ``first_row`` on."""
        kernel.dqs_positions(self._skinning, pose, part, out, first_row)

    def normals(self, algorithms: Sequence[Algorithm], pose: slice, part: slice) -> list[Vector]:
        """Return the normals that algorithms 4–6 give a block."""
        normals = kernel.dqs_normals(self._skinning, pose, part)
        chosen = (normals[algorithm - Algorithm.DQS_APPROXIMATED] for algorithm in algorithms)
        return [tuple(axis.T for axis in normal) for normal in chosen]


def sides_of(primitives: Sequence[RestPrimitive], joint_matrices: Float64Array) -> Float64Array | None:
    """Return −1 (P, V) if the joint of the largest weight mirrors, else 1; None if no joint mirrors.

    A joint that mirrors turns t' × b' to the inside. For example, some left hands are right hands under a
    negative scale. In a fold, the surface turns over although its joints do not mirror. A fold is left as it
    is, because the exact normal does turn inside out there.
    """
    mirrors = np.linalg.det(joint_matrices[..., :3, :3]) < 0
    if not mirrors.any():
        return None
    dominant = np.concatenate(
        [
            np.take_along_axis(primitive.joints, primitive.weights.argmax(axis=1)[:, None], axis=1)[:, 0]
            for primitive in primitives
        ]
    )
    return np.where(mirrors.T[dominant], -1.0, 1.0).T
