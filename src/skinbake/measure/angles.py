"""Angular errors of every algorithm's normals on one mesh, against true normals of the deformed surface."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np

from skinbake.geometry.skinned import BoolArray, Float32Array, Float64Array, FloatArray, IntArray, blocks
from skinbake.measure.draws import Corrections
from skinbake.skinning.blended import BlendedSkinning
from skinbake.skinning.components import Vector, cross, dot, scaled
from skinbake.skinning.rest import Algorithm, Options, RestPrimitive
from skinbake.skinning.run import Skinning
from skinbake.threads import Threads, thread_count
from skinbake.timing import stage
from skinbake.truth import kernel
from skinbake.truth.areas import squared_cross
from skinbake.truth.blending import BlendedPrimitive, chunks, sides_of
from skinbake.truth.normals import ClassSums
from skinbake.truth.operator import GradientOperator
from skinbake.truth.truths import ChunkMemory, Truths, VertexBlock, truths_at_rest

if TYPE_CHECKING:
    from skinbake.truth.morphing import Morphing

METHODS: dict[str, dict[str, Algorithm]] = {
    "lbs": {
        "standard": Algorithm.LBS_STANDARD,
        "direct": Algorithm.LBS_DIRECT,
        "accurate": Algorithm.LBS_ACCURATE,
    },
    "dqs": {
        "standard": Algorithm.DQS_STANDARD,
        "accurate": Algorithm.DQS_ACCURATE,
        "exact": Algorithm.DQS_EXACT,
    },
    # Each with the algorithm of linear blending that ``blended.LINEAR`` names.
    "blend": {"standard": Algorithm.DQS_STANDARD, "accurate": Algorithm.DQS_EXACT},
}

INSIDE_OUT = {"accurate", "exact"}
"""The lightings whose normal is t' × b'. A mirroring joint turns that normal to the inside."""

IDENTITY_SAMPLES = 1 << 21
"""The approximate number of vertices × poses for algorithm 2: evenly spread, if there are more."""


STEPPED_SAMPLES = 1 << 13
"""Vertices × poses that go through the steps of blended skinning at a time."""


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
    corrections: Corrections | None = None,
    advance: Callable[[float], None] = lambda poses: None,
    direct: bool = True,
) -> float:
    """Run every algorithm of a method over all poses, and measure its normals block by block.

    primitives belong to one mesh, in the operator's order. joint_matrices are (P, J, 4, 4). The
    truths are built from the positions that the method itself gives. record is called with every block, in an
    order that does not depend on the number of threads. With count, the thread that measured a block calls
    it, and record is called with its result instead. advance is called with poses done. With morphing, every
    pose starts from its own primitives, so poses are measured one at a time. at_rest is the result of
    ``truths_at_rest`` for the same mesh. With corrections, LBS has the lighting ``corrected`` too. Unless
    direct, algorithm 2 is left out. Returns the largest angle in degrees between the normals of algorithms 2
    and 3, or 0 if they are not compared.
    """
    vertices, poses = len(operator.positions), len(joint_matrices)
    truths = truths_at_rest(operator, primitives, poses, morphing) if at_rest is None else at_rest
    played = corrections if method == "lbs" else None
    mesh = _PosedMesh(primitives, joint_matrices, method, options or Options(), truths, played, direct)
    identity, memory = Identity(), ChunkMemory()
    with Threads(thread_count()) as threads:
        for chunk in mesh.chunks(morphing):
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


@dataclass(frozen=True, slots=True)
class _PosedMesh:
    """One mesh under a method of skinning: its primitives and truths at rest, joint matrices (P, J, 4, 4)."""

    primitives: Sequence[RestPrimitive]
    joint_matrices: Float64Array
    method: str
    options: Options
    truths: Truths
    corrections: Corrections | None
    direct: bool

    def _algorithms(self, *, direct: bool) -> dict[str, Algorithm]:
        every = METHODS[self.method]
        return {lighting: every[lighting] for lighting in every if lighting != "direct" or direct}

    def chunks(self, morphing: Morphing | None) -> Iterator[_Chunk]:
        """Yield the poses that are measured together: many at a time, if all start from the same primitives.

        Morph targets give each pose its own primitives to start from. Algorithm 2 is only compared with
        algorithm 3. In millions of vertices × poses, a sample is enough: most chunks go without algorithm 2.
        """
        vertices, poses = len(self.truths.operator.positions), len(self.joint_matrices)
        # Every stride-th chunk compares algorithms 2 and 3.
        stride = max(1, -(-vertices * poses // IDENTITY_SAMPLES)) if morphing is None else 1
        sides, truths = sides_of(self.primitives, self.joint_matrices), self.truths
        skinned = self._skinned(self.primitives, self.joint_matrices) if morphing is None else ()
        for number, pose in enumerate(chunks(vertices, poses) if morphing is None else blocks(poses, 1)):
            if morphing is not None:
                primitives, truths = morphing.posed(self.primitives, self.truths, pose.start)
                skinned = self._skinned(primitives, self.joint_matrices[pose])
            yield _Chunk(
                truths=truths,
                skinned=skinned,
                at=pose if morphing is None else slice(0, 1),
                first_pose=pose.start,
                algorithms=self._algorithms(direct=self.direct and number % stride == 0),
                sides=None if sides is None else sides[pose],
                compares=self.options.cap is None,
                corrections=self.corrections,
            )

    def _skinned(
        self, primitives: Sequence[RestPrimitive], joint_matrices: Float64Array
    ) -> Sequence[_Skinned]:
        """Return what skins the primitives."""
        if self.method == "dqs":
            return [
                SteppedPrimitive(one) for one in Skinning.of_mesh(primitives, joint_matrices, self.options)
            ]
        linear = [
            BlendedPrimitive(
                primitive, joint_matrices, self.options, direct=partial(primitive_for_direct, primitive)
            )
            for primitive in primitives
        ]
        if self.method == "lbs":
            return linear
        both = BlendedSkinning.of_mesh(primitives, joint_matrices, self.options)
        return list(map(BetweenPrimitive, linear, both))


@dataclass(frozen=True, slots=True)
class _Chunk:
    """Some poses of one mesh that are measured together.

    at are these poses among the poses of the skinned primitives. first_pose is the first of them among all
    poses of the mesh. algorithms are named by their lighting. sides (P, V) are the result of ``sides_of`` in
    these poses. compares tells whether algorithms 2 and 3 are compared if both are there.
    """

    truths: Truths
    skinned: Sequence[_Skinned]
    at: slice
    first_pose: int
    algorithms: Mapping[str, Algorithm]
    sides: Float64Array | None
    compares: bool
    corrections: Corrections | None = None

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

        deformed are the result of ``positions``, and sums those of ``Truths.sums`` for them. Return the
        normals of algorithms 2 and 3 compared, too, or None if they are not.
        """
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # what has no normal gets NaN
            side = None if self.sides is None else self.sides[:, block.part]
            # The normals of all lightings.
            steps = tuple(self.algorithms.values())
            found = self.skinned[block.primitive].normals(steps, self.at, block.rows)
            normals = dict(zip(self.algorithms, found, strict=True))
            if self.corrections is not None:
                one = self.skinned[block.primitive]
                assert isinstance(one, BlendedPrimitive)
                normals["corrected"] = self.corrections.normals(
                    block.primitive, one, self.at, self.first_pose, block.rows
                )
            # The true normals, by each truth.
            expected, exist = self.truths.normals(block.number, deformed, sums, side)
            # The angle between the two. Some lightings point inside where joints mirror.
            measured = []
            for lighting, vectors in normals.items():
                outside = vectors if side is None or lighting not in INSIDE_OUT else scaled(side, vectors)
                # Direct lighting equals accurate lighting except for its side in folds: one truth will do.
                names = self.truths.of_mesh[:1] if lighting == "direct" else self.truths.of_mesh
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
        chosen = (normals[algorithm - Algorithm.DQS_STANDARD] for algorithm in algorithms)
        return [tuple(axis.T for axis in normal) for normal in chosen]


