"""A primitive as it was before its bake: its influences, its tangents, and its Draco stream.

They are known again by their content, since other tools renumber accessors.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from skinbake.errors import InputError, Place
from skinbake.format.metadata import (
    FORMER_ATTRIBUTES,
    KEY,
    STRAIGHTENED,
    influence_digests,
    noted_names,
    tangent_digest,
)
from skinbake.gltf.accessors import read_accessor
from skinbake.gltf.codecs import draco
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject, index

BEFORE, ACCESSORS = "before", "accessors"


def note_former_stream(former: JsonObject, accessors: JsonObject) -> JsonObject:
    """Return the ``extras`` of a new Draco extension: the former ``extras``, with the former extension noted.

    accessors has, by name, the accessors of the attributes that the new stream replaces or leaves out.
    """
    extras = former.get("extras")
    note = {BEFORE: former, **({ACCESSORS: accessors} if accessors else {})}
    return {**(extras if isinstance(extras, dict) else {}), KEY: note}


def with_former_stream(primitive: JsonObject) -> JsonObject | None:
    """Return the primitive with the stream that it had before a bake. None: bake noted no stream.

    Its attributes are the present ones, except the ones that adoption replaced.
    """
    extension = draco.extension_of(primitive) or {}
    extras = extension.get("extras")
    note = extras.get(KEY) if isinstance(extras, dict) else None
    before = note.get(BEFORE) if isinstance(note, dict) else None
    if not isinstance(note, dict) or not isinstance(before, dict):
        return None
    attributes, former = primitive.get("attributes"), note.get(ACCESSORS, {})
    if not isinstance(attributes, dict) or not isinstance(former, dict):
        return None
    extensions = {**primitive["extensions"], draco.EXTENSION: before}
    return {**primitive, "attributes": {**attributes, **former}, "extensions": extensions}


def former_attributes(
    document: Document, attributes: JsonObject, note: JsonObject, place: Place
) -> dict[str, int] | None:
    """Return the accessors to restore if bake adopted joints, empty if it adopted none.

    None if they must not be restored: the accessors in the metadata no longer hold the former influences, or
    the adopted ones have been edited since and the edits would be lost.
    """
    former, noted, digest = note.get("adopted"), note.get("formerDigest"), note.get("digest")
    if former is None:
        return {}
    if not isinstance(former, dict) or not isinstance(digest, dict):
        return None
    try:
        draco.add_former_streams(document, with_former_stream)
        count = len(document.objects("accessors"))
        numbers = {name: index(former, name, count, place.at(name)) for name in former}
        found = {name: number for name, number in numbers.items() if number is not None}
        now = _influence_digests(document, attributes, place)
        before = _influence_digests(document, former_sets({**attributes, **found}, note), place)
    except InputError:
        return None
    unedited = now == {name: digest.get(name) for name in now}
    return found if unedited and before == noted else None


def former_tangent(
    document: Document, attributes: JsonObject, note: JsonObject, place: Place
) -> dict[str, int] | None:
    """Return the accessor of TANGENT to restore if bake straightened it, empty if it did not.

    None if it must not be restored: the former accessor has other content now, or TANGENT has been edited.
    """
    noted, digest = note.get(STRAIGHTENED), note.get("digest")
    if noted is None:
        return {}
    if not isinstance(noted, dict) or not isinstance(digest, dict):
        return None
    where = place.at("TANGENT")
    try:
        draco.add_former_streams(document, with_former_stream)
        count = len(document.objects("accessors"))
        former, now = (index(holder, "TANGENT", count, where) for holder in (noted, attributes))
        if former is None or now is None:
            return None
        digests = [
            tangent_digest(read_accessor(document, number, where).decoded()) for number in (former, now)
        ]
    except InputError:
        return None
    return {"TANGENT": former} if digests == [noted.get("digest"), digest.get("TANGENT")] else None


def former_sets(attributes: JsonObject, note: JsonObject) -> JsonObject:
    """Return the attributes without the influence sets that bake added."""
    if FORMER_ATTRIBUTES not in note:
        return attributes
    noted = noted_names(note, FORMER_ATTRIBUTES)
    return {
        name: number
        for name, number in attributes.items()
        if name in noted or not name.startswith(("JOINTS_", "WEIGHTS_"))
    }


def _influence_digests(document: Document, attributes: JsonObject, place: Place) -> dict[str, str]:
    """Return the digests of JOINTS and WEIGHTS, all sets side by side, as in the metadata."""
    count = len(document.objects("accessors"))
    sets: dict[str, list[npt.NDArray[Any]]] = {"JOINTS": [], "WEIGHTS": []}
    while f"JOINTS_{len(sets['JOINTS'])}" in attributes:
        for kind, arrays in sets.items():
            number = index(attributes, f"{kind}_{len(arrays)}", count, place)
            if number is None:
                raise InputError(f"it has no {kind}_{len(arrays)}", place)
            stored = read_accessor(document, number, place)
            arrays.append(stored.values if kind == "JOINTS" else stored.decoded())
    for kind, arrays in sets.items():
        if not arrays or len({len(values) for values in arrays}) > 1:
            raise InputError(f"its {kind} sets have different numbers of vertices, or are missing", place)
    with np.errstate(invalid="ignore"):  # sets of different types are joined: a signalling NaN is cast
        joints, weights = (np.concatenate(arrays, axis=1) for arrays in sets.values())
    return influence_digests(joints, weights)
