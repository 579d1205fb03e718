"""The baked primitives of a file, read back with their metadata and with their structure checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from skinbake.choices import Frame, FrameChoice, Gradients, Weld
from skinbake.errors import Chosen, Message, Notice, Place
from skinbake.format.digests import changed_arrays
from skinbake.format.note import BAKE, NO_METADATA, GradientNote, gradient_note, primitive_left
from skinbake.format.stored_slots import DamagedBake, read_blend, read_slots
from skinbake.geometry import frames
from skinbake.geometry.frames import unit_normals
from skinbake.geometry.skinned import Float64Array, FloatArray, SkinnedPrimitive
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.budget import Cost
from skinbake.gltf.document import Document
from skinbake.gltf.reading.meshes import read_primitive, reason_to_skip, skinned_sources
from skinbake.gltf.reading.scenes import meshes_of_one_skin
from skinbake.gradients.tangents import TANGENT_TOLERANCE, frame_vectors
from skinbake.skinning.rest import RestPrimitive
from skinbake.timing import stage
from skinbake.truth.mesh import normalised_weights
from skinbake.wording import counted

if TYPE_CHECKING:
    from skinbake.format.baked import Baked


@dataclass(frozen=True, slots=True)
class BakedView:
    """One baked primitive as the file stores it.

    now holds its arrays. alpha, beta are (V, K − 1). tangents, bitangents (V, 3) are the frame that the
    note names. changed are the digests that no longer hold. rounding (V, 2) is the largest change that an
    encoding may have made to a value of α, and to a value of β. blend (V, 3) are the blend weight and its
    derivatives along the frame, None without them.
    """

    source: PrimitiveSource
    note: GradientNote
    now: SkinnedPrimitive
    alpha: FloatArray
    beta: FloatArray
    tangents: FloatArray
    bitangents: FloatArray
    changed: tuple[str, ...]
    rounding: Float64Array
    blend: Float64Array | None = None

    @classmethod
    def unwritten(cls, baked: Baked) -> BakedView:
        """Return a bake as it will be read, before it is written. Adopted joints have weight 0."""
        primitive, result = baked.primitive, baked.result
        joints = np.where(result.adopted_joints >= 0, result.adopted_joints, primitive.joints)
        now = primitive.with_influences(joints, primitive.weights)
        frame = frame_vectors(primitive, result.frame)
        note, none = baked.note._replace(frame=str(result.frame)), np.zeros((len(joints), 2))
        return cls(baked.source, note, now, result.alpha, result.beta, *frame, (), none)

    @classmethod
    def unbaked(cls, source: PrimitiveSource, now: SkinnedPrimitive) -> BakedView:
        """Return a primitive whose α and β are 0, with a frame from NORMAL."""
        frame = frame_vectors(now, Frame.NORMAL)
        none, note = np.zeros((len(now.joints), now.joints.shape[1] - 1)), GradientNote(frame=Frame.NORMAL)
        return cls(source, note, now, none, none, *frame, (), np.zeros((len(none), 2)))

    @property
    def kind(self) -> Gradients:
        """The kind of α and β."""
        return Gradients(self.note.gradients)


def is_baked(document: Document, source: PrimitiveSource) -> bool:
    """Tell whether a primitive has the note of a bake, or attributes of the usual names."""
    return gradient_note(document, source) is not None or any(
        name.startswith("_SKINBAKE_") for name in source.attributes
    )


def left_on_purpose(document: Document) -> dict[Place, str]:
    """Return the skinned primitives that a bake has left out by a choice, with the words of that."""
    noted = ((source.place, primitive_left(source)) for source in skinned_sources(document))
    return {place: f"left by bake {one.by}: {place.within_file}" for place, one in noted if one is not None}


def baked_views(document: Document, sources: Sequence[PrimitiveSource]) -> list[BakedView]:
    """Return every baked primitive whose structure is sound; tell the problem of each other one."""
    views: list[BakedView] = []
    for source in sources:
        try:
            view = _view(document, source)
        except DamagedBake as damage:
            document.notices.tell(damage.notice)
            continue
        views.append(view)
        # The normal of the rest frame must be the stored one.
        if (
            view.note.frame == Frame.TANGENT
            and view.now.tangents is not None
            and "TANGENT" not in view.changed
        ):
            used = np.unique(view.now.triangles)
            angles = frames.tangent_deviation(unit_normals(view.now.normals[used]), view.now.tangents[used])
            count, largest = int(np.count_nonzero(angles > TANGENT_TOLERANCE)), angles.max(initial=0.0)
            if count:
                vertices = counted(count, "vertex", "vertices")
                leaning = Message(
                    f"at {vertices} TANGENT × bitangent leans more than {TANGENT_TOLERANCE}° from NORMAL "
                    f"(up to {largest:.3g}°), and so does the lighting at rest: {BAKE} with ",
                    Chosen("frame", FrameChoice.NORMAL),
                )
                document.notices.tell(Notice("tangents-skewed", leaning, source.place, count))
    # The primitives of a mesh, or of a skin, are gathered together, because one bake made all of them.
    for first, *others in gathered_together(document, views):
        for view in others:
            for wrong in view.note.differences(first.note, first.source.place.within_file):
                message = f"its metadata is damaged: {wrong}, which it was gathered with; {BAKE}"
                document.notices.tell(Notice("metadata-broken", message, view.source.place))
    return views


def sound_views(document: Document) -> list[BakedView]:
    """Return the baked primitives of a document whose structure is sound, and that light reaches."""
    sound = [
        source
        for source in skinned_sources(document)
        if is_baked(document, source) and reason_to_skip(document, source, generate_normals=False) is None
    ]
    with document.notices.withheld():
        return baked_views(document, sound)


def gathered_together(document: Document, views: Sequence[BakedView]) -> list[list[BakedView]]:
    """Return the views in the groups that one bake gathered as one surface, according to their metadata.

    Groups and views keep their order. If one view is welded over its skin, its group has all views that the
    same skins draw. ``baked_views`` checks that all of them name the same gathering.
    """
    meshes = list(dict.fromkeys(view.source.mesh for view in views))
    groups = [[mesh] for mesh in meshes]
    if any(view.note.weld == Weld.SKIN for view in views):
        groups = meshes_of_one_skin(document, meshes)
    return [[view for view in views if view.source.mesh in group] for group in groups]


def whole_surfaces(document: Document, views: Sequence[BakedView]) -> list[list[BakedView]]:
    """Return the views in the groups that the truths take as one surface, whatever the bake was told.

    Meshes that the same skins draw are one surface. A mesh with morph targets is by itself, because each node
    that draws it has its own weights for them. Groups and views keep their order.
    """
    meshes = list(dict.fromkeys(view.source.mesh for view in views))
    plain = [mesh for mesh in meshes if not document.asset.meshes[mesh].target_count]
    groups = meshes_of_one_skin(document, plain) + [[mesh] for mesh in meshes if mesh not in plain]
    groups.sort(key=lambda group: meshes.index(group[0]))
    return [[view for view in views if view.source.mesh in group] for group in groups]


def _view(document: Document, source: PrimitiveSource) -> BakedView:
    """Return a baked primitive. Raises DamagedBake if its structure is not sound."""
    note, place = gradient_note(document, source), source.place
    if note is None:
        message = NO_METADATA if is_baked(document, source) else f"it is not baked: {BAKE}"
        raise DamagedBake("metadata-missing", message, place)
    refusal = note.refusal(source.influence_sets)
    if refusal is not None:
        raise DamagedBake(*refusal, place)
    now = read_primitive(document, source)
    work = Cost.COMPARED_VERTEX * len(now.positions) + Cost.COMPARED_SLOT * now.joints.size
    work += Cost.COMPARED_TRIANGLE * len(now.triangles)
    document.budget.claim(work, "measuring it", place)
    slots = read_slots(document, source, note, len(now.positions))
    blend = read_blend(document, source, note, len(now.positions))
    if note.frame == Frame.TANGENT and now.tangents is None:
        message = (
            "it was baked for TANGENT, which was removed since (some tools do where no material needs it). "
            f"Bake last: {BAKE} on the file that the last tool wrote"
        )
        raise DamagedBake("frame", message, place)
    with stage("digests"):
        changed = changed_arrays(note.digest, note.frame, now)
    found = slots.alpha, slots.beta, *frame_vectors(now, note.frame), changed, slots.rounding
    return BakedView(source, note, now, *found, blend)


def rest_primitive(view: BakedView) -> RestPrimitive:
    """Return the data of a baked primitive that a replay reads. Joints past the skin's become 0.

    float32 data of the file stays float32. A replay computes in float64, and a million vertices fit in
    memory.
    """
    joints = np.where(view.now.joints < view.source.joint_count, view.now.joints, 0)
    return RestPrimitive(
        positions=view.now.positions.astype(np.float64),
        normals=unit_normals(view.now.normals),
        tangents=view.tangents,
        bitangents=view.bitangents,
        joints=joints,
        weights=normalised_weights(view.now.weights, joints),
        alpha=view.alpha,
        beta=view.beta,
        blend=view.blend,
    )
