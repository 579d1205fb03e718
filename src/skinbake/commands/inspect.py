"""``skinbake inspect``: the skinned primitives of a file, and the bakes in it."""

from __future__ import annotations

import numpy as np

from skinbake.choices import Encoding, FrameChoice, Layout
from skinbake.errors import Notice
from skinbake.files.bounds import BESIDE, Bounds
from skinbake.format.attribute_store import compression_of
from skinbake.format.digests import changed_arrays
from skinbake.format.note import NO_METADATA, corrective_notes, file_left, gradient_note
from skinbake.freshness.baked_views import is_baked
from skinbake.freshness.corrective_freshness import changed_since
from skinbake.freshness.staleness import made_states
from skinbake.geometry.skinned import SkinnedPrimitive
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.budget import Cost
from skinbake.gltf.codecs.meshopt import bytes_beside
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.reading.meshes import (
    has_float_tangents,
    read_primitive,
    reason_to_skip,
    skinned_sources,
    tell_half_skinned,
)
from skinbake.gradients.influences import weight_field, weight_sum_notices
from skinbake.gradients.normals import lean_notices
from skinbake.gradients.tangents import chosen_frame, with_straight_tangents
from skinbake.report.inspect import (
    AttributeSummary,
    BakeSummary,
    CorrectiveSummary,
    InspectResult,
    MorphSummary,
    PrimitiveSummary,
)
from skinbake.timing import stage
from skinbake.wording import counted


def inspect_file(source: str, bounds: Bounds = BESIDE) -> InspectResult:
    """Return a summary of one file. Raises SkinbakeError if it cannot be read."""
    with stage("read"):
        document = read_document(source, bounds)
    sources = skinned_sources(document)
    tell_half_skinned(document)
    what = f"summing up {counted(len(sources), 'primitive')}"
    document.budget.claim(Cost.SUMMED_PRIMITIVE * len(sources), what, document.place)
    tell, primitives = document.notices.tell, []
    read: dict[int, list[PrimitiveSource]] = {}
    leaning: set[int] = set()
    for entry in sources:
        reason = reason_to_skip(document, entry, generate_normals=False)
        if reason is not None:
            tell(reason)
        if reason is None or reason.code in ("no-normals", "unlit"):
            with document.budget.passing():
                primitive = read_primitive(document, entry)
                primitives.append(_summary(document, entry, primitive))
                note = gradient_note(document, entry)
                refusal = None if note is None else note.refusal(entry.influence_sets)
                if refusal is not None:
                    tell(Notice(*refusal, entry.place))
                elif note is None and is_baked(document, entry):
                    tell(Notice("metadata-missing", NO_METADATA, entry.place))
                if reason is not None and reason.code == "unlit":
                    continue  # no light reaches its normals
                tell(*weight_sum_notices(primitive, entry.place))
                read.setdefault(entry.mesh, []).append(entry)
                if lean_notices([(primitive, entry.place)]):
                    leaning.add(entry.mesh)
    # The normals of one mesh. Few meshes have any that lean, so only these are read at once.
    for mesh in sorted(leaning):
        with document.budget.passing():
            together = []
            for entry in read[mesh]:
                primitive = read_primitive(document, entry)
                work = Cost.SUMMED_VERTEX * len(primitive.positions)
                document.budget.claim(work, "comparing its normals", entry.place)
                together.append((primitive, entry.place))
            tell(*lean_notices(together))
    made = list(made_states(document))
    return InspectResult(
        input=source,
        byte_length=len(document.raw or b"") + bytes_beside(document),
        meshes=len(document.asset.meshes),
        skins=len(document.asset.skins),
        animations=len(document.asset.animations),
        primitives=tuple(primitives),
        notices=tuple(document.notices),
        left=file_left(document) is not None,
        morphs=tuple(
            MorphSummary(one.source.place, one.of, one.targets, one.frames, one.changed) for one in made
        ),
    )


def _summary(document: Document, source: PrimitiveSource, primitive: SkinnedPrimitive) -> PrimitiveSummary:
    work = Cost.SUMMED_VERTEX * len(primitive.positions) + Cost.SUMMED_SLOT * primitive.joints.size
    document.budget.claim(work, "summing it up", source.place)
    _, defects = weight_field(primitive)
    sums = primitive.weights.astype(np.float64).sum(axis=1)
    attributes = [_attribute(document, source, name) for name in source.attributes]
    note = gradient_note(document, source)
    bake = None
    if note is not None:
        names = {*note.slot_names, *note.blend_names}
        gone = sorted(names - source.attributes.keys())
        changed = (*changed_arrays(note.digest, note.frame, primitive), *gone)
        size = sum(attribute.byte_length for attribute in attributes if attribute.name in names)
        how = f"gradients {note.gradients}, frame from {note.frame}, weighting {note.weighting}"
        words = [f"by {note.generator}, {how}, neighbours {note.neighbours}"]
        words += [f"encoding {note.encoding}"] if note.encoding != Encoding.FLOAT32 else []
        words += [f"layout {note.layout}"] if note.layout != Layout.ATTRIBUTES else []
        words += [f"blend weights {note.blend.weights}"] if note.blend else []
        _, other = note.refusal(source.influence_sets) or ("", None)
        bake = BakeSummary(note.json, ", ".join(words), changed, size, other)
    return PrimitiveSummary(
        place=source.place,
        vertices=len(primitive.positions),
        triangles=len(primitive.triangles),
        joints=source.joint_count,
        influence_sets=source.influence_sets,
        influences=int(np.count_nonzero(primitive.weights > 0, axis=1).max(initial=0)),
        weight_sums=(float(sums.min()), float(sums.max())),
        defects=defects._asdict(),
        frame=_frame(document, source, primitive),
        attributes=tuple(attributes),
        compression=compression_of(document, source),
        morph_targets=len(source.whole_targets),
        bake=bake,
        correctives=_correctives(document, source, primitive),
    )


def _correctives(
    document: Document, source: PrimitiveSource, primitive: SkinnedPrimitive
) -> CorrectiveSummary | None:
    """Return what the metadata of its mesh says of the correctives of a primitive, None if it has none."""
    note = corrective_notes(document).get(source.mesh)
    if note is None:
        return None
    changed, fit = changed_since(document, source, primitive, note)
    still_fit = () if fit else changed or ("targets",)
    return CorrectiveSummary(note.generator, note.targets, note.clips, still_fit)


def _frame(document: Document, source: PrimitiveSource, primitive: SkinnedPrimitive) -> str:
    """Return the frame that bake would take."""
    if len(primitive.normals) == 0:
        return "none: no NORMAL"
    if has_float_tangents(document, source):
        primitive = with_straight_tangents(primitive)
    return chosen_frame(primitive, FrameChoice.AUTO).kind


def _attribute(document: Document, source: PrimitiveSource, name: str) -> AttributeSummary:
    place = source.place.at(name)
    stored, size = document.asset.accessors[document.asset.accessor_of(source, name) or 0].described(place)
    return AttributeSummary(name, stored, size)
