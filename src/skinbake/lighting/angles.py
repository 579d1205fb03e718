"""Angular errors of every algorithm's normals on one mesh, against true normals of the deformed surface."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import DTypeLike

from skinbake.choices import Truth
from skinbake.geometry import dual_quaternions
from skinbake.geometry.morphs import MorphTargets
from skinbake.geometry.skinned import BoolArray, Float32Array, Float64Array, FloatArray
from skinbake.lighting import kernel
from skinbake.lighting.blending import BlendedSurface, blocks, chunks
from skinbake.lighting.metrics import cosine, squared_sine
from skinbake.lighting.operator import GradientOperator
from skinbake.lighting.reference import RestFrames, morphed_frames, rest_frames
from skinbake.lighting.triangle_normals import (
    CarriedNormals,
    ClassBlock,
    ClassSums,
    carried_normals,
    class_blocks,
)
from skinbake.skinning.algorithms import Algorithm
from skinbake.skinning.components import Vector, cross, dot, scaled
from skinbake.skinning.morphs import morphed
from skinbake.skinning.run import Skinning
from skinbake.skinning.surface import Options, RestSurface
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

IDENTITY_TOLERANCE = 1e-4
"""Degrees by which algorithms 2 and 3 may differ. Given the same gradients, both are exact."""

IDENTITY_SAMPLES = 1 << 21
"""The approximate number of vertices × poses for algorithm 2: evenly spread, if there are more."""

WELL_CONDITIONED = 1e-3
"""The sine between t' and b', relative to their lengths, below which a fold has no normal to compare."""


@dataclass(frozen=True, slots=True)
class Morphing:
    """The morph targets of one mesh by primitive (None: no targets), and their weights (P, N) in P poses.

    kept, if it is there, keeps each pose's surfaces and truths when they are first made, for another method.
    """

    targets: tuple[MorphTargets | None, ...]
    weights: Float64Array
    kept: dict[int, tuple[Sequence[RestSurface], Truths]] | None = None

    def surfaces(self, surfaces: Sequence[RestSurface], pose: int) -> list[RestSurface]:
        """Return the primitives as they are in one pose, before skinning."""
        return [
            surface if targets is None else morphed(surface, targets, self.weights[pose])
            for surface, targets in zip(surfaces, self.targets, strict=True)
        ]


@dataclass(frozen=True, slots=True)
class MeasuredBlock:
    """Errors of one lighting on a block of one primitive's vertices, in some poses, by one truth.

    surface is the number of the primitive. pose and vertex are the first ones of the block. errors (P, V) are
    float32 degrees. valid (P, V) is true if the truth exists.
    """

    truth: str
    lighting: str
    surface: int
    pose: int
    vertex: int
    errors: Float32Array
    valid: BoolArray


def not_rigid_joints(surfaces: Sequence[RestSurface], joint_matrices: Float64Array) -> list[int]:
    """Return the joints in use that dual quaternions cannot represent, in joint matrices (P, J, 4, 4)."""
    in_use = np.zeros(joint_matrices.shape[1], dtype=np.bool_)
    for surface in surfaces:
        in_use |= surface.joints_in_use(len(in_use))
    return [int(joint) for joint in dual_quaternions.not_rigid_joints(joint_matrices, in_use)]


def lighting_errors(  # noqa: PLR0913  # five arguments are optional, and by keyword
    operator: GradientOperator,
    surfaces: Sequence[RestSurface],
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

    surfaces are the primitives of one mesh in the operator's order. joint_matrices are (P, J, 4, 4). The
    truths are built from the positions that the method itself gives. record is called with every block, in an
    order that does not depend on the number of threads. With count, the thread that measured a block calls
    it, and record is called with its result instead. advance is called with poses done. With morphing, every
    pose starts from its own surface, so poses are measured one at a time. at_rest is the result of
    ``truths_at_rest`` for the same mesh. Returns the largest angle in degrees between the normals of
    algorithms 2 and 3, or 0 if they are not compared.
    """
    poses, options = len(joint_matrices), options or Options()
    vertices = len(operator.positions)
    parts = _parts(operator, poses, morphing)
    truth = truths_at_rest(operator, surfaces, poses, morphing) if at_rest is None else at_rest
    identity = Identity() if method == "lbs" and options.cap is None else None
    skinned: Sequence[_Skinned] = []
    sides = sides_of(surfaces, joint_matrices)
    # Algorithm 2 is only compared with algorithm 3. In millions of vertices × poses, a sample is enough.
    stride = -(-vertices * poses // IDENTITY_SAMPLES) if method == "lbs" and not morphing else 1
    memory = ChunkMemory()
    with Threads(thread_count()) as threads:
        for number, pose in enumerate(parts):
            if morphing or not skinned:
                posed, own_truth = _morphed(surfaces, truth, morphing, pose.start)
                # Each pose is a chunk of its own, because each has its own surface.
                matrices = joint_matrices[pose] if morphing else joint_matrices
                skinned = [_skinned(surface, matrices, method, options) for surface in posed]
            at = slice(0, 1) if morphing else pose
            algorithms = dict(METHODS[method])
            if number % max(stride, 1):
                del algorithms["direct"]
            chunk = _Chunk(own_truth, skinned, algorithms, pose, at, None if sides is None else sides[pose])
            with stage("positions"):
                deformed = chunk.positions(threads, memory)
            with stage("truths"):
                sums = chunk.truths.sums(deformed, threads, memory)
            with stage("normals"):
                work = partial(chunk.measured, deformed, sums, count)
                found = threads.each(work, truth.pieces)
                for piece, (counts, compared) in zip(truth.pieces, found, strict=True):
                    for one in counts:
                        record(one)
                    if identity is not None:
                        identity.take(compared)
                    advance((pose.stop - pose.start) * (piece.part.stop - piece.part.start) / vertices)
            if identity is not None:
                identity.close()
    return 0.0 if identity is None else identity.largest


def truths_at_rest(
    operator: GradientOperator,
    surfaces: Sequence[RestSurface],
    poses: int,
    morphing: Morphing | None,
    names: Sequence[str] = tuple(Truth),
) -> Truths:
    """Measure a mesh at rest, for any number of calls of ``lighting_errors`` with so many poses."""
    parts = _parts(operator, poses, morphing)
    with stage("truths"):
        return Truths.of(operator, surfaces, parts[0].stop if parts else 0, names)


def _parts(operator: GradientOperator, poses: int, morphing: Morphing | None) -> list[slice]:
    """Return the poses that are measured together."""
    if morphing:
        return [slice(pose, pose + 1) for pose in range(poses)]
    return chunks(len(operator.positions), poses)


@dataclass(frozen=True, slots=True)
class Truths:
    """The data of one mesh that both truths need: blocks of vertices and of weld classes, the rest pose."""

    operator: GradientOperator
    names: Sequence[str]
    pieces: Sequence[_Block]
    classes: Sequence[ClassBlock]
    frames: RestFrames
    carried: CarriedNormals | None

    @classmethod
    def of(
        cls, operator: GradientOperator, surfaces: Sequence[RestSurface], poses: int, names: Sequence[str]
    ) -> Truths:
        """Measure a mesh at rest, for chunks of so many poses."""
        pieces = _blocks(operator.slices, poses)
        positions, normals = (_joined(surfaces, name) for name in ("positions", "normals"))
        parts = tuple(piece.part for piece in pieces)
        frames = rest_frames(operator, positions, normals, parts=parts)
        classes: list[ClassBlock] = []
        carried = None
        if Truth.TRIANGLES in names:
            classes = class_blocks(operator)
            carried = carried_normals(operator, frames, positions, normals, classes)
        return cls(operator, names, pieces, classes, frames, carried)

    def moved(self, surfaces: Sequence[RestSurface]) -> Truths:
        """Measure the mesh under morph targets, before skinning."""
        positions, normals = (_joined(surfaces, name) for name in ("positions", "normals"))
        frames = morphed_frames(self.frames, positions, normals)
        carried = self.carried and carried_normals(self.operator, frames, positions, normals, self.classes)
        return replace(self, frames=frames, carried=carried)

    def sums(
        self, deformed: Float64Array, threads: Threads, memory: ChunkMemory | None = None
    ) -> ClassSums | None:
        """Return the sums of the truth by triangles for all deformed positions (3, V, P) at once."""
        if self.carried is None:
            return None
        shape = 3, len(self.operator.ends) - 1, deformed.shape[2]
        total = (memory or ChunkMemory()).array("sums", shape, np.float32)

        def sum_up(block: ClassBlock) -> None:
            total[:, block.part] = kernel.class_sums(self.operator, deformed, block)

        threads.done(sum_up, self.classes)
        return ClassSums(self.carried, self.operator.classes, total)

    def normals(
        self, number: int, deformed: Float64Array, sums: ClassSums | None, sides: Float64Array | None
    ) -> tuple[Float64Array, BoolArray]:
        """Return a block's unit normals (U, 3, B, P) by each truth of ``names``, and where they exist."""
        normals, exist = kernel.true_normals(self.frames, number, deformed, sides, sums)
        chosen = [number for number, truth in enumerate(Truth) if truth in self.names]
        return normals[chosen[0] : chosen[-1] + 1], exist[chosen[0] : chosen[-1] + 1]


class ChunkMemory:
    """Large arrays that each chunk of poses fills anew. The system would clear fresh memory first."""

    def __init__(self) -> None:
        self._arrays: dict[str, Any] = {}

    def array(self, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> Any:
        """Return an array, its values arbitrary. The last one of this name must be in use no more."""
        size = math.prod(shape)
        if name not in self._arrays or len(self._arrays[name]) < size:
            self._arrays.pop(name, None)
            self._arrays[name] = np.empty(size, dtype)
        return self._arrays[name][:size].reshape(shape)


_Compared = tuple[FloatArray, FloatArray] | None
"""The values of a block that ``Identity`` takes."""


@dataclass(frozen=True, slots=True)
class _Chunk:
    """Some poses of one mesh. ``at`` are the same poses among the poses of the skinned surfaces."""

    truths: Truths
    skinned: Sequence[_Skinned]
    algorithms: dict[str, Algorithm]
    pose: slice
    at: slice
    sides: Float64Array | None

    def positions(self, threads: Threads, memory: ChunkMemory) -> Float64Array:
        """Return the positions of all vertices: (3, V, P)."""
        shape = 3, len(self.truths.operator.positions), self.at.stop - self.at.start
        deformed: Float64Array = memory.array("positions", shape, np.float64)

        def place(block: _Block) -> None:
            # A position may be past all numbers.
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                deformed[:, block.part] = self.skinned[block.surface].positions(self.at, block.rows)

        threads.done(place, self.truths.pieces)
        return deformed

    def measured(
        self,
        deformed: Float64Array,
        sums: ClassSums | None,
        count: Callable[[MeasuredBlock], Any] | None,
        block: _Block,
    ) -> tuple[list[Any], _Compared]:
        """Measure all lightings of a block by every truth, and count them if told how.

        The truth by triangles skips algorithm 2.
        """
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # what has no normal gets NaN
            side = None if self.sides is None else self.sides[:, block.part]
            steps = tuple(self.algorithms.values())
            found = self.skinned[block.surface].normals(steps, self.at, block.rows)
            normals = dict(zip(self.algorithms, found, strict=True))
            expected, exist = self.truths.normals(block.number, deformed, sums, side)
            measured = []
            for lighting, vectors in normals.items():
                outside = vectors if side is None or lighting not in INSIDE_OUT else scaled(side, vectors)
                truths = [truth for truth in self.truths.names if (truth, lighting) not in NOT_MEASURED]
                errors = kernel.angles(outside, expected[: len(truths)])
                corner = block.surface, self.pose.start, block.rows.start
                measured += [
                    MeasuredBlock(truth, lighting, *corner, errors[number].T, exist[number].T)
                    for number, truth in enumerate(truths)
                ]
            compared = (
                compared_normals(normals["direct"], normals["accurate"]) if "direct" in normals else None
            )
        return measured if count is None else list(map(count, measured)), compared


@dataclass(frozen=True, slots=True)
class _Block:
    """Some vertices: the numbers of block and primitive, the rows in the primitive, the part of the mesh."""

    number: int
    surface: int
    rows: slice
    part: slice


def _blocks(slices: Sequence[slice], poses: int) -> list[_Block]:
    """Cut the vertices of all primitives, each at its slice of the mesh, for chunks of so many poses."""
    pieces = [
        (surface, here.start, part) for surface, here in enumerate(slices) for part in blocks(here, poses)
    ]
    return [
        _Block(number, surface, slice(part.start - start, part.stop - start), part)
        for number, (surface, start, part) in enumerate(pieces)
    ]


class _Skinned(Protocol):
    """A surface that is skinned block by block, by poses and vertices."""

    def positions(self, pose: slice, part: slice) -> Float64Array:
        """Return the positions of a block: (3, V, P)."""

    def normals(self, algorithms: Sequence[Algorithm], pose: slice, part: slice) -> list[Vector]:
        """Return the normals that algorithms give a block."""


def _skinned(surface: RestSurface, joint_matrices: Float64Array, method: str, options: Options) -> _Skinned:
    if method == "lbs":
        return BlendedSurface(surface, joint_matrices, options, direct=partial(_for_direct, surface))
    return SteppedSurface(surface, joint_matrices, options)


class SteppedSurface:
    """A rest surface under dual quaternions, as in algorithms 4–6: the counterpart of ``BlendedSurface``."""

    def __init__(self, rest: RestSurface, joint_matrices: Float64Array, options: Options) -> None:
        self._skinning = Skinning.of(rest, joint_matrices, dual_quaternions=True, options=options)

    def positions(self, pose: slice, part: slice) -> Float64Array:
        """Return the positions of a block: (3, V, P)."""
        return kernel.dqs_positions(self._skinning, pose, part)

    def normals(self, algorithms: Sequence[Algorithm], pose: slice, part: slice) -> list[Vector]:
        """Return the normals that algorithms 4–6 give a block."""
        normals = kernel.dqs_normals(self._skinning, pose, part)
        chosen = (normals[algorithm - Algorithm.DQS_APPROXIMATED] for algorithm in algorithms)
        return [tuple(axis.T for axis in normal) for normal in chosen]


def _joined(surfaces: Sequence[RestSurface], name: str) -> FloatArray:
    """Return one array of all primitives, their vertices concatenated. A single one is not copied."""
    if len(surfaces) == 1:
        only: FloatArray = getattr(surfaces[0], name)
        return only
    return np.concatenate([getattr(surface, name) for surface in surfaces])


def _morphed(
    surfaces: Sequence[RestSurface], truth: Truths, morphing: Morphing | None, pose: int
) -> tuple[Sequence[RestSurface], Truths]:
    """Return the primitives before skinning, and the data of them that the truths need."""
    if morphing is None or not morphing.weights[pose].any():
        return surfaces, truth
    if morphing.kept is not None and pose in morphing.kept:
        return morphing.kept[pose]
    moved = morphing.surfaces(surfaces, pose)
    found = moved, truth.moved(moved)
    if morphing.kept is not None:
        morphing.kept[pose] = found
    return found


def sides_of(surfaces: Sequence[RestSurface], joint_matrices: Float64Array) -> Float64Array | None:
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
            np.take_along_axis(surface.joints, surface.weights.argmax(axis=1)[:, None], axis=1)[:, 0]
            for surface in surfaces
        ]
    )
    return np.where(mirrors.T[dominant], -1.0, 1.0).T


