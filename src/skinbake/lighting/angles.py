"""Angular errors of every algorithm's normals on one mesh, against the reference of the deformed surface."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from skinbake.geometry.dual_quaternions import rigid_motions
from skinbake.geometry.morphs import MorphTargets
from skinbake.geometry.skinned import BoolArray, Float32Array, Float64Array, FloatArray
from skinbake.lighting.blending import BlendedSurface, blocks, chunks
from skinbake.lighting.metrics import angles_between, cosine, squared_sine
from skinbake.lighting.operator import GradientOperator
from skinbake.lighting.reference import RestFrames, block_normals, morphed_frames, rest_frames, tangent_blocks
from skinbake.skinning.algorithms import Algorithm
from skinbake.skinning.components import Vector, scaled
from skinbake.skinning.morphs import morphed
from skinbake.skinning.run import Skinning
from skinbake.skinning.surface import Options, RestSurface
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
"""Lightings whose normal is t' × b', which a mirroring joint turns to the inside."""

IDENTITY_TOLERANCE = 1e-4
"""Degrees by which algorithms 2 and 3 may differ: both are exact given the same gradients."""

WELL_CONDITIONED = 1e-3
"""Sine between t' and b', relative to their lengths, below which a fold has no normal to compare."""


@dataclass(frozen=True, slots=True)
class Morphing:
    """Morph targets of one mesh, by primitive (None: it has none), and their weights (P, N) in P poses."""

    targets: tuple[MorphTargets | None, ...]
    weights: Float64Array

    def surfaces(self, surfaces: Sequence[RestSurface], pose: int) -> list[RestSurface]:
        """Return the primitives as they are in one pose, before skinning."""
        return [
            surface if targets is None else morphed(surface, targets, self.weights[pose])
            for surface, targets in zip(surfaces, self.targets, strict=True)
        ]


@dataclass(frozen=True, slots=True)
class MeasuredBlock:
    """Errors of one lighting on a block of one primitive's vertices, in some poses.

    surface is the primitive's number, pose and vertex where the block begins. errors (P, V) are float32
    degrees; valid (P, V) is where the reference exists.
    """

    lighting: str
    surface: int
    pose: int
    vertex: int
    errors: Float32Array
    valid: BoolArray


def not_rigid_joints(surfaces: Sequence[RestSurface], joint_matrices: Float64Array) -> list[int]:
    """Return the joints in use that dual quaternions cannot stand for, in joint matrices (P, J, 4, 4)."""
    in_use = np.zeros(joint_matrices.shape[1], dtype=np.bool_)
    for surface in surfaces:
        in_use |= surface.joints_in_use(len(in_use))
    return [int(joint) for joint in rigid_motions(joint_matrices, in_use=in_use).not_rigid]


def lighting_errors(
    operator: GradientOperator,
    surfaces: Sequence[RestSurface],
    joint_matrices: Float64Array,
    method: str,
    record: Callable[[MeasuredBlock], None],
    *,
    options: Options | None = None,
    morphing: Morphing | None = None,
    advance: Callable[[int], None] = lambda poses: None,
) -> float:
    """Run every algorithm of a method over all poses, and measure its normals block by block.

    surfaces are the primitives of one mesh in the operator's order, joint_matrices (P, J, 4, 4). The
    reference is built from the positions that the method itself gives. record is called with every block,
    advance with the number of poses done. With morphing, every pose starts from a surface of its own: one
    pose at a time then. Returns the largest angle in degrees between the normals of algorithms 2 and 3, 0
    where they are not compared.
    """
    with stage("reference"):
        rest = rest_frames(
            operator,
            *(_joined(surfaces, name) for name in ("positions", "normals", "tangents", "bitangents")),
        )
    poses, options = len(joint_matrices), options or Options()
    algorithms = tuple(METHODS[method].values())
    parts = chunks(len(rest.areas), poses)
    if morphing:
        parts = [slice(pose, pose + 1) for pose in range(poses)]
    pieces = _blocks(operator.slices, parts[0].stop if parts else 0)
    along = tangent_blocks(rest, [block.part for block in pieces])
    identity = Identity() if method == "lbs" and options.cap is None else None
    skinned: Sequence[_Skinned] = []
    sides = _sides(surfaces, joint_matrices)
    deformed = np.empty(0)
    for pose in parts:
        posed, frames = _morphed(surfaces, rest, morphing, pose.start)
        with stage("replay"):
            if morphing or not skinned:
                # Each of its poses is a chunk of one, of a surface of its own.
                matrices = joint_matrices[pose] if morphing else joint_matrices
                skinned = [_skinned(surface, matrices, method, options) for surface in posed]
            at = slice(0, 1) if morphing else pose
            if deformed.size != 3 * len(rest.areas) * (pose.stop - pose.start):
                deformed = np.empty((len(rest.areas), 3, pose.stop - pose.start))
            for block in pieces:
                deformed[block.part] = skinned[block.surface].positions(at, block.rows)
        for block, derivatives in zip(pieces, along, strict=True):
            side = None if sides is None else sides[pose, block.part]
            with stage("reference"):
                expected, valid = block_normals(frames, derivatives, block.part, deformed, side)
            with stage("replay"):
                found = skinned[block.surface].normals(algorithms, at, block.rows)
                normals = dict(zip(METHODS[method], found, strict=True))
            with stage("angles"):
                for lighting, vectors in normals.items():
                    outside = vectors if side is None or lighting not in INSIDE_OUT else scaled(side, vectors)
                    errors = angles_between(outside, expected).astype(np.float32)
                    corner = pose.start, block.rows.start
                    record(MeasuredBlock(lighting, block.surface, *corner, errors, valid))
                if identity is not None:
                    identity.add(normals["direct"], normals["accurate"])
        if identity is not None:
            with stage("angles"):
                identity.close()
        advance(pose.stop - pose.start)
    return 0.0 if identity is None else identity.largest


@dataclass(frozen=True, slots=True)
class _Block:
    """Some vertices of one primitive: its number, their rows in it, and their part of the mesh's vertices."""

    surface: int
    rows: slice
    part: slice


