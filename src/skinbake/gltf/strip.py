"""Take out of a document everything that bake added, and put back what it replaced."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from skinbake.errors import InputError, Notice, Place
from skinbake.gltf import json_access
from skinbake.gltf.accessors import read_accessor
from skinbake.gltf.additions import BUFFER_ADDED, BUFFER_LENGTH, KEY
from skinbake.gltf.document import Document, joined
from skinbake.gltf.json_access import JsonObject, objects, text
from skinbake.gltf.metadata import noted_names, read_metadata


def stripped(document: Document) -> tuple[Document, int, list[Notice]]:
    """Return the document as before bake, how many primitives were baked, and what could not be undone.

    A document that holds no bake is returned as it is. Accessors, buffer views and bytes are removed where
    they still stand at the end, as bake put them; where another tool has rearranged the file since, they
    stay behind unused, and a notice says so. Raises InputError where the file's structure is broken.
    """
    meshes: list[JsonObject] = []
    removed: set[int] = set()
    in_use: set[int] = set()
    notices: list[Notice] = []
    count = 0
    for number, mesh in enumerate(document.objects("meshes")):
        place = Place(document.name, number, text(mesh, "name", document.place))
        primitives = objects(mesh, "primitives", place)
        restored = []
        for position, primitive in enumerate(primitives):
            here = Place(place.file, place.mesh, place.mesh_name, position)
            note = read_metadata(document, primitive)
            restored.append(
                primitive if note is None else _restored(document, primitive, note, here, notices)
            )
            count += note is not None
            removed |= _accessors_of(primitive) - _accessors_of(restored[-1])
            in_use |= _accessors_of(restored[-1])
        meshes.append({**mesh, "primitives": restored} if primitives else mesh)
    if count == 0:
        return document, 0, []
    root = {**document.json, "meshes": meshes}
    return _without(document, root, removed - in_use, notices), count, notices


def _accessors_of(primitive: JsonObject) -> set[int]:
    attributes = primitive.get("attributes")
    values = attributes.values() if isinstance(attributes, dict) else ()
    return {number for number in values if isinstance(number, int)}


def _restored(
    document: Document, primitive: JsonObject, note: JsonObject, place: Place, notices: list[Notice]
) -> JsonObject:
    """Return the primitive's JSON without our attributes and metadata, its own influences back in place."""
    attributes = dict(json_access.member(primitive, "attributes", place))
    for key in ("alpha", "beta", "generated"):
        for name in noted_names(note, key):
            attributes.pop(name, None)
    former = note.get("adopted")
    if isinstance(former, dict) and former:
        if _still_the_same(document, attributes, former, place):
            attributes.update(former)
        else:
            notices.append(
                Notice(
                    "adopted-kept",
                    "the influences from before its bake are no longer in the file: joints that bake adopted "
                    "stay, with weights too small to see",
                    place,
                )
            )
    written = {**primitive, "attributes": attributes} if "attributes" in primitive else dict(primitive)
    extras = primitive.get("extras")
    if isinstance(extras, dict) and extras.get(KEY) is note:
        left = {key: value for key, value in extras.items() if key != KEY}
        written["extras"] = left
        if not left and not note.get("keepExtras"):
            del written["extras"]
    return written


def _still_the_same(document: Document, attributes: JsonObject, former: dict[str, Any], place: Place) -> bool:
    """Tell whether the noted accessors still hold the influences that the adopted ones were made from."""
    accessors = document.objects("accessors")
    for name, number in former.items():
        if name not in attributes or not isinstance(number, int) or not 0 <= number < len(accessors):
            return False
        if not name.startswith("JOINTS_"):
            continue
        weights_name = name.replace("JOINTS", "WEIGHTS")
        weights_number = former.get(weights_name, attributes.get(weights_name))
        if not isinstance(weights_number, int) or not 0 <= weights_number < len(accessors):
            return False
        try:
            before = read_accessor(document, number, place.at(name)).values
            weights = read_accessor(document, weights_number, place.at(weights_name)).values
            now = read_accessor(document, attributes[name], place.at(name)).values
        except (InputError, IndexError, TypeError):
            return False
        if before.shape != now.shape or weights.shape != now.shape:
            return False
        if np.any((before != now) & (weights != 0)):
            return False
    return True


