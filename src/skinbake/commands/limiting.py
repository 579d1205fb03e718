"""``bake --limit-influences``: fewer influences a vertex, and what that costs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skinbake.bake.baker import BakeFindings, BakeSettings, bake_mesh, rest_frame
from skinbake.bake.limit import limited_slots
from skinbake.commands.poses import PoseRequest, PoseSet, described, pose_set, skins_of
from skinbake.geometry import frames
from skinbake.geometry.skinned import BakedPrimitive, Float64Array, FloatArray, SkinnedPrimitive
from skinbake.gltf.animation import read_clips
from skinbake.gltf.document import Document
from skinbake.gltf.limit import with_limit
from skinbake.gltf.primitives import PrimitiveSource, StoredInfluences, read_influences
from skinbake.replay.algorithms import Algorithm
from skinbake.replay.run import replay
from skinbake.replay.surface import RestSurface
from skinbake.report.bake import LimitCost, Spread
from skinbake.verify.influences import normalised_weights
from skinbake.verify.metrics import angular_errors, summarise, vertex_areas

Outcome = tuple[BakedPrimitive, BakeFindings]

BLOCK_SAMPLES = 1 << 20
"""Vertices × poses replayed at a time: bounds the memory."""


@dataclass(frozen=True, slots=True)
class Limited:
    """A primitive with its largest influences alone.

    stored are its new influence sets; vertices is how many lost influences, left_out the share of their
    weight that went, on average.
    """

    primitive: SkinnedPrimitive
    stored: tuple[StoredInfluences, ...]
    vertices: int
    left_out: float


def limited(
    document: Document, source: PrimitiveSource, primitive: SkinnedPrimitive, count: int | None
) -> Limited | None:
    """Return the primitive with ``count`` influences a vertex, None where it stores no more than that."""
    if count is None or primitive.joints.shape[1] <= count:
        return None
    kept = limited_slots(primitive, count)
    before = read_influences(document, source, len(primitive.positions))
    stored = with_limit(before, kept.slots, kept.shares, kept.rewritten)
    losing = kept.dropped > 0
    return Limited(
        primitive.with_influences(
            np.concatenate([entry.joints.values.astype(np.int64) for entry in stored], axis=1),
            np.concatenate([entry.weights.decoded() for entry in stored], axis=1),
        ),
        tuple(stored),
        int(np.count_nonzero(losing)),
        float(kept.dropped[losing].mean()) if losing.any() else 0.0,
    )


def limit_costs(
    document: Document,
    sources: Sequence[PrimitiveSource],
    whole: Sequence[SkinnedPrimitive],
    parts: Sequence[Limited | None],
    outcomes: Sequence[Outcome],
    settings: BakeSettings,
) -> list[LimitCost | None]:
    """Return what the limit costs each primitive of one surface, None for those that it leaves alone.

    ``whole`` are the primitives with all their influences, ``outcomes`` the bakes of the limited ones.
    Accurate normals (algorithm 3) and positions before and after are compared over the poses that verify
    takes by default. Raises InputError where animations or skins cannot be read.
    """
    if not any(parts):
        return [None] * len(parts)
    clips = read_clips(document)
    sets = [pose_set(document, skin, clips, PoseRequest()) for skin in skins_of(document, sources[0].mesh)]
    told = described(PoseRequest(), sets, sum(clip.duration - clip.start for clip in clips))
    costs: list[LimitCost | None] = []
    for source, primitive, part, (before, _), (after, _) in zip(
        sources, whole, parts, bake_mesh(whole, settings), outcomes, strict=True
    ):
        if part is None:
            costs.append(None)
            continue
        pair = (
            _surface(primitive, before, source.joint_count, settings),
            _surface(part.primitive, after, source.joint_count, settings),
        )
        turned, moved, size = _differences(pair, sets)
        areas = np.tile(vertex_areas(primitive.positions, primitive.triangles), len(turned))
        costs.append(
            LimitCost(
                influences=part.primitive.joints.shape[1],
                vertices=part.vertices,
                left_out=part.left_out,
                normals=_spread(turned, areas),
                positions=_spread(moved, areas),
                size=size,
                poses=told,
            )
        )
    return costs


def _surface(
    primitive: SkinnedPrimitive, baked: BakedPrimitive, joint_count: int, settings: BakeSettings
) -> RestSurface:
    """Return what a replay reads of a bake that is not written yet; adopted joints stand at weight 0."""
    frame = rest_frame(primitive, settings.frame)
    named = np.where(baked.adopted_joints >= 0, baked.adopted_joints, primitive.joints)
    joints = np.where(named < joint_count, named, 0)
    return RestSurface(
        positions=primitive.positions.astype(np.float64),
        normals=frames.unit_normals(primitive.normals).astype(np.float64),
        tangents=frame.tangents.astype(np.float64),
        bitangents=frame.bitangents.astype(np.float64),
        joints=joints,
        weights=normalised_weights(primitive.weights, joints),
        alpha=baked.alpha.astype(np.float64),
        beta=baked.beta.astype(np.float64),
    )


def _differences(
    pair: tuple[RestSurface, RestSurface], sets: Sequence[PoseSet]
) -> tuple[FloatArray, FloatArray, float]:
    """Return angles between normals in degrees and distances between positions, each (P, V), and the size.

    The size is the diagonal of the box around the posed primitive, the largest of all poses.
    """
    turned: list[Float64Array] = []
    moved: list[Float64Array] = []
    size = 0.0
    step = max(1, BLOCK_SAMPLES // max(len(pair[0].positions), 1))
    for matrices in (poses.joint_matrices for poses in sets):
        for start in range(0, len(matrices), step):
            before, after = (
                replay(Algorithm.LBS_ACCURATE, surface, matrices[start : start + step]) for surface in pair
            )
            turned.append(angular_errors(after.normals, before.normals))
            moved.append(np.linalg.norm(after.positions - before.positions, axis=2))
            size = max(size, float(np.linalg.norm(np.ptp(before.positions, axis=1), axis=1).max(initial=0.0)))
    return np.concatenate(turned), np.concatenate(moved), size


def _spread(values: FloatArray, areas: FloatArray) -> Spread:
    """Summarise (P, V), weighted by area; a normal that does not exist before or after is left out."""
    flat = values.ravel()[None]
    summary = summarise(flat, areas, valid=np.isfinite(flat))
    return Spread(0.0, 0.0, 0.0) if summary is None else Spread(summary.mean, summary.p99, summary.max)