def _for_direct(surface: RestSurface, part: slice) -> RestSurface:
    """Return the surface from which algorithm 2 equals algorithm 3, even in a slightly skewed frame.

    n0 is ± t0 × b0. The gradients are in the dual basis: their products with t0 and b0 *are* α and β. NORMAL
    and TANGENT of a file are orthonormal to a tenth of a degree, and a frame in float32 to 1e-7. A fold
    amplifies either error.
    """
    block = surface.rows(part)
    t, b = (tuple(vectors.T.astype(np.float64)) for vectors in (block.tangents, block.bitangents))
    normal = cross(t, b)
    volume = dot(normal, normal)
    # For very small arrays, numpy's own cross product would take most of the time.
    by_alpha, by_beta = cross(b, normal), cross(normal, t)
    gradients = np.empty((*block.joints.shape, 3))
    for axis in range(3):
        gradients[:, 1:, axis] = (
            block.alpha * (by_alpha[axis] / volume)[:, None] + block.beta * (by_beta[axis] / volume)[:, None]
        )
    gradients[:, 0] = -gradients[:, 1:].sum(axis=1)
    sign = np.where(dot(normal, tuple(block.normals.T)) < 0, -1.0, 1.0)
    return replace(block, normals=np.stack(scaled(sign, normal), axis=1), gradients=gradients)


