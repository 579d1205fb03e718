"""The baked primitives of a file, read back with their metadata and with their structure checked."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeGuard

import numpy as np

from skinbake.choices import Frame, FrameChoice, Gradients, Weighting, Weld
from skinbake.errors import Chosen, Message, Notice
from skinbake.format.blend_weights import read_blend, wrong_blend
from skinbake.format.metadata import KEPT, POSES, STORED_POSE, VERSION, changed_arrays, read_metadata
from skinbake.format.stored_slots import BAKE, NO_METADATA, read_slots, shown, wrong_storage
from skinbake.geometry import frames
from skinbake.geometry.frames import unit_normals
from skinbake.geometry.skinned import Float64Array, FloatArray, SkinnedPrimitive
from skinbake.gltf.budget import Cost
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject, is_number
from skinbake.gltf.primitives import PrimitiveSource, read_primitive, reason_to_skip, skinned_sources
from skinbake.gltf.scenes import meshes_of_one_skin
from skinbake.gradients.tangents import TANGENT_TOLERANCE, frame_vectors
from skinbake.skinning.rest import RestPrimitive
from skinbake.timing import stage
from skinbake.truth.mesh import normalised_weights
from skinbake.version import FIT
from skinbake.wording import counted


@dataclass(frozen=True, slots=True)
class BakedView:
    """One baked primitive as the file stores it.

    now holds its arrays. alpha, beta are (V, K − 1). tangents, bitangents (V, 3) are the frame that the
    metadata names. changed are the digests that no longer hold. rounding (V, 2) is the largest change that an
    encoding may have made to a value of α, and to a value of β. blend (V, 3) are the blend weight and its
    derivatives along the frame, None without them.
    """

    source: PrimitiveSource
    metadata: JsonObject
    now: SkinnedPrimitive
    alpha: FloatArray
    beta: FloatArray
    tangents: FloatArray
    bitangents: FloatArray
    changed: tuple[str, ...]
    rounding: Float64Array
    blend: Float64Array | None = None


def is_baked(document: Document, source: PrimitiveSource) -> bool:
    """Tell whether a primitive has the metadata of a bake, or attributes of the usual names."""
    return read_metadata(document, source.json) is not None or any(
        name.startswith("_SKINBAKE_") for name in source.attributes
    )


def baked_views(document: Document, sources: Sequence[PrimitiveSource]) -> list[BakedView]:
    """Return every baked primitive whose structure is sound; tell the problem of each other one."""
    views: list[BakedView] = []
    for source in sources:
        found = _view(document, source)
        if isinstance(found, BakedView):
            views.append(found)
            document.notices.tell(*_skewed(found))
        else:
            document.notices.tell(found)
    document.notices.tell(*_contradictions(document, views))
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
    if any(_weld(view) == "skin" for view in views):
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


def _weld(view: BakedView) -> str:
    return str(view.metadata.get("weld", Weld.MESH))


def _view(  # noqa: PLR0911  # one for each problem
    document: Document, source: PrimitiveSource
) -> BakedView | Notice:
    metadata = read_metadata(document, source.json)
    if metadata is None:
        message = NO_METADATA if is_baked(document, source) else f"it is not baked: {BAKE}"
        return Notice("metadata-missing", message, source.place)
    other = other_version(metadata)
    if other is not None:
        return Notice("version", other, source.place)
    wrong = next(_wrong_members(metadata, source), None)
    if wrong is not None:
        return Notice("metadata-broken", f"its metadata is damaged: {wrong}; {BAKE}", source.place)
    now = read_primitive(document, source)
    work = Cost.COMPARED_VERTEX * len(now.positions) + Cost.COMPARED_SLOT * now.joints.size
    work += Cost.COMPARED_TRIANGLE * len(now.triangles)
    document.budget.claim(work, "measuring it", source.place)
    slots = read_slots(document, source, metadata, len(now.positions))
    if isinstance(slots, Notice):
        return slots
    blend = read_blend(document, source, metadata, len(now.positions))
    if isinstance(blend, Notice):
        return blend
    frame = _rest_frame(now, metadata["frame"])
    if frame is None:
        message = (
            "it was baked for TANGENT, which was removed since (some tools do where no material needs it). "
            f"Bake last: {BAKE} on the file that the last tool wrote"
        )
        return Notice("frame", message, source.place)
    with stage("digests"):
        changed = changed_arrays(metadata, now)
    found = slots.alpha, slots.beta, *frame, changed, slots.rounding
    return BakedView(source, metadata, now, *found, blend)


def other_version(metadata: JsonObject) -> str | None:
    """Return which version of the metadata or of a fit cannot be read, and what to do; None if none is."""
    version, fit = metadata["version"], metadata.get("fit")  # ``read_metadata`` finds none without an integer
    if isinstance(version, bool) or version != VERSION:
        remedy = "update skinbake" if version > VERSION else BAKE
        return f"its metadata has version {shown(version)}, this skinbake reads {VERSION}: {remedy}"
    if metadata.get("gradients", Gradients.SURFACE) == Gradients.SURFACE:
        return None
    remedy = BAKE
    if isinstance(fit, int) and not isinstance(fit, bool) and fit > 0:
        if fit <= FIT:
            return None
        remedy = "update skinbake"
    return f"its α/β come from version {shown(fit)} of the fit, this skinbake has {FIT}: {remedy}"


def _wrong_members(metadata: JsonObject, source: PrimitiveSource) -> Iterator[str]:
    """Yield each defect of a member of the metadata (docs/reference/file-format.md)."""
    usual = {"weld": Weld.MESH, "gradients": Gradients.SURFACE}
    names = {"frame": Frame, "weighting": Weighting, "weld": Weld, "gradients": Gradients}
    for name, known in names.items():
        if metadata.get(name, usual.get(name)) not in list(known):
            yield f'"{name}" is {shown(metadata.get(name))}'
    if metadata.get("gradients") == Gradients.POSES and not _names_poses(metadata.get(POSES)):
        yield f'"{POSES}" is {shown(metadata.get(POSES))}'
    for name, is_complete in ((STORED_POSE, _has_fingerprint), (KEPT, _tells_fit)):
        if name in metadata and not is_complete(metadata[name]):
            yield f'"{name}" is {shown(metadata[name])}'
    angle = metadata.get("creaseAngle")
    if isinstance(angle, bool) or not isinstance(angle, int | float) or not 0 <= angle <= 180:
        yield f'"creaseAngle" is {shown(angle)}'
    slots, now = metadata.get("influences"), 4 * source.influence_sets
    if isinstance(slots, bool) or slots != now:
        yield f'"influences" is {shown(slots)}, and it has {now} a vertex'
    yield from wrong_storage(metadata, source.influence_sets)
    yield from wrong_blend(metadata)
    digest = metadata.get("digest")
    if not isinstance(digest, dict) or not digest:
        yield f'"digest" is {shown(digest)}'
        return
    wanted = ["POSITION", "NORMAL", "JOINTS", "WEIGHTS", "indices"]
    if metadata.get("frame") == Frame.TANGENT:
        wanted.append("TANGENT")
    for name in wanted:
        if not isinstance(digest.get(name), str):
            yield f'"digest" of {name} is {shown(digest.get(name))}'


def _names_poses(noted: object) -> bool:
    """Tell whether the member about the poses of a fit is complete."""
    if not _has_fingerprint(noted) or not isinstance(noted.get("from"), list):
        return False
    return all(isinstance(one, str) for one in noted["from"])


def _has_fingerprint(noted: object) -> TypeGuard[JsonObject]:
    """Tell whether a member has a fingerprint of poses, and the digest of α and β."""
    if not isinstance(noted, dict) or not isinstance(noted.get("slots"), str):
        return False
    numbers = noted.get("fingerprint")
    return isinstance(numbers, list) and all(map(is_number, numbers))


def _tells_fit(noted: object) -> bool:
    """Tell whether a member has the share of a fit that was kept."""
    return isinstance(noted, dict) and is_number(noted.get("fit")) and 0 <= noted["fit"] <= 1


def _rest_frame(primitive: SkinnedPrimitive, kind: str) -> tuple[FloatArray, FloatArray] | None:
    """Return (t0, b0) of the frame that the metadata names, or None if its TANGENT is gone."""
    if kind == Frame.TANGENT and primitive.tangents is None:
        return None
    return frame_vectors(primitive, kind)


def _skewed(view: BakedView) -> Iterator[Notice]:
    """Yield a problem if the normal of the rest frame is not the stored one."""
    if view.metadata["frame"] != Frame.TANGENT or view.now.tangents is None or "TANGENT" in view.changed:
        return
    used = np.unique(view.now.triangles)
    normals = frames.unit_normals(view.now.normals[used])
    angles = frames.tangent_deviation(normals, view.now.tangents[used])
    count, largest = int(np.count_nonzero(angles > TANGENT_TOLERANCE)), float(angles.max(initial=0.0))
    if count:
        vertices = counted(count, "vertex", "vertices")
        message = Message(
            f"at {vertices} TANGENT × bitangent leans more than {TANGENT_TOLERANCE}° from NORMAL "
            f"(up to {largest:.3g}°), and so does the lighting at rest: {BAKE} with ",
            Chosen("frame", FrameChoice.NORMAL),
        )
        yield Notice("tangents-skewed", message, view.source.place, count)


def _contradictions(document: Document, views: Sequence[BakedView]) -> Iterator[Notice]:
    """Yield a problem for each primitive whose settings differ from the first primitive of its group.

    The primitives of a mesh, or of a skin, are gathered together, because one bake made all of them.
    """
    for group in gathered_together(document, views):
        other = group[0]
        theirs = _gathering(other)
        for view in group[1:]:
            for key, ours in _gathering(view).items():
                if ours != theirs[key] and not (key == "creaseAngle" and math.isclose(ours, theirs[key])):
                    message = (
                        f'its metadata is damaged: "{key}" is {shown(ours)}, and {shown(theirs[key])} in '
                        f"{other.source.place.within_file}, which it was gathered with; {BAKE}"
                    )
                    yield Notice("metadata-broken", message, view.source.place)


def _gathering(view: BakedView) -> dict[str, Any]:
    """Return the settings that all primitives of one surface share."""
    kind = view.metadata.get("gradients", Gradients.SURFACE)
    return {
        "weld": _weld(view),
        "gradients": kind,
        STORED_POSE: view.metadata.get(STORED_POSE, {}).get("fingerprint"),
        **{key: view.metadata[key] for key in ("weighting", "creaseAngle")},
    }


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
