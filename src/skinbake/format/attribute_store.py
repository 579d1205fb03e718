"""Store the new attributes of a primitive: in plain views, meshopt views, or its Draco stream."""

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
    """Take the new attributes of one primitive, and make the other changes of its JSON at the end."""

    def add(
        self,
        name: str,
        values: Values,
        *,
        normalized: bool = False,
        extras: JsonObject | None = None,
    ) -> int:
        """Store an attribute (V, components) of a glTF type and return the index of its accessor."""

    def finished(self, primitive: JsonObject) -> JsonObject:
        """Return the JSON of the primitive with all its new attributes, and the changes of their storage."""


def store_for(
    document: Document, additions: Additions, source: PrimitiveSource, level: int | None
) -> AttributeStore:
    """Return the store for the present storage of a primitive: plain, meshopt, or Draco.

    level is that of ``--compress-level``, 0 … 10, None for the default of each codec.
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


def level_ignored(document: Document, sources: Sequence[PrimitiveSource], level: int | None) -> list[Notice]:
    """Return a notice if a level of ``--compress-level`` was given, and no primitive is compressed."""
    if level is None or any(
        draco.extension_of(source.json) is not None or meshopt_of(document, source) is not None
        for source in sources
    ):
        return []
    message = (
        "--compress-level has no effect, because nothing that is baked is compressed: --compress draco or "
        "--compress meshopt compresses it"
    )
    return [Notice("level-ignored", message, document.place)]


def stored_otherwise(document: Document, sources: Sequence[PrimitiveSource]) -> list[Notice]:
    """Return a notice if the storage of primitives must differ from that in ``document``."""
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
    """Return the meshopt extension of any attribute of a primitive, None without one."""
    accessors, views = document.objects("accessors"), document.objects("bufferViews")
    for attribute in source.attributes:
        number = index(source.attributes, attribute, len(accessors), source.place.at(attribute))
        view = index(accessors[number or 0], "bufferView", len(views), source.place.at(attribute))
        name = None if view is None else meshopt.extension_of(views[view], source.place.at(attribute))
        if name is not None:
            return name
    return None


class _PlainStore:
    """Accessors with their own buffer views, which meshopt compresses if ``packed`` says so."""

    def __init__(self, additions: Additions, packed: Packed | None) -> None:
        self._additions, self._packed = additions, packed
        self._taken: set[int] = set()

    def add(
        self,
        name: str,
        values: Values,
        *,
        normalized: bool = False,
        extras: JsonObject | None = None,
    ) -> int:
        number = self._additions.add(
            values, normalized=normalized, extras=extras, packed=self._packed, apart_from=self._taken
        )
        self._taken.add(number)
        return number

    def finished(self, primitive: JsonObject) -> JsonObject:
        return primitive


class _DracoStore:
    """A new stream with all data of the old one, in the order of its decoder, and the new attributes.

    The old stream stays in the file for ``strip``. The extension's ``extras`` name its place.
    """

    def __init__(self, document: Document, additions: Additions, source: PrimitiveSource, level: int) -> None:
        self._document, self._additions, self._source, self._level = document, additions, source, level
        self._new: dict[str, Values] = {}
        self._taken: set[int] = set()

    def add(
        self,
        name: str,
        values: Values,
        *,
        normalized: bool = False,
        extras: JsonObject | None = None,
    ) -> int:
        if (
            values.dtype.kind == "i"
        ):  # DracoPy encodes only unsigned integers and floats, so these go beside the stream
            number = self._additions.add(values, normalized=normalized, extras=extras, apart_from=self._taken)
            self._taken.add(number)
            return number
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
