"""The baked primitives of a file, read back with their metadata and checked for their structure."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from skinbake.bake.baker import TANGENT_TOLERANCE
from skinbake.errors import Notice
from skinbake.geometry import frames
from skinbake.geometry.skinned import FloatArray, SkinnedPrimitive
from skinbake.gltf.accessors import read_accessor
from skinbake.gltf.document import Document
from skinbake.gltf.former import former_attributes
from skinbake.gltf.json_access import JsonObject, index
from skinbake.gltf.limit import common_unit
from skinbake.gltf.metadata import FORMER_ATTRIBUTES, VERSION, changed_arrays, read_metadata
from skinbake.gltf.primitives import PrimitiveSource, read_influences, read_primitive
from skinbake.gltf.skin_groups import meshes_of_one_skin
from skinbake.verify.limits import limited_primitive

WELDS = ("mesh", "skin")
WEIGHTINGS = ("max", "angle", "area", "angle-area")
FRAMES = (frames.NORMAL_FRAME, frames.TANGENT_FRAME)
BAKE = "run skinbake bake"


@dataclass(frozen=True, slots=True)
class BakedView:
    """One baked primitive as it stands in the file.

    now holds its arrays, before the arrays from before adoption where the file still has them (else now).
    alpha, beta (V, K − 1); tangents, bitangents (V, 3) of the frame that the metadata names. changed are the
    digests that no longer hold.
    """

    source: PrimitiveSource
    metadata: JsonObject
    now: SkinnedPrimitive
    before: SkinnedPrimitive
    alpha: FloatArray
    beta: FloatArray
    tangents: FloatArray
    bitangents: FloatArray
    changed: tuple[str, ...]


def is_baked(document: Document, source: PrimitiveSource) -> bool:
    """Tell whether a primitive carries metadata of a bake, or attributes of the usual names."""
    return read_metadata(document, source.json) is not None or any(
        name.startswith("_SKINBAKE_") for name in source.attributes
    )


def baked_views(
    document: Document, sources: Sequence[PrimitiveSource]
) -> tuple[list[BakedView], list[Notice]]:
    """Return every baked primitive that holds together, and a problem for each that does not."""
    views: list[BakedView] = []
    problems: list[Notice] = []
    for source in sources:
        found = _view(document, source)
        if isinstance(found, BakedView):
            views.append(found)
            problems += _skewed(found)
        else:
            problems.append(found)
    return views, [*problems, *_contradictions(document, views)]


def gathered_together(document: Document, views: Sequence[BakedView]) -> list[list[BakedView]]:
    """Return the views in the groups that one bake gathered as one surface, by what their metadata says.

    Groups and views keep their order. Where one is welded over its skin, all that the same skins draw are:
    that all of them say so is for ``baked_views`` to check.
    """
    meshes = list(dict.fromkeys(view.source.mesh for view in views))
    groups = [[mesh] for mesh in meshes]
    if any(_weld(view) == "skin" for view in views):
        groups, _ = meshes_of_one_skin(document, meshes)
    return [[view for view in views if view.source.mesh in group] for group in groups]


def _weld(view: BakedView) -> str:
    return str(view.metadata.get("weld", WELDS[0]))


def _view(document: Document, source: PrimitiveSource) -> BakedView | Notice:
    metadata = read_metadata(document, source.json)
    if metadata is None:
        what = "has α/β but no metadata that can be read" if is_baked(document, source) else "is not baked"
        return Notice("metadata-missing", f"it {what}: {BAKE}", source.place)
    version = metadata.get("version")
    if isinstance(version, bool) or version != VERSION:
        message = f"its metadata has version {_shown(version)}, this skinbake reads {VERSION}: {BAKE}"
        return Notice("version", message, source.place)
    wrong = next(_wrong_members(metadata, source), None)
    if wrong is not None:
        return Notice("metadata-broken", f"its metadata is damaged: {wrong}; {BAKE}", source.place)
    now = read_primitive(document, source)
    arrays = []
    for key in ("alpha", "beta"):
        found = _stored_slots(document, source, metadata[key], now)
        if isinstance(found, Notice):
            return found
        arrays.append(found)
    frame = _rest_frame(now, metadata["frame"])
    if frame is None:
        message = (
            "it was baked for TANGENT, which was removed since (some tools do where no material needs it). "
            f"Bake last: {BAKE} on the file that the last tool wrote"
        )
        return Notice("frame", message, source.place)
    changed = changed_arrays(metadata, now)
    before = _before_adoption(document, source, metadata, now)
    return BakedView(source, metadata, now, before, arrays[0], arrays[1], frame[0], frame[1], changed)


def _wrong_members(metadata: JsonObject, source: PrimitiveSource) -> Iterator[str]:
    """Yield what is wrong with each member of the metadata that is not as CONVENTIONS.md has it."""
    if metadata.get("frame") not in FRAMES:
        yield f'"frame" is {_shown(metadata.get("frame"))}'
    if metadata.get("weld", WELDS[0]) not in WELDS:
        yield f'"weld" is {_shown(metadata.get("weld"))}'
    if metadata.get("weighting") not in WEIGHTINGS:
        yield f'"weighting" is {_shown(metadata.get("weighting"))}'
    angle = metadata.get("creaseAngle")
    if isinstance(angle, bool) or not isinstance(angle, int | float) or not 0 <= angle <= 180:
        yield f'"creaseAngle" is {_shown(angle)}'
    slots, now = metadata.get("influences"), 4 * source.influence_sets
    if isinstance(slots, bool) or slots != now:
        yield f'"influences" is {_shown(slots)}, and it has {now} a vertex'
    for key in ("alpha", "beta"):
        names = metadata.get(key)
        if not isinstance(names, list) or not _are_names(names, source.influence_sets):
            yield f'"{key}" is {_shown(names)}, not an attribute for each influence set'
    digest = metadata.get("digest")
    if not isinstance(digest, dict) or not digest:
        yield f'"digest" is {_shown(digest)}'
        return
    wanted = ["POSITION", "NORMAL", "JOINTS", "WEIGHTS", "indices"]
    if metadata.get("frame") == frames.TANGENT_FRAME:
        wanted.append("TANGENT")
    for name in wanted:
        if not isinstance(digest.get(name), str):
            yield f'"digest" of {name} is {_shown(digest.get(name))}'


def _are_names(values: list[Any], count: int) -> bool:
    return len(values) == count and all(isinstance(value, str) for value in values)


def _shown(value: object) -> str:
    if value is None:
        return "missing"
    shown = repr(value)
    return shown if len(shown) <= 40 else f"{shown[:40]}…"


def _stored_slots(
    document: Document, source: PrimitiveSource, names: Sequence[str], primitive: SkinnedPrimitive
) -> FloatArray | Notice:
    """Return α or β of slots 1 … K − 1, (V, K − 1), or the problem with it."""
    parts = []
    for number, name in enumerate(names):
        place = source.place.at(name)
        accessor = index(source.attributes, name, len(document.objects("accessors")), place)
        if accessor is None:
            message = f"its metadata names this attribute, which was removed or renamed since: {BAKE}"
            return Notice("attribute-missing", message, place)
        values = read_accessor(document, accessor, place).values
        components = 3 if number == 0 else 4
        if values.dtype != np.float32:
            message = (
                f"it is stored as {values.dtype.name}, FLOAT is needed: it looks quantised after its bake. "
                f"Bake last: {BAKE} on the file that the last tool wrote, or keep the tool off this attribute"
            )
            return Notice("attribute-format", message, place)
        if values.shape != (len(primitive.positions), components):
            message = (
                f"it holds {values.shape[0]:,} vectors of {values.shape[1]}, expected "
                f"{len(primitive.positions):,} of {components}: {BAKE}"
            )
            return Notice("attribute-format", message, place)
        broken = int(np.count_nonzero(~np.isfinite(values).all(axis=1)))
        if broken:
            message = f"at {broken:,} vertices it is not a finite number: {BAKE}"
            return Notice("attribute-not-finite", message, place, broken)
        parts.append(values)
    return np.concatenate(parts, axis=1).astype(np.float32)


def _rest_frame(primitive: SkinnedPrimitive, kind: str) -> tuple[FloatArray, FloatArray] | None:
    """Return (t0, b0) of the frame that the metadata names, None where its TANGENT is gone."""
    normals = frames.unit_normals(primitive.normals)
    if kind == frames.NORMAL_FRAME:
        return frames.frame_from_normal(normals)
    if primitive.tangents is None:
        return None
    return frames.frame_from_tangent(normals, primitive.tangents)


def _before_adoption(
    document: Document, source: PrimitiveSource, metadata: JsonObject, now: SkinnedPrimitive
) -> SkinnedPrimitive:
    """Return the primitive with the influences that its bake began with, or as it is now where they are gone.

    Those are the file's from before it, or what its limit of influences leaves of them.

    α and β come from those; the weights that adoption gave its slots are too small to matter much.
    """
    former = former_attributes(document, source.attributes, metadata, source.place)
    if not former:
        return now
    attributes = {**source.attributes, **former}
    source = replace(source, json={**source.json, "attributes": attributes})
    before = read_primitive(document, source)
    if FORMER_ATTRIBUTES not in metadata:
        return before
    unit = common_unit(read_influences(document, source, len(before.positions)))
    return limited_primitive(before, now.joints.shape[1], unit)


def _skewed(view: BakedView) -> Iterator[Notice]:
    """Yield a problem where the rest frame's normal is not the one stored."""
    if (
        view.metadata["frame"] != frames.TANGENT_FRAME
        or view.now.tangents is None
        or "TANGENT" in view.changed
    ):
        return
    used = np.unique(view.now.triangles)
    normals = frames.unit_normals(view.now.normals[used])
    angles = frames.tangent_deviation(normals, view.now.tangents[used])
    count, largest = int(np.count_nonzero(angles > TANGENT_TOLERANCE)), float(angles.max(initial=0.0))
    if count:
        message = (
            f"at {count:,} vertices TANGENT × bitangent leans more than {TANGENT_TOLERANCE}° from NORMAL "
            f"(up to {largest:.3g}°), and so does the lighting at rest: {BAKE} with --frame normal"
        )
        yield Notice("tangents-skewed", message, view.source.place, count)


def _contradictions(document: Document, views: Sequence[BakedView]) -> Iterator[Notice]:
    """Yield a problem for each primitive whose settings are not those of the first it was gathered with.

    The primitives of a mesh, or of a skin, are gathered together: one bake made them all.
    """
    for group in gathered_together(document, views):
        other = group[0]
        theirs = _gathering(other)
        for view in group[1:]:
            for key, ours in _gathering(view).items():
                if ours != theirs[key] and not (key == "creaseAngle" and math.isclose(ours, theirs[key])):
                    message = (
                        f'its metadata is damaged: "{key}" is {_shown(ours)}, and {_shown(theirs[key])} in '
                        f"{other.source.place.within_file}, which it was gathered with; {BAKE}"
                    )
                    yield Notice("metadata-broken", message, view.source.place)


def _gathering(view: BakedView) -> dict[str, Any]:
    """Return the settings that all primitives of one surface share."""
    return {"weld": _weld(view), **{key: view.metadata[key] for key in ("weighting", "creaseAngle")}}
