"""Take out of a document everything that bake added, and put back what it replaced."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from skinbake.choices import Layout
from skinbake.errors import Notice, Place
from skinbake.format.former import former_attributes, with_former_stream
from skinbake.format.metadata import FORMER_ATTRIBUTES, noted_names, read_metadata, slot_names
from skinbake.gltf import json_access
from skinbake.gltf.additions import BUFFER_ADDED, BUFFER_LENGTH, FALLBACK_ADDED, KEY
from skinbake.gltf.codecs import draco, meshopt
from skinbake.gltf.document import Document, joined
from skinbake.gltf.json_access import JsonObject, integer, objects, text


def stripped(document: Document) -> tuple[Document, int, list[Notice]]:
    """Return the document as before bake, how many primitives were baked, and what could not be undone.

    A document that holds no bake is returned as it is. Accessors, buffer views and bytes are removed where
    they still stand at the end, as bake put them; where another tool has rearranged the file since, they
    stay behind unused, and a notice says so. Raises InputError where the file's structure is broken.
    """
    meshes: list[JsonObject] = []
    changed: list[tuple[JsonObject, JsonObject]] = []
    notices: list[Notice] = []
    for number, mesh in enumerate(document.objects("meshes")):
        place = Place(document.name, number, text(mesh, "name", document.place))
        restored = []
        for position, primitive in enumerate(objects(mesh, "primitives", place)):
            here = Place(place.file, place.mesh, place.mesh_name, position)
            note = read_metadata(document, primitive)
            if note is None:
                restored.append(primitive)
                continue
            written, found = _restored(document, primitive, note, here)
            restored.append(written)
            changed.append((primitive, written))
            notices += found
        meshes.append({**mesh, "primitives": restored} if restored else mesh)
    if not changed:
        return document, 0, []
    root = {**document.json, "meshes": meshes}
    removed = set().union(*(_attribute_accessors(old) - _attribute_accessors(new) for old, new in changed))
    streams = _stream_views(old for old, _ in changed) - _stream_views(_all_primitives(root))
    removed -= _accessors_in_use(root)
    return _without(document, root, removed, streams, notices), len(changed), notices


def _stream_views(primitives: Iterable[JsonObject]) -> set[int]:
    """Return the buffer views of the Draco streams of some primitives."""
    return _numbers((draco.extension_of(primitive) or {}).get("bufferView") for primitive in primitives)


def _all_primitives(root: JsonObject) -> Iterator[JsonObject]:
    for mesh in json_access.entries_of(root.get("meshes")):
        yield from json_access.entries_of(mesh.get("primitives"))


def _attribute_accessors(primitive: JsonObject) -> set[int]:
    return _numbers(json_access.values_of(primitive.get("attributes")))


def _accessors_in_use(root: JsonObject) -> set[int]:
    """Return every accessor that glTF 2.0 itself refers to; what extensions refer to cannot be known."""
    values: list[object] = []
    for primitive in _all_primitives(root):
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
    return {number for value in values if (number := json_access.reference(value)) is not None}


def _restored(
    document: Document, primitive: JsonObject, note: JsonObject, place: Place
) -> tuple[JsonObject, list[Notice]]:
    """Return the primitive's JSON without our attributes and metadata, its own influences back in place."""
    attributes = dict(json_access.member(primitive, "attributes", place))
    notices = _removed(attributes, note, place)
    ours = [name for name in json_access.member(primitive, "attributes", place) if name not in attributes]
    former = former_attributes(document, attributes, note, place)
    attributes = _in_former_order({**attributes, **(former or {})}, note)
    written = {**primitive, "attributes": attributes} if "attributes" in primitive else dict(primitive)
    if draco.extension_of(primitive) is not None:
        written["extensions"] = _extensions_before(document, primitive, ours, former is not None, place)
    extras = primitive.get("extras")
    if isinstance(extras, dict) and extras.get(KEY) is note:
        left = {key: value for key, value in extras.items() if key != KEY}
        written["extras"] = left
        if not left and not note.get("keepExtras"):
            del written["extras"]
    if former is not None:
        return written, notices
    if FORMER_ATTRIBUTES in note:
        message = (
            "another tool has removed or edited the influences from before the bake: the "
            "influences that --limit-influences left stay, with adopted joints among them"
        )
        return written, [*notices, Notice("limited-kept", message, place)]
    message = (
        "another tool has removed or edited the influences from before the bake: joints that bake "
        "adopted stay, with weights too small to see"
    )
    return written, [*notices, Notice("adopted-kept", message, place)]


