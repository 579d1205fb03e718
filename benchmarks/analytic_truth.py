"""How far the true normals of verify, and algorithm 3, are from closed forms: behind docs/lighting.md.

Usage: python -m benchmarks.analytic_truth

A bumpy tube with three joints bends in eight steps. Its positions and weights are functions of an angle and
a height, so that the normal of the deformed tube is known: from differences of fourth order in these two. The
weights are smooth, steep (they change over a sixth of that height), or kinked (straight ramps, as painting
tools leave them).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fixtures.builder import grid
from fixtures.make_fixtures import (
    ELBOW_DEGREES,
    TUBE_JOINTS,
    TUBE_LENGTH,
    TUBE_RADIUS,
    WRIST_DEGREES,
    chain_weights,
    tube_surface,
    tube_weights,
)
from skinbake.choices import USUAL_TRUTHS, Gradients
from skinbake.commands.bake import bake_file
from skinbake.commands.bake_options import BakeOptions
from skinbake.freshness.baked_views import baked_views, rest_primitive
from skinbake.geometry.poses import composed, normalised
from skinbake.geometry.rig import NO_PARENT, Rig
from skinbake.geometry.skinned import Float64Array, FloatArray, IntArray, SkinnedPrimitive
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.clips import read_clips
from skinbake.gltf.reading.meshes import skinned_sources
from skinbake.gradients.baker import bake_primitives
from skinbake.skinning.rest import Algorithm, RestPrimitive
from skinbake.threads import Threads
from skinbake.truth.areas import vertex_areas
from skinbake.truth.mesh import normalised_weights
from skinbake.truth.operator import gradient_operator
from skinbake.truth.poses import PoseRequest, pose_set
from skinbake.truth.truths import Truths
from tests.support.replay import replay
from tests.support.whole_fields import angular_errors, rest_frame

REPOSITORY = Path(__file__).resolve().parents[1]
BENT_TUBE = REPOSITORY / "fixtures" / "bent_tube.glb"

SIZES = ((17, 24), (33, 46), (97, 124))
"""Vertices around the tube, the seam's copies included, and along it."""

STEP = 1e-4
RAMP = 0.35
STEEP = 0.04

RIG = Rig(np.array([NO_PARENT, 0, 1], dtype=np.int32), TUBE_JOINTS.astype(np.float64))

Weights = Callable[[Float64Array, Float64Array], Float64Array]


def steep_weights(theta: Float64Array, height: Float64Array) -> Float64Array:
    """Return the bent tube's weights, changing over a sixth of the height."""
    return chain_weights(height + 0.15 * np.cos(theta), TUBE_JOINTS[1:, 1].tolist(), STEEP)


def kinked_weights(theta: Float64Array, height: Float64Array) -> Float64Array:
    """Return weights of straight ramps, with a kink at both ends of each."""
    along = height + 0.15 * np.cos(theta)
    steps = [np.clip((along - border) / RAMP + 0.5, 0.0, 1.0) for border in TUBE_JOINTS[1:, 1]]
    return -np.diff(np.stack([np.ones_like(along), *steps, np.zeros_like(along)], axis=1), axis=1)


KINDS: dict[str, Weights] = {"smooth": tube_weights, "steep": steep_weights, "kinked": kinked_weights}


@dataclass(frozen=True)
class Errors:
    """Mean angles in degrees, by area over all poses: each against what its name says."""

    vertices: int
    standard: float
    accurate: float
    accurate_by: dict[str, float]
    truths: dict[str, float]


def skinned(
    weights: Weights, matrices: Float64Array, theta: Float64Array, height: Float64Array
) -> Float64Array:
    """Return the positions (P, V, 3) of the tube under joint matrices (P, 3, 4, 4)."""
    points = tube_surface(theta, height, TUBE_RADIUS)[0]
    moved = np.einsum("pjab,vb->pvja", matrices[..., :3, :3], points) + matrices[:, None, :, :3, 3]
    return np.asarray(np.einsum("vj,pvja->pva", weights(theta, height), moved))


def exact_normals(
    weights: Weights, matrices: Float64Array, theta: Float64Array, height: Float64Array
) -> Float64Array:
    """Return the normals (P, V, 3) of the deformed tube, of any length, by differences of fourth order."""

    def slope(across: float, along: float) -> Float64Array:
        near, far = (
            skinned(weights, matrices, theta + n * across, height + n * along)
            - skinned(weights, matrices, theta - n * across, height - n * along)
            for n in (1.0, 2.0)
        )
        return (8.0 * near - far) / (12.0 * STEP)

    return np.cross(slope(0.0, STEP), slope(STEP, 0.0))


def bends(count: int = 8) -> Float64Array:
    """Return joint matrices (P, 3, 4, 4): elbow and wrist of the bent tube, in equal steps to its largest."""
    shares = np.arange(1, count + 1) / count
    matrices = np.tile(np.eye(4), (count, 3, 1, 1))
    for pose, share in enumerate(shares):
        parent = np.eye(4)
        for joint, (axis, degrees) in enumerate((((0, 0, 1), ELBOW_DEGREES), ((1, 0, 0), WRIST_DEGREES)), 1):
            half = np.radians(degrees * share) / 2.0
            turn = normalised(np.concatenate([[np.cos(half)], np.sin(half) * np.array(axis)]))
            pivot = TUBE_JOINTS[joint]
            local = composed(np.zeros((1, 3)), turn[None], np.ones((1, 3)))[0]
            local[:3, 3] = pivot - local[:3, :3] @ pivot
            parent = parent @ local
            matrices[pose, joint] = parent
    return matrices


