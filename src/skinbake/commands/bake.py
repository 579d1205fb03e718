"""``skinbake bake``: read a document, bake every skinned primitive, write it."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from skinbake.choices import (
    BAKE_RANGES,
    SLOTS_PER_SET,
    Encoding,
    FrameChoice,
    Gradients,
    Layout,
    Neighbours,
    Scheme,
    Weighting,
    Weld,
    check_range,
    member_of,
    option_of,
)
from skinbake.containment import OWN_FOLDERS, Within
from skinbake.errors import ChoiceError, InputError, Notice, Place, noticed
from skinbake.format.attribute_store import level_ignored, stored_otherwise
from skinbake.format.baked import AttributeNames, Baked, with_baked, with_scale
from skinbake.format.encodings import vertex_bytes
from skinbake.format.growth import draco_growth
from skinbake.format.layouts import GradientFormat
from skinbake.format.strip import stripped
from skinbake.geometry.rig import Rig
from skinbake.geometry.skinned import BakedPrimitive, SkinnedPrimitive
from skinbake.gltf.beside import files_read
from skinbake.gltf.codecs import draco
from skinbake.gltf.container import for_target
from skinbake.gltf.digests import digests_of
from skinbake.gltf.document import STDIO, Document, read_document
from skinbake.gltf.json_access import JsonObject
from skinbake.gltf.output import AS_USUAL, Writing, plan_output, refuse_own_input
from skinbake.gltf.primitives import (
    PrimitiveSource,
    has_float_tangents,
    read_influences,
    read_primitive,
    reason_to_skip,
    skinned_sources,
    why_nothing,
)
from skinbake.gltf.rigs import fitting_rig, rig_digest
from skinbake.gltf.writing import version_of
from skinbake.gradients.assumptions import assumptions, check_finite
from skinbake.gradients.baker import BakeFindings, BakeSettings, bake_mesh
from skinbake.gradients.normal_lean import lean_notices
from skinbake.gradients.normals import with_smooth_normals
from skinbake.gradients.tangents import with_straight_tangents
from skinbake.report.bake import BakedCounts, EncodingCost, ExtensionCost, FileResult, LimitCost
from skinbake.timing import stage
from skinbake.version import FIT

if TYPE_CHECKING:
    from skinbake.format.extension import Extended
    from skinbake.lighting.limit_cost import Limited
    from skinbake.lighting.poses_to_fit import FoundPoses, PoseSource
    from skinbake.lighting.unwritten import UnwrittenBake

BYTES_A_VERTEX, BYTES_A_SLOT, BYTES_A_TRIANGLE = 128, 48, 24
"""The approximate memory of a bake, at most."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Baker:
    """Bake files and documents. The fields are the options of ``skinbake bake``, under the same names.

    crease_angle is in degrees. Enumerations may be given by their values. fit_poses are ``animations``,
    ``random:N`` and files, which are read at once. Raises ChoiceError for a value that does not exist and for
    options that contradict each other, and InputError for a file that cannot be read.
    """

    gradients: Gradients = Gradients.RIG
    fit_poses: tuple[PoseSource, ...] = ()
    weighting: Weighting = Weighting.MAX
    crease_angle: float = 15.0
    weld: Weld = Weld.MESH
    neighbours: Neighbours = Neighbours.ADOPT
    frame: FrameChoice = FrameChoice.AUTO
    limit_influences: int | None = None
    generate_normals: bool = False
    alpha_name: str | None = None
    beta_name: str | None = None
    compress: Scheme = Scheme.KEEP
    compress_level: int | None = None
    position_bits: int | None = None
    normal_bits: int | None = None
    texcoord_bits: int | None = None
    encoding: Encoding = Encoding.FLOAT32
    layout: Layout = Layout.ATTRIBUTES
    require_baked: bool = False
    warnings_as_errors: bool = False

    def __post_init__(self) -> None:
        for name, kind in ENUMERATIONS.items():
            object.__setattr__(self, name, member_of(kind, getattr(self, name), name))
        object.__setattr__(self, "fit_poses", _pose_sources(self))
        _check_ranges(self)
        _check_names(self)
        _check_compression(self)

    def with_gradients(self, kind: Gradients) -> Baker:
        """Return a baker of another kind of gradients. Only gradients fitted to poses have poses."""
        return replace(self, gradients=kind, fit_poses=self.fit_poses if kind is Gradients.POSES else ())

    def bake_file(
        self, source: str, target: str | None, writing: Writing = AS_USUAL, within: Within = OWN_FOLDERS
    ) -> FileResult:
        """Bake one file and write it to ``target``. With None, or on a dry run, nothing is written.

        Raises SkinbakeError, and then nothing has been written. Its notices are the ones found before the
        error.
        """
        replaced = version_of(source) if target == source != STDIO else None
        with stage("read"):
            document = read_document(source, within.bounds)
        if target is not None:
            refuse_own_input(document, source, target)
        made, result, notices = self._rebaked(document, target, pack=writing.pack)
        untouched = result is document and target == source and source != STDIO
        planned = None
        if target is not None and not untouched:
            with noticed(notices), stage("write"):
                planned = plan_output(result, target, root=within.output)
            notices = [*notices, *planned.notices]
        with noticed(notices):
            if self.warnings_as_errors and notices:
                raise InputError("not written: there are warnings (--warnings-as-errors)", document.place)
            if planned is not None and not writing.dry_run:
                with stage("write"):
                    planned = replace(planned, replaces=replaced).write(sync=writing.sync)
        return FileResult(
            source,
            target,
            "baked" if made.primitives else "unchanged",
            made.primitives,
            made.skipped,
            tuple(notices),
            encoding=made.encoding,
            written=digests_of(planned.files) if writing.traced and planned else {},
            read=files_read(document, target, pack=writing.pack) if writing.lists_read else (),
        )

    def _rebaked(
        self, document: Document, target: str | None, *, pack: bool
    ) -> tuple[BakedDocument, Document, list[Notice]]:
        """Bake a document that may hold an earlier bake, for the container of the target.

        Returns the bake, the document to write, and notices. If no primitive can be baked, the document is
        written as it came, with any earlier bake.
        """
        with stage("strip"):
            original, _, undone = stripped(document)
            prepared, moved = (original, []) if target is None else for_target(original, target, pack=pack)
        made = self.bake_document(prepared)
        if made.primitives:
            return made, made.document, [*undone, *moved, *made.notices]
        reason = "none of its skinned primitives can be baked" if made.skipped else why_nothing(document)
        if self.require_baked:
            raise InputError(f"{reason} (--require-baked)", document.place)
        result, moved = (document, []) if target is None else for_target(document, target, pack=pack)
        last = Notice("nothing-baked", f"passed through unchanged: {reason}", document.place)
        return made, result, [*moved, *made.notices, last]

    def bake_document(self, document: Document) -> BakedDocument:
        """Bake every skinned primitive of a document that holds no earlier bake (``stripped``).

        Raises InputError.
        """
        sources, skipped, reasons = self._bakeable(document)
        if not sources:
            return BakedDocument(document, (), skipped, tuple(reasons))
        given = document
        with stage("compress"):
            document, kept = self._recoded(document, sources)
        sources = [source.in_document(document) for source in sources]
        surfaces, apart = _surfaces(document, sources, self.weld)
        aims = [self._aim(document, surface) for surface in surfaces]
        bakes = [
            bake
            for surface, aim in zip(surfaces, aims, strict=True)
            for bake in self._baked_surface(document, surface, aim)
        ]
        storage = with_scale(GradientFormat(self.encoding, self.layout), [bake.result for bake in bakes])
        with stage("store"):
            to_store = [bake.to_store(self._noted_settings) for bake in bakes]
            names, level = self.attribute_names, self.compress_level
            written, lengths = with_baked(document, to_store, names, storage, level=level)
        with stage("encoding"):
            cost, unmeasured = _encoding_cost(document, bakes, storage)
        unfitted = [notice for aim in aims for notice in aim.notices]
        notices = [*kept, *reasons, *apart, *unfitted, *(notice for bake in bakes for notice in bake.notices)]
        notices += [
            *stored_otherwise(document, sources),
            *level_ignored(document, sources, level),
            *unmeasured,
        ]
        if self.compress is Scheme.DRACO:
            notices += draco_growth(given, written)
        primitives = tuple(
            (bake.source.place, bake.counts(self.encoding, length))
            for bake, length in zip(bakes, lengths, strict=True)
        )
        return BakedDocument(written, primitives, skipped, tuple(notices), cost)

    def _recoded(self, document: Document, sources: list[PrimitiveSource]) -> tuple[Document, list[Notice]]:
        """Return the document with its geometry compressed as chosen, and notices on the exceptions."""
        in_draco = any(draco.extension_of(source.json) is not None for source in sources)
        if self.compress is Scheme.KEEP and not in_draco:
            return document, []
        from skinbake.gltf.codecs.recode import Compression, recoded

        return recoded(document, sources, Compression(self.compress, self.compress_level, self._bits))

    def _bakeable(self, document: Document) -> tuple[list[PrimitiveSource], int, list[Notice]]:
        """Return the primitives to bake, the number of skinned ones left out, and notices on the latter."""
        sources, notices = skinned_sources(document)
        wanted: list[PrimitiveSource] = []
        for source in sources:
            reason = reason_to_skip(document, source, generate_normals=self.generate_normals)
            if reason is None and self.frame is FrameChoice.TANGENT:
                reason = _reason_of_frame(source)
            if reason is None:
                wanted.append(source)
            else:
                notices.append(reason)
        return wanted, len(sources) - len(wanted), notices

    def _aim(self, document: Document, sources: Sequence[PrimitiveSource]) -> _Aim:
        """Return the rig and the poses to which a surface is fitted."""
        if self.gradients is Gradients.SURFACE:
            return _Aim()
        with stage("rig"):
            rig, notices = fitting_rig(document, sources[0])
        if self.gradients is Gradients.RIG:
            return _Aim(rig, notices=notices)
        from skinbake.lighting.poses_to_fit import poses_to_fit  # it poses: half a second of imports

        with stage("poses"):
            found = poses_to_fit(document, sources[0].mesh, self.fit_poses, sources[0].place)
        return _Aim(rig, found, [*notices, *found.notices])

    def _baked_surface(
        self, document: Document, sources: Sequence[PrimitiveSource], aim: _Aim
    ) -> list[PrimitiveBake]:
        """Bake primitives as one surface. Raises InputError if α or β are not finite."""
        with stage("arrays"):
            whole = with_smooth_normals(_read(document, sources))
            if self.frame is not FrameChoice.NORMAL:
                whole = _straight(document, sources, whole)
        if self.limit_influences is not None:
            return self._limited_surface(document, sources, whole, self.limit_influences, aim)
        if self.neighbours is Neighbours.EXTEND:
            return self._extended_surface(document, sources, whole, aim)
        return _finite(self._bakes(document, sources, whole, aim))

    def _limited_surface(
        self,
        document: Document,
        sources: Sequence[PrimitiveSource],
        whole: Sequence[SkinnedPrimitive],
        count: int,
        aim: _Aim,
    ) -> list[PrimitiveBake]:
        """Bake primitives as one surface with at most ``count`` influences a vertex, and measure the cost."""
        from skinbake.lighting.limit_cost import limit_costs, limited  # it replays: half a second of imports

        with stage("limit"):
            parts = [limited(document, *pair, count) for pair in zip(sources, whole, strict=True)]
        primitives = [part.primitive if part else one for part, one in zip(parts, whole, strict=True)]
        bakes = _finite(self._bakes(document, sources, primitives, aim))
        if not any(parts):
            return bakes
        with stage("limit"):
            before = self._bakes(document, sources, whole, aim)
            costs = limit_costs(document, _unwritten(before), _unwritten(bakes), parts)
        return [
            replace(bake, limited=part, limit_cost=cost)
            for bake, part, cost in zip(bakes, parts, costs, strict=True)
        ]

    def _extended_surface(
        self,
        document: Document,
        sources: Sequence[PrimitiveSource],
        whole: Sequence[SkinnedPrimitive],
        aim: _Aim,
    ) -> list[PrimitiveBake]:
        """Bake primitives as one surface, with a further influence set where free slots are too few."""
        from skinbake.format.extension import extended  # few bakes ask for it

        tried = bake_mesh(whole, self.settings)
        parts = [
            extended(one, read_influences(document, source, len(one.positions)), found.overflowing_vertices)
            if found.overflowing_vertices
            else None
            for source, one, (_, found) in zip(sources, whole, tried, strict=True)
        ]
        primitives = [part.primitive if part else one for part, one in zip(parts, whole, strict=True)]
        bakes = _finite(self._bakes(document, sources, primitives, aim))
        return [replace(bake, extended=part) for bake, part in zip(bakes, parts, strict=True)]

    def _bakes(
        self,
        document: Document,
        sources: Sequence[PrimitiveSource],
        primitives: Sequence[SkinnedPrimitive],
        aim: _Aim,
    ) -> list[PrimitiveBake]:
        outcomes = bake_mesh(primitives, self.settings, aim.rig)
        noted = self._noted_aim(aim)
        bakes = [
            PrimitiveBake(source, primitive, *outcome, fitted=noted)
            for source, primitive, outcome in zip(sources, primitives, outcomes, strict=True)
        ]
        return bakes if aim.poses is None else _fitted_to_poses(document, bakes, aim.poses)

    def _noted_aim(self, aim: _Aim) -> JsonObject:
        """Return what the metadata says of the fit."""
        noted: JsonObject = {}
        if aim.rig is not None:
            noted = {"gradients": "rig", "fit": FIT, "rig": rig_digest(aim.rig)}
        if aim.poses is not None:
            names = [source if isinstance(source, str) else source.name for source in self.fit_poses]
            noted |= {
                "gradients": "poses",
                "fit": FIT,
                "poses": {"from": names, "fingerprint": list(aim.poses.fingerprint)},
            }
        return noted

    @property
    def settings(self) -> BakeSettings:
        """Return the options of the gradients."""
        return BakeSettings(self.weighting, math.radians(self.crease_angle), self.neighbours, self.frame)

    @property
    def attribute_names(self) -> AttributeNames:
        """Return the patterns of the attributes' names."""
        usual = AttributeNames()
        return AttributeNames(self.alpha_name or usual.alpha, self.beta_name or usual.beta)

    @property
    def _bits(self) -> dict[str, int]:
        """Return the numbers of bits to which Draco quantises, by attribute."""
        bits = {"POSITION": self.position_bits, "NORMAL": self.normal_bits, "TEXCOORD_0": self.texcoord_bits}
        return {name: count for name, count in bits.items() if count is not None}

    @property
    def _noted_settings(self) -> JsonObject:
        return {
            "weighting": str(self.weighting),
            "creaseAngle": round(float(np.degrees(math.radians(self.crease_angle))), 6),
            "neighbours": str(self.neighbours),
            **({"weld": str(self.weld)} if self.weld is Weld.SKIN else {}),
        }


