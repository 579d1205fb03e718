"""The bake of one surface: the primitives whose gradients are computed together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from skinbake.choices import SLOTS_PER_SET, Encoding, Frame, FrameChoice, Gradients
from skinbake.errors import InputError, Notice
from skinbake.format.baked import Baked
from skinbake.format.blend_weights import BlendGradient, read_blend_weights
from skinbake.format.encodings import vertex_bytes
from skinbake.format.metadata import KEPT, STORED_POSE, Digests, digests
from skinbake.geometry.rig import Rig
from skinbake.geometry.skinned import BakedPrimitive, SkinnedPrimitive
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject
from skinbake.gltf.primitives import PrimitiveSource, has_float_tangents, read_influences, read_primitive
from skinbake.gltf.rigs import fitting_rig
from skinbake.gradients import kernel
from skinbake.gradients.assumptions import assumptions, check_finite
from skinbake.gradients.baker import BakeFindings, BakeSettings, bake_primitives, slots_of_surface
from skinbake.gradients.kept import Slots, mixed, scaled
from skinbake.gradients.tangents import frame_vectors, with_straight_tangents
from skinbake.report.bake import BakedCounts, ExtensionCost, KeptCounts, LimitCost
from skinbake.timing import stage
from skinbake.version import FIT

if TYPE_CHECKING:
    from skinbake.format.influences import Extended, Limited
    from skinbake.measure.guard import KeptShare
    from skinbake.measure.unwritten import UnwrittenBake
    from skinbake.pose_fit.poses import FoundPoses, PoseSource

BYTES_A_VERTEX, BYTES_A_SLOT, BYTES_A_TRIANGLE = 128, 48, 24
"""The approximate memory of a bake, at most."""

BYTES_A_CORNER = 256
"""The approximate memory for the gradient of blend weights, at most."""


class FitTarget(NamedTuple):
    """The rig and the poses to which a surface is fitted, None for none, and notices about them.

    asked is the kind of gradients that the user asked for. pose_names are the sources of the poses, as the
    metadata names them.
    """

    asked: Gradients = Gradients.SURFACE
    rig: Rig | None = None
    poses: FoundPoses | None = None
    pose_names: Sequence[str] = ()
    notices: Sequence[Notice] = ()

    @classmethod
    def of(
        cls,
        document: Document,
        sources: Sequence[PrimitiveSource],
        kind: Gradients,
        fit_poses: Sequence[PoseSource],
    ) -> FitTarget:
        """Return what the primitives of a surface are fitted to for a kind of gradients."""
        if kind is Gradients.SURFACE:
            return cls()
        with document.notices.withheld() as told, stage("rig"):
            rig = fitting_rig(document, sources[0])
        notices = [*told]
        if kind is Gradients.RIG:
            return cls(kind, rig, notices=notices)
        from skinbake.pose_fit.poses import poses_to_fit  # it poses: half a second of imports

        with document.notices.withheld() as told, stage("poses"):
            found = poses_to_fit(document, sources[0].mesh, fit_poses, sources[0].place)
        names = [source if isinstance(source, str) else source.name for source in fit_poses]
        return cls(kind, rig, found, names, [*notices, *told])

    @property
    def noted(self) -> JsonObject:
        """Return what the metadata says of the fit."""
        noted: JsonObject = {}
        if self.rig is not None:
            noted = {"gradients": "rig", "fit": FIT, "rig": self.rig.digest}
            if self.rig.fingerprint is not None:
                noted[STORED_POSE] = {"fingerprint": list(self.rig.fingerprint)}
        if self.poses is not None:
            noted |= {
                "gradients": "poses",
                "fit": FIT,
                "poses": {"from": list(self.pose_names), "fingerprint": list(self.poses.fingerprint)},
            }
        return noted


class SurfaceBake(NamedTuple):
    """The primitives of one surface, with their arrays as they are baked, and the options of the gradients.

    digests return those of the arrays of each primitive. Each method returns the bakes of all primitives. It
    raises InputError if α or β are not finite.
    """

    document: Document
    sources: Sequence[PrimitiveSource]
    primitives: Sequence[SkinnedPrimitive]
    settings: BakeSettings
    target: FitTarget
    digests: Sequence[Digests]

    @classmethod
    def of(
        cls, document: Document, sources: Sequence[PrimitiveSource], settings: BakeSettings, target: FitTarget
    ) -> SurfaceBake:
        """Read the arrays of a surface. Raises InputError if they cannot be read, or take too much memory."""
        with stage("arrays"):
            primitives = _read(document, sources)
            if not all(len(primitive.normals) for primitive in primitives):
                from skinbake.gradients.normals import with_smooth_normals  # most files have normals

                primitives = with_smooth_normals(primitives)
            if settings.frame is not FrameChoice.NORMAL:
                # The tangents of few leaning vertices are straightened, if they are floats.
                primitives = [
                    with_straight_tangents(primitive) if has_float_tangents(document, source) else primitive
                    for source, primitive in zip(sources, primitives, strict=True)
                ]
        frame = Frame.NORMAL if settings.frame is FrameChoice.NORMAL else Frame.TANGENT
        found = [partial(digests, primitive, frame) for primitive in primitives]
        return cls(document, sources, primitives, settings, target, found)

    def plain(self) -> list[PrimitiveBake]:
        """Bake with the influences of the file."""
        return _finite(self._bakes(self.primitives))

    def limited(self, count: int) -> list[PrimitiveBake]:
        """Bake with at most ``count`` influences a vertex."""
        from skinbake.format.influences import limited  # few bakes ask for it

        pairs = list(zip(self.sources, self.primitives, strict=True))
        with stage("limit"):
            parts = [limited(self.document, *pair, count) for pair in pairs]
        bakes = _finite(self._bakes(self._changed(parts)))
        return [replace(bake, limited=part) for bake, part in zip(bakes, parts, strict=True)]

    def extended(self) -> list[PrimitiveBake]:
        """Bake with a further influence set where free slots are too few."""
        from skinbake.format.influences import extended  # few bakes ask for it

        tried = bake_primitives(self.primitives, self.settings)
        parts = [
            extended(
                one, read_influences(self.document, source, len(one.positions)), found.overflowing_vertices
            )
            if found.overflowing_vertices and not source.unread_sets  # a set more would close the gap
            else None
            for source, one, (_, found) in zip(self.sources, self.primitives, tried, strict=True)
        ]
        bakes = _finite(self._bakes(self._changed(parts)))
        return [replace(bake, extended=part) for bake, part in zip(bakes, parts, strict=True)]

    def _changed(self, parts: Sequence[Limited | None] | Sequence[Extended | None]) -> list[SkinnedPrimitive]:
        """Return the primitives with other influences, where a part has such."""
        return [part.primitive if part else one for part, one in zip(parts, self.primitives, strict=True)]

    def _bakes(self, primitives: Sequence[SkinnedPrimitive]) -> list[PrimitiveBake]:
        outcomes = bake_primitives(primitives, self.settings, self.target.rig)
        noted = self.target.noted
        bakes = [
            PrimitiveBake(source, primitive, *outcome, found, asked=self.target.asked, fitted=noted)
            for source, primitive, outcome, found in zip(
                self.sources, primitives, outcomes, self.digests, strict=True
            )
        ]
        return (
            bakes if self.target.poses is None else _fitted_to_poses(self.document, bakes, self.target.poses)
        )

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
            size = BYTES_A_CORNER * 3 * len(one.triangles)
            self.document.budget.claim(size, "the gradient of blend weights", bakes[0].source.place)
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

    digests returns those of the arrays before any limit or extension.
    asked is the kind of gradients that the user asked for. fitted is what the metadata says of the fit,
    nothing for the gradients of the surface. share is how much of it is kept, None for all. blend is the
    gradient of its blend weights, if it has any.
    """

    source: PrimitiveSource
    primitive: SkinnedPrimitive
    result: BakedPrimitive
    findings: BakeFindings
    digests: Digests
    limited: Limited | None = None
    asked: Gradients = Gradients.SURFACE
    fitted: JsonObject = field(default_factory=dict)
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
            fitted=bool(self.fitted),
        )

    def to_store(self, settings: JsonObject) -> Baked:
        """Return the data to write. settings is noted in the metadata."""
        changed = self.limited or self.extended
        influences = changed.stored if changed else None
        kept = {} if self.share is None else {KEPT: {"fit": self.share.fit}}
        noted = {**settings, **self.fitted, **kept}
        return Baked(self.source, self.primitive, self.result, self.digests, noted, influences, self.blend)

    def counts(self, encoding: Encoding, added_bytes: int) -> BakedCounts:
        """Return the numbers of the report."""
        influences, part = self.primitive.joints.shape[1], self.limited
        return BakedCounts(
            vertices=len(self.primitive.positions),
            triangles=len(self.primitive.triangles),
            degenerate_triangles=self.findings.degenerate_triangles,
            influences=influences,
            gradients=self.fitted.get("gradients", str(Gradients.SURFACE)),
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
            extended=None if self.extended is None else _extension_cost(self.extended, self.result, encoding),
        )


