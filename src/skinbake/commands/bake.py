"""``skinbake bake``: read a document, bake every skinned primitive, write it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from skinbake.choices import Encoding, FrameChoice, Weld
from skinbake.containment import OWN_FOLDERS, Within
from skinbake.errors import InputError, Notice, Place, noticed
from skinbake.format.attribute_store import stored_otherwise
from skinbake.format.baked import AttributeNames, Baked, with_baked, with_scale
from skinbake.format.encodings import vertex_bytes
from skinbake.format.layouts import Storage
from skinbake.format.strip import stripped
from skinbake.geometry.skinned import BakedPrimitive, SkinnedPrimitive
from skinbake.gltf.codecs.recode import Compression, recoded
from skinbake.gltf.container import for_target
from skinbake.gltf.digests import digests_of
from skinbake.gltf.document import STDIO, Document, read_document
from skinbake.gltf.json_access import JsonObject
from skinbake.gltf.output import PlannedOutput, plan_output, refuse_own_input
from skinbake.gltf.primitives import (
    PrimitiveSource,
    read_primitive,
    reason_to_skip,
    skinned_sources,
)
from skinbake.gltf.writing import version_of
from skinbake.gradients.assumptions import assumptions, check_finite
from skinbake.gradients.baker import BakeFindings, BakeSettings, bake_mesh
from skinbake.gradients.normals import with_smooth_normals
from skinbake.report.bake import BakedCounts, EncodingCost, FileResult, LimitCost, Status
from skinbake.timing import stage

if TYPE_CHECKING:
    from skinbake.lighting.limit_cost import Limited
    from skinbake.lighting.unwritten import UnwrittenBake

BYTES_A_VERTEX, BYTES_A_SLOT, BYTES_A_TRIANGLE = 128, 48, 24
"""What a bake sets aside at most, about."""


@dataclass(frozen=True, slots=True)
class BakeOptions:
    """The options of ``skinbake bake`` that do not name files.

    weld is ``mesh`` or ``skin``; limit_influences a multiple of 4, or None; traced asks for
    digests of what is written; sync waits until that is on the disk.
    """

    settings: BakeSettings = field(default_factory=BakeSettings)
    names: AttributeNames = field(default_factory=AttributeNames)
    weld: Weld = Weld.MESH
    limit_influences: int | None = None
    generate_normals: bool = False
    require_baked: bool = False
    warnings_as_errors: bool = False
    storage: Storage = field(default_factory=Storage)
    dry_run: bool = False
    make_folder: bool = False
    traced: bool = False
    sync: bool = True
    compression: Compression = field(default_factory=Compression)


def bake_file(
    source: str, target: str | None, options: BakeOptions, within: Within = OWN_FOLDERS
) -> FileResult:
    """Bake one file and write it to ``target`` (nowhere for None, or on a dry run).

    Raises SkinbakeError, and then nothing has been written; its notices are what was found before.
    """
    notices: list[Notice] = []
    with noticed(notices):
        return _bake_file(source, target, options, within, notices)


def _bake_file(
    source: str, target: str | None, options: BakeOptions, within: Within, notices: list[Notice]
) -> FileResult:
    replaced = version_of(source) if target == source != STDIO else None
    with stage("read"):
        document = read_document(source, within.bounds)
    if target is not None:
        refuse_own_input(document, source, target)
    with stage("strip"):
        original, _, undone = stripped(document)
        prepared, moved = (original, []) if target is None else for_target(original, target)
    made = bake_document(prepared, options)
    if made.primitives:
        result, found = made.document, [*undone, *moved, *made.notices]
    else:
        result, found = _passed_through(document, target, made, options)
    notices += found
    untouched = result is document and target == source and source != STDIO
    with stage("write"):
        planned = (
            None
            if target is None or untouched
            else plan_output(result, target, make_folder=options.make_folder, root=within.output)
        )
    if planned is not None:
        notices += planned.notices
    if options.warnings_as_errors and notices:
        raise InputError("not written: there are warnings (--warnings-as-errors)", document.place)
    if planned is not None and not options.dry_run:
        with stage("write"):
            planned = replace(planned, replaces=replaced).write(sync=options.sync)
    status: Status = "baked" if made.primitives else "unchanged"
    written = _digests(planned) if options.traced else None
    return FileResult(
        source,
        target,
        status,
        made.primitives,
        made.skipped,
        tuple(notices),
        encoding=made.encoding,
        written=written,
    )


def _digests(planned: PlannedOutput | None) -> dict[str, str]:
    return {} if planned is None else digests_of(planned.files)


def _passed_through(
    document: Document, target: str | None, made: BakedDocument, options: BakeOptions
) -> tuple[Document, list[Notice]]:
    """Return a document in which nothing can be baked as it came, an earlier bake included, and why."""
    reason = "none of its skinned primitives can be baked" if made.skipped else "nothing in it is skinned"
    if options.require_baked:
        raise InputError(f"{reason} (--require-baked)", document.place)
    result, moved = (document, []) if target is None else for_target(document, target)
    last = Notice("nothing-baked", f"passed through unchanged: {reason}", document.place)
    return result, [*moved, *made.notices, last]


@dataclass(frozen=True, slots=True)
class BakedDocument:
    """A document with α and β, what was baked into each primitive, and what had to be assumed.

    skipped counts the skinned primitives that were left out. Where nothing can be baked, the document is
    the one that was given, primitives is empty and encoding None.
    """

    document: Document
    primitives: tuple[tuple[Place, BakedCounts], ...]
    skipped: int
    notices: tuple[Notice, ...]
    encoding: EncodingCost | None = None


def bake_document(document: Document, options: BakeOptions) -> BakedDocument:
    """Bake every skinned primitive of a document that holds no earlier bake (``stripped``).

    Raises InputError.
    """
    sources, skipped, reasons = _bakeable(document, options)
    if not sources:
        return BakedDocument(document, (), skipped, tuple(reasons))
    with stage("compress"):
        document, kept = recoded(document, sources, options.compression)
    sources = [source.in_document(document) for source in sources]
    surfaces, apart = _surfaces(document, sources, options)
    bakes = [bake for surface in surfaces for bake in _baked_surface(document, surface, options)]
    storage = with_scale(options.storage, [bake.result for bake in bakes])
    with stage("store"):
        written, lengths = with_baked(
            document,
            [bake.to_store(_noted_settings(options)) for bake in bakes],
            options.names,
            storage,
            level=options.compression.level,
        )
    with stage("encoding"):
        cost, unmeasured = _encoding_cost(document, bakes, storage)
    notices = [*kept, *reasons, *apart, *(notice for bake in bakes for notice in bake.notices)]
    notices += [*stored_otherwise(document, sources), *unmeasured]
    primitives = tuple(
        (bake.source.place, bake.counts(storage.encoding, length))
        for bake, length in zip(bakes, lengths, strict=True)
    )
    return BakedDocument(written, primitives, skipped, tuple(notices), cost)


def _bakeable(document: Document, options: BakeOptions) -> tuple[list[PrimitiveSource], int, list[Notice]]:
    """Return the primitives that are baked, how many skinned ones are not, and a notice on each of those."""
    sources, notices = skinned_sources(document)
    wanted: list[PrimitiveSource] = []
    for source in sources:
        reason = reason_to_skip(document, source, generate_normals=options.generate_normals)
        reason = reason or _reason_of_frame(source, options)
        if reason is None:
            wanted.append(source)
        else:
            notices.append(reason)
    return wanted, len(sources) - len(wanted), notices


def _reason_of_frame(source: PrimitiveSource, options: BakeOptions) -> Notice | None:
    wants_tangents = options.settings.frame is FrameChoice.TANGENT
    if not wants_tangents or {"NORMAL", "TANGENT"} <= source.attributes.keys():
        return None
    lacking = "NORMAL" if "NORMAL" not in source.attributes else "TANGENT"
    return Notice(
        "no-tangents", f"skipped: it has no {lacking}; --frame auto takes the frame from NORMAL", source.place
    )


def _surfaces(
    document: Document, sources: Sequence[PrimitiveSource], options: BakeOptions
) -> tuple[list[list[PrimitiveSource]], list[Notice]]:
    """Return the primitives in the groups that are baked as one surface, and what is kept apart."""
    by_mesh: dict[int, list[PrimitiveSource]] = defaultdict(list)
    for source in sources:
        by_mesh[source.mesh].append(source)
    if options.weld is not Weld.SKIN:
        return list(by_mesh.values()), []
    from skinbake.gltf.skin_groups import meshes_of_one_skin

    groups, apart = meshes_of_one_skin(document, by_mesh)
    return [[source for mesh in group for source in by_mesh[mesh]] for group in groups], apart


@dataclass(frozen=True, slots=True)
class PrimitiveBake:
    """One primitive: its arrays as baked from, the result, what was found, and what a limit took from it."""

    source: PrimitiveSource
    primitive: SkinnedPrimitive
    result: BakedPrimitive
    findings: BakeFindings
    limited: Limited | None = None
    limit_cost: LimitCost | None = None

    @property
    def notices(self) -> list[Notice]:
        """Return what had to be assumed."""
        source = self.source
        return assumptions(self.primitive, self.result, self.findings, source.joint_count, source.place)

    def to_store(self, settings: JsonObject) -> Baked:
        """Return what is written of it; settings is noted in the metadata."""
        influences = self.limited.stored if self.limited else None
        return Baked(self.source, self.primitive, self.result, settings, influences)

    def counts(self, encoding: Encoding, added_bytes: int) -> BakedCounts:
        """Return the numbers of the report."""
        influences = self.primitive.joints.shape[1]
        return BakedCounts(
            vertices=len(self.primitive.positions),
            triangles=len(self.primitive.triangles),
            degenerate_triangles=self.findings.degenerate_triangles,
            influences=influences,
            frame=self.result.frame,
            generated_normals="NORMAL" not in self.source.attributes,
            adopting_vertices=self.findings.adopting_vertices,
            overflowing_vertices=self.findings.overflowing_vertices,
            gradient=self.findings.magnitude,
            lost_gradient=self.findings.lost,
            added_bytes=added_bytes,
            bytes_per_vertex=vertex_bytes(encoding, influences),
            limited=self.limit_cost,
        )


def _baked_surface(
    document: Document, sources: Sequence[PrimitiveSource], options: BakeOptions
) -> list[PrimitiveBake]:
    """Bake primitives as one surface."""
    with stage("arrays"):
        whole = with_smooth_normals(_read(document, sources))
    if options.limit_influences is not None:
        return _limited_surface(document, sources, whole, options, options.limit_influences)
    return _finite(_bakes(sources, whole, options))


def _bakes(
    sources: Sequence[PrimitiveSource], primitives: Sequence[SkinnedPrimitive], options: BakeOptions
) -> list[PrimitiveBake]:
    """Bake primitives as one surface."""
    outcomes = bake_mesh(primitives, options.settings)
    return [
        PrimitiveBake(source, primitive, *outcome)
        for source, primitive, outcome in zip(sources, primitives, outcomes, strict=True)
    ]


def _finite(bakes: list[PrimitiveBake]) -> list[PrimitiveBake]:
    """Return the bakes; InputError where α or β of one are not finite."""
    for bake in bakes:
        check_finite(bake.primitive, bake.result, bake.source.place)
    return bakes


def _limited_surface(
    document: Document,
    sources: Sequence[PrimitiveSource],
    whole: Sequence[SkinnedPrimitive],
    options: BakeOptions,
    count: int,
) -> list[PrimitiveBake]:
    """Bake primitives as one surface with at most ``count`` influences a vertex, and measure the cost."""
    from skinbake.lighting.limit_cost import limit_costs, limited  # replays: half a second of imports

    with stage("limit"):
        parts = [limited(document, *pair, count) for pair in zip(sources, whole, strict=True)]
    primitives = [part.primitive if part else one for part, one in zip(parts, whole, strict=True)]
    bakes = _finite(_bakes(sources, primitives, options))
    if not any(parts):
        return bakes
    with stage("limit"):
        before = _bakes(sources, whole, options)
        costs = limit_costs(document, _unwritten(before), _unwritten(bakes), parts)
    return [
        replace(bake, limited=part, limit_cost=cost)
        for bake, part, cost in zip(bakes, parts, costs, strict=True)
    ]


def _unwritten(bakes: Sequence[PrimitiveBake]) -> list[UnwrittenBake]:
    from skinbake.lighting.unwritten import UnwrittenBake

    return [UnwrittenBake(bake.source, bake.primitive, bake.result) for bake in bakes]


def _encoding_cost(
    document: Document, bakes: Sequence[PrimitiveBake], storage: Storage
) -> tuple[EncodingCost, list[Notice]]:
    """Return what the encoding costs, and a notice where the file cannot be posed to measure it."""
    encoding = storage.encoding
    if not encoding.is_scaled:
        return EncodingCost(str(encoding)), []
    from skinbake.lighting.encoding_cost import added_by_encoding  # replays, as limits do

    try:
        added = added_by_encoding(document, _unwritten(bakes), storage)
    except InputError as error:
        message = f"what --encoding {encoding} adds to the error could not be measured: {error.message}"
        notice = Notice("encoding-unmeasured", message, error.place or document.place)
        return EncodingCost(str(encoding)), [notice]
    return EncodingCost(str(encoding), added.mean if added else None, added.p99 if added else None), []


def _read(document: Document, sources: Sequence[PrimitiveSource]) -> list[SkinnedPrimitive]:
    """Return the arrays of primitives, once it is clear of each that baking it does not take too much."""
    found: list[SkinnedPrimitive] = []
    vertices, widest = 0, 0
    for source in sources:
        primitive = read_primitive(document, source)
        found.append(primitive)
        # One surface has as many slots everywhere as the widest of its primitives.
        count, width = primitive.joints.shape
        slots = max(width, widest) * (vertices + count) - widest * vertices
        vertices, widest = vertices + count, max(width, widest)
        size = BYTES_A_VERTEX * count + BYTES_A_SLOT * slots + BYTES_A_TRIANGLE * len(primitive.triangles)
        document.budget.claim(size, "baking it", source.place)
    return found


def _noted_settings(options: BakeOptions) -> JsonObject:
    settings = options.settings
    return {
        "weighting": str(settings.weighting),
        "creaseAngle": round(float(np.degrees(settings.crease_angle)), 6),
        "neighbours": str(settings.neighbours),
        **({"weld": str(options.weld)} if options.weld is Weld.SKIN else {}),
    }