@dataclass(frozen=True, slots=True)
class _Aim:
    """The rig and the poses to which a surface is fitted, None for none, and notices about them."""

    rig: Rig | None = None
    poses: FoundPoses | None = None
    notices: Sequence[Notice] = ()


ENUMERATIONS = {
    "gradients": Gradients,
    "weighting": Weighting,
    "weld": Weld,
    "neighbours": Neighbours,
    "frame": FrameChoice,
    "compress": Scheme,
    "encoding": Encoding,
    "layout": Layout,
}

HIGHEST_MESHOPT_LEVEL = 3


def _pose_sources(baker: Baker) -> tuple[PoseSource, ...]:
    """Return the sources of the poses, the file's own clips if none is named."""
    if baker.gradients is not Gradients.POSES:
        if baker.fit_poses:
            raise ChoiceError("--fit-poses needs --gradients poses")
        return ()
    from skinbake.lighting.poses_to_fit import ANIMATIONS, pose_source  # it poses: half a second of imports

    return tuple(map(pose_source, baker.fit_poses or (ANIMATIONS,)))


def _check_ranges(baker: Baker) -> None:
    for name, numbers in BAKE_RANGES.items():
        check_range(name, getattr(baker, name), numbers)
    if baker.limit_influences is not None and baker.neighbours is Neighbours.EXTEND:
        raise ChoiceError("--limit-influences contradicts --neighbours extend, which adds influences")
    if (baker.limit_influences or 0) % SLOTS_PER_SET:
        raise ChoiceError(
            f"--limit-influences {baker.limit_influences}: expected a multiple of 4, "
            "because glTF stores influences in sets of 4"
        )