def _fitted_to_poses(
    document: Document, bakes: Sequence[PrimitiveBake], found: FoundPoses
) -> list[PrimitiveBake]:
    """Return the bakes of one surface with α and β fitted to poses."""
    from skinbake.pose_fit.fit import fit_size, fitted_to_poses
    from skinbake.truth.operator import true_operator

    for bake in bakes:
        document.budget.claim(fit_size(*bake.primitive.joints.shape), "fitting it", bake.source.place)
    operator = true_operator(
        [bake.primitive for bake in bakes],
        claim=lambda size: document.budget.claim_welding(size, bakes[0].source.place),
    )
    surfaces = [bake.rest_primitive() for bake in unwritten(bakes)]
    with stage("fit"):
        slots = fitted_to_poses(operator, surfaces, found.groups)
    return [
        replace(bake, result=bake.result.with_slots(alpha, beta))
        for bake, (alpha, beta) in zip(bakes, slots, strict=True)
    ]


def _extension_cost(part: Extended, result: BakedPrimitive, encoding: Encoding) -> ExtensionCost:
    """Return the price of an influence set more, of the types that it has with its adopted joints."""
    from skinbake.format.influences import with_adopted
    from skinbake.skinning.algorithms import Algorithm
    from skinbake.skinning.counting import multiply_adds

    after = part.primitive.joints.shape[1]
    before, added = after - SLOTS_PER_SET, with_adopted(part.stored, result.adopting, result.adopted)[-1]
    stored = SLOTS_PER_SET * (added.joints.values.itemsize + added.weights.values.itemsize)
    work = [sum(multiply_adds(Algorithm.LBS_ACCURATE, count).values()) for count in (before, after)]
    return ExtensionCost(
        influences=after,
        vertices=part.vertices,
        bytes=stored + vertex_bytes(encoding, after) - vertex_bytes(encoding, before),
        multiply_adds=work[1] - work[0],
    )


