"""Store the geometry of a document in another compression before a bake: values stay, bytes change.

``--compress none``, ``draco`` and ``meshopt`` recode. The default, ``keep``, does nothing here: the additions
of bake are then stored like their primitive (``attribute_store``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from skinbake.choices import Scheme
from skinbake.errors import InputError, Notice, Place
from skinbake.geometry.triangles import TRIANGLES
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.budget import Cost
from skinbake.gltf.codecs import draco, meshopt
from skinbake.gltf.codecs.meshopt import view_bytes
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import (
    JsonObject,
    entries_of,
    every_object,
    index,
    integer,
    is_number,
    member,
    names,
    objects,
    put_back,
    reference,
    text,
)
from skinbake.gltf.reading.accessors import read_accessor
from skinbake.gltf.reading.meshes import check_format, read_indices
from skinbake.gltf.writing.additions import Additions, Packed
from skinbake.gltf.writing.references import uses_of_accessors
from skinbake.wording import percent

UNSIGNED_SHORT, UNSIGNED_INT = 5123, 5125
SIGNED = (5120, 5122)


@dataclass(frozen=True, slots=True)
class Compression:
    """The compression that ``bake`` writes.

    level is 0 (fast) to 10 (small), None for the default of each codec. bits are the numbers of bits to which
    ``draco`` quantises, by attribute (POSITION, NORMAL, TEXCOORD_0). Other attributes stay exact.
    """

    scheme: Scheme = Scheme.KEEP
    level: int | None = None
    bits: Mapping[str, int] = field(default_factory=dict)


def recoded(document: Document, sources: list[PrimitiveSource], compression: Compression) -> Document:
    """Return the document with its geometry in ``compression``; tell of the exceptions.

    sources are the primitives that will be baked. ``none`` decodes all data that Draco or meshopt compressed,
    animations and images too. ``draco`` and ``meshopt`` compress those primitives and leave all other data as
    it is. Unreferenced bytes are removed from their buffers. A document without any change is returned as it
    is. Raises InputError if its data cannot be read.
    """
    recoder = _Recoder(document)
    if compression.scheme is Scheme.NONE:
        _decompress(recoder)
    elif compression.scheme is Scheme.MESHOPT:
        _into_meshopt(recoder, sources, compression)
    elif compression.scheme is Scheme.DRACO:
        _into_draco(recoder, sources, compression)
    return recoder.finished()


class _Recoder:
    """Collect the changes of a document: accessors, primitives, buffer views, and new bytes."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.additions = Additions(document)
        self.accessors = list(document.objects("accessors"))
        self.views = list(document.objects("bufferViews"))
        self.meshes = [
            {**mesh, "primitives": list(objects(mesh, "primitives", document.place))}
            if "primitives" in mesh
            else mesh
            for mesh in document.objects("meshes")
        ]
        self._uses = uses_of_accessors(document.json)
        self.required: dict[str, None] = {}
        self._changed = False

    def set_primitive(self, place: Place, primitive: JsonObject) -> None:
        self._changed = True
        self.meshes[place.mesh or 0]["primitives"][place.primitive or 0] = primitive

    def set_view(self, number: int, view: JsonObject) -> None:
        self._changed = True
        self.views[number] = view

    def set_accessor(self, number: int, view: int | None, **members: Any) -> None:
        """Give an accessor other data: its own buffer view, or (None) a Draco stream."""
        self._changed = True
        kept = {
            key: value
            for key, value in self.accessors[number].items()
            if key not in {"bufferView", "byteOffset", "sparse"}
        }
        self.accessors[number] = {**({} if view is None else {"bufferView": view}), **kept, **members}

    def own(self, number: int, users: int) -> int:
        """Return an accessor that only ``users`` references name: this one, or a copy if it has more."""
        left = self._uses.get(number, 0) - users
        if left <= 0:
            return number
        self._uses[number] = left
        self.accessors.append(self.accessors[number])
        return len(self.accessors) - 1

    def finished(self) -> Document:
        """Return the document with all changes, or as it was if there are none."""
        if not self._changed:
            return self.document
        changes = {"accessors": self.accessors, "bufferViews": self.views, "meshes": self.meshes}
        applied = self.additions.applied({key: value for key, value in changes.items() if value})
        from skinbake.gltf.writing.compaction import compacted

        result = compacted(self.document, applied)
        # The JSON with its compressions in extensionsUsed and extensionsRequired.
        root = result.json
        ours = {draco.EXTENSION, *meshopt.EXTENSIONS}
        present = _extensions_in(root) & ours
        root = dict(root)
        for key in ("extensionsUsed", "extensionsRequired"):
            kept = [name for name in names(root, key, result.place) if name not in ours or name in present]
            kept += [name for name in self.required if name not in kept]
            put_back(root, key, kept)
        return result.edited(json=root)