def _without(document: Document, root: JsonObject, removed: set[int], notices: list[Notice]) -> Document:
    """Return the document without the accessors, and without the buffer views and bytes only they used."""
    tail = _tail_of_bake(document, removed)
    if tail is None:
        notices.append(
            Notice(
                "bytes-left",
                "another tool has rearranged the file since its bake: unused data of the bake stays in it",
                document.place,
            )
        )
        return document.edited(json=root)
    accessors, views = document.objects("accessors"), document.objects("bufferViews")
    _put_back(root, "accessors", accessors[: len(accessors) - len(removed)])
    _put_back(root, "bufferViews", views[: tail.first_view])
    return _shrunk(document, root, views[tail.first_view], tail.undo)


@dataclass(frozen=True, slots=True)
class _Tail:
    """Where the buffer views of a bake begin, and what it noted of the buffer as it was."""

    first_view: int
    undo: JsonObject


def _tail_of_bake(document: Document, removed: set[int]) -> _Tail | None:
    """Return the end of the document that is the bake's alone, None where it is no longer as bake left it.

    Other tools renumber accessors, and put several into one buffer view: then nothing can be cut off.
    """
    accessors, views = document.objects("accessors"), document.objects("bufferViews")
    kept = len(accessors) - len(removed)
    ours = {accessors[number].get("bufferView") for number in removed}
    first = len(views) - len(ours)
    if removed != set(range(kept, len(accessors))) or ours != set(range(first, len(views))):
        return None
    others = (*_views_of(accessors[:kept]), *_views_of(document.objects("images")))
    extras = views[first].get("extras") if ours else None
    undo = extras.get(KEY) if isinstance(extras, dict) else None
    if not isinstance(undo, dict) or any(view >= first for view in others):
        return None
    return _Tail(first, undo)


def _views_of(holders: list[JsonObject]) -> Iterator[int]:
    """Yield the buffer views that accessors, sparse ones included, or images refer to."""
    for holder in holders:
        sparse = holder.get("sparse")
        parts = [sparse.get("indices"), sparse.get("values")] if isinstance(sparse, dict) else []
        for part in (holder, *parts):
            view = part.get("bufferView") if isinstance(part, dict) else None
            if isinstance(view, int):
                yield view


def _put_back(root: JsonObject, key: str, entries: list[JsonObject]) -> None:
    """Set a top-level array, or remove it where nothing is left: glTF allows no empty one."""
    if entries:
        root[key] = entries
    else:
        root.pop(key, None)


def _shrunk(document: Document, root: JsonObject, first: JsonObject, undo: JsonObject) -> Document:
    """Return the document with the buffer as it was before the view ``first`` was added."""
    buffers = list(document.objects("buffers"))
    if undo.get(BUFFER_ADDED):
        if first.get("buffer") != len(buffers) - 1:
            return document.edited(json=root)
        uri = buffers.pop().get("uri")
        _put_back(root, "buffers", buffers)
        new_files = {name: pieces for name, pieces in document.new_files.items() if name != uri}
        return document.edited(json=root, new_files=new_files)
    start, length = first.get("byteOffset"), undo.get(BUFFER_LENGTH)
    binary = joined(document.binary or ())
    if first.get("buffer") != 0 or not isinstance(start, int) or not isinstance(length, int):
        return document.edited(json=root)
    if not 0 < length <= start <= len(binary):
        return document.edited(json=root)
    root["buffers"] = [{**buffers[0], "byteLength": length}, *buffers[1:]]
    return document.edited(json=root, binary=(memoryview(binary)[:start],))
