"""``skinbake bake``: read a document, bake every skinned primitive, write it."""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from skinbake.choices import Encoding, FrameChoice
from skinbake.containment import OWN_FOLDERS, Within
from skinbake.errors import InputError, Notice, Place, SkinbakeError, defect
from skinbake.format.attribute_store import stored_otherwise
from skinbake.format.baked import AttributeNames, Baked, with_baked
from skinbake.format.encodings import vertex_bytes
from skinbake.format.layouts import Storage
from skinbake.format.strip import stripped
from skinbake.geometry.blocks import blocks
from skinbake.geometry.frames import TANGENT_FRAME
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
from skinbake.gradients.baker import TANGENT_TOLERANCE, BakeFindings, BakeSettings, bake_mesh
from skinbake.gradients.influences import SUM_TOLERANCE
from skinbake.gradients.normals import with_smooth_normals
from skinbake.report.bake import BakedCounts, EncodingCost, FileResult, LimitCost, Status
from skinbake.timing import stage

if TYPE_CHECKING:
    from skinbake.lighting.limit_cost import Limited, Outcome

logger = logging.getLogger(__name__)

BYTES_A_VERTEX, BYTES_A_SLOT, BYTES_A_TRIANGLE = 128, 48, 24
"""What a bake sets aside at most, about."""

WELD_MESH, WELD_SKIN = "mesh", "skin"


