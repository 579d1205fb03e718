"""The scene of a document: its baked surfaces, how nodes draw them, and which poses are affordable.

It serves verify, dump, pictures and pages. It is built from a document with sound bakes, in a file or made in
memory.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from skinbake.choices import Truth
from skinbake.errors import BudgetError, InputError, Notice
from skinbake.freshness.baked_views import BakedView, gathered_together, whole_surfaces
from skinbake.freshness.expected import true_operator_of
from skinbake.freshness.staleness import surface_operator
from skinbake.geometry.frames import frame_from_normal, unit_normals
from skinbake.geometry.skinned import Float32Array, Float64Array, FloatArray, IntArray
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.budget import SAMPLES, Cost, Work
from skinbake.gltf.document import Document
from skinbake.gltf.reading.clips import Clip, clip_poses, read_clips
from skinbake.gltf.reading.meshes import has_surface, plain_sources, read_primitive
from skinbake.gltf.reading.scenes import faces_backward, first_equal, shown_nodes, shown_skins
from skinbake.gltf.reading.skins import Skeleton, read_node, rest_pose
from skinbake.measure.angles import MeasuredBlock, lighting_errors
from skinbake.measure.draws import HALF_TURN, Draw, Surface
from skinbake.skinning.rest import RestPrimitive
from skinbake.timing import stage
from skinbake.truth.operator import TRUE_CREASE_ANGLE, TRUE_WEIGHTING, GradientOperator
from skinbake.truth.poses import (
    LEAST_SAMPLES,
    SHARED_SAMPLES,
    PosePlan,
    PoseRequest,
    PoseSet,
    draws_of,
    planned_poses,
    sampled_clips,
    steps_of_looking,
)
from skinbake.truth.truths import Truths
from skinbake.wording import counted, one_or_many

if TYPE_CHECKING:
    from skinbake.freshness.corrective_freshness import PlayedCorrectives

LIGHTINGS = ("standard", "accurate", "corrected")

DrawKey: TypeAlias = tuple[int, int | None]
"""A skin, and the node with the morph weights, if there are any."""


def measure(draw: Draw, record: Callable[[MeasuredBlock], None], at_rest: Truths | None = None) -> None:
    """Measure the errors of lighting by linear blend skinning in a draw, block by block."""
    lighting_errors(
        draw.surface.operator,
        draw.surface.rest,
        draw.matrices,
        "lbs",
        record,
        morphing=draw.morphing,
        at_rest=at_rest or draw.truths(),
        corrections=draw.corrections,
        direct=False,
    )


def errors_of(draw: Draw) -> list[dict[str, Float32Array]]:
    """Return by primitive and lighting errors in degrees, and where they are known: (2, P, V).

    The truth is that by triangles.
    """
    count, names = len(draw.matrices), LIGHTINGS if draw.corrections else LIGHTINGS[:2]
    found = [
        {name: np.zeros((2, count, len(rest.positions)), np.float32) for name in names}
        for rest in draw.surface.rest
    ]

    def record(block: MeasuredBlock) -> None:
        own = found[block.primitive].get(block.lighting)
        if own is not None:
            poses = slice(block.pose, block.pose + block.errors.shape[0])
            rows = slice(block.vertex, block.vertex + block.errors.shape[1])
            own[0, poses, rows] = np.where(block.valid, block.errors, 0.0)
            own[1, poses, rows] = block.valid

    measure(draw, record, draw.truths((Truth.TRIANGLES,)))
    return found


class Scene:
    """The surfaces of a document, and how nodes draw them.

    views are its sound bakes. correctives are the file's own: the bakes may have been made in memory, to
    be compared with them. is_partial: not all draws and poses were ``measured``.
    """

    def __init__(
        self,
        document: Document,
        views: Sequence[BakedView],
        correctives: PlayedCorrectives | None = None,
    ) -> None:
        self.document, self.views, self.correctives = document, views, correctives
        self.is_partial = False
        self._operators: dict[tuple[int, ...], GradientOperator] = {}
        self._made: dict[tuple[int, ...], Surface] = {}

    @classmethod
    def of_bakes(
        cls,
        document: Document,
        views: Sequence[BakedView],
        operators: Sequence[GradientOperator] = (),
        correctives: PlayedCorrectives | None = None,
    ) -> Scene:
        """Return a scene in which operators of bakes serve again, where the truths take the same surface.

        operators have the settings of the bakes, one for each of the surfaces that ``gathered_together``
        returns. They are built if there are none.
        """
        surfaces = gathered_together(document, views)
        made = operators or [surface_operator(document, surface) for surface in surfaces]
        scene = cls(document, [view for surface in surfaces for view in surface], correctives)
        scene._operators = {
            tuple(map(id, own)): one
            for own, one in zip(surfaces, made, strict=True)
            # The truths weight triangles in one way, whatever the bake was told.
            if own[0].note.weighting == TRUE_WEIGHTING
            and math.isclose(own[0].note.crease_angle, TRUE_CREASE_ANGLE)
        }
        return scene

    @cached_property
    def surfaces(self) -> list[Surface]:
        """The surfaces that the truths take as whole."""
        return [self._surface(views) for views in whole_surfaces(self.document, self.views)]

    def _surface(self, views: Sequence[BakedView]) -> Surface:
        """Return the surface of views, made once: what is measured is often what is shown."""
        key = tuple(map(id, views))

        def welded() -> GradientOperator:
            made = self._operators.get(key)
            return true_operator_of(self.document, views) if made is None else made

        if key not in self._made:
            self._made[key] = Surface(self.document, views, welded, self.correctives)
        return self._made[key]

    def measured(self, clips: Sequence[Clip], request: PoseRequest) -> list[Draw]:
        """Return each surface as often as skins draw it, or nodes if it has morph targets, in asked poses.

        If all skins or poses are too much work for the file, some skins of
        each surface are measured, in some poses each, and a notice says so. Raises InputError if a skin
        cannot be posed, or if the work is out of proportion to the file even so.
        """
        document, budget = self.document, self.document.budget
        self.is_partial = False
        with stage("gradient operator"):
            for surface in self.surfaces:
                surface.operator  # noqa: B018  # its memory is claimed before that of the poses
        # Claim the work of each draw, and pose it. Draws of one skin and node share their poses.
        drawn, plans = self._planned(clips, request)
        most_samples = SAMPLES.most(budget.backed)
        samples, sets, found = 0, dict[DrawKey, PoseSet](), list[Draw]()
        for surface, draw in drawn:
            plan = plans[draw]
            what = f"{counted(surface.vertices, 'vertex', 'vertices')} in {counted(plan.count, 'pose')}"
            budget.claim(_morphed(surface, plan), f"{what} of morph targets", surface.place)
            budget.claim(Cost.MEASURED_SAMPLE * (surface.vertices * plan.count), what, surface.place)
            samples += _samples(surface, plan)
            if samples > most_samples:
                raise InputError(
                    f"it asks for {samples:,} vertices times poses, as often as nodes draw it and clips move "
                    f"it: over the {most_samples:,} that a file of its size may ask for",
                    surface.place,
                )
            if draw not in sets:
                sets[draw] = planned_poses(document, plan)
            found.append(Draw(surface, *draw, plan.skeleton, sets[draw]).posed(sets[draw]))
        return found

    def _planned(
        self, clips: Sequence[Clip], request: PoseRequest
    ) -> tuple[list[tuple[Surface, DrawKey]], dict[DrawKey, PosePlan]]:
        """Return the affordable draws, and the plans of as many poses as are affordable."""
        document, budget = self.document, self.document.budget
        # One draw of each surface is measured in any case, or the file is refused. The others follow while
        # they are affordable in the least number of poses.
        every = [
            (rank, surface, draw)
            for surface in self.surfaces
            for rank, draw in enumerate(draws_of(document, surface.views[0].source.mesh, clips))
        ]
        most_samples = SAMPLES.most(budget.backed)
        plans, chosen = dict[DrawKey, PosePlan](), list[int]()
        steps, samples, sampled = 0.0, 0, set[object](sampled_clips(document))
        for number in sorted(range(len(every)), key=lambda number: every[number][0]):
            rank, surface, draw = every[number]
            needed = Cost.MEASURED_PRIMITIVE * len(surface.views)
            if rank and steps + needed.steps + steps_of_looking(clips) > budget.steps_left:
                break
            what = f"{counted(len(surface.views), 'primitive')} of skin {draw[0]}"
            budget.claim(needed, what, surface.place)
            plan = plans.get(draw) or PosePlan.of(document, draw[0], clips, request, draw[1])
            few = _limited(plan, LEAST_SAMPLES)
            steps += (0 if draw in plans else few.work(sampled).steps) + _morphed(surface, few).steps
            sampled.update(map(few.key, few.sampled))
            samples += _samples(surface, few)
            if rank and (steps > budget.steps_left or samples > most_samples):
                break
            plans[draw] = plan
            chosen.append(number)
        drawn = [every[number][1:] for number in sorted(chosen)]
        if len(drawn) < len(every):
            message = (
                f"its lighting is measured in {len(drawn):,} of the {len(every):,} ways in which skins draw "
                "its meshes: all are too much work for a file of its size"
            )
            left_out = len(every) - len(drawn)
            document.notices.tell(Notice("poses-left-out", message, document.place, left_out))
            self.is_partial = True

        # As many poses as are affordable. Plans that are too much work in LEAST_SAMPLES poses each are kept
        # so: their claims are refused below.
        def is_too_much(most: int | None) -> bool:
            some = plans if most is None else {draw: _limited(plan, most) for draw, plan in plans.items()}
            steps, sampled = 0.0, set[object](sampled_clips(document))
            for plan in some.values():
                steps += plan.work(sampled).steps
                sampled.update(map(plan.key, plan.sampled))
            steps += sum(_morphed(surface, some[draw]).steps for surface, draw in drawn)
            samples = sum(_samples(surface, some[draw]) for surface, draw in drawn)
            return steps > budget.steps_left or samples > most_samples

        poses = max((plan.count for plan in plans.values()), default=0)
        if poses > LEAST_SAMPLES and is_too_much(None):
            counts = range(LEAST_SAMPLES, poses)
            fitting = bisect_left(counts, True, key=is_too_much)
            plans = {draw: _limited(plan, counts[max(fitting - 1, 0)]) for draw, plan in plans.items()}
            most = max(plan.count for plan in plans.values())
            message = (
                f"its lighting is measured in {most:,} of up to {poses:,} poses of each skin, which evenly "
                "spread clips share: all poses are too much work for a file of its size"
            )
            document.notices.tell(Notice("poses-left-out", message, document.place, poses - most))
            self.is_partial = True
        return drawn, plans

    def shown(self) -> list[Draw]:
        """Return what the nodes of the shown scene draw, at rest. Raises InputError for a broken skin."""
        document, clips = self.document, read_clips(self.document)
        what = f"showing {counted(len(clips), 'clip')}"
        document.budget.claim(Cost.SHOWN_CLIP * len(clips), what, document.place)
        shown, found = shown_skins(document), list[Draw]()
        for group in whole_surfaces(document, [view for view in self.views if view.source.mesh in shown]):
            meshes = dict.fromkeys(view.source.mesh for view in group)
            drawn: list[tuple[int, int | None, set[int]]] = []
            for skin, node in dict.fromkeys(
                key for mesh in meshes for key in draws_of(document, mesh, clips)
            ):
                # Skins may draw meshes crosswise: each mesh by one of them here, by the other in another
                # scene. Some exporters write a skin for each mesh: equal ones are one.
                own = {mesh for mesh in meshes if skin in shown[mesh]}
                kind = first_equal(document, skin)
                alike = (one for one in drawn if first_equal(document, one[0]) == kind and not one[2] & own)
                same = next(alike, None)
                if same is not None and node is None:
                    same[2].update(own)
                elif own:
                    drawn.append((skin, node, own))
            for skin, node, own in drawn:
                views = [view for view in group if view.source.mesh in own]
                found.append(Draw.at_rest(self._surface(views), skin, node))
        return found


def _limited(plan: PosePlan, most: int) -> PosePlan:
    return replace(plan, request=plan.request._replace(most=most))


def _morphed(surface: Surface, plan: PosePlan) -> Work:
    """Return the work of measuring a surface under morph targets, pose by pose."""
    if plan.resting is None or not plan.morphs:
        return Work()
    of_primitive = Cost.MEASURED_MORPH + Cost.MEASURED_TARGET * len(plan.resting)
    return of_primitive * (len(surface.views) * plan.count)


def _samples(surface: Surface, plan: PosePlan) -> int:
    """Return the vertices × poses of a draw. Clips of the file count, not the samples that users ask for."""
    asked = plan.request.samples
    return surface.vertices * (plan.count if asked is None else -(-plan.count // asked) * SHARED_SAMPLES)


def claim_draws(document: Document, draws: Sequence[Draw], clips: Sequence[Clip], poses: int) -> None:
    """Count the memory and the work of showing draws in so many poses. Raises BudgetError for too much."""
    for draw in draws:
        skeleton, primitives, vertices = draw.skeleton, len(draw.surface.views), draw.surface.vertices
        nodes, joints = len(skeleton.nodes), len(skeleton.joints)
        work = Cost.DRAWN_PRIMITIVE * primitives + Cost.SAMPLED_CLIP * len(clips)
        work += Work(steps=sum(len(clip.channels) for clip in clips) + poses * (nodes + joints))
        if draw.node is not None:
            targets = document.asset.meshes[draw.surface.views[0].source.mesh].target_count
            work += (Cost.DRAWN_MORPH + Cost.DRAWN_TARGET * targets) * (primitives * poses)
            work += Cost.READ_TARGET * (targets * primitives * len(clips))
        work += (Cost.NODE_MATRIX * nodes + Cost.JOINT_MATRIX * joints) * poses
        work += (Cost.DRAWN_VERTEX + Cost.POSED_VERTEX * poses) * vertices
        drawn = f"drawing {counted(vertices, 'vertex', 'vertices')} in {counted(poses, 'pose')}"
        document.budget.claim(work, drawn, document.place)


@dataclass(frozen=True, slots=True)
class Attachment:
    """A primitive that a node of the shown scene draws without a skin: a hat, a staff.

    matrices (P, 1, 4, 4) belong to its node in P poses, at rest until it is posed.
    """

    source: PrimitiveSource
    rest: RestPrimitive
    triangles: IntArray
    tangents: FloatArray | None
    skeleton: Skeleton
    matrices: Float64Array

    def at(self, document: Document, clip: Clip, times: Float64Array) -> Attachment:
        """Return it at times (P,) of a clip. It faces along +Z."""
        turn = HALF_TURN if faces_backward(document) else np.eye(4)
        return replace(self, matrices=turn @ clip_poses(self.skeleton, clip, times))

    def positions(self, pose: int) -> Float64Array:
        """Return its positions (V, 3) in a pose."""
        matrix = self.matrices[pose, 0]
        return np.asarray(self.rest.positions @ matrix[:3, :3].T + matrix[:3, 3])


def attachments(document: Document) -> list[Attachment]:
    """Return what nodes of the shown scene draw without a skin; tell what of it cannot be read."""
    sources: dict[int | None, list[PrimitiveSource]] = {}
    for source in plain_sources(document):
        sources.setdefault(source.mesh, []).append(source)
    budget = document.budget
    found: list[Attachment] = []
    read: dict[tuple[int, int], tuple[RestPrimitive, IntArray, FloatArray | None] | None] = {}
    lost: set[int] = set()
    for number in sorted(shown_nodes(document)):
        for source in sources.get(document.asset.nodes[number].mesh, ()):
            try:
                skeleton = read_node(document, number)
                work = Cost.DRAWN_PRIMITIVE + Cost.SHOWN_CLIP * len(skeleton.nodes)
                budget.claim(work, "drawing meshes without a skin", document.place)
                key = source.mesh, source.primitive
                if key not in read:
                    read[key] = _rigid(document, source)
                one = read[key]
                vertices = 0 if one is None else len(one[0].positions)
                again = Cost.DRAWN_AGAIN * vertices
                budget.claim(again, f"drawing {vertices:,} vertices once more", source.place)
            except BudgetError:
                raise
            except InputError:
                lost.add(source.mesh)
                continue
            if one is not None:
                found.append(Attachment(source, *one, skeleton, rest_pose(skeleton)))
    if lost:
        words = one_or_many(len(lost), "1 mesh without a skin", "{} meshes without a skin")
        message = f"{words} cannot be read: left out of the picture"
        document.notices.tell(Notice("not-skinned", message, document.place, len(lost)))
    return found


def _rigid(
    document: Document, source: PrimitiveSource
) -> tuple[RestPrimitive, IntArray, FloatArray | None] | None:
    """Return a primitive as one joint moves all of it, its triangles and TANGENT; None without a surface."""
    if not has_surface(document, source):
        return None
    mesh = read_primitive(document, source)
    count = len(mesh.positions)
    document.budget.claim(Cost.DRAWN_VERTEX * count, "a mesh without a skin", source.place)
    normals = mesh.normals
    if not len(normals):
        from skinbake.geometry.triangles import smooth_normals  # most meshes have normals

        normals = smooth_normals(mesh.positions, mesh.triangles, np.arange(count))
    normals = unit_normals(normals)
    rest = RestPrimitive(
        np.asarray(mesh.positions, np.float64),
        normals,
        *frame_from_normal(normals),
        joints=np.zeros((count, 4), np.int64),
        weights=np.eye(4)[np.zeros(count, np.int64)],
        alpha=np.zeros((count, 3)),
        beta=np.zeros((count, 3)),
    )
    return rest, mesh.triangles, mesh.tangents