def _blocks(slices: Sequence[slice], poses: int) -> list[_Block]:
    """Cut the vertices of all primitives, each at its slice of the mesh's, for chunks of so many poses."""
    return [
        _Block(surface, slice(part.start - here.start, part.stop - here.start), part)
        for surface, here in enumerate(slices)
        for part in blocks(here, poses)
    ]


class _Skinned(Protocol):
    """A surface that is skinned block by block, by poses and vertices."""

    def positions(self, pose: slice, part: slice) -> Float64Array:
        """Return the positions of a block: (V, 3, P)."""

    def normals(self, algorithms: Sequence[Algorithm], pose: slice, part: slice) -> list[Vector]:
        """Return the normals that algorithms give a block whose positions were asked for before."""


def _skinned(surface: RestSurface, joint_matrices: Float64Array, method: str, options: Options) -> _Skinned:
    if method == "lbs":
        return BlendedSurface(surface, joint_matrices, options, direct=_for_direct(surface))
    return SteppedSurface(surface, joint_matrices, options)


class SteppedSurface:
    """A rest surface under dual quaternions, line by line: what ``BlendedSurface`` is for blending."""

    def __init__(self, rest: RestSurface, joint_matrices: Float64Array, options: Options) -> None:
        self._skinning = Skinning.of(rest, joint_matrices, dual_quaternions=True, options=options)
        self._approximated: dict[int, Vector] = {}

    def positions(self, pose: slice, part: slice) -> Float64Array:
        """Return the positions of a block: (V, 3, P)."""
        (posed,) = self._skinning.run((Algorithm.DQS_APPROXIMATED,), pose, part)
        self._approximated[part.start] = posed.normal
        return np.stack([component.T for component in posed.position], axis=1)

    def normals(self, algorithms: Sequence[Algorithm], pose: slice, part: slice) -> list[Vector]:
        """Return the normals that algorithms 4–6 give a block whose positions were asked for before."""
        others = [one for one in algorithms if one is not Algorithm.DQS_APPROXIMATED]
        found = dict(zip(others, self._skinning.run(others, pose, part), strict=True))
        return [
            found[one].normal if one in found else self._approximated.pop(part.start) for one in algorithms
        ]