@dataclass(frozen=True, slots=True)
class BakeOptions:
    """The options of ``skinbake bake`` that do not name files.

    weld is ``mesh`` or ``skin``; limit_influences a multiple of 4, or None; traced asks for
    digests of what is written; sync waits until that is on the disk.
    """

    settings: BakeSettings = field(default_factory=BakeSettings)
    names: AttributeNames = field(default_factory=AttributeNames)
    weld: str = WELD_MESH
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

    Raises nothing: what fails is in the result, and then nothing has been written.
    """
    notices: list[Notice] = []
    try:
        return _bake_file(source, target, options, within, notices)
    except SkinbakeError as error:
        failure = error
    except MemoryError:
        failure = InputError("it needs more memory than there is or --max-memory allows", Place(source))
    except Exception as error:  # a defect of ours: the other files of a build must not suffer from it
        logger.debug("where it failed", exc_info=True)
        failure = defect(error, source)
    return FileResult(source, target, "failed", notices=tuple(notices), error=failure)


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
    with stage("compress"):
        prepared, kept = recoded(prepared, _bakeable(prepared, options), options.compression)
    found = [*undone, *moved, *kept]
    begun = len(found)
    result, primitives, skipped = bake_document(prepared, options, found)
    if not primitives:
        result, found = _passed_through(document, target, skipped, options, found[begun:])
    with stage("encoding"):
        encoding = _encoding(prepared, result, options, found) if primitives else None
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
    status: Status = "baked" if primitives else "unchanged"
    written = _digests(planned) if options.traced else None
    return FileResult(
        source, target, status, tuple(primitives), skipped, tuple(notices), encoding=encoding, written=written
    )


def _digests(planned: PlannedOutput | None) -> dict[str, str]:
    return {} if planned is None else digests_of(planned.files)


def _encoding(
    prepared: Document, result: Document, options: BakeOptions, notices: list[Notice]
) -> EncodingCost:
    """Return what the encoding costs; a file that cannot be posed is told of in ``notices``."""
    encoding = options.storage.encoding
    if not encoding.is_scaled:
        return EncodingCost(str(encoding))
    from skinbake.lighting.encoding_cost import added_by_encoding  # replays: half a second of imports

    plain, _, _ = bake_document(prepared, replace(options, storage=Storage()), [])
    try:
        added = added_by_encoding(result, plain)
    except InputError as error:
        message = f"what --encoding {encoding} adds to the error could not be measured: {error.message}"
        notices.append(Notice("encoding-unmeasured", message, error.place or prepared.place))
        added = None
    return EncodingCost(str(encoding), added.mean if added else None, added.p99 if added else None)


def _bakeable(document: Document, options: BakeOptions) -> list[PrimitiveSource]:
    sources, _ = skinned_sources(document)
    return [
        source
        for source in sources
        if reason_to_skip(document, source, generate_normals=options.generate_normals) is None
        and _reason_of_frame(source, options) is None
    ]


def _passed_through(
    document: Document, target: str | None, skipped: int, options: BakeOptions, notices: list[Notice]
) -> tuple[Document, list[Notice]]:
    """Return a document in which nothing can be baked as it came, an earlier bake included, and why."""
    reason = "none of its skinned primitives can be baked" if skipped else "nothing in it is skinned"
    if options.require_baked:
        raise InputError(f"{reason} (--require-baked)", document.place)
    result, moved = (document, []) if target is None else for_target(document, target)
    last = Notice("nothing-baked", f"passed through unchanged: {reason}", document.place)
    return result, [*moved, *notices, last]


def bake_document(
    document: Document, options: BakeOptions, notices: list[Notice]
) -> tuple[Document, list[tuple[Place, BakedCounts]], int]:
    """Return the baked document, what was baked, and how many skinned primitives were skipped.

    The document holds no earlier bake (``stripped``). One in which nothing can be baked is returned as it is.
    What had to be assumed is added to ``notices``. Raises InputError.
    """
    sources, found = skinned_sources(document)
    notices += found
    by_mesh: dict[int, list[PrimitiveSource]] = defaultdict(list)
    for source in sources:
        reason = reason_to_skip(document, source, generate_normals=options.generate_normals)
        reason = reason or _reason_of_frame(source, options)
        if reason is None:
            by_mesh[source.mesh].append(source)
        else:
            notices.append(reason)
    baked: list[Baked] = []
    results: list[tuple[Place, BakedCounts]] = []
    for group in _welded_together(document, by_mesh, options, notices):
        _bake_sources(document, group, options, notices, baked, results)
    skipped = len(sources) - len(baked)
    if not baked:
        return document, [], skipped
    notices += stored_otherwise(document, [item.source for item in baked])
    level = options.compression.level
    with stage("store"):
        written, lengths = with_baked(document, baked, options.names, options.storage, level=level)
    counts = [(place, replace(c, added_bytes=n)) for (place, c), n in zip(results, lengths, strict=True)]
    return written, counts, skipped


def _welded_together(
    document: Document,
    by_mesh: dict[int, list[PrimitiveSource]],
    options: BakeOptions,
    notices: list[Notice],
) -> list[list[PrimitiveSource]]:
    """Return the primitives in the groups that are baked as one surface; append to ``notices``."""
    if options.weld != WELD_SKIN:
        return list(by_mesh.values())
    from skinbake.gltf.skin_groups import meshes_of_one_skin

    groups, found = meshes_of_one_skin(document, by_mesh)
    notices += found
    return [[source for mesh in group for source in by_mesh[mesh]] for group in groups]


def _reason_of_frame(source: PrimitiveSource, options: BakeOptions) -> Notice | None:
    if options.settings.frame is not FrameChoice.TANGENT or {"NORMAL", "TANGENT"} <= source.attributes.keys():
        return None
    lacking = "NORMAL" if "NORMAL" not in source.attributes else "TANGENT"
    return Notice(
        "no-tangents", f"skipped: it has no {lacking}; --frame auto takes the frame from NORMAL", source.place
    )


def _bake_sources(
    document: Document,
    sources: list[PrimitiveSource],
    options: BakeOptions,
    notices: list[Notice],
    baked: list[Baked],
    results: list[tuple[Place, BakedCounts]],
) -> None:
    """Bake primitives as one surface; append to ``baked``, ``results`` and ``notices``."""
    with stage("arrays"):
        whole = with_smooth_normals(_read(document, sources))
    with stage("limit"):
        parts = _limited(document, sources, whole, options)
    primitives = [part.primitive if part else one for part, one in zip(parts, whole, strict=True)]
    outcomes = bake_mesh(primitives, options.settings)
    for source, primitive, (outcome, _) in zip(sources, primitives, outcomes, strict=True):
        _check_finite(source, primitive, outcome)
    with stage("limit"):
        costs = _limit_costs(document, sources, whole, parts, outcomes, options)
    for source, primitive, part, cost, (outcome, findings) in zip(
        sources, primitives, parts, costs, outcomes, strict=True
    ):
        notices += _assumptions(source, primitive, outcome, findings)
        stored = part.stored if part else None
        baked.append(Baked(source, primitive, outcome, _noted_settings(options), stored))
        counts = _counts(source, primitive, outcome, findings, options.storage.encoding)
        results.append((source.place, replace(counts, limited=cost)))


def _check_finite(source: PrimitiveSource, primitive: SkinnedPrimitive, outcome: BakedPrimitive) -> None:
    """Raise InputError where α or β of a vertex are not finite: no shader can make a normal of those."""
    count, of_tangents = 0, False
    for rows in blocks(len(outcome.alpha)):
        slots = np.isfinite(outcome.alpha[rows]) & np.isfinite(outcome.beta[rows])
        if slots.all():
            continue
        bad = ~slots.all(axis=1)
        count += int(np.count_nonzero(bad))
        if outcome.frame == TANGENT_FRAME and primitive.tangents is not None:
            of_tangents |= bool((np.abs(primitive.tangents[rows][bad]) > 2.0).any())
    if not count:
        return
    vertices = "1 vertex" if count == 1 else f"{count} vertices"
    advice = (
        "their TANGENT is not of length 1: mend it, or take --frame normal"
        if of_tangents
        else "they lie closer together than float32 can hold a slope for: scale the model up, or merge them"
    )
    raise InputError(f"α or β of {vertices} are not finite numbers; {advice}", source.place)


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


def _limited(
    document: Document,
    sources: Sequence[PrimitiveSource],
    whole: Sequence[SkinnedPrimitive],
    options: BakeOptions,
) -> list[Limited | None]:
    """Return the primitives that a limit of influences changes, None for each that it leaves alone."""
    if options.limit_influences is None:
        return [None] * len(whole)
    from skinbake.lighting.limit_cost import limited  # replays, as encodings do

    return [
        limited(document, source, primitive, options.limit_influences)
        for source, primitive in zip(sources, whole, strict=True)
    ]


def _limit_costs(
    document: Document,
    sources: Sequence[PrimitiveSource],
    whole: Sequence[SkinnedPrimitive],
    parts: Sequence[Limited | None],
    outcomes: Sequence[Outcome],
    options: BakeOptions,
) -> Sequence[LimitCost | None]:
    if not any(parts):
        return [None] * len(whole)
    from skinbake.lighting.limit_cost import limit_costs

    return limit_costs(document, sources, whole, parts, outcomes, options.settings)


def _counts(
    source: PrimitiveSource,
    primitive: SkinnedPrimitive,
    outcome: BakedPrimitive,
    findings: BakeFindings,
    encoding: Encoding,
) -> BakedCounts:
    return BakedCounts(
        vertices=len(primitive.positions),
        triangles=len(primitive.triangles),
        degenerate_triangles=findings.degenerate_triangles,
        influences=primitive.joints.shape[1],
        frame=outcome.frame,
        generated_normals="NORMAL" not in source.attributes,
        adopting_vertices=findings.adopting_vertices,
        overflowing_vertices=findings.overflowing_vertices,
        gradient=findings.magnitude,
        lost_gradient=findings.lost,
        added_bytes=0,
        bytes_per_vertex=vertex_bytes(encoding, primitive.joints.shape[1]),
    )


def _noted_settings(options: BakeOptions) -> JsonObject:
    settings = options.settings
    return {
        "weighting": settings.weighting,
        "creaseAngle": round(float(np.degrees(settings.crease_angle)), 6),
        "neighbours": settings.neighbours,
        **({"weld": WELD_SKIN} if options.weld == WELD_SKIN else {}),
    }


def _assumptions(
    source: PrimitiveSource, primitive: SkinnedPrimitive, outcome: BakedPrimitive, findings: BakeFindings
) -> list[Notice]:
    """Return one notice for each kind of thing that had to be assumed."""
    weights = findings.weights
    outside = 0
    if primitive.joints.max() >= source.joint_count:
        unused = (primitive.joints >= source.joint_count) & (primitive.weights == 0)
        outside = int(np.count_nonzero(unused.any(axis=1)))
    forced = outcome.frame == TANGENT_FRAME
    consequence = "used all the same, as asked" if forced else "the frame is taken from NORMAL instead"
    table = [
        ("weights-negative", weights.negative, "{} vertices have negative weights: taken as 0"),
        (
            "weights-zero",
            weights.all_zero,
            "{} vertices have no weight at all: taken as bound to slot 0's joint",
        ),
        (
            "weights-sum",
            weights.not_normalised,
            f"the weights of {{}} vertices miss a sum of 1 by over {SUM_TOLERANCE}: taken as divided by it",
        ),
        (
            "joints-repeated",
            weights.repeated_joint,
            "{} vertices name a joint twice: its weights are added up",
        ),
        (
            "joints-outside-skin",
            outside,
            f"{{}} vertices name a joint past the skin's {source.joint_count}, at weight 0: ignored",
        ),
        (
            "tangents-skewed",
            findings.bad_tangents,
            f"at {{}} vertices TANGENT × bitangent leans more than {TANGENT_TOLERANCE}° from NORMAL "
            f"(up to {findings.tangent_deviation:.3g}°): {consequence}",
        ),
        (
            "normals-zero",
            findings.zero_normals,
            "{} vertices have a NORMAL without a direction: taken as (0, 0, 1)",
        ),
    ]
    return [
        Notice(code, text.format(f"{count:,}"), source.place, count) for code, count, text in table if count
    ]
