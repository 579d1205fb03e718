"""Take out of a document everything that bake added, and put back what it replaced."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from skinbake.errors import Notice, Place
from skinbake.gltf import json_access
from skinbake.gltf.additions import BUFFER_ADDED, BUFFER_LENGTH, KEY
from skinbake.gltf.document import Document, joined
from skinbake.gltf.former import former_attributes
from skinbake.gltf.json_access import JsonObject, integer, objects, text
from skinbake.gltf.metadata import FORMER_ATTRIBUTES, noted_names, read_metadata


def stripped(document: Document) -> tuple[Document, int, list[Notice]]:
    """Return the document as before bake, how many primitives were baked, and what could not be undone.

    A document that holds no bake is returned as it is. Accessors, buffer views and bytes are removed where
    they still stand at the end, as bake put them; where another tool has rearranged the file since, they
    stay behind unused, and a notice says so. Raises InputError where the file's structure is broken.
    """
    meshes: list[JsonObject] = []
    removed: set[int] = set()
    notices: list[Notice] = []
    count = 0
    for number, mesh in enumerate(document.objects("meshes")):
        place = Place(document.name, number, text(mesh, "name", document.place))
        restored = []
        for position, primitive in enumerate(objects(mesh, "primitives", place)):
            here = Place(place.file, place.mesh, place.mesh_name, position)
            note = read_metadata(document, primitive)
            if note is None:
                restored.append(primitive)
                continue
            count += 1
            written, notice = _restored(document, primitive, note, here)
            restored.append(written)
            notices += [notice] if notice else []
            removed |= _attribute_accessors(primitive) - _attribute_accessors(written)
        meshes.append({**mesh, "primitives": restored} if restored else mesh)
    if count == 0:
        return document, 0, []
    root = {**document.json, "meshes": meshes}
    return _without(document, root, removed - _accessors_in_use(root), notices), count, notices


def _attribute_accessors(primitive: JsonObject) -> set[int]:
    return _numbers(json_access.values_of(primitive.get("attributes")))


def _accessors_in_use(root: JsonObject) -> set[int]:
    """Return every accessor that glTF 2.0 itself refers to; what extensions refer to cannot be known."""
    values: list[object] = []
    for mesh in json_access.entries_of(root.get("meshes")):
        for primitive in json_access.entries_of(mesh.get("primitives")):
            values += [*json_access.values_of(primitive.get("attributes")), primitive.get("indices")]
            for target in json_access.entries_of(primitive.get("targets")):
                values += target.values()
    for skin in json_access.entries_of(root.get("skins")):
        values.append(skin.get("inverseBindMatrices"))
    for animation in json_access.entries_of(root.get("animations")):
        for sampler in json_access.entries_of(animation.get("samplers")):
            values += [sampler.get("input"), sampler.get("output")]
    return _numbers(values)


def _numbers(values: Iterable[object]) -> set[int]:
    return {number for value in values if (number := json_access.accessor_number(value)) is not None}


def _restored(
    document: Document, primitive: JsonObject, note: JsonObject, place: Place
) -> tuple[JsonObject, Notice | None]:
    """Return the primitive's JSON without our attributes and metadata, its own influences back in place."""
    attributes = dict(json_access.member(primitive, "attributes", place))
    for key in ("alpha", "beta", "generated"):
        for name in noted_names(note, key):
            attributes.pop(name, None)
    former = former_attributes(document, attributes, note, place)
    attributes = _in_former_order({**attributes, **(former or {})}, note)
    written = {**primitive, "attributes": attributes} if "attributes" in primitive else dict(primitive)
    extras = primitive.get("extras")
    if isinstance(extras, dict) and extras.get(KEY) is note:
        left = {key: value for key, value in extras.items() if key != KEY}
        written["extras"] = left
        if not left and not note.get("keepExtras"):
            del written["extras"]
    if former is not None:
        return written, None
    if FORMER_ATTRIBUTES in note:
        message = (
            "the influences from before its bake are gone, or were edited since: those that "
            "--limit-influences left stay, and adopted joints among them"
        )
        return written, Notice("limited-kept", message, place)
    message = (
        "the influences from before its bake are gone, or were edited since: joints that bake adopted stay, "
        "with weights too small to see"
    )
    return written, Notice("adopted-kept", message, place)


def _in_former_order(attributes: JsonObject, note: JsonObject) -> JsonObject:
    """Return the attributes in the order of before, where bake removed some and noted it."""
    noted = noted_names(note, FORMER_ATTRIBUTES)
    order = [*(name for name in noted if name in attributes), *attributes]
    return {name: attributes[name] for name in order}


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

    Other tools renumber accessors, put several into one buffer view, and append: then nothing can be cut off.
    """
    accessors, views = document.objects("accessors"), document.objects("bufferViews")
    kept = len(accessors) - len(removed)
    if not removed or removed != set(range(kept, len(accessors))):
        return None
    ours = {accessors[number].get("bufferView") for number in removed}
    first = len(views) - len(ours)
    if ours != set(range(first, len(views))):
        return None
    extras = views[first].get("extras")
    undo = extras.get(KEY) if isinstance(extras, dict) else None
    others = (*_views_of(accessors[:kept]), *_views_of(document.objects("images")))
    if not isinstance(undo, dict) or any(view >= first for view in others):
        return None
    return _Tail(first, undo) if _is_at_the_end(document, views, first, undo) else None


def _is_at_the_end(document: Document, views: list[JsonObject], first: int, undo: JsonObject) -> bool:
    """Tell whether nothing that stays lies in the buffer, or the part of it, that is to be cut off."""
    buffers = document.objects("buffers")
    buffer, start = views[first].get("buffer"), views[first].get("byteOffset")
    if undo.get(BUFFER_ADDED):
        return buffer == len(buffers) - 1 and all(view.get("buffer") != buffer for view in views[:first])
    length = undo.get(BUFFER_LENGTH)
    if buffer != 0 or not document.has_binary_buffer:
        return False
    if not isinstance(start, int) or not isinstance(length, int) or not 0 < length <= start:
        return False
    ends = (
        integer(view, "byteOffset", document.place, default=0) + integer(view, "byteLength", document.place)
        for view in views[:first]
        if view.get("buffer") == 0
    )
    return start <= len(joined(document.binary or ())) and all(end <= start for end in ends)


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
        uri = buffers.pop().get("uri")
        _put_back(root, "buffers", buffers)
        new_files = {name: pieces for name, pieces in document.new_files.items() if name != uri}
        return document.edited(json=root, new_files=new_files)
    root["buffers"] = [{**buffers[0], "byteLength": undo[BUFFER_LENGTH]}, *buffers[1:]]
    binary = memoryview(joined(document.binary or ()))
    return document.edited(json=root, binary=(binary[: first["byteOffset"]],))
