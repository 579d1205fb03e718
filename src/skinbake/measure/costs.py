"""What an encoding of fewer bits costs in lighting."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skinbake.format.baked import Baked
from skinbake.format.encodings import GradientFormat, rounded, shortened
from skinbake.freshness.baked_views import BakedView, rest_primitive
from skinbake.geometry.skinned import Float64Array, FloatArray
from skinbake.gltf.document import Document
from skinbake.gltf.reading.clips import read_clips
from skinbake.measure.tally import ErrorTally
from skinbake.skinning.components import dot
from skinbake.skinning.rest import Algorithm, RestPrimitive
from skinbake.truth.areas import RestAreas, angles_between
from skinbake.truth.blending import blended_blocks
from skinbake.truth.poses import PoseRequest, PoseSet, pose_set


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
    """The angle in degrees that an encoding adds, over poses and vertices, weighted by rest area.

    effect is the mean angle by which α and β turn standard normals.
    """

    mean: float
    p99: float
    effect: float


def added_error(primitives: Iterable[EncodedPrimitive]) -> AddedError | None:
    """Measure the angle between algorithm 3's normals with stored and with unrounded α and β.

    All samples count together, and all poses count alike. If the unrounded normal of a sample vanishes, the
    sample is left out. If only its stored normal vanishes, the sample counts as 180°. None if no sample is
    left.
    """
    tally, effect = ErrorTally(), ErrorTally()
    for item in primitives:
        exact = replace(item.primitive, alpha=item.alpha, beta=item.beta)
        for pose, part, blended in blended_blocks((item.primitive, exact), item.joint_matrices):
            (stored,) = blended[0].normals((Algorithm.LBS_ACCURATE,), pose, part)
            both = Algorithm.LBS_STANDARD, Algorithm.LBS_ACCURATE
            standard, unrounded = blended[1].normals(both, pose, part)
            square = dot(unrounded, unrounded)
            valid = (square > 0.0) & np.isfinite(square)
            for counted, normals in ((tally, stored), (effect, standard)):
                angles = angles_between(normals, unrounded).astype(np.float32)
                counted.add(angles, item.areas[part], valid=valid)
    found = tally.summary(), effect.summary()
    if found[0] is None or found[1] is None:
        return None
    return AddedError(found[0].mean, found[0].p99, found[1].mean)


def encoded_primitives(
    document: Document, bakes: Sequence[Baked], storage: GradientFormat
) -> Iterator[EncodedPrimitive]:
    """Yield primitives with α and β as ``storage`` rounds them, in the poses of a document.

    Raises InputError if the animations or skins of the document cannot be read.
    """
    clips, sets = read_clips(document), dict[int, PoseSet]()
    for bake in bakes:
        exact = rest_primitive(BakedView.unwritten(bake))
        alpha, beta = (
            rounded(slots, storage.encoding, storage.scale).astype(np.float64)
            for slots in shortened(bake.result.alpha, bake.result.beta, storage.scale)
        )
        for skin in document.asset.skins_of(bake.source.mesh):
            if skin not in sets:
                sets[skin] = pose_set(document, skin, clips, PoseRequest())
            stored = replace(exact, alpha=alpha, beta=beta)
            areas = RestAreas(document, skin).of(bake.primitive)
            yield EncodedPrimitive(stored, exact.alpha, exact.beta, areas, sets[skin].joint_matrices)
