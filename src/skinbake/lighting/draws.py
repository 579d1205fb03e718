"""The draws of a baked document: its surfaces as skins draw them, each with the poses to measure it in."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from skinbake.errors import InputError
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.animation import Clip
from skinbake.gltf.document import Document
from skinbake.lighting.baked_views import BakedView, whole_surfaces
from skinbake.lighting.before_adoption import true_operator_of
from skinbake.lighting.operator import TRUE_CREASE_ANGLE, TRUE_WEIGHTING, GradientOperator
from skinbake.lighting.poses import SHARED_SAMPLES, PoseRequest, PoseSet, draws_of, pose_set
from skinbake.lighting.rest_areas import RestAreas
from skinbake.lighting.rest_primitives import rest_primitive
from skinbake.skinning.rest import RestPrimitive
from skinbake.wording import counted

BYTES_A_SAMPLE = 32
"""The memory of one vertex in one pose, at most: its errors, while they may be among the largest."""

SAMPLES_A_BYTE, SAMPLES_FREE = 24, 1_000_000
"""The vertices × poses that a file may need, for each of its bytes and in addition. Each takes 3 µs.

A mesh is measured once for each skin that draws it, and in at least three poses of each clip. Fifty soldiers
of one mesh of 3,000 vertices need 20 a byte, a character of a million vertices needs 0.5.
"""


@dataclass(frozen=True, slots=True)
class Draw:
    """One surface as one skin draws it: its baked primitives, and what a replay and the truths need of them.

    operator is that of the truths, over all primitives. rest are these for the replay, areas the
    areas around their vertices, (V,) each, in the squared unit of the scene. They are the weights of errors.
    poses are those of the skin, and of the node if the mesh has morph targets.
    """

    views: Sequence[BakedView]
    operator: GradientOperator
    rest: Sequence[RestPrimitive]
    areas: Sequence[Float64Array]
    poses: PoseSet


def true_surfaces(
    document: Document, meshes: Sequence[Sequence[BakedView]], operators: Sequence[GradientOperator]
) -> list[tuple[list[BakedView], GradientOperator]]:
    """Return the surfaces that the truths take as whole, each with the operator of the truths.

    meshes are the surfaces of the bakes, and operators have the settings of these bakes. An operator serves
    again if the bake had the same surface, and the truths' weighting and crease angle. Otherwise a new one is
    built. Raises InputError if that takes too much memory for the file.
    """
    of_bake = {_views_key(views): one for views, one in zip(meshes, operators, strict=True)}
    return [
        (views, _true_operator(document, views, of_bake.get(_views_key(views))))
        for views in whole_surfaces(document, [view for views in meshes for view in views])
    ]


def _views_key(views: Sequence[BakedView]) -> tuple[int, ...]:
    return tuple(map(id, views))


def _true_operator(
    document: Document, views: Sequence[BakedView], operator: GradientOperator | None
) -> GradientOperator:
    """Return the operator of one surface with the settings of the truths, not with those of the bake.

    ``operator`` is the bake's own one, or None if the bake had other surfaces.
    """
    noted = views[0].metadata
    usual = noted["weighting"] == TRUE_WEIGHTING and math.isclose(noted["creaseAngle"], TRUE_CREASE_ANGLE)
    if operator is not None and usual:
        return operator
    return true_operator_of(document, views)


def draws(
    document: Document,
    surfaces: Sequence[tuple[Sequence[BakedView], GradientOperator]],
    clips: Sequence[Clip],
    request: PoseRequest,
) -> Iterator[Draw]:
    """Yield each of the ``true_surfaces`` as often as skins draw it, or nodes if it has morph targets.

    Raises InputError if a skin cannot be posed, or if the work is out of proportion to the file.
    """
    work = _Work(document, request)
    found: dict[tuple[int, int | None], PoseSet] = {}
    for views, operator in surfaces:
        rest = [rest_primitive(view) for view in views]
        for skin, node in draws_of(document, views[0].source.mesh, clips):
            if (skin, node) not in found:
                found[skin, node] = pose_set(document, skin, clips, request, node)
            poses = found[skin, node]
            work.claim(views, poses)
            space = RestAreas(document, skin)
            areas = [space.of(view.now) for view in views]
            yield Draw(views, operator, rest, areas, poses)


class _Work:
    """The work of measuring the draws of a document, as vertices × poses."""

    def __init__(self, document: Document, request: PoseRequest) -> None:
        self._document, self._request = document, request
        self._samples = 0

    def claim(self, views: Sequence[BakedView], poses: PoseSet) -> None:
        """Count the work of a draw. Raises InputError if all of it is far out of proportion to the file."""
        vertices, count = sum(len(view.now.positions) for view in views), len(poses.clips)
        place = replace(views[0].source.place, primitive=None)
        self._document.budget.claim(
            BYTES_A_SAMPLE * vertices * count,
            f"{counted(vertices, 'vertex', 'vertices')} in {counted(count, 'pose')}",
            place,
        )
        # The clips of the file count, not how many samples of each the user asks for.
        asked = self._request.samples
        self._samples += vertices * (count if asked is None else -(-count // asked) * SHARED_SAMPLES)
        most = SAMPLES_FREE + SAMPLES_A_BYTE * self._document.budget.backed
        if self._samples > most:
            raise InputError(
                f"it asks for {self._samples:,} vertices times poses, as often as nodes draw it and clips "
                f"move it: over the {most:,} that a file of its size may ask for",
                place,
            )
