"""The cost of an encoding of α and β on a file: how it moves normals over the poses of verify."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from skinbake.format.encodings import rounded
from skinbake.format.layouts import GradientFormat
from skinbake.gltf.animation import read_clips, skins_of
from skinbake.gltf.document import Document
from skinbake.lighting.encoding import AddedError, EncodedPrimitive, added_error
from skinbake.lighting.poses import PoseRequest, PoseSet, pose_set
from skinbake.lighting.rest_areas import RestAreas
from skinbake.lighting.unwritten import UnwrittenBake


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
