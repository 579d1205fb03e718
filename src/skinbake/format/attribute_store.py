"""Where the new attributes of a primitive go: plain views, meshopt's, or the primitive's Draco stream."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from skinbake.errors import Notice
from skinbake.format.former import note_former_stream
from skinbake.gltf.accessors import read_accessor
from skinbake.gltf.additions import Additions, Packed
from skinbake.gltf.codecs import draco, meshopt
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject, index, member
from skinbake.gltf.primitives import PrimitiveSource

Values = npt.NDArray[Any]


class AttributeStore(Protocol):
    """Takes the new attributes of one primitive, and at last changes what else of its JSON they need."""

    def add(
        self,
        name: str,
        values: Values,
        *,
        normalized: bool = False,
        extras: JsonObject | None = None,
    ) -> int:
        """Store an attribute (V, components) of one of glTF's types and return its accessor's index."""

    def finished(self, primitive: JsonObject) -> JsonObject:
        """Return the primitive's JSON, all its new attributes in it, with what their storage changes."""


def store_for(
    document: Document, additions: Additions, source: PrimitiveSource, level: int | None
) -> AttributeStore:
    """Return the store that keeps a primitive as it is stored: plain, by meshopt, or in Draco.

    level is that of ``--compress-level``, 0 … 10, None for each codec's usual one.
    """
    if draco.extension_of(source.json) is not None:
        return _DracoStore(document, additions, source, draco.USUAL_LEVEL if level is None else level)
    name = meshopt_of(document, source)
    if name is None:
        return _PlainStore(additions, None)
    required = document.json.get("extensionsRequired")
    beside = not (isinstance(required, list) and name in required)
    chosen = meshopt.level_of(level)
    return _PlainStore(additions, Packed(name, chosen, beside))


def stored_otherwise(document: Document, sources: Sequence[PrimitiveSource]) -> list[Notice]:
    """Return a notice where primitives cannot be stored quite as they were in ``document``."""
    compressed = [source for source in sources if draco.extension_of(source.json) is not None]
    if not compressed:
        return []
    from skinbake.gltf.codecs.draco_stream import EDGEBREAKER

    count = sum(
        draco.read_stream(document, source.json, source.place).method == EDGEBREAKER for source in compressed
    )
    if not count:
        return []
    streams = "Draco stream is" if count == 1 else "Draco streams are"
    message = (
        f"{count} {streams} stored by the sequential method instead of edgebreaker: it is larger, "
        "but it keeps the order of vertices"
    )
    return [Notice("draco-sequential", message, document.place, count)]


def meshopt_of(document: Document, source: PrimitiveSource) -> str | None:
    """Return the meshopt extension in which any of a primitive's attributes is stored, None where none is."""
    accessors, views = document.objects("accessors"), document.objects("bufferViews")
    for attribute in source.attributes:
        number = index(source.attributes, attribute, len(accessors), source.place.at(attribute))
        view = index(accessors[number or 0], "bufferView", len(views), source.place.at(attribute))
        name = None if view is None else meshopt.extension_of(views[view], source.place.at(attribute))
        if name is not None:
            return name
    return None


class _PlainStore:
    """Accessors with buffer views of their own, which meshopt compresses where ``packed`` says so."""

    def __init__(self, additions: Additions, packed: Packed | None) -> None:
        self._additions, self._packed = additions, packed

    def add(
        self,
        name: str,
        values: Values,
        *,
        normalized: bool = False,
        extras: JsonObject | None = None,
    ) -> int:
        return self._additions.add(values, normalized=normalized, extras=extras, packed=self._packed)

    def finished(self, primitive: JsonObject) -> JsonObject:
        return primitive


class _DracoStore:
    """A new stream that holds all that the old one does, in the order of its decoder, and the new attributes.

    The old stream stays in the file, for strip: the extension's ``extras`` say where.
    """

    def __init__(self, document: Document, additions: Additions, source: PrimitiveSource, level: int) -> None:
        self._document, self._additions, self._source, self._level = document, additions, source, level
        self._new: dict[str, Values] = {}

    def add(
        self,
        name: str,
        values: Values,
        *,
        normalized: bool = False,
        extras: JsonObject | None = None,
    ) -> int:
        if values.dtype.kind == "i":  # DracoPy encodes unsigned integers and floats; beside the stream, then
            return self._additions.add(values, normalized=normalized, extras=extras)
        self._new[name] = values
        return self._additions.add_inside(values, normalized=normalized, extras=extras)

    def finished(self, primitive: JsonObject) -> JsonObject:
        before = draco.extension_of(self._source.json) or {}
        inside = member(before, "attributes", self._source.place)
        left = member(primitive, "attributes", self._source.place)
        names = [name for name in dict.fromkeys([*inside, *self._new]) if name in left]
        view, numbers = self._encoded(names)
        replaced = [name for name in inside if name in self._new or name not in left]
        former = {name: self._source.attributes[name] for name in replaced}
        extension = {
            **before,
            "bufferView": view,
            "attributes": numbers,
            "extras": note_former_stream(before, former),
        }
        return {**primitive, "extensions": {**primitive["extensions"], draco.EXTENSION: extension}}

    def _encoded(self, names: list[str]) -> tuple[int, dict[str, int]]:
        """Return the buffer view of the new stream, and the unique id of each attribute in it."""
        faces = draco.read_stream(self._document, self._source.json, self._source.place).faces
        arrays = {name: self._values(name) for name in names}
        from skinbake.gltf.codecs import draco_stream

        stream = draco_stream.encode(arrays, faces, self._source.place, level=self._level)
        numbers = {name: stream.unique_ids[name] for name in names}
        return self._additions.add_stream(stream.data), numbers

    def _values(self, name: str) -> npt.NDArray[Any]:
        if name in self._new:
            return np.asarray(self._new[name])
        number = int(self._source.attributes[name])
        return read_accessor(self._document, number, self._source.place.at(name)).values
