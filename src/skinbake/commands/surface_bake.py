"""α and β of surfaces: primitives whose gradients are computed together."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from skinbake.choices import SLOTS_PER_SET, Encoding, Frame, FrameChoice, Gradients, Neighbours, Weld
from skinbake.commands.bake_options import BakeOptions
from skinbake.errors import InputError, Notice
from skinbake.format.baked import Baked
from skinbake.format.digests import Digests, digests
from skinbake.format.encodings import vertex_bytes
from skinbake.format.note import FitPoses, GradientNote, Kept
from skinbake.format.stored_slots import BlendGradient, read_blend_weights
from skinbake.geometry.rig import Rig
from skinbake.geometry.skinned import BakedPrimitive, SkinnedPrimitive
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.budget import Cost
from skinbake.gltf.document import Document
from skinbake.gltf.reading.meshes import has_float_tangents, read_influences, read_primitive
from skinbake.gltf.reading.skins import fitting_rig
from skinbake.gradients import kernel
from skinbake.gradients.assumptions import assumptions, check_finite
from skinbake.gradients.baker import BakeFindings, BakeSettings, bake_primitives, slots_of_surface
from skinbake.gradients.kept import Slots, mixed, scaled
from skinbake.gradients.tangents import frame_vectors, with_straight_tangents
from skinbake.report.bake import BakedCounts, ExtensionCost, KeptCounts, LimitCost
from skinbake.threads import Threads, thread_count
from skinbake.timing import stage
from skinbake.version import FIT

if TYPE_CHECKING:
    from skinbake.format.influences import Extended, Limited
    from skinbake.measure.guard import KeptShare
    from skinbake.measure.unwritten import UnwrittenBake
    from skinbake.pose_fit.poses import FoundPoses

LARGE = 1 << 17
"""The vertices of a surface from which on the digests of its arrays are made beside the bake."""


def bake_surfaces(
    document: Document, sources: Sequence[PrimitiveSource], options: BakeOptions
) -> list[list[PrimitiveBake]]:
    """Bake primitives, surface by surface. Notices tell which stay apart or unfitted.

    All that is fitted to is read before the first surface is baked. Raises InputError if arrays cannot be
    read, take too much memory, or lead to α or β that are not finite.
    """
    by_mesh: dict[int, list[PrimitiveSource]] = defaultdict(list)
    for source in sources:
        by_mesh[source.mesh].append(source)
    groups: Sequence[Sequence[int]] = [[mesh] for mesh in by_mesh]
    if options.weld is Weld.SKIN:
        from skinbake.gltf.reading.scenes import meshes_of_one_skin, tell_meshes_apart

        groups = meshes_of_one_skin(document, by_mesh)
        tell_meshes_apart(document, by_mesh)
    surfaces = [
        SurfaceBake.of(document, [source for mesh in group for source in by_mesh[mesh]], options)
        for group in groups
    ]
    made = [surface.baked(options) for surface in surfaces]
    if options.gradients is Gradients.RIG:
        # A surface that would be lit worse keeps only a share of its fit.
        with stage("guard"):
            from skinbake.measure.guard import Judged, judged_shares  # it poses: most kinds of bakes do not

            judged = [Judged(unwritten(own), one.rig) for one, own in zip(surfaces, made, strict=True)]
            shares = judged_shares(document, judged, options.settings)
            kept = zip(surfaces, made, shares, strict=True)
            made = [surface.keeping(bakes, own) for surface, bakes, own in kept]
    if options.blend is not None and made:
        made = [one.with_blend(own, options.blend) for one, own in zip(surfaces, made, strict=True)]
        without = [bake for bakes in made for bake in bakes if bake.blend is None]
        if len(without) == len(sources):
            message = f"--blend {options.blend}: nothing that is baked has this attribute"
            raise InputError(message, document.place)
        message = f"it has no attribute {options.blend}, and is left to linear blend skinning"
        document.notices.tell(*(Notice("no-blend", message, bake.source.place) for bake in without))
    return made


class SurfaceBake(NamedTuple):
    """The primitives of one surface, with their arrays as they are baked, and what α and β are fitted to.

    digests return the digests of each primitive's arrays. ``rig`` and ``poses`` are None if there is no such
    fit, and ``note`` says that, with the options. Each method returns the bakes of all primitives.
    """

    document: Document
    sources: Sequence[PrimitiveSource]
    primitives: Sequence[SkinnedPrimitive]
    settings: BakeSettings
    digests: Sequence[Digests]
    asked: Gradients
    rig: Rig | None
    poses: FoundPoses | None
    note: GradientNote

    @classmethod
    def of(cls, document: Document, sources: Sequence[PrimitiveSource], options: BakeOptions) -> SurfaceBake:
        """Read a surface. Raises InputError if it cannot be read, or takes too much memory."""
        # The rig and the poses that α and β are fitted to.
        rig, poses, note = None, None, options.note
        if options.gradients is not Gradients.SURFACE:
            with stage("rig"):
                rig = fitting_rig(document, sources[0])
            if rig is not None:
                note = replace(note, gradients=Gradients.RIG, fit=FIT, rig=rig.digest)
                if rig.fingerprint is not None:
                    note = replace(note, stored_pose=FitPoses(fingerprint=tuple(rig.fingerprint)))
        if options.gradients is Gradients.POSES:
            from skinbake.pose_fit.poses import poses_to_fit  # it poses: half a second of imports

            with stage("poses"):
                poses = poses_to_fit(document, sources[0].mesh, options.fit_poses, sources[0].place)
            names = (source if isinstance(source, str) else source.name for source in options.fit_poses)
            found = FitPoses(sources=tuple(names), fingerprint=tuple(poses.fingerprint))
            note = replace(note, gradients=Gradients.POSES, fit=FIT, poses=found)
        # The arrays. Each is read when the memory for the bake of those before has been claimed.
        primitives: list[SkinnedPrimitive] = []
        with stage("arrays"):
            vertices, widest = 0, 0
            for source in sources:
                primitive = read_primitive(document, source)
                primitives.append(primitive)
                # All parts of one surface have as many slots as its widest primitive.
                count, width = primitive.joints.shape
                slots = max(width, widest) * (vertices + count) - widest * vertices
                vertices, widest = vertices + count, max(width, widest)
                work = Cost.BAKED_VERTEX * count + Cost.BAKED_SLOT * slots
                work += Cost.BAKED_TRIANGLE * len(primitive.triangles)
                document.budget.claim(work, "baking it", source.place)
            if not all(len(primitive.normals) for primitive in primitives):
                from skinbake.gradients.normals import with_smooth_normals  # most files have normals

                primitives = with_smooth_normals(primitives)
            if options.frame is not FrameChoice.NORMAL:
                # The tangents of few leaning vertices are straightened, if they are floats.
                primitives = [
                    with_straight_tangents(primitive) if has_float_tangents(document, source) else primitive
                    for source, primitive in zip(sources, primitives, strict=True)
                ]
        frame = Frame.NORMAL if options.frame is FrameChoice.NORMAL else Frame.TANGENT
        of_arrays = [partial(digests, primitive, frame) for primitive in primitives]
        return cls(
            document,
            sources,
            primitives,
            options.settings,
            of_arrays,
            options.gradients,
            rig,
            poses,
            note,
        )

    def baked(self, options: BakeOptions) -> list[PrimitiveBake]:
        """Bake with the influences of the file, with fewer, or with a set more where free slots are few."""
        limit = options.limit_influences
        # Welding and grouping leave a core idle.
        is_large = sum(len(one.positions) for one in self.primitives) >= LARGE
        with Threads(thread_count() if is_large else 1) as threads:
            begun = self._replace(digests=[threads.begun(digests) for digests in self.digests])
            if limit is not None:
                from skinbake.format.influences import limited  # few bakes ask for it

                pairs = zip(self.sources, self.primitives, strict=True)
                with stage("limit"):
                    fewer = [limited(self.document, *pair, limit) for pair in pairs]
                bakes = begun.plain(_changed(self.primitives, fewer))
                return [replace(bake, limited=part) for bake, part in zip(bakes, fewer, strict=True)]
            if options.neighbours is Neighbours.EXTEND:
                from skinbake.format.influences import extended  # few bakes ask for it

                tried = bake_primitives(self.primitives, self.settings)
                more = [
                    extended(one, read_influences(self.document, source, len(one.positions)), lacking)
                    # A set more would close the gap before sets that are not read.
                    if (lacking := found.overflowing_vertices) and not source.unread_sets
                    else None
                    for source, one, (_, found) in zip(self.sources, self.primitives, tried, strict=True)
                ]
                bakes = begun.plain(_changed(self.primitives, more))
                return [replace(bake, extended=part) for bake, part in zip(bakes, more, strict=True)]
            return begun.plain(self.primitives)

    def plain(self, primitives: Sequence[SkinnedPrimitive]) -> list[PrimitiveBake]:
        """Bake its primitives with these influences. Raises InputError if α or β are not finite."""
        outcomes = bake_primitives(primitives, self.settings, self.rig)
        bakes = [
            PrimitiveBake(source, primitive, *outcome, found, self.note, asked=self.asked)
            for source, primitive, outcome, found in zip(
                self.sources, primitives, outcomes, self.digests, strict=True
            )
        ]
        if self.poses is not None:
            from skinbake.pose_fit.fit import fit_work, fitted_to_poses
            from skinbake.truth.operator import true_operator

            for bake in bakes:
                work = fit_work(*bake.primitive.joints.shape)
                self.document.budget.claim(work, "fitting it", bake.source.place)
            welding = self.document.budget.welding(bakes[0].source.place)
            operator = true_operator(primitives, claim=welding)
            rest = [bake.rest_primitive() for bake in unwritten(bakes)]
            with stage("fit"):
                slots = fitted_to_poses(operator, rest, self.poses.groups)
            bakes = [
                replace(bake, result=bake.result.with_slots(alpha, beta))
                for bake, (alpha, beta) in zip(bakes, slots, strict=True)
            ]
        for bake in bakes:
            check_finite(bake.primitive, bake.result, bake.source.place)
        return bakes

    def with_blend(self, bakes: Sequence[PrimitiveBake], attribute: str) -> list[PrimitiveBake]:
        """Return the bakes with the gradient of the blend weights that an attribute holds.

        The gradient is that of the surface, taken as those of the skin weights are. Raises InputError if some
        primitives of the surface have the attribute and some have not.
        """
        primitives = [bake.primitive for bake in bakes]
        weights = [
            read_blend_weights(self.document, bake.source, attribute, len(bake.primitive.positions))
            for bake in bakes
        ]
        found = [one for one in weights if one is not None]
        if not found:
            return list(bakes)
        if len(found) < len(bakes):
            lacking = next(bake for bake, one in zip(bakes, weights, strict=True) if one is None)
            message = (
                f"it has no attribute {attribute}, and other primitives of the same surface have it: give it "
                "to all of them, as 0 where they are skinned by linear blending"
            )
            raise InputError(message, lacking.source.place)
        from skinbake.gradients.weight_gradients import field_derivatives  # few bakes ask for it

        for one in primitives:
            work = Cost.BLENDED_CORNER * 3 * len(one.triangles)
            self.document.budget.claim(work, "the gradient of blend weights", bakes[0].source.place)
        with stage("gradients"):
            ends = np.cumsum([len(one.positions) for one in primitives])
            triangles = [
                one.triangles[kernel.mark_proper(one.positions, one.triangles)].astype(np.int64) + start
                for one, start in zip(primitives, [0, *ends[:-1]], strict=True)
            ]
            frames = [frame_vectors(bake.primitive, bake.result.frame) for bake in bakes]
            derivatives = field_derivatives(
                np.concatenate([one.positions for one in primitives]),
                np.concatenate(triangles),
                np.concatenate(found),
                np.concatenate([bake.result.classes for bake in bakes]),
                (np.concatenate([t for t, _ in frames]), np.concatenate([b for _, b in frames])),
                weighting=self.settings.weighting,
            ).astype(np.float32)
        return [
            replace(bake, blend=BlendGradient(attribute, own))
            for bake, own in zip(bakes, np.split(derivatives, ends[:-1]), strict=True)
        ]

    def keeping(
        self, bakes: Sequence[PrimitiveBake], shares: Sequence[KeptShare | None]
    ) -> list[PrimitiveBake]:
        """Return the bakes of the surface, of which some keep only a share. None keeps all."""
        if not any(shares):
            return list(bakes)
        slots: list[Slots] = [(bake.result.alpha, bake.result.beta) for bake in bakes]
        classes = [bake.result.classes for bake in bakes]
        fits = [1.0 if share is None else share.fit for share in shares]
        if min(fits) < 1.0:
            slots = mixed(slots, self._by_surface(bakes), classes, fits)
        kept = scaled(slots, classes, [None if share is None else share.eighths for share in shares])
        return [
            replace(bake, result=bake.result.with_slots(*own), share=share)
            for bake, own, share in zip(bakes, kept, shares, strict=True)
        ]

    def _by_surface(self, bakes: Sequence[PrimitiveBake]) -> list[Slots]:
        """Return the gradients of the surface in the slots of bakes that are fitted.

        The gradients alone would adopt other joints at some vertices, or the same ones in another order.
        """
        found = bake_primitives([bake.primitive for bake in bakes], self.settings)
        adopted = [bake.result.adopted_joints for bake in bakes]
        others = [
            (own != result.adopted_joints).any(axis=1)
            for own, (result, _) in zip(adopted, found, strict=True)
        ]
        slots: list[Slots] = [(result.alpha, result.beta) for result, _ in found]
        if not any(map(np.any, others)):
            return slots
        frames = [frame_vectors(bake.primitive, bake.result.frame) for bake in bakes]
        there = slots_of_surface(
            [
                bake.primitive.with_influences(
                    np.where(own < 0, bake.primitive.joints, own), bake.primitive.weights
                )
                for bake, own in zip(bakes, adopted, strict=True)
            ],
            (np.concatenate([t for t, _ in frames]), np.concatenate([b for _, b in frames])),
            weighting=self.settings.weighting,
            crease_angle=self.settings.crease_angle,
            rig=None,
        )
        return [
            (np.where(rows[:, None], own[0], one[0]), np.where(rows[:, None], own[1], one[1]))
            for rows, own, one in zip(others, there, slots, strict=True)
        ]


@dataclass(frozen=True, slots=True)
class PrimitiveBake:
    """One primitive: the arrays that were baked, the result, the findings, and the loss by a limit.

    digests returns the digests of the arrays before any limit or extension. note says what α and β are made
    by, and asked which kind of gradients the user asked for. share is how much of a fit is kept, None for
    all. blend is the gradient of its blend weights, if it has any.
    """

    source: PrimitiveSource
    primitive: SkinnedPrimitive
    result: BakedPrimitive
    findings: BakeFindings
    digests: Digests
    note: GradientNote
    limited: Limited | None = None
    asked: Gradients = Gradients.SURFACE
    extended: Extended | None = None
    share: KeptShare | None = None
    blend: BlendGradient | None = None

    @property
    def notices(self) -> list[Notice]:
        """Return the assumptions made."""
        source = self.source
        return assumptions(
            self.primitive,
            self.result,
            self.findings,
            source.joint_count,
            source.place,
            asked=self.asked,
            fitted=self.note.gradients != Gradients.SURFACE,
        )

    @property
    def to_store(self) -> Baked:
        """The data to write."""
        changed = self.limited or self.extended
        influences = changed.stored if changed else None
        note = replace(self.note, kept=None if self.share is None else Kept(fit=self.share.fit))
        return Baked(self.source, self.primitive, self.result, self.digests, note, influences, self.blend)

    def counts(self, encoding: Encoding, added_bytes: int) -> BakedCounts:
        """Return the numbers of the report."""
        influences, part, extended = self.primitive.joints.shape[1], self.limited, None
        if self.extended is not None:
            # The price of an influence set more, of the types that it has with its adopted joints.
            from skinbake.format.influences import with_adopted
            from skinbake.skinning.algorithms import Algorithm
            from skinbake.skinning.counting import multiply_adds

            before = influences - SLOTS_PER_SET
            added = with_adopted(self.extended.stored, self.result.adopting, self.result.adopted)[-1]
            stored = SLOTS_PER_SET * (added.joints.values.itemsize + added.weights.values.itemsize)
            work = [sum(multiply_adds(Algorithm.LBS_ACCURATE, one).values()) for one in (before, influences)]
            extended = ExtensionCost(
                influences=influences,
                vertices=self.extended.vertices,
                bytes=stored + vertex_bytes(encoding, influences) - vertex_bytes(encoding, before),
                multiply_adds=work[1] - work[0],
            )
        return BakedCounts(
            vertices=len(self.primitive.positions),
            triangles=len(self.primitive.triangles),
            degenerate_triangles=self.findings.degenerate_triangles,
            influences=influences,
            gradients=str(self.note.gradients),
            kept=None if self.share is None else KeptCounts(self.share.fit, self.share.mean),
            frame=str(self.result.frame),
            generated_normals="NORMAL" not in self.source.attributes,
            adopting_vertices=self.findings.adopting_vertices,
            overflowing_vertices=self.findings.overflowing_vertices,
            gradient=self.findings.magnitude,
            lost_gradient=self.findings.lost,
            added_bytes=added_bytes,
            bytes_per_vertex=vertex_bytes(encoding, influences) + (8 if self.blend else 0),
            limited=None if part is None else LimitCost(influences, part.vertices, part.left_out),
            extended=extended,
        )


def unwritten(bakes: Sequence[PrimitiveBake]) -> list[UnwrittenBake]:
    """Return the bakes as a replay reads them, before anything is written."""
    from skinbake.measure.unwritten import UnwrittenBake

    return [UnwrittenBake(bake.source, bake.primitive, bake.result) for bake in bakes]


def _changed(
    primitives: Sequence[SkinnedPrimitive], parts: Sequence[Limited | None] | Sequence[Extended | None]
) -> list[SkinnedPrimitive]:
    """Return the primitives with other influences, where a part has such."""
    return [part.primitive if part else one for part, one in zip(parts, primitives, strict=True)]