def _extensions_in(root: JsonObject) -> set[str]:
    found = (node.get("extensions") for node in every_object(root))
    return {name for extensions in found if isinstance(extensions, dict) for name in extensions}


def _decompress(recoder: _Recoder) -> None:
    document = recoder.document
    done: set[int] = set()
    opened: set[int] = set()
    for number, mesh in enumerate(document.objects("meshes")):
        for position, primitive in enumerate(entries_of(mesh.get("primitives"))):
            if draco.extension_of(primitive) is not None:
                place = Place(document.name, number, text(mesh, "name", document.place), position)
                _leave_draco(recoder, place, primitive, None, done)
    for number, view in enumerate(document.objects("bufferViews")):
        names = meshopt.extensions_of(view, document.place)
        if not names:
            continue
        data = recoder.additions.add_data(view_bytes(document, number, document.place))
        kept = {key: value for key, value in view.items() if key != "extensions"}
        others = {key: value for key, value in view["extensions"].items() if key not in names}
        recoder.set_view(number, {**kept, **data, **({"extensions": others} if others else {})})
        opened.add(number)
    for number, accessor in enumerate(document.asset.accessors):
        if number in done or accessor.is_small_matrix:
            continue
        if reference(accessor.json.get("bufferView")) in opened and "min" in accessor.json:
            values = read_accessor(document, number, document.place).values
            recoder.accessors[number] = {**accessor.json, **_bounds(accessor.json, values)}


def _leave_draco(
    recoder: _Recoder, place: Place, primitive: JsonObject, packed: Packed | None, done: set[int]
) -> None:
    """Give the accessors of a Draco primitive buffer views, and remove the extension."""
    for number, is_index in draco.accessors_inside(recoder.document, primitive, place):
        if number not in done:
            values = read_accessor(recoder.document, number, place).values
            members: JsonObject = {}
            if is_index and values.dtype.kind != "u":
                raise InputError("indices must be of an unsigned integer type", place.at("indices"))
            if packed is not None and is_index:
                values, members = _for_index_codec(values)
            view = recoder.additions.add_values(values, packed, indices=is_index)
            recoder.set_accessor(number, view, **members, **_bounds(recoder.accessors[number], values))
            done.add(number)
    others = {key: value for key, value in primitive["extensions"].items() if key != draco.EXTENSION}
    plain = {key: value for key, value in primitive.items() if key != "extensions"}
    recoder.set_primitive(place, {**plain, **({"extensions": others} if others else {})})


def _for_index_codec(indices: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], JsonObject]:
    """Return indices for the codecs of meshopt, at least as shorts, and the new members of the accessor."""
    if indices.dtype.itemsize > 1:
        return indices, {}
    return indices.astype(np.uint16), {"componentType": UNSIGNED_SHORT}


def _into_meshopt(recoder: _Recoder, sources: list[PrimitiveSource], compression: Compression) -> None:
    document, views = recoder.document, recoder.document.objects("bufferViews")
    used = _extensions_in(document.json)
    name = next((name for name in meshopt.EXTENSIONS if name in used), meshopt.VENDOR)
    level = meshopt.level_of(compression.level)
    packed = Packed(name, level, beside=False)
    done: set[int] = set()
    for source in sources:
        if draco.extension_of(source.json) is not None:
            recoder.required[name] = None
            _leave_draco(recoder, source.place, source.json, packed, done)
        # The accessors of its attributes, then that of its indices.
        holders = [*((source.attributes, name) for name in source.attributes), (source.json, "indices")]
        for holder, key in holders:
            accessor = document.asset.accessor(holder, key, source.place)
            if accessor is None:
                continue
            number, is_index = accessor.number, holder is source.json
            view = index(accessor.json, "bufferView", len(views), source.place)
            is_packed = view is not None and meshopt.extension_of(views[view], source.place) is not None
            stays = is_packed or (accessor.is_small_matrix and not is_index)
            if number not in done and not stays:
                recoder.required[name] = None
                members: JsonObject = {}
                if is_index:
                    values, members = _for_index_codec(read_indices(recoder.document, source)[:, None])
                else:
                    values = read_accessor(recoder.document, number, source.place).values
                view = recoder.additions.add_values(values, packed, indices=is_index)
                recoder.set_accessor(number, view, **members)
            done.add(number)