def _removed(attributes: JsonObject, note: JsonObject, place: Place) -> list[Notice]:
    """Take what bake added out of the attributes; return a notice where that can no longer be told."""
    names = slot_names(note)
    missing = [name for name in names if name not in attributes]
    doubtful = note.get("layout") == Layout.TEXCOORD and missing and len(missing) < len(names)
    for name in [*(() if doubtful else names), *noted_names(note, "generated")]:
        attributes.pop(name, None)
    if not doubtful:
        return []
    message = (
        f"α and β were in {names[0]} to {names[-1]}, but {', '.join(missing)} are missing: the "
        "other sets stay, because they may hold texture coordinates now"
    )
    return [Notice("texcoords-kept", message, place, len(names) - len(missing))]


def _extensions_before(
    document: Document, primitive: JsonObject, ours: list[str], complete: bool, place: Place
) -> JsonObject:
    """Return a primitive's extensions with the Draco stream from before its bake, where that is there still.

    Else, or where not all attributes are back (``complete``), the stream of the bake stays, and the
    extension no longer names what of it is ours.
    """
    extensions = dict(json_access.member(primitive, "extensions", place))
    before = with_former_stream(primitive)
    if complete and before is not None and draco.holds_the_same(document, primitive, before, place):
        return {**extensions, draco.EXTENSION: draco.extension_of(before)}
    extension = dict(draco.extension_of(primitive) or {})
    inside = json_access.member(extension, "attributes", place)
    extension["attributes"] = {name: number for name, number in inside.items() if name not in ours}
    extras = extension.get("extras")
    if isinstance(extras, dict) and KEY in extras:
        extension["extras"] = {key: value for key, value in extras.items() if key != KEY}
        if not extension["extras"]:
            del extension["extras"]
    return {**extensions, draco.EXTENSION: extension}


def _in_former_order(attributes: JsonObject, note: JsonObject) -> JsonObject:
    """Return the attributes in the order of before, where bake removed some and noted it."""
    noted = noted_names(note, FORMER_ATTRIBUTES)
    order = [*(name for name in noted if name in attributes), *attributes]
    return {name: attributes[name] for name in order}


def _without(
    document: Document, root: JsonObject, removed: set[int], streams: set[int], notices: list[Notice]
) -> Document:
    """Return the document without the accessors, and without the buffer views and bytes only they used.

    streams are buffer views of Draco streams that no primitive has any more.
    """
    tail = _tail_of_bake(document, removed, streams)
    if tail is None:
        notices.append(
            Notice(
                "bytes-left",
                "another tool has rearranged the file since its bake: the data of the bake stays "
                "in the file, unused",
                document.place,
            )
        )
        return document.edited(json=root)
    accessors, views = document.objects("accessors"), document.objects("bufferViews")
    _put_back(root, "accessors", accessors[: len(accessors) - len(removed)])
    _put_back(root, "bufferViews", views[: tail.first_view])
    return _shrunk(document, root, tail)


@dataclass(frozen=True, slots=True)
class _Tail:
    """Where the buffer views of a bake begin, and what it noted of the buffer as it was.

    start is the first byte of them in the buffer that holds their data; fallbacks the number of buffers at
    the end that no bytes stand for.
    """

    first_view: int
    undo: JsonObject
    start: int
    fallbacks: int


