"""A primitive as it was before its bake: its influences, its tangents, and its Draco stream.

They are known again by their content, since other tools renumber accessors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from skinbake.errors import BrokenPassedOver, InputError, Place
from skinbake.format.digests import INFLUENCE_TYPES, array_digest, influence_digests
from skinbake.format.note import GradientNote, stream_note
from skinbake.gltf.budget import ELEMENTS, Cost
from skinbake.gltf.codecs import draco
from skinbake.gltf.document import Document, once_a_document
from skinbake.gltf.json_access import JsonObject
from skinbake.gltf.reading.accessors import StoredArray, read_accessor


def with_former_stream(primitive: JsonObject) -> JsonObject | None:
    """Return the primitive with the stream that it had before a bake. None: bake noted no stream.

    Its attributes are the present ones, except what adoption replaced.
    """
    note = stream_note(draco.extension_of(primitive) or {})
    attributes = primitive.get("attributes")
    if note is None or not isinstance(attributes, dict):
        return None
    extensions = {**primitive["extensions"], draco.EXTENSION: note.before}
    return {**primitive, "attributes": {**attributes, **note.accessors}, "extensions": extensions}


def former_attributes(
    document: Document, attributes: JsonObject, note: GradientNote, place: Place
) -> dict[str, int] | None:
    """Return the accessors to restore if bake adopted joints, empty if it adopted none.

    None if they must not be restored: the accessors in the metadata no longer hold the former influences, or
    the adopted ones have been edited since and the edits would be lost.
    """
    if note.adopted is None:
        return {} if note.former_attributes is None else None
    now: dict[str, str] | None = None
    with BrokenPassedOver():
        draco.add_former_streams(document, with_former_stream)
        now, _ = _influence_digests(document, attributes, place)
    if now is None or now != {name: note.digest.get(name) for name in now}:
        return None
    for by_digest in (False, True):
        with BrokenPassedOver():
            found = {
                name: number
                for name, number in note.adopted.items()
                if document.asset.accessor_at(number) is not None
            }
            if by_digest:
                # The accessors of any numbers that hold the former JOINTS_0 and WEIGHTS_0. The digests of
                # several sets are of all sets together, and find none of them.
                digests = {name: note.former_digest.get(name.removesuffix("_0")) for name in note.adopted}
                again = {
                    name: _with_digest(document, attributes, name, one, place)
                    for name, one in digests.items()
                }
                found = {name: number for name, number in again.items() if number is not None}
            restored = former_sets({**attributes, **found}, note)
            before, covered = _influence_digests(document, restored, place)
            if before == note.former_digest and found.keys() <= covered:
                return found
    return None


def _with_digest(
    document: Document, attributes: JsonObject, name: str, digest: str | None, place: Place
) -> int | None:
    """Return an accessor that has a digest, and as many rows of four numbers as that of an attribute."""
    accessor = document.asset.accessor(attributes, name, place)
    if accessor is None or digest is None:
        return None
    count = accessor.count(place)
    return _by_digest(document, count).get(digest)


@once_a_document
def _by_digest(document: Document, count: int) -> dict[str | None, int]:
    """Return the accessors of so many rows of four numbers by digest, or some of them if there are too many.

    All accessors that are looked at have room in the document, unless many share their bytes.
    """
    fours = _fours_of(document)
    room = max(document.budget.backed, ELEMENTS.free) - fours.looked_at
    some = fours.by_count.get(count, [])[: room // count]
    fours.looked_at += count * len(some)
    return {_digest(document, number, document.place): number for number in reversed(some)}


@dataclass
class _Fours:
    """The accessors of rows of four numbers by their number of rows, and the rows that were looked at."""

    by_count: dict[float, list[int]]
    looked_at: int = 0


@once_a_document
def _fours_of(document: Document) -> _Fours:
    found: dict[float, list[int]] = {}
    for number, accessor in enumerate(document.objects("accessors")):
        size = accessor.get("count")
        if isinstance(size, int | float) and accessor.get("type") == "VEC4" and "bufferView" in accessor:
            found.setdefault(size, []).append(number)  # 4.0 is the same key as 4
    return _Fours(found)


def _digest(document: Document, number: int, place: Place) -> str | None:
    """Return the digest of an accessor in the form of the metadata, None if it cannot be read."""
    with BrokenPassedOver():
        stored = _read(document, number, place)
        kind = stored.values.dtype
        is_joints = kind.kind == "u" and kind.itemsize <= 2 and not stored.normalized
        values, name = (stored.values, "JOINTS") if is_joints else (stored.decoded(), "WEIGHTS")
        return array_digest(values, INFLUENCE_TYPES[name])
    return None


def _read(document: Document, number: int, place: Place) -> StoredArray:
    """Return an accessor, and count the memory of its digest: many primitives may name it."""
    stored = read_accessor(document, number, place)
    document.budget.claim(Cost.DIGESTED_NUMBER * stored.values.size, "its digest", place, passing=True)
    return stored


def former_tangent(
    document: Document, attributes: JsonObject, note: GradientNote, place: Place
) -> dict[str, int] | None:
    """Return the accessor of TANGENT to restore if bake straightened it, empty if it did not.

    None if it must not be restored: the former accessor has other content now, or TANGENT has been edited.
    """
    if note.straightened is None:
        return {}
    before, after = note.straightened.digest, note.digest.get("TANGENT")
    if before is None or after is None:  # so is the digest of an accessor that cannot be read
        return None
    where = place.at("TANGENT")
    with BrokenPassedOver():
        draco.add_former_streams(document, with_former_stream)
        now = document.asset.accessor(attributes, "TANGENT", where)
        if now is None or _digest(document, now.number, where) != after:
            return None
        former = document.asset.accessor_at(note.straightened.tangent)
        if former is not None and _digest(document, former.number, where) == before:
            return {"TANGENT": former.number}
        again = _with_digest(document, attributes, "TANGENT", before, where)
        return None if again is None else {"TANGENT": again}
    return None


def former_sets(attributes: JsonObject, note: GradientNote) -> JsonObject:
    """Return the attributes without the influence sets that bake added."""
    if note.former_attributes is None:
        return attributes
    return {
        name: number
        for name, number in attributes.items()
        if name in note.former_attributes or not name.startswith(("JOINTS_", "WEIGHTS_"))
    }


def _influence_digests(
    document: Document, attributes: JsonObject, place: Place
) -> tuple[dict[str, str], set[str]]:
    """Return the digests of JOINTS and WEIGHTS, all sets side by side, and the attributes that they cover."""
    sets: dict[str, list[npt.NDArray[Any]]] = {"JOINTS": [], "WEIGHTS": []}
    while f"JOINTS_{len(sets['JOINTS'])}" in attributes:
        for kind, arrays in sets.items():
            accessor = document.asset.needed(attributes, f"{kind}_{len(arrays)}", place)
            stored = _read(document, accessor.number, place)
            arrays.append(stored.values if kind == "JOINTS" else stored.decoded())
    for kind, arrays in sets.items():
        if not arrays or len({len(values) for values in arrays}) > 1:
            raise InputError(f"its {kind} sets have different numbers of vertices, or are missing", place)
    with np.errstate(invalid="ignore"):  # sets of different types are joined: a signalling NaN is cast
        joints, weights = (np.concatenate(arrays, axis=1) for arrays in sets.values())
    covered = {f"{kind}_{number}" for kind, arrays in sets.items() for number in range(len(arrays))}
    return influence_digests(joints, weights), covered
