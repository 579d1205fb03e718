"""The baked primitives of a file, read back with their metadata and checked for their structure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skinbake.errors import Notice
from skinbake.geometry import frames
from skinbake.geometry.skinned import FloatArray, SkinnedPrimitive
from skinbake.gltf.accessors import read_accessor
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject
from skinbake.gltf.metadata import VERSION, digests, read_metadata
from skinbake.gltf.primitives import PrimitiveSource, read_primitive, skinned_sources
from skinbake.gltf.strip import stripped


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
    original, _, _ = stripped(document)
    before = {(entry.mesh, entry.primitive): entry for entry in skinned_sources(original)[0]}
    views, problems = [], []
    for source in sources:
        found = _view(document, source, original, before[source.mesh, source.primitive])
        if isinstance(found, BakedView):
            views.append(found)
        else:
            problems.append(found)
    return views, problems


def _view(
    document: Document, source: PrimitiveSource, original: Document, former: PrimitiveSource
) -> BakedView | Notice:
    metadata = read_metadata(document, source.json)
    if metadata is None:
        what = (
            "has α/β but no metadata: a tool dropped its extras; "
            if is_baked(document, source)
            else "is not baked; "
        )
        return Notice("metadata-missing", f"it {what}run skinbake bake", source.place)
    if metadata.get("version") != VERSION:
        return Notice(
            "version", f"its metadata has version {metadata.get('version')}, not {VERSION}", source.place
        )
    now = read_primitive(document, source)
    arrays = []
    for key in ("alpha", "beta"):
        found = _stored_slots(document, source, metadata, key, now)
        if isinstance(found, Notice):
            return found
        arrays.append(found)
    frame = _rest_frame(now, str(metadata.get("frame")))
    if frame is None:
        return Notice("frame", "it was baked for TANGENT, which it no longer has: bake again", source.place)
    noted = metadata.get("digest")
    current = digests(now, str(metadata["frame"]))
    changed = tuple(n for n in current if not isinstance(noted, dict) or noted.get(n) != current[n])
    before = now if {"JOINTS", "WEIGHTS"} & set(changed) else read_primitive(original, former)
    before = replace(before, normals=now.normals)
    return BakedView(source, metadata, now, before, arrays[0], arrays[1], frame[0], frame[1], changed)


def _stored_slots(
    document: Document, source: PrimitiveSource, metadata: JsonObject, key: str, primitive: SkinnedPrimitive
) -> FloatArray | Notice:
    """Return α or β of slots 1 … K − 1, (V, K − 1), or the problem with it."""
    names = metadata.get(key)
    if not isinstance(names, list) or len(names) != source.influence_sets:
        return Notice(
            "metadata-broken", f'its metadata names no "{key}" for every influence set', source.place
        )
    parts = []
    for number, name in enumerate(names):
        place = source.place.at(str(name))
        if name not in source.attributes:
            message = "this attribute, which its metadata names, is missing: removed or renamed; bake again"
            return Notice("attribute-missing", message, place)
        values = read_accessor(document, source.attributes[name], place).values
        components = 3 if number == 0 else 4
        if values.dtype != np.float32 or values.shape != (len(primitive.positions), components):
            message = (
                f"expected {len(primitive.positions)} FLOAT vectors of {components}, found "
                f"{values.shape[0]} of {values.shape[1]} ({values.dtype}): bake again"
            )
            return Notice("attribute-format", message, place)
        if not np.isfinite(values).all():
            return Notice("attribute-not-finite", "it holds values that are not finite: bake again", place)
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
