"""``bake --limit-influences``: fewer influences a vertex, and the cost of that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skinbake.format.limit import with_limit
from skinbake.geometry.skinned import Float64Array, FloatArray, SkinnedPrimitive
from skinbake.gltf.animation import read_clips, skins_of
from skinbake.gltf.document import Document
from skinbake.gltf.primitives import PrimitiveSource, StoredInfluences, read_influences
from skinbake.gradients.limit import limited_slots
from skinbake.lighting.blending import blended_blocks
from skinbake.lighting.metrics import angles_between, total_area
from skinbake.lighting.poses import PoseRequest, PoseSet, described, pose_set
from skinbake.lighting.rest_areas import RestAreas
from skinbake.lighting.tally import ErrorTally
from skinbake.lighting.unwritten import UnwrittenBake
from skinbake.report.bake import LimitCost, Spread
from skinbake.skinning.algorithms import Algorithm
from skinbake.skinning.rest import RestPrimitive


@dataclass(frozen=True, slots=True)
class Limited:
    """A primitive with only its largest influences.

    stored are its new influence sets. vertices is the number of vertices that lost influences. left_out is
    the average share of weight that these vertices lost.
    """

    primitive: SkinnedPrimitive
    stored: tuple[StoredInfluences, ...]
    vertices: int
    left_out: float


def limited(
    document: Document, source: PrimitiveSource, primitive: SkinnedPrimitive, count: int | None
) -> Limited | None:
    """Return the primitive with ``count`` influences a vertex, or None if it stores no more than that."""
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
    whole: Sequence[UnwrittenBake],
    limited: Sequence[UnwrittenBake],
    parts: Sequence[Limited | None],
) -> list[LimitCost | None]:
    """Return the cost of the limit for each primitive of one surface, None for unchanged ones.

    ``whole`` are their bakes with all influences. ``limited`` are their bakes with the influences of
    ``parts``. Accurate normals (algorithm 3) and positions before and after are compared over the poses that
    verify takes by default. Raises InputError if animations or skins cannot be read.
    """
    clips = read_clips(document)
    skins = skins_of(document, whole[0].source.mesh)
    sets = [pose_set(document, skin, clips, PoseRequest()) for skin in skins]
    spaces = [RestAreas(document, skin) for skin in skins]
    told = described(PoseRequest(), sets, sum(clip.duration - clip.start for clip in clips))
    return [
        None if part is None else _cost(part, before, after, sets, spaces, told)
        for part, before, after in zip(parts, whole, limited, strict=True)
    ]


def _cost(
    part: Limited,
    before: UnwrittenBake,
    after: UnwrittenBake,
    sets: Sequence[PoseSet],
    spaces: Sequence[RestAreas],
    told: str,
) -> LimitCost:
    areas = [space.of(before.primitive) for space in spaces]
    turned, moved, size = _differences((before.rest_primitive(), after.rest_primitive()), sets, areas)
    return LimitCost(
        influences=part.primitive.joints.shape[1],
        vertices=part.vertices,
        left_out=part.left_out,
        normals=_spread(turned),
        positions=_spread(moved),
        size=size,
        poses=told,
    )


def _differences(
    pair: tuple[RestPrimitive, RestPrimitive], sets: Sequence[PoseSet], by_set: Sequence[Float64Array]
) -> tuple[ErrorTally, ErrorTally, float]:
    """Return angles between normals in degrees, distances between positions, and the size.

    by_set are areas (V,) that weight the vertices. The size is the diagonal of the box around the posed
    primitive, the largest of all poses.
    """
    weight = sum(
        len(poses.joint_matrices) * total_area(areas) for poses, areas in zip(sets, by_set, strict=True)
    )
    turned, moved = ErrorTally(weight), ErrorTally(weight)
    size = 0.0
    for poses, areas in zip(sets, by_set, strict=True):
        matrices = poses.joint_matrices
        low, high = np.full((3, len(matrices)), np.inf), np.full((3, len(matrices)), -np.inf)
        for pose, part, blended in blended_blocks(pair, matrices):
            before, after = (one.normals((Algorithm.LBS_ACCURATE,), pose, part)[0] for one in blended)
            _count(turned, angles_between(after, before), areas[part])
            first, second = (one.positions(pose, part) for one in blended)
            _count(moved, np.linalg.norm(second - first, axis=0).T, areas[part])
            low[:, pose] = np.minimum(low[:, pose], first.min(axis=1))
            high[:, pose] = np.maximum(high[:, pose], first.max(axis=1))
        size = max(size, float(np.linalg.norm(high - low, axis=0).max(initial=0.0)))
    return turned, moved, size


def _count(tally: ErrorTally, values: FloatArray, areas: FloatArray) -> None:
    """Count values (P, V). A value that does not exist, like an angle without a normal, is left out."""
    tally.add(values, areas, valid=np.isfinite(values))


def _spread(tally: ErrorTally) -> Spread:
    summary = tally.summary()
    return Spread(0.0, 0.0, 0.0) if summary is None else Spread(summary.mean, summary.p99, summary.max)