def measured(
    primitive: SkinnedPrimitive, rest: RestPrimitive, matrices: Float64Array, exact: Float64Array
) -> Errors:
    """Measure algorithms 1 and 3, and both truths, on a tube whose exact normals (P, V, 3) are known."""
    operator = gradient_operator([primitive])
    posed = {one: replay(one, rest, matrices) for one in (Algorithm.LBS_STANDARD, Algorithm.LBS_ACCURATE)}
    accurate = posed[Algorithm.LBS_ACCURATE]
    truths = Truths.of(operator, [rest], len(matrices), USUAL_TRUTHS)
    deformed = np.ascontiguousarray(np.transpose(accurate.positions, (2, 1, 0)), dtype=np.float64)
    with Threads(1) as threads:
        sums = truths.sums(deformed, threads)
    found = {truth: np.empty(exact.shape) for truth in USUAL_TRUTHS}
    for block in truths.vertex_blocks:
        normals, _ = truths.normals(block.number, deformed, sums, None)
        for truth, vectors in zip(USUAL_TRUTHS, normals, strict=True):
            found[truth][:, block.part] = vectors.T
    areas = vertex_areas(primitive.positions, primitive.triangles)

    def mean(one: FloatArray, other: FloatArray) -> float:
        return float(np.average(angular_errors(one, other).mean(axis=0), weights=areas))

    return Errors(
        len(primitive.positions),
        mean(posed[Algorithm.LBS_STANDARD].normals, exact),
        mean(accurate.normals, exact),
        {truth: mean(accurate.normals, normals) for truth, normals in found.items()},
        {truth: mean(normals, exact) for truth, normals in found.items()},
    )


def tube(weights: Weights, columns: int, rows: int) -> tuple[SkinnedPrimitive, Float64Array, Float64Array]:
    """Return a tube with its parameters (V,), theta and height: slot i is joint i at every vertex."""
    theta_of = np.linspace(0, 2 * np.pi, columns)
    height, theta, triangles = grid(np.linspace(0, TUBE_LENGTH, rows), theta_of)
    theta = np.where(theta == theta_of[-1], 0.0, theta)
    positions, normals = tube_surface(theta, height, TUBE_RADIUS)
    joints: IntArray = np.tile(np.array([0, 1, 2, 0]), (len(theta), 1))
    padded = np.pad(weights(theta, height), ((0, 0), (0, 1)))
    return SkinnedPrimitive(positions, normals, None, joints, padded, triangles), theta, height


def grown(weights: Weights, columns: int, rows: int, *, gradients: Gradients = Gradients.FITTED) -> Errors:
    """Bake a tube and measure it."""
    primitive, theta, height = tube(weights, columns, rows)
    settings = BakeOptions().settings
    ((baked, _),) = bake_primitives([primitive], settings, RIG if gradients is Gradients.FITTED else None)
    frame, matrices = rest_frame(primitive, settings.frame), bends()
    rest = RestPrimitive(
        positions=primitive.positions,
        normals=primitive.normals,
        tangents=frame.tangents.astype(np.float64),
        bitangents=frame.bitangents.astype(np.float64),
        joints=np.where(baked.adopted_joints >= 0, baked.adopted_joints, primitive.joints),
        weights=normalised_weights(primitive.weights, primitive.joints),
        alpha=baked.alpha.astype(np.float64),
        beta=baked.beta.astype(np.float64),
    )
    return measured(primitive, rest, matrices, exact_normals(weights, matrices, theta, height))


def bent_tube(gradients: Gradients) -> Errors:
    """Bake the fixture and measure it in the poses that verify takes."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / BENT_TUBE.name
        bake_file(str(BENT_TUBE), str(path), BakeOptions(gradients=gradients))
        document = read_document(str(path))
    (view,) = baked_views(document, skinned_sources(document))
    matrices = pose_set(document, 0, read_clips(document), PoseRequest()).joint_matrices
    _, theta, height = tube(tube_weights, 33, 46)
    exact = exact_normals(tube_weights, matrices, theta, height)
    return measured(view.now, rest_primitive(view), matrices, exact)


def lines() -> Iterator[str]:
    """Yield the table."""
    yield (
        "| weights | vertices | standard | surface | rig | rig, by tangents | by triangles "
        "| truth by tangents | by triangles |"
    )
    yield "|---|--:|--:|--:|--:|--:|--:|--:|--:|"
    kinds = (Gradients.SURFACE, Gradients.FITTED)
    for kind, weights in KINDS.items():
        for size in SIZES:
            yield row(kind, *(grown(weights, *size, gradients=gradients) for gradients in kinds))
    yield row("README's tube", *(bent_tube(gradients) for gradients in kinds))


def row(name: str, surface: Errors, rig: Errors) -> str:
    """Return a row of the table."""
    angles = (
        rig.standard,
        surface.accurate,
        rig.accurate,
        *(rig.accurate_by[truth] for truth in USUAL_TRUTHS),
        *(rig.truths[truth] for truth in USUAL_TRUTHS),
    )
    return f"| {name} | {rig.vertices:,} | {' | '.join(f'{angle:.3f}' for angle in angles)} |"


def main() -> None:
    print("\n".join(lines()))


if __name__ == "__main__":
    main()