def _into_draco(recoder: _Recoder, sources: list[PrimitiveSource], compression: Compression) -> None:
    document, tell = recoder.document, recoder.document.notices.tell
    # A stream is written anew where it can then hold what sparse accessors replace.
    anew = {
        source.place
        for source in sources
        if draco.extension_of(source.json) is not None
        and _sparse_inside(document, source) is not None
        and _reason_against_draco(document, source) is None
    }
    groups: dict[tuple[object, ...], list[PrimitiveSource]] = {}
    for source in sources:
        if draco.extension_of(source.json) is not None and source.place not in anew:
            if compression.bits:
                message = (
                    "it is already in Draco and is not quantised again: decode it with --compress none first"
                )
                tell(Notice("bits-ignored", message, source.place))
            continue
        reason = _reason_against_draco(recoder.document, source)
        if reason is not None:
            tell(Notice("not-compressed", f"left as it is, not put into Draco: {reason}", source.place))
        else:
            key = (reference(source.json.get("indices")), *sorted(source.attributes.items()))
            groups.setdefault(key, []).append(source)
    for group in groups.values():
        # Tell of each attribute that bits were asked for and that stays exact.
        for name in compression.bits:
            if (accessor := document.asset.accessor(group[0].attributes, name, group[0].place)) is not None:
                from skinbake.gltf.codecs import draco_stream

                place = group[0].place.at(name)
                values = read_accessor(document, accessor.number, place).values
                reason = draco_stream.reason_against_bits(name, values)
                if reason is not None:
                    message = f"it is not quantised and stays exact: {reason}"
                    tell(Notice("bits-ignored", message, place))
        changes = _streamed(recoder, group[0], len(group), compression)
        for source in group:
            extensions = {**member(source.json, "extensions", source.place), **changes["extensions"]}
            recoder.set_primitive(source.place, {**source.json, **changes, "extensions": extensions})
        recoder.required[draco.EXTENSION] = None


def reason_against_new_stream(document: Document, source: PrimitiveSource) -> str | None:
    """Return the reason why the data of a Draco stream cannot be written to another, None if it can."""
    return _reason_against_draco(document, source, inside_only=True) or _sparse_inside(document, source)


def _reason_against_draco(
    document: Document, source: PrimitiveSource, *, inside_only: bool = False
) -> str | None:
    """Return the reason why a primitive cannot be written to Draco, None if it can.

    All its attributes count, or only those that are already ``inside`` its stream.
    """
    mode = integer(source.json, "mode", source.place, default=TRIANGLES)
    if mode != TRIANGLES:
        return f"its mode is {mode}, but Draco stores only lists of triangles"
    extension = draco.extension_of(source.json) or {}
    chosen = member(extension, "attributes", source.place) if inside_only else source.attributes
    if "POSITION" not in chosen:
        return "it has no POSITION"
    if len(chosen) > draco.MOST_ATTRIBUTES:
        return f"it has {len(chosen)} attributes"
    for name in chosen:
        accessor = document.asset.accessor(source.attributes, name, source.place)
        kind = None if accessor is None else accessor.json.get("componentType")
        reason = ""
        if accessor is not None and accessor.is_small_matrix:
            reason = f"has the type {accessor.json['type']}, which is not stored in Draco"
        elif kind in SIGNED and name != "POSITION":
            reason = "are signed integers, which the encoder cannot store"
        elif kind == UNSIGNED_INT:
            reason = "has 32-bit integers, for which Draco would need gigabytes of memory"
        if reason:
            return f"its {name} {reason}"
    return None


def _sparse_inside(document: Document, source: PrimitiveSource) -> str | None:
    """Return why a stream cannot be written again whose elements a sparse accessor replaces, else None."""
    accessors = document.objects("accessors")
    for number, is_index in draco.accessors_inside(document, source.json, source.place):
        if "sparse" in accessors[number]:
            names = [name for name, other in source.attributes.items() if other == number and not is_index]
            what = ", ".join(names) or "indices"
            return f"its {what} has a sparse accessor over the stream, which programs read in different ways"
    return None