def _finite(bakes: list[PrimitiveBake]) -> list[PrimitiveBake]:
    """Return the bakes. Raises InputError if α or β of one are not finite."""
    for bake in bakes:
        check_finite(bake.primitive, bake.result, bake.source.place)
    return bakes


def unwritten(bakes: Sequence[PrimitiveBake]) -> list[UnwrittenBake]:
    """Return the bakes as a replay reads them, before anything is written."""
    from skinbake.measure.unwritten import UnwrittenBake

    return [UnwrittenBake(bake.source, bake.primitive, bake.result) for bake in bakes]


def _read(document: Document, sources: Sequence[PrimitiveSource]) -> list[SkinnedPrimitive]:
    """Return the arrays of primitives. First check for each that its bake does not take too much memory."""
    found: list[SkinnedPrimitive] = []
    vertices, widest = 0, 0
    for source in sources:
        primitive = read_primitive(document, source)
        found.append(primitive)
        # All parts of one surface have as many slots as its widest primitive.
        count, width = primitive.joints.shape
        slots = max(width, widest) * (vertices + count) - widest * vertices
        vertices, widest = vertices + count, max(width, widest)
        size = BYTES_A_VERTEX * count + BYTES_A_SLOT * slots + BYTES_A_TRIANGLE * len(primitive.triangles)
        document.budget.claim(size, "baking it", source.place)
    return found
