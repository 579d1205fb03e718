"""Angular errors of every algorithm's normals on one mesh, against the reference of the deformed surface."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skinbake.geometry.dual_quaternions import rigid_motions
from skinbake.geometry.morphs import MorphTargets
from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray
from skinbake.replay.algorithms import Algorithm
from skinbake.replay.morphs import morphed
from skinbake.replay.run import replay
from skinbake.replay.surface import Baseline, RestSurface
from skinbake.verify.metrics import angular_errors
from skinbake.verify.operator import GradientOperator
from skinbake.verify.reference import RestFrames, morphed_frames, reference_normals, rest_frames

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

BLOCK_SAMPLES = 1 << 20
"""Vertices × poses replayed at a time: bounds the memory, some 300 MB."""

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
class LightingErrors:
    """Errors of one mesh under one method, over P poses and the V vertices of its primitives.

    errors maps lightings to (P, V) float32 degrees; valid (P, V) is where the reference exists. identity is
    the largest angle in degrees between the normals of algorithms 2 and 3, 0 for dual quaternions.
    """

    errors: dict[str, FloatArray]
    valid: BoolArray
    identity: float


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
    *,
    cap: float | None = None,
    baseline: Baseline = Baseline.BLENDED,
    morphing: Morphing | None = None,
    advance: Callable[[int], None] = lambda poses: None,
) -> LightingErrors:
    """Replay every algorithm of a method over all poses, and measure its normals.

    surfaces are the primitives of one mesh in the operator's order, joint_matrices (P, J, 4, 4). The
    reference is built from the positions that the method itself gives. advance is called with the number of
    poses done. With morphing, every pose starts from a surface of its own: one pose at a time then.
    """
    rest = rest_frames(
        operator,
        *(_joined(surfaces, name) for name in ("positions", "normals", "tangents", "bitangents")),
    )
    poses, count = len(joint_matrices), len(rest.areas)
    errors = {lighting: np.empty((poses, count), np.float32) for lighting in METHODS[method]}
    valid = np.empty((poses, count), np.bool_)
    identity = 0.0
    size = 1 if morphing else max(1, BLOCK_SAMPLES // max(count, 1))
    for start in range(0, poses, size):
        block = slice(start, start + size)
        posed, frames = _morphed(surfaces, rest, morphing, start)
        measured, deformed = _replayed(posed, joint_matrices[block], method, cap, baseline)
        sides = _sides(posed, joint_matrices[block])
        expected, valid[block] = reference_normals(frames, deformed, sides)
        for lighting, values in measured.items():
            turned = values * sides[..., None] if lighting in INSIDE_OUT else values
            errors[lighting][block] = angular_errors(turned, expected)
        if method == "lbs" and cap is None:
            identity = max(identity, _disagreement(measured["direct"], measured["accurate"]))
        advance(len(deformed))
    return LightingErrors(errors, valid, identity)


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


def _replayed(
    surfaces: Sequence[RestSurface],
    joint_matrices: Float64Array,
    method: str,
    cap: float | None,
    baseline: Baseline,
) -> tuple[dict[str, FloatArray], FloatArray]:
    """Return the normals (P, V, 3) by lighting, and the deformed positions (P, V, 3)."""
    normals: dict[str, FloatArray] = {}
    positions: FloatArray = np.empty(0)
    for lighting, algorithm in METHODS[method].items():
        rest = [_for_direct(surface) for surface in surfaces] if lighting == "direct" else surfaces
        skinned = [replay(algorithm, surface, joint_matrices, cap=cap, baseline=baseline) for surface in rest]
        normals[lighting] = np.concatenate([surface.normals for surface in skinned], axis=1)
        if lighting == "approximated":
            positions = np.concatenate([surface.positions for surface in skinned], axis=1)
    return normals, positions


def _sides(surfaces: Sequence[RestSurface], joint_matrices: Float64Array) -> Float64Array:
    """Return −1 (P, V) where the joint of the largest weight mirrors, else 1.

    A joint that mirrors turns t' × b' to the inside: some left hands are right hands under a negative scale.
    A fold, where the surface turns over although its joints do not mirror, is left as it is: there the exact
    normal does turn inside out.
    """
    mirrors = np.linalg.det(joint_matrices[..., :3, :3]) < 0
    dominant = np.concatenate(
        [
            np.take_along_axis(surface.joints, surface.weights.argmax(axis=1)[:, None], axis=1)[:, 0]
            for surface in surfaces
        ]
    )
    return np.where(mirrors[:, dominant], -1.0, 1.0)


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


def _disagreement(direct: FloatArray, accurate: FloatArray) -> float:
    """Return the largest angle between two fields of normals in degrees, their sign left out.

    Where a fold turns the surface inside out (det J < 0), J⁻ᵀ n keeps to the side of J n and t' × b' does
    not. A fold so sharp that its normal nearly vanishes amplifies rounding, and is left out.
    """
    length = np.linalg.norm(accurate, axis=-1)
    sound = length > WELL_CONDITIONED * np.median(length, axis=-1, keepdims=True)
    angles = angular_errors(direct, accurate)[sound]
    angles = angles[np.isfinite(angles)]
    return float(np.minimum(angles, 180.0 - angles).max(initial=0.0))