def _streamed(recoder: _Recoder, source: PrimitiveSource, users: int, compression: Compression) -> JsonObject:
    """Put the attributes and triangles of a primitive into a stream; return the changes of its JSON.

    users is the number of primitives that have the same attributes and triangles, and so the same changes.
    """
    document, place = recoder.document, source.place
    accessors = document.objects("accessors")
    numbers = {name: index(source.attributes, name, len(accessors), place) or 0 for name in source.attributes}
    stored = {name: read_accessor(document, number, place.at(name)) for name, number in numbers.items()}
    check_format(stored["POSITION"], "POSITION", 3, place.at("POSITION"))
    arrays = {name: attribute.values for name, attribute in stored.items()}
    corners = index(source.json, "indices", len(accessors), place)
    faces = read_indices(document, source)
    faces = faces[: len(faces) // 3 * 3].reshape(-1, 3)
    level = draco.USUAL_LEVEL if compression.level is None else compression.level
    from skinbake.gltf.codecs import draco_stream

    entries = sum(1 << number for number in compression.bits.values())
    work = Cost.DRACO_STREAM + Cost.DRACO_TABLE_ENTRY * entries
    document.budget.claim(work, "putting it into Draco", place)
    stream = draco_stream.encode(arrays, faces, place, level=level, bits=compression.bits)
    attributes = {name: recoder.own(number, users) for name, number in numbers.items()}
    for name, number in attributes.items():
        bounds = _bounds(recoder.accessors[number], stream.values[name]) if name in compression.bits else {}
        recoder.set_accessor(number, None, **bounds)
    if corners is None:
        recoder.accessors.append({"componentType": UNSIGNED_INT, "count": faces.size, "type": "SCALAR"})
        corners = len(recoder.accessors) - 1
    else:
        corners = recoder.own(corners, users)
        recoder.set_accessor(corners, None, count=int(faces.size))
    inside = {name: stream.unique_ids[name] for name in attributes}
    extension = {"bufferView": recoder.additions.add_stream(stream.data), "attributes": inside}
    return {"attributes": attributes, "indices": corners, "extensions": {draco.EXTENSION: extension}}


def _bounds(accessor: JsonObject, values: npt.NDArray[Any]) -> JsonObject:
    """Return the members min and max of an accessor, if they differ from its values; otherwise none.

    Quantisation, by this run or by an earlier tool, moves the bounded values. glTF requires exact bounds.
    """
    noted: dict[str, Any] = {key: accessor.get(key) for key in ("min", "max")}
    if not all(isinstance(numbers, list) for numbers in noted.values()):
        return {}
    bounds = {"min": values.min(axis=0), "max": values.max(axis=0)}
    if not all(np.isfinite(bound).all() for bound in bounds.values()):
        return {}
    found = {}
    for key, bound in bounds.items():
        numbers: list[Any] = noted[key]
        if len(numbers) == len(bound) and all(map(is_number, numbers)):
            # They equal the bound if they do after rounding to its type.
            rounded = [np.float32(number) for number in numbers] if values.dtype.kind == "f" else numbers
            if rounded == bound.tolist():
                continue
        found[key] = bound.tolist()
    return found


LARGER = 1.15
"""The growth from which it is told as a factor: below it, "1.0 times" would say nothing."""


def tell_draco_growth(before: Document, after: Document) -> None:
    """Tell if a bake with ``--compress draco`` needs more bytes than its input.

    An input that is in Draco already grows by α and β alone, and is not a case for a remedy. Nor is an output
    that Draco could not take.
    """

    def is_in_draco(document: Document) -> bool:
        return any(
            draco.extension_of(primitive) is not None
            for mesh in document.objects("meshes")
            for primitive in objects(mesh, "primitives", document.place)
        )

    if is_in_draco(before) or not is_in_draco(after):
        return
    # The bytes of all buffers, without those that only stand for compressed ones.
    first, last = (
        sum(
            integer(buffer, "byteLength", document.place)
            for buffer in document.objects("buffers")
            if not meshopt.is_fallback(buffer, document.place)
        )
        for document in (before, after)
    )
    if last <= first or not first:
        return
    growth = last / first
    by = f"{growth:.2g} times as large" if growth >= LARGER else f"{percent(growth - 1.0, 1)} larger"
    sizes = f"{by} ({first:,} to {last:,} bytes)"
    message = (
        f"--compress draco makes its buffers {sizes}, because floats stay exact: use --compress meshopt; "
        "--position-bits 14 --normal-bits 10 helps less"
    )
    before.notices.tell(Notice("draco-larger", message, before.place))
