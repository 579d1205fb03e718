"""What options of a bake cost in lighting: fewer influences a vertex, and encodings of fewer bits."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skinbake.format.encodings import rounded
from skinbake.format.influences import with_limit
from skinbake.format.layouts import GradientFormat
from skinbake.geometry.skinned import Float64Array, FloatArray, SkinnedPrimitive
from skinbake.gltf.animation import read_clips, skins_of
from skinbake.gltf.document import Document
from skinbake.gltf.primitives import PrimitiveSource, StoredInfluences, joints_of_skin, read_influences
from skinbake.gradients.influences import limited_slots
from skinbake.measure.tally import ErrorTally
from skinbake.measure.unwritten import UnwrittenBake
from skinbake.report.bake import LimitCost, Spread
from skinbake.skinning.algorithms import Algorithm
from skinbake.skinning.components import dot
from skinbake.skinning.rest import RestPrimitive
from skinbake.truth.areas import RestAreas, angles_between
from skinbake.truth.blending import blended_blocks
from skinbake.truth.poses import PoseRequest, PoseSet, described, pose_set


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
    joints = np.concatenate([entry.joints.values.astype(np.int64) for entry in stored], axis=1)
    weights = np.concatenate([entry.weights.decoded() for entry in stored], axis=1)
    losing = kept.dropped > 0
    return Limited(
        primitive.with_influences(joints_of_skin(joints, weights, source), weights),
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
    turned, moved = ErrorTally(), ErrorTally()
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
    with np.errstate(over="ignore"):
        tally.add(values, areas, valid=np.isfinite(values.astype(np.float32)))


def _spread(tally: ErrorTally) -> Spread:
    summary = tally.summary()
    return Spread(0.0, 0.0, 0.0) if summary is None else Spread(summary.mean, summary.p99, summary.max)


@dataclass(frozen=True, slots=True)
class EncodedPrimitive:
    """One primitive in P poses with stored α and β, and with alpha and beta (V, K − 1) before storage.

    primitive has the stored α and β. areas (V,) are rest areas. joint_matrices are (P, J, 4, 4).
    """

    primitive: RestPrimitive
    alpha: FloatArray
    beta: FloatArray
    areas: FloatArray
    joint_matrices: Float64Array


@dataclass(frozen=True, slots=True)
class AddedError:
    """The angle in degrees that an encoding adds, over poses and vertices, weighted by rest area."""

    mean: float
    p99: float


def added_error(primitives: Iterable[EncodedPrimitive]) -> AddedError | None:
    """Measure the angle between algorithm 3's normals with stored and with unrounded α and β.

    All samples count together, and all poses count alike. If the unrounded normal of a sample vanishes, the
    sample is left out. If only its stored normal vanishes, the sample counts as 180°. None if no sample is
    left.
    """
    tally = ErrorTally()
    for item in primitives:
        exact = replace(item.primitive, alpha=item.alpha, beta=item.beta)
        for pose, part, blended in blended_blocks((item.primitive, exact), item.joint_matrices):
            stored, unrounded = (one.normals((Algorithm.LBS_ACCURATE,), pose, part)[0] for one in blended)
            square = dot(unrounded, unrounded)
            angles = angles_between(stored, unrounded).astype(np.float32)
            tally.add(angles, item.areas[part], valid=(square > 0.0) & np.isfinite(square))
    summary = tally.summary()
    return None if summary is None else AddedError(summary.mean, summary.p99)


def added_by_encoding(
    document: Document, bakes: Sequence[UnwrittenBake], storage: GradientFormat
) -> AddedError | None:
    """Return the angle between accurate normals with α and β as ``storage`` rounds them, and as float32.

    The document has the poses. None if no pose has a normal. Raises InputError if the animations or
    skins of the document cannot be read.
    """
    return added_error(_primitives(document, bakes, storage))


def _primitives(
    document: Document, bakes: Sequence[UnwrittenBake], storage: GradientFormat
) -> Iterator[EncodedPrimitive]:
    clips, sets = read_clips(document), dict[int, PoseSet]()
    for bake in bakes:
        exact = bake.rest_primitive()
        alpha, beta = (
            rounded(slots, storage.encoding, storage.scale).astype(np.float64)
            for slots in (bake.baked.alpha, bake.baked.beta)
        )
        for skin in skins_of(document, bake.source.mesh):
            if skin not in sets:
                sets[skin] = pose_set(document, skin, clips, PoseRequest())
            stored = replace(exact, alpha=alpha, beta=beta)
            areas = RestAreas(document, skin).of(bake.primitive)
            yield EncodedPrimitive(stored, exact.alpha, exact.beta, areas, sets[skin].joint_matrices)