def _check_names(baker: Baker) -> None:
    for name in ("alpha_name", "beta_name"):
        pattern = getattr(baker, name)
        if pattern is None:
            continue
        if not pattern.startswith("_") or "{set}" not in pattern:
            raise ChoiceError(
                f"{option_of(name)} {pattern}: expected a name that begins with an underscore, as glTF "
                "wants, and contains {set}"
            )
        if baker.layout is not Layout.ATTRIBUTES:
            raise ChoiceError(f"{option_of(name)} needs --layout attributes; {baker.layout} has fixed names")
    if baker.attribute_names.alpha == baker.attribute_names.beta:
        raise ChoiceError("--alpha-name and --beta-name must differ")


def _check_compression(baker: Baker) -> None:
    """Raise ChoiceError for bits, a level or a layout that the compression cannot use."""
    bits = (baker.position_bits, baker.normal_bits, baker.texcoord_bits)
    if any(count is not None for count in bits) and baker.compress is not Scheme.DRACO:
        raise ChoiceError("--position-bits, --normal-bits and --texcoord-bits need --compress draco")
    level = baker.compress_level
    if level is not None and baker.compress is Scheme.NONE:
        raise ChoiceError("--compress-level contradicts --compress none, which compresses nothing")
    if baker.compress is Scheme.MESHOPT and level is not None and level > HIGHEST_MESHOPT_LEVEL:
        raise ChoiceError(f"--compress-level of meshopt is at most {HIGHEST_MESHOPT_LEVEL}")
    if baker.layout is Layout.TEXCOORD and baker.encoding is not Encoding.FLOAT32:
        raise ChoiceError(
            f"--layout texcoord needs --encoding float32, not {baker.encoding}: only float texture "
            "coordinates of glTF may be negative"
        )