def _joined(surfaces: Sequence[RestSurface], name: str) -> FloatArray:
    """Return one array of the primitives, their vertices concatenated."""
    return np.concatenate([getattr(surface, name) for surface in surfaces])


def _morphed(
    surfaces: Sequence[RestSurface], rest: RestFrames, morphing: Morphing | None, pose: int
) -> tuple[Sequence[RestSurface], RestFrames]:
    """Return the primitives before skinning, and what the reference needs of them."""
    if morphing is None or not morphing.weights[pose].any():
        return surfaces, rest
    moved = morphing.surfaces(surfaces, pose)
    return moved, morphed_frames(rest, _joined(moved, "positions"), _joined(moved, "normals"))


def _sides(surfaces: Sequence[RestSurface], joint_matrices: Float64Array) -> Float64Array | None:
    """Return −1 (P, V) where the joint of the largest weight mirrors, else 1; None where no joint mirrors.

    A joint that mirrors turns t' × b' to the inside: some left hands are right hands under a negative scale.
    A fold, where the surface turns over although its joints do not mirror, is left as it is: there the exact
    normal does turn inside out.
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


def _for_direct(surface: RestSurface) -> RestSurface:
    """Return what algorithm 2 must start from to equal algorithm 3 where the frame is not quite orthonormal.

    n0 is ± t0 × b0, and the gradients are those whose products with t0 and b0 *are* α and β: in the dual
    basis. NORMAL and TANGENT of a file are orthonormal to a tenth of a degree, a frame in float32 to 1e-7,
    and a fold amplifies either.
    """
    normals = np.cross(surface.tangents, surface.bitangents)
    volume = np.einsum("vi,vi->v", normals, normals)[:, None]
    duals = np.cross(surface.bitangents, normals) / volume, np.cross(normals, surface.tangents) / volume
    others = surface.alpha[:, :, None] * duals[0][:, None] + surface.beta[:, :, None] * duals[1][:, None]
    gradients = np.concatenate([-others.sum(axis=1, keepdims=True), others], axis=1)
    return replace(surface, normals=normals * surface.handedness()[:, None], gradients=gradients)


class Identity:
    """The largest angle between the normals of algorithms 2 and 3, block by block, their sign left out.

    Where a fold turns the surface inside out (det J < 0), J⁻ᵀ n keeps to the side of J n and t' × b' does
    not. A fold so sharp that its normal nearly vanishes, beside the pose's median, amplifies rounding, and is
    left out.
    """

    def __init__(self) -> None:
        self.largest = 0.0
        self._ratios: list[FloatArray] = []
        self._squares: list[FloatArray] = []

    def add(self, direct: Vector, accurate: Vector) -> None:
        """Take the normals of a block, components (P, V)."""
        with np.errstate(all="ignore"):
            ratio = squared_sine(direct, accurate) / np.square(cosine(direct, accurate))
        self._ratios.append(ratio)
        self._squares.append(cosine(accurate, accurate))

    def close(self) -> None:
        """Measure the blocks taken since the last call: all vertices of a mesh, in the same poses."""
        if not self._ratios:
            return
        highest = np.max([np.fmax.reduce(block, axis=1, initial=0.0) for block in self._ratios], axis=0)
        # Medians take time: only poses that may have a larger angle need theirs.
        for pose in np.argsort(-highest):
            if not _angle(highest[pose]) > self.largest:
                break
            ratios, squares = (
                np.concatenate([block[pose] for block in values]) for values in (self._ratios, self._squares)
            )
            length = np.sqrt(squares)
            sound = length > WELL_CONDITIONED * np.median(length)
            self.largest = max(self.largest, _angle(np.fmax.reduce(ratios[sound], initial=0.0)))
        self._ratios, self._squares = [], []


def _angle(squared_tangent: float) -> float:
    return float(np.degrees(np.arctan(np.sqrt(squared_tangent))))