def _tail_of_bake(document: Document, removed: set[int], streams: set[int]) -> _Tail | None:
    """Return the end of the document that is the bake's alone, None where it is no longer as bake left it.

    Other tools renumber accessors, put several into one buffer view, and append: then nothing can be cut off.
    """
    accessors, views = document.objects("accessors"), document.objects("bufferViews")
    kept = len(accessors) - len(removed)
    if not removed or removed != set(range(kept, len(accessors))):
        return None
    ours = _numbers(accessors[number].get("bufferView") for number in removed) | streams
    first = len(views) - len(ours)
    if not ours or ours != set(range(first, len(views))):
        return None
    extras = views[first].get("extras")
    undo = extras.get(KEY) if isinstance(extras, dict) else None
    others = (*_views_of(accessors[:kept]), *_views_of(document.objects("images")))
    if not isinstance(undo, dict) or any(first <= view < len(views) for view in others):
        return None
    return _at_the_end(document, first, undo)


def _at_the_end(document: Document, first: int, undo: JsonObject) -> _Tail | None:
    """Return the tail where nothing that stays lies in the buffers, or the part of one, to be cut off."""
    views, buffers = document.objects("bufferViews"), document.objects("buffers")
    kept = [data for view in views[:first] for data in _stored_ranges(view, document.place)]
    added = [data for view in views[first:] for data in _stored_ranges(view, document.place)]
    fallbacks = 1 if undo.get(FALLBACK_ADDED) else 0
    last = len(buffers) - fallbacks
    whole = last - 1 if undo.get(BUFFER_ADDED) else last  # from here on the buffers go
    if any(whole <= buffer < len(buffers) for buffer, _, _ in kept):
        return None
    if undo.get(BUFFER_ADDED):
        return _Tail(first, undo, 0, fallbacks) if all(buffer >= whole for buffer, _, _ in added) else None
    length = undo.get(BUFFER_LENGTH)
    starts = [begin for buffer, begin, _ in added if buffer == 0]
    if not starts or any(0 < buffer < last for buffer, _, _ in added) or not document.has_binary_buffer:
        return None
    start = min(starts)
    if not isinstance(length, int) or not 0 < length <= start <= len(joined(document.binary or ())):
        return None
    is_free = all(end <= start for buffer, _, end in kept if buffer == 0)
    return _Tail(first, undo, start, fallbacks) if is_free else None


def _stored_ranges(view: JsonObject, place: Place) -> Iterator[tuple[int, int, int]]:
    """Yield (buffer, start, end) of a buffer view's bytes, and of its compressed ones."""
    name = meshopt.extension_of(view, place)
    extensions = json_access.member(view, "extensions", place)
    for holder in (view, *((json_access.member(extensions, name, place),) if name is not None else ())):
        start = integer(holder, "byteOffset", place, default=0)
        yield integer(holder, "buffer", place), start, start + integer(holder, "byteLength", place)


def _views_of(holders: list[JsonObject]) -> Iterator[int]:
    """Yield the buffer views that accessors, sparse ones included, or images refer to."""
    for holder in holders:
        sparse = holder.get("sparse")
        parts = [sparse.get("indices"), sparse.get("values")] if isinstance(sparse, dict) else []
        for part in (holder, *parts):
            view = json_access.reference(part.get("bufferView")) if isinstance(part, dict) else None
            if view is not None:
                yield view


def _put_back(root: JsonObject, key: str, entries: list[JsonObject]) -> None:
    """Set a top-level array, or remove it where nothing is left: glTF allows no empty one."""
    if entries:
        root[key] = entries
    else:
        root.pop(key, None)


def _shrunk(document: Document, root: JsonObject, tail: _Tail) -> Document:
    """Return the document with the buffers as they were before the bake."""
    buffers = list(document.objects("buffers"))
    buffers = buffers[: len(buffers) - tail.fallbacks]
    if tail.undo.get(BUFFER_ADDED):
        uri = buffers.pop().get("uri")
        _put_back(root, "buffers", buffers)
        new_files = {name: pieces for name, pieces in document.new_files.items() if name != uri}
        return document.edited(json=root, new_files=new_files)
    root["buffers"] = [{**buffers[0], "byteLength": tail.undo[BUFFER_LENGTH]}, *buffers[1:]]
    binary = memoryview(joined(document.binary or ()))
    return document.edited(json=root, binary=(binary[: tail.start],))