@dataclass(frozen=True, slots=True)
class BakedDocument:
    """A document with α and β, the bake of each primitive, and the assumptions made.

    skipped is the number of skinned primitives that were left out. If no primitive can be baked, the document
    is the given one, primitives is empty and encoding is None.
    """

    document: Document
    primitives: tuple[tuple[Place, BakedCounts], ...]
    skipped: int
    notices: tuple[Notice, ...]
    encoding: EncodingCost | None = None


@dataclass(frozen=True, slots=True)
class PrimitiveBake:
    """One primitive: the arrays that were baked, the result, the findings, and the loss by a limit.

    fitted is what the metadata says of the fit, nothing for the gradients of the surface.
    """

    source: PrimitiveSource
    primitive: SkinnedPrimitive
    result: BakedPrimitive
    findings: BakeFindings
    limited: Limited | None = None
    limit_cost: LimitCost | None = None
    fitted: JsonObject = field(default_factory=dict)
    extended: Extended | None = None

    @property
    def notices(self) -> list[Notice]:
        """Return the assumptions made, and signs of errors in the model."""
        source, given = self.source, self.primitive
        assumed = assumptions(
            given,
            self.result,
            self.findings,
            source.joint_count,
            source.place,
            fitted=bool(self.fitted),
        )
        return [*assumed, *lean_notices(given, source.place)]

    def to_store(self, settings: JsonObject) -> Baked:
        """Return the data to write. settings is noted in the metadata."""
        changed = self.limited or self.extended
        influences = changed.stored if changed else None
        return Baked(self.source, self.primitive, self.result, {**settings, **self.fitted}, influences)

    def counts(self, encoding: Encoding, added_bytes: int) -> BakedCounts:
        """Return the numbers of the report."""
        influences = self.primitive.joints.shape[1]
        return BakedCounts(
            vertices=len(self.primitive.positions),
            triangles=len(self.primitive.triangles),
            degenerate_triangles=self.findings.degenerate_triangles,
            influences=influences,
            gradients=self.fitted.get("gradients", str(Gradients.SURFACE)),
            frame=str(self.result.frame),
            generated_normals="NORMAL" not in self.source.attributes,
            adopting_vertices=self.findings.adopting_vertices,
            overflowing_vertices=self.findings.overflowing_vertices,
            gradient=self.findings.magnitude,
            lost_gradient=self.findings.lost,
            added_bytes=added_bytes,
            bytes_per_vertex=vertex_bytes(encoding, influences),
            limited=self.limit_cost,
            extended=None if self.extended is None else _extension_cost(self.extended, encoding),
        )