class BetweenPrimitive:
    """A primitive between linear blending and dual quaternions, by the blend weights of its vertices."""

    def __init__(self, linear: BlendedPrimitive, skinning: BlendedSkinning) -> None:
        self._linear, self._skinning = linear, skinning

    def put_positions(self, pose: slice, part: slice, out: Float64Array, first_row: int) -> None:
        """Write the positions of some vertices to the rows of out (3, V, P) from ``first_row`` on."""
        self._linear.put_positions(pose, part, out, first_row)
        blend = self._skinning.rest.rows(part).blend
        if blend is None:
            return
        own = out[:, first_row : first_row + len(blend)]
        moved = np.empty(own.shape)
        kernel.dqs_positions(self._skinning.dual, pose, part, moved, 0)
        own += blend[:, :1] * (moved - own)

    def normals(self, algorithms: Sequence[Algorithm], pose: slice, part: slice) -> list[Vector]:
        """Return the normals of a block, by algorithms of dual quaternions and those that go with them."""
        # Small parts: both methods, step by step, have two hundred numbers of each sample at a time.
        size = max(1, STEPPED_SAMPLES // max(pose.stop - pose.start, 1))
        found: list[list[Vector]] = [[] for _ in algorithms]
        for rows in blocks(part.stop - part.start, size):
            own = slice(part.start + rows.start, part.start + rows.stop)
            for normals, one in zip(found, self._skinning.run(algorithms, pose, own), strict=True):
                normals.append(one.normal)
        return [
            tuple(np.concatenate(axis, axis=1) for axis in zip(*normals, strict=True)) for normals in found
        ]


IDENTITY_TOLERANCE = 1e-4
"""Degrees by which algorithms 2 and 3 may differ."""

WELL_CONDITIONED = 1e-3
"""The sine between t' and b', relative to their lengths, below which a fold has no normal to compare."""

COLLAPSED = 1e-9
"""The length of t' × b', relative to the longest one, below which only rounding is left.

Joints that are scaled to 0 hide parts of a character. If these parts have most of its vertices, the median of
the lengths is rounding too.
"""

Compared: TypeAlias = tuple[FloatArray, FloatArray]
"""What ``compared_normals`` returns for a block."""


def primitive_for_direct(primitive: RestPrimitive, part: slice | IntArray) -> RestPrimitive:
    """Return the vertices from which algorithm 2 equals algorithm 3, even in a slightly skewed frame.

    n0 is ± t0 × b0. The gradients are in the dual basis: their products with t0 and b0 *are* α and β. NORMAL
    and TANGENT of a file are orthonormal to a tenth of a degree, and a frame in float32 to 1e-7. A fold
    amplifies either error.
    """
    block = primitive.rows(part)
    t, b = (tuple(vectors.T.astype(np.float64)) for vectors in (block.tangents, block.bitangents))
    normal = cross(t, b)
    volume = dot(normal, normal)
    # For very small arrays, numpy's own cross product would take most of the time.
    by_alpha, by_beta = cross(b, normal), cross(normal, t)
    # ∇w = α t* + β b*, with the dual basis t*, b*; slot 0 has minus the sum.
    gradients = np.empty((*block.joints.shape, 3))
    for axis in range(3):
        gradients[:, 1:, axis] = (
            block.alpha * (by_alpha[axis] / volume)[:, None] + block.beta * (by_beta[axis] / volume)[:, None]
        )
    gradients[:, 0] = -gradients[:, 1:].sum(axis=1)
    # n0 = ± t0 × b0, on the side of NORMAL.
    sign = np.where(dot(normal, tuple(block.normals.T)) < 0, -1.0, 1.0)
    return replace(block, normals=np.stack(scaled(sign, normal), axis=1), gradients=gradients)


def compared_normals(direct: Vector, accurate: Vector) -> Compared:
    """Return the squared tangent of the angle between two lightings of a block, and the second's length.

    Both are float32 (P, V). All blocks of a chunk are kept until its last block is there.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a fold may have no normal
        ratio = squared_cross(direct, accurate) / np.square(dot(direct, accurate))
        length = np.sqrt(dot(accurate, accurate))
        return ratio.astype(np.float32), length.astype(np.float32)


class Identity:
    """The largest angle between the normals of algorithms 2 and 3, block by block, without their signs.

    In a fold that turns the surface inside out (det J < 0), J⁻ᵀ n keeps to the side of J n, and t' × b' does
    not. A very sharp fold amplifies rounding. Its normal nearly vanishes beside the pose's median, and it is
    left out. So is a vertex of a part that its joints collapse.
    """

    def __init__(self) -> None:
        self.largest = 0.0
        self._ratios: list[FloatArray] = []
        self._lengths: list[FloatArray] = []

    def take(self, compared: Compared | None) -> None:
        """Take the result of ``compared_normals`` for a block, or None if the block was not compared."""
        if compared is not None:
            self._ratios.append(compared[0])
            self._lengths.append(compared[1])

    def close(self) -> None:
        """Measure the blocks taken since the last call: all vertices of a mesh, in the same poses."""
        if not self._ratios:
            return
        highest = np.max([np.fmax.reduce(block, axis=1, initial=0.0) for block in self._ratios], axis=0)
        # Medians take time. Only poses that may have a larger angle need a median.
        for pose in np.argsort(-highest):
            if not _angle(highest[pose]) > self.largest:
                break
            ratios, lengths = (
                np.concatenate([block[pose] for block in values]) for values in (self._ratios, self._lengths)
            )
            # Folds and collapsed parts have no normal to compare.
            longest = lengths[np.isfinite(lengths)].max(initial=0.0)
            sound = lengths > max(WELL_CONDITIONED * _median(lengths), COLLAPSED * longest)
            self.largest = max(self.largest, _angle(np.fmax.reduce(ratios[sound], initial=0.0)))
        self._ratios, self._lengths = [], []


def _median(values: FloatArray) -> float:
    """Return the median, NaN if a value is NaN. NumPy's own one imports its masked arrays, 17 ms."""
    upper = len(values) // 2
    lower = upper - 1 + len(values) % 2
    ordered = np.partition(values, (lower, upper, -1))
    return float(np.nan if np.isnan(ordered[-1]) else ordered[[lower, upper]].mean())


def _angle(squared_tangent: float) -> float:
    return float(np.degrees(np.arctan(np.sqrt(squared_tangent))))
