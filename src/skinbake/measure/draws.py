"""The draws of a baked document: its surfaces as skins draw them, each with the poses to measure it in."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

from skinbake.choices import USUAL_TRUTHS, Truth
from skinbake.errors import InputError, Notice
from skinbake.freshness.baked_views import BakedView, rest_primitive, whole_surfaces
from skinbake.freshness.expected import true_operator_of
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.animation import Clip
from skinbake.gltf.budget import SAMPLES, Cost, Work
from skinbake.gltf.document import Document
from skinbake.measure.angles import Corrections
from skinbake.skinning.rest import RestPrimitive
from skinbake.truth.areas import RestAreas
from skinbake.truth.fine import FineMesh
from skinbake.truth.operator import TRUE_CREASE_ANGLE, TRUE_WEIGHTING, GradientOperator
from skinbake.truth.poses import (
    LEAST_SAMPLES,
    SHARED_SAMPLES,
    PosePlan,
    PoseRequest,
    PoseSet,
    draws_of,
    planned_poses,
    steps_of_looking,
)
from skinbake.wording import counted

FINE_RATIO = 8
"""The vertices and points of a usual fine mesh for each vertex of the mesh. So many of them count as one."""


DrawKey: TypeAlias = tuple[int, int | None]
"""A skin, and the node with the morph weights, if there are any."""


@dataclass(frozen=True, slots=True)
class Draw:
    """One surface as one skin draws it: its baked primitives, and what a replay and the truths need of them.

    operator is that of the truths, over all primitives. rest are these for the replay, areas the
    areas around their vertices, (V,) each, in the squared unit of the scene. They are the weights of errors.
    poses are those of the skin, and of the node if the mesh has morph targets. fine is the mesh of the truth
    *fine*, None without it. skin and node are their numbers. corrections are the correctives that its clips
    play, if any.
    """

    views: Sequence[BakedView]
    operator: GradientOperator
    rest: Sequence[RestPrimitive]
    areas: Sequence[Float64Array]
    poses: PoseSet
    fine: FineMesh | None = None
    skin: int = 0
    node: int | None = None
    corrections: Corrections | None = None


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
    truths: Collection[Truth] = USUAL_TRUTHS,
) -> tuple[list[Draw], list[Notice]]:
    """Return each of the ``true_surfaces`` as often as skins draw it, or nodes if it has morph targets.

    truths are those to measure by.

    If all skins or poses are too much work for the file, some skins of each surface are measured, in some
    poses each, and a notice says so. Raises InputError if a skin cannot be posed, or if the work is out of
    proportion to the file even so.
    """
    drawn, plans, notices = _planned(document, surfaces, clips, request)
    measured = [(views, draw) for views, _, draw in drawn]
    plans, fewer = _fewer_poses(document, plans, measured)
    notices += fewer
    work = _Work(document)
    rests = {id(views): [rest_primitive(view) for view in views] for views, _ in surfaces}
    fine = {
        id(views): _fine_mesh(document, views, operator)
        for views, operator in surfaces
        if Truth.FINE in truths
    }
    sets: dict[DrawKey, PoseSet] = {}
    found = []
    for views, operator, draw in drawn:
        work.claim(views, plans[draw], fine.get(id(views)))
        if draw not in sets:
            sets[draw] = planned_poses(document, plans[draw])
        space = RestAreas(document, draw[0])
        areas = [space.of(view.now) for view in views]
        of_fine = fine.get(id(views))
        found.append(Draw(views, operator, rests[id(views)], areas, sets[draw], of_fine, *draw))
    return found, notices


def _planned(
    document: Document,
    surfaces: Sequence[tuple[Sequence[BakedView], GradientOperator]],
    clips: Sequence[Clip],
    request: PoseRequest,
) -> tuple[
    list[tuple[Sequence[BakedView], GradientOperator, DrawKey]], dict[DrawKey, PosePlan], list[Notice]
]:
    """Return the draws to measure, their plans, and a notice if these are not all."""
    every = [
        (rank, views, operator, draw)
        for views, operator in surfaces
        for rank, draw in enumerate(draws_of(document, views[0].source.mesh, clips))
    ]
    budget, plans, chosen = document.budget, dict[DrawKey, PosePlan](), list[int]()
    steps, samples = 0.0, 0
    looking = steps_of_looking(clips)
    # One draw of each surface is measured in any case, or the file is refused.
    for number in sorted(range(len(every)), key=lambda number: every[number][0]):
        rank, views, _, draw = every[number]
        place = views[0].source.place._replace(primitive=None)
        needed = Cost.MEASURED_PRIMITIVE * len(views)
        if rank and steps + needed.steps + looking > budget.steps_left:
            break
        budget.claim(needed, f"{counted(len(views), 'primitive')} of skin {draw[0]}", place)
        plan = plans.get(draw) or PosePlan.of(document, draw[0], clips, request, draw[1])
        few = _limited(plan, LEAST_SAMPLES)
        steps += (0 if draw in plans else few.work.steps) + _morphing(few, len(views)).steps
        samples += _samples(views, few)
        if rank and (steps > budget.steps_left or samples > SAMPLES.most(document.budget.backed)):
            break
        plans[draw] = plan
        chosen.append(number)
    left_out = len(every) - len(chosen)
    drawn = [every[number][1:] for number in sorted(chosen)]
    if not left_out:
        return drawn, plans, []
    message = (
        f"its lighting is measured in {len(chosen):,} of the {len(every):,} ways in which skins draw its "
        "meshes: all are too much work for a file of its size"
    )
    return drawn, plans, [Notice("poses-left-out", message, document.place, left_out)]


def _limited(plan: PosePlan, most: int) -> PosePlan:
    return replace(plan, request=plan.request._replace(most=most))


def _fine_mesh(document: Document, views: Sequence[BakedView], operator: GradientOperator) -> FineMesh:
    """Return the mesh of the truth *fine*. Raises InputError if it takes too much memory for the file."""
    corners, place = operator.triangles.size, views[0].source.place._replace(primitive=None)
    what = f"the truth fine at {counted(corners, 'corner')} of triangles"
    document.budget.claim(Cost.FINE_CORNER * corners, what, place)
    return FineMesh.of(operator)


def _fewer_poses(
    document: Document,
    plans: dict[DrawKey, PosePlan],
    drawn: Sequence[tuple[Sequence[BakedView], DrawKey]],
) -> tuple[dict[DrawKey, PosePlan], list[Notice]]:
    """Return plans of so few poses that the document may claim their work, and a notice on it.

    drawn are the primitives of each draw, and its plan. Plans that are too much work in
    ``LEAST_SAMPLES`` poses each are returned so: their claims are refused.
    """
    every = max((plan.count for plan in plans.values()), default=0)

    def limited(most: int) -> dict[DrawKey, PosePlan]:
        return {draw: _limited(plan, most) for draw, plan in plans.items()}

    def is_too_much(some: dict[DrawKey, PosePlan]) -> bool:
        steps = sum(plan.work.steps for plan in some.values())
        steps += sum(_morphing(some[draw], len(views)).steps for views, draw in drawn)
        samples = sum(_samples(views, some[draw]) for views, draw in drawn)
        return steps > document.budget.steps_left or samples > SAMPLES.most(document.budget.backed)

    if every <= LEAST_SAMPLES or not is_too_much(plans):
        return plans, []
    counts = range(LEAST_SAMPLES, every)
    fitting = bisect_left(counts, True, key=lambda most: is_too_much(limited(most)))
    few = limited(counts[max(fitting - 1, 0)])
    most = max(plan.count for plan in few.values())
    message = (
        f"its lighting is measured in {most:,} of up to {every:,} poses of each skin, which evenly spread "
        "clips share: all poses are too much work for a file of its size"
    )
    return few, [Notice("poses-left-out", message, document.place, every - most)]


def _morphing(plan: PosePlan, primitives: int) -> Work:
    """Return the steps of measuring so many primitives under morph targets, pose by pose."""
    if plan.resting is None or not plan.morphs:
        return Work()
    return (Cost.MEASURED_MORPH + Cost.MEASURED_TARGET * len(plan.resting)) * (primitives * plan.count)


def _samples(views: Sequence[BakedView], plan: PosePlan, fine: FineMesh | None = None) -> int:
    """Return the vertices × poses of a draw. The clips of the file count, not the samples that users ask for.

    A fine mesh has about eight times the vertices, and its user has asked for it.
    """
    vertices = sum(len(view.now.positions) for view in views) if fine is None else -(-fine.size // FINE_RATIO)
    asked = plan.request.samples
    return vertices * (plan.count if asked is None else -(-plan.count // asked) * SHARED_SAMPLES)


class _Work:
    """The work of measuring the draws of a document, as vertices × poses."""

    def __init__(self, document: Document) -> None:
        self._document = document
        self._samples = 0

    def claim(self, views: Sequence[BakedView], plan: PosePlan, fine: FineMesh | None) -> None:
        """Count the work of a draw. Raises InputError if all of it is far out of proportion to the file."""
        vertices, count = sum(len(view.now.positions) for view in views), plan.count
        place = views[0].source.place._replace(primitive=None)
        samples = f"{counted(vertices, 'vertex', 'vertices')} in {counted(count, 'pose')}"
        self._document.budget.claim(_morphing(plan, len(views)), f"{samples} of morph targets", place)
        self._document.budget.claim(Cost.MEASURED_SAMPLE * (vertices * count), samples, place)
        self._samples += _samples(views, plan, fine)
        most = SAMPLES.most(self._document.budget.backed)
        if self._samples > most:
            raise InputError(
                f"it asks for {self._samples:,} vertices times poses, as often as nodes draw it and clips "
                f"move it: over the {most:,} that a file of its size may ask for",
                place,
            )