def _fitted_to_poses(
    document: Document, bakes: Sequence[PrimitiveBake], found: FoundPoses
) -> list[PrimitiveBake]:
    """Return the bakes of one surface with α and β fitted to poses."""
    from skinbake.lighting.operator import true_operator
    from skinbake.lighting.pose_fit import fit_size, fitted_to_poses

    for bake in bakes:
        document.budget.claim(fit_size(*bake.primitive.joints.shape), "fitting it", bake.source.place)
    operator = true_operator(
        [bake.primitive for bake in bakes],
        claim=lambda size: document.budget.claim_welding(size, bakes[0].source.place),
    )
    surfaces = [bake.rest_surface() for bake in _unwritten(bakes)]
    with stage("fit"):
        slots = fitted_to_poses(operator, surfaces, found.groups)
    return [
        replace(bake, result=bake.result.with_slots(alpha, beta))
        for bake, (alpha, beta) in zip(bakes, slots, strict=True)
    ]


def _extension_cost(part: Extended, encoding: Encoding) -> ExtensionCost:
    """Return the price of an influence set more."""
    from skinbake.skinning.algorithms import Algorithm
    from skinbake.skinning.counting import multiply_adds

    after = part.primitive.joints.shape[1]
    before, added = after - SLOTS_PER_SET, part.stored[-1]
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


