"""Store the new attributes of a primitive: in plain views, meshopt views, or its Draco stream."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from skinbake.errors import Notice
from skinbake.format.note import StreamNote, with_note
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.budget import Cost
from skinbake.gltf.codecs import draco, meshopt
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject, index, member
from skinbake.gltf.reading.accessors import read_accessor
from skinbake.gltf.writing.additions import Additions, Packed

Values = npt.NDArray[Any]


def store_for(
    document: Document, additions: Additions, source: PrimitiveSource, level: int | None
) -> AttributeStore:
    """Return the store for the present storage of a primitive: plain, meshopt, or Draco.

    level is that of ``--compress-level``, 0 … 10, None for the default of each codec.
    """
    if draco.extension_of(source.json) is not None:
        return _DracoStore(document, additions, source, draco.USUAL_LEVEL if level is None else level)
    return AttributeStore(additions, meshopt_packing(document, source, level))


def meshopt_packing(document: Document, source: PrimitiveSource, level: int | None) -> Packed | None:
    """Return how new data of a primitive is compressed by meshopt, None if the primitive is not."""
    name = meshopt_of(document, source)
    if name is None:
        return None
    required = document.json.get("extensionsRequired")
    beside = not (isinstance(required, list) and name in required)
    return Packed(name, meshopt.level_of(level), beside)


def tell_level_ignored(document: Document, sources: Sequence[PrimitiveSource], level: int | None) -> None:
    """Tell if a level of ``--compress-level`` was given, and no primitive is compressed."""
    if level is None or any(
        draco.extension_of(source.json) is not None or meshopt_of(document, source) is not None
        for source in sources
    ):
        return
    message = (
        "--compress-level has no effect, because nothing that is baked is compressed: --compress draco or "
        "--compress meshopt compresses it"
    )
    document.notices.tell(Notice("level-ignored", message, document.place))


def tell_stored_otherwise(document: Document, sources: Sequence[PrimitiveSource], written: Document) -> None:
    """Tell of Draco streams that the bake ``written`` replaces, or that hold former influences."""
    sequential = 0
    for source in sources:
        before = draco.extension_of(source.json)
        if before is None:
            continue
        from skinbake.gltf.codecs.draco_stream import EDGEBREAKER

        after = written.asset.counterpart(source)
        extension = draco.extension_of(after.json) or {}
        if extension.get("bufferView") != before.get("bufferView"):
            method = draco.read_stream(document, source.json, source.place).method
            sequential += method == EDGEBREAKER
            continue
        inside = member(before, "attributes", source.place).keys() - extension.get("attributes", {}).keys()
        if beside := sorted(inside & after.attributes.keys()):
            from skinbake.gltf.writing.recode import reason_against_new_stream

            message = (
                f"its new {' and '.join(beside)} are stored beside its Draco stream, not in it: "
                f"{reason_against_new_stream(document, source)}. Babylon.js and PlayCanvas do not read them "
                "there: for these, bake with --compress none"
            )
            document.notices.tell(Notice("not-compressed", message, source.place))
    if not sequential:
        return
    streams = "Draco stream is" if sequential == 1 else "Draco streams are"
    message = (
        f"{sequential} {streams} stored by the sequential method instead of edgebreaker, because influences, "
        "tangents or normals are new: it is larger, but it keeps the order of vertices"
    )
    document.notices.tell(Notice("draco-sequential", message, document.place, sequential))


def compression_of(document: Document, source: PrimitiveSource) -> str | None:
    """Return the extension that compresses a primitive, or any attribute of it; None without one."""
    if draco.extension_of(source.json) is not None:
        return draco.EXTENSION
    return meshopt_of(document, source)


def meshopt_of(document: Document, source: PrimitiveSource) -> str | None:
    """Return the meshopt extension of any attribute of a primitive, None without one."""
    views = document.objects("bufferViews")
    for attribute in source.attributes:
        place = source.place.at(attribute)
        accessor = document.asset.accessor(source.attributes, attribute, place)
        view = None if accessor is None else index(accessor.json, "bufferView", len(views), place)
        name = None if view is None else meshopt.extension_of(views[view], place)
        if name is not None:
            return name
    return None


class AttributeStore:
    """Take the new attributes of one primitive, and make the other changes of its JSON at the end.

    They get accessors with their own buffer views, which meshopt compresses if ``packed`` says so.
    """

    def __init__(self, additions: Additions, packed: Packed | None = None) -> None:
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
        """Store an attribute (V, components) of a glTF type and return the index of its accessor."""
        number = self._additions.add(
            values, normalized=normalized, extras=extras, packed=self._packed, apart_from=self._taken
        )
        self._taken.add(number)
        return number

    def finished(self, primitive: JsonObject) -> JsonObject:
        """Return the JSON of the primitive with all its new attributes, and the changes of their storage."""
        return primitive


class _DracoStore(AttributeStore):
    """New attributes beside a Draco stream, in the order of its decoder, so that the stream stays as it is.

    Babylon.js and PlayCanvas read nothing beside a stream. So attributes that they need for skinning and
    lighting go into a new stream, which also holds all data of the old one: a generated NORMAL, and what
    replaces data of the old stream. The old stream stays in the file for ``strip``. The extension's
    ``extras`` name its place. If the encoder cannot write all of this, these attributes too go beside.

    If the file also has plain data, for loaders without Draco, its vertices may have another order there.
    Then α and β go into a new stream too, unless they are signed integers, which the encoder cannot write.
    """

    def __init__(self, document: Document, additions: Additions, source: PrimitiveSource, level: int) -> None:
        from skinbake.gltf.writing.recode import reason_against_new_stream

        super().__init__(additions)
        self._document, self._source, self._level = document, source, level
        self._before = draco.extension_of(source.json) or {}
        self._inside = member(self._before, "attributes", source.place)
        self._is_writable = reason_against_new_stream(document, source) is None
        numbers = [int(source.attributes[name]) for name in self._inside]
        self._has_plain_data = any("bufferView" in document.objects("accessors")[one] for one in numbers)
        self._new: dict[str, Values] = {}

    def add(
        self,
        name: str,
        values: Values,
        *,
        normalized: bool = False,
        extras: JsonObject | None = None,
    ) -> int:
        is_read = name in self._inside or name == "NORMAL" or self._has_plain_data
        if self._is_writable and is_read and values.dtype.kind != "i":
            self._new[name] = values
            return self._additions.add_accessor({}, values, normalized, extras)
        return super().add(name, values, normalized=normalized, extras=extras)

    def finished(self, primitive: JsonObject) -> JsonObject:
        now, former = member(primitive, "attributes", self._source.place), self._source.attributes
        stay = [name for name in self._inside if now.get(name) == former[name]]
        left = {name: former[name] for name in self._inside if name not in stay}
        view, inside = self._before["bufferView"], {name: self._inside[name] for name in stay}
        if self._new:
            from skinbake.gltf.codecs import draco_stream

            names = [name for name in dict.fromkeys([*self._inside, *self._new]) if name in now]
            faces = draco.read_stream(self._document, self._source.json, self._source.place).faces
            arrays: dict[str, npt.NDArray[Any]] = {}
            for name in names:
                if name in self._new:
                    arrays[name] = np.asarray(self._new[name])
                else:
                    number, place = int(self._source.attributes[name]), self._source.place.at(name)
                    arrays[name] = read_accessor(self._document, number, place).values
            what = "putting its new attributes into Draco"
            self._document.budget.claim(Cost.DRACO_STREAM, what, self._source.place)
            stream = draco_stream.encode(arrays, faces, self._source.place, level=self._level)
            view = self._additions.add_stream(stream.data)
            inside = {name: stream.unique_ids[name] for name in names}
        elif not left:
            return primitive
        extension = {**self._before, "bufferView": view, "attributes": inside}
        extension = with_note(extension, StreamNote(before=self._before, accessors=left))
        return {**primitive, "extensions": {**primitive["extensions"], draco.EXTENSION: extension}}
