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
from skinbake.errors import InputError, Notice, skipped
from skinbake.format.baked import Baked
from skinbake.format.digests import Digests, digests
from skinbake.format.encodings import vertex_bytes
from skinbake.format.note import FitPoses, GradientNote
from skinbake.format.stored_slots import BlendGradient, read_blend_weights
from skinbake.geometry.rig import Rig
from skinbake.geometry.skinned import BakedPrimitive, SkinnedPrimitive
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.budget import Cost
from skinbake.gltf.document import Document
from skinbake.gltf.reading.meshes import has_float_tangents, read_influences, read_primitive
from skinbake.gradients import kernel
from skinbake.gradients.assumptions import assumptions, check_finite
from skinbake.gradients.baker import EIGHTHS, BakeFindings, bake_primitives, kept_slots
from skinbake.gradients.tangents import frame_vectors, with_straight_tangents
from skinbake.report.bake import BakedCounts, ExtensionCost, LimitCost
from skinbake.threads import Threads, thread_count
from skinbake.timing import stage
from skinbake.version import FIT

if TYPE_CHECKING:
    from skinbake.format.influences import Changed

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
    made = [surface.baked() for surface in surfaces]
    if any(surface.rig for surface in surfaces):
        # A primitive that would be lit worse keeps only a part of its α and β.
        with stage("guard"):
            from skinbake.measure.guard import UNBAKED, kept_eighths  # it poses: other kinds of bakes do not

            kept = kept_eighths(document, [[bake.to_store for bake in own] for own in made])
        left = [
            bake.source.place
            for bakes, own in zip(made, kept, strict=True)
            for bake, part in zip(bakes, own, strict=True)
            if part == UNBAKED
        ]
        if left:
            words = "in its clips, every part of α/β lights it worse than standard lighting"
            document.notices.tell(*(skipped("standard-is-better", place, words) for place in left))
            return bake_surfaces(document, [one for one in sources if one.place not in left], options)
        made = [_keeping(bakes, own) for bakes, own in zip(made, kept, strict=True)]
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

    digests return the digests of each primitive's arrays. ``rig`` is None if there is no such fit, and
    ``note`` says that, with the options. Each method returns the bakes of all primitives.
    """

    document: Document
    sources: Sequence[PrimitiveSource]
    primitives: Sequence[SkinnedPrimitive]
    options: BakeOptions
    digests: Sequence[Digests]
    rig: Rig | None
    note: GradientNote

    @classmethod
    def of(cls, document: Document, sources: Sequence[PrimitiveSource], options: BakeOptions) -> SurfaceBake:
        """Read a surface. Raises InputError if it cannot be read, or takes too much memory."""
        # The rig and the poses that α and β are fitted to.
        rig, note = None, options.note
        if options.gradients is Gradients.FITTED:
            from skinbake.truth.fit_poses import ANIMATIONS, posed_rig  # it poses: other kinds do not

            with stage("poses"):
                rig = posed_rig(document, sources[0], options.fit_poses)
            if rig is not None:
                given = options.fit_poses or (ANIMATIONS,)
                names = tuple(source if isinstance(source, str) else source.name for source in given)
                poses = FitPoses(sources=names, fingerprint=rig.fingerprint)
                note = note._replace(gradients=Gradients.FITTED, fit=FIT, rig=rig.digest, poses=poses)
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
        return cls(document, sources, primitives, options, of_arrays, rig, note)

    def baked(self) -> list[PrimitiveBake]:
        """Bake with the influences of the file, with fewer, or with a set more where free slots are few."""
        limit = self.options.limit_influences
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
            if self.options.neighbours is Neighbours.EXTEND:
                from skinbake.format.influences import extended  # few bakes ask for it

                tried = bake_primitives(self.primitives, self.options.settings)
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
        outcomes = bake_primitives(primitives, self.options.settings, self.rig)
        bakes = [
            PrimitiveBake(source, primitive, *outcome, found, self.note, asked=self.options.gradients)
            for source, primitive, outcome, found in zip(
                self.sources, primitives, outcomes, self.digests, strict=True
            )
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
                weighting=self.options.weighting,
            ).astype(np.float32)
        return [
            replace(bake, blend=BlendGradient(attribute, own))
            for bake, own in zip(bakes, np.split(derivatives, ends[:-1]), strict=True)
        ]


def _keeping(bakes: Sequence[PrimitiveBake], eighths: Sequence[int]) -> list[PrimitiveBake]:
    """Return the bakes of a surface, each with some eighths of its α and β."""
    if min(eighths) == EIGHTHS:
        return list(bakes)
    slots = [(bake.result.alpha, bake.result.beta) for bake in bakes]
    kept = kept_slots(slots, [bake.result.classes for bake in bakes], eighths)
    return [
        replace(bake, result=bake.result.with_slots(*own), eighths=one)
        for bake, own, one in zip(bakes, kept, eighths, strict=True)
    ]


@dataclass(frozen=True, slots=True)
class PrimitiveBake:
    """One primitive: the arrays that were baked, the result, the findings, and the loss by a limit.

    digests returns the digests of the arrays before any limit or extension. note says what α and β are made
    by, and asked which kind of gradients the user asked for. eighths of α and β are kept. blend is the
    gradient of its blend weights, if it has any.
    """

    source: PrimitiveSource
    primitive: SkinnedPrimitive
    result: BakedPrimitive
    findings: BakeFindings
    digests: Digests
    note: GradientNote
    limited: Changed | None = None
    asked: Gradients = Gradients.SURFACE
    extended: Changed | None = None
    eighths: int = EIGHTHS
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
        note = self.note._replace(kept=None if self.eighths == EIGHTHS else self.eighths / EIGHTHS)
        return Baked(self.source, self.primitive, self.result, self.digests, note, influences, self.blend)

    def counts(self, encoding: Encoding, added_bytes: int) -> BakedCounts:
        """Return the numbers of the report."""
        influences, part, extended = self.primitive.joints.shape[1], self.limited, None
        if self.extended is not None:
            # The price of an influence set more, of the types that it has with its adopted joints.
            from skinbake.format.influences import with_adopted
            from skinbake.skinning.counting import multiply_adds
            from skinbake.skinning.rest import Algorithm

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
            kept=None if self.eighths == EIGHTHS else self.eighths / EIGHTHS,
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


def _changed(
    primitives: Sequence[SkinnedPrimitive], parts: Sequence[Changed | None]
) -> list[SkinnedPrimitive]:
    """Return the primitives with other influences, where a part has such."""
    return [part.primitive if part else one for part, one in zip(parts, primitives, strict=True)]