def _reason_of_frame(source: PrimitiveSource) -> Notice | None:
    """Return why a primitive cannot be baked for the frame from TANGENT, or None if it can."""
    lacking = next((name for name in ("NORMAL", "TANGENT") if name not in source.attributes), None)
    if lacking is None:
        return None
    return Notice(
        "no-tangents", f"skipped: it has no {lacking}; --frame auto takes the frame from NORMAL", source.place
    )


def _surfaces(
    document: Document, sources: Sequence[PrimitiveSource], weld: Weld
) -> tuple[list[list[PrimitiveSource]], list[Notice]]:
    """Return the groups of primitives that are baked as one surface, and notices on the separate ones."""
    by_mesh: dict[int, list[PrimitiveSource]] = defaultdict(list)
    for source in sources:
        by_mesh[source.mesh].append(source)
    if weld is not Weld.SKIN:
        return list(by_mesh.values()), []
    from skinbake.gltf.skin_groups import meshes_of_one_skin

    groups, apart = meshes_of_one_skin(document, by_mesh)
    return [[source for mesh in group for source in by_mesh[mesh]] for group in groups], apart


def _unwritten(bakes: Sequence[PrimitiveBake]) -> list[UnwrittenBake]:
    from skinbake.lighting.unwritten import UnwrittenBake

    return [UnwrittenBake(bake.source, bake.primitive, bake.result) for bake in bakes]


def _encoding_cost(
    document: Document, bakes: Sequence[PrimitiveBake], storage: GradientFormat
) -> tuple[EncodingCost, list[Notice]]:
    """Return the cost of the encoding, and a notice if the file cannot be posed to measure it."""
    encoding = storage.encoding
    if not encoding.is_scaled:
        return EncodingCost(str(encoding)), []
    from skinbake.lighting.encoding_cost import added_by_encoding  # it replays, as limits do

    try:
        added = added_by_encoding(document, _unwritten(bakes), storage)
    except InputError as error:
        message = f"the error that --encoding {encoding} adds could not be measured: {error.message}"
        notice = Notice("encoding-unmeasured", message, error.place or document.place)
        return EncodingCost(str(encoding)), [notice]
    return EncodingCost(str(encoding), added.mean if added else None, added.p99 if added else None), []


def _straight(
    document: Document, sources: Sequence[PrimitiveSource], primitives: Sequence[SkinnedPrimitive]
) -> list[SkinnedPrimitive]:
    """Return the primitives with the tangents of few leaning vertices straightened, if they are floats."""
    return [
        with_straight_tangents(primitive) if has_float_tangents(document, source) else primitive
        for source, primitive in zip(sources, primitives, strict=True)
    ]


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