def compared_normals(direct: Vector, accurate: Vector) -> tuple[FloatArray, FloatArray]:
    """Return the squared tangent of the angle between two lightings of a block, and the second's length.

    Both are float32 (V, P). All blocks of a chunk are kept until its last block is there.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # likewise
        ratio = squared_sine(direct, accurate) / np.square(cosine(direct, accurate))
        length = np.sqrt(cosine(accurate, accurate))
        return ratio.astype(np.float32), length.astype(np.float32)


class Identity:
    """The largest angle between the normals of algorithms 2 and 3, block by block, without their signs.

    In a fold that turns the surface inside out (det J < 0), J⁻ᵀ n keeps to the side of J n, and t' × b' does
    not. A very sharp fold amplifies rounding. Its normal nearly vanishes beside the pose's median, and it is
    left out.
    """

    def __init__(self) -> None:
        self.largest = 0.0
        self._ratios: list[FloatArray] = []
        self._lengths: list[FloatArray] = []

    def add(self, direct: Vector, accurate: Vector) -> None:
        """Take the normals of a block, components (P, V)."""
        self.take(compared_normals(direct, accurate))

    def take(self, compared: _Compared) -> None:
        """Take the result of ``compared_normals`` for a block."""
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
            sound = lengths > WELL_CONDITIONED * _median(lengths)
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
