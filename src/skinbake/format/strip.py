"""Remove all additions of bake from a document, and restore the parts that it replaced."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Set
from typing import NamedTuple

from skinbake.choices import Layout
from skinbake.errors import Notice, Place, UnsupportedFeatureError
from skinbake.format.blend_weights import blend_names
from skinbake.format.former import former_attributes, former_sets, former_tangent, with_former_stream
from skinbake.format.layouts import added_slot_names
from skinbake.format.metadata import (
    FORMER_ATTRIBUTES,
    KEY,
    VERSION,
    corrective_note,
    noted_names,
    read_metadata,
    without_left,
)
from skinbake.format.morph_targets import former_targets, morph_note, noted_targets
from skinbake.gltf import json_access
from skinbake.gltf.additions import BUFFER_ADDED, BUFFER_LENGTH, FALLBACK_ADDED
from skinbake.gltf.codecs import draco, meshopt
from skinbake.gltf.document import Document, joined
from skinbake.gltf.json_access import JsonObject, integer, objects, reference, text


def stripped(document: Document) -> tuple[Document, int, list[Notice]]:
    """Return the document as before bake, the number of baked primitives, and notices on leftovers.

    A mesh with correctives counts as one.

    A document without a bake is returned as it is. Accessors, buffer views and bytes are removed if they are
    still at the end, where bake put them. If another tool has rearranged the file since, they stay in it
    unused, and a notice says so. Raises InputError if the structure of the file is broken, or if a later
    version of skinbake has baked it: what its metadata means is unknown. The note of a bake that has left the
    file unbaked is removed, too.
    """
    document, corrected, notices = uncorrected(without_left(document))
    meshes: list[JsonObject] = []
    changed: list[tuple[JsonObject, JsonObject]] = []
    for number, mesh in enumerate(document.objects("meshes")):
        place = Place(document.name, number, text(mesh, "name", document.place))
        of_targets = morph_note(mesh)
        if of_targets is not None:
            _refuse_later_version(of_targets, place)
        morphing = former_targets(document, mesh)
        restored = []
        pairs = zip(objects(mesh, "primitives", place), objects(morphing, "primitives", place), strict=True)
        for position, ((given, primitive), noted) in enumerate(zip(pairs, noted_targets(mesh), strict=False)):
            here = Place(place.file, place.mesh, place.mesh_name, position)
            note = read_metadata(document, primitive)
            if note is None:
                restored.append(primitive)
                changed += [(given, primitive)] if noted else []
                continue
            _refuse_later_version(note, here)
            written, found = _restored(document, primitive, note, here)
            restored.append(written)
            changed.append((given, written))
            notices += found
        meshes.append({**morphing, "primitives": restored} if restored else morphing)
    if not changed and meshes == document.objects("meshes"):
        return document, corrected, notices
    root = {**document.json, "meshes": meshes}
    removed = set[int]().union(
        *(_accessors_of_vertices(old) - _accessors_of_vertices(new) for old, new in changed)
    )
    streams = _stream_views(old for old, _ in changed) - _stream_views(_all_primitives(root))
    removed -= _accessors_in_use(root)
    return _without(document, root, removed, streams, notices), corrected + len(changed), notices


def uncorrected(document: Document) -> tuple[Document, int, list[Notice]]:
    """Return the document without correctives alone, how many meshes had any, and notices as ``stripped``.

    What a bake has made for the file's own morph targets stays.
    """
    if not any(map(corrective_note, document.objects("meshes"))):
        return document, 0, []
    from skinbake.format.corrective_strip import narrowed, without_correctives  # few files have any

    root, to_narrow, count = without_correctives(document)
    notices: list[Notice] = []
    unused = _accessors_in_use(document.json) - _accessors_in_use(root)
    found, more = narrowed(_without(document, root, unused, set(), notices), to_narrow)
    return found, count, [*notices, *more]


def _refuse_later_version(note: JsonObject, place: Place) -> None:
    if note["version"] > VERSION:
        message = (
            f"its metadata has version {note['version']}, this skinbake reads {VERSION}: update skinbake"
        )
        raise UnsupportedFeatureError(message, place)


def _stream_views(primitives: Iterable[JsonObject]) -> set[int]:
    """Return the buffer views of the Draco streams of some primitives."""
    return _numbers((draco.extension_of(primitive) or {}).get("bufferView") for primitive in primitives)


def _all_primitives(root: JsonObject) -> Iterator[JsonObject]:
    for mesh in json_access.entries_of(root.get("meshes")):
        yield from json_access.entries_of(mesh.get("primitives"))


def _accessors_of_vertices(primitive: JsonObject) -> set[int]:
    values = [*json_access.values_of(primitive.get("attributes"))]
    for target in json_access.entries_of(primitive.get("targets")):
        values += target.values()
    return _numbers(values)


def _accessors_in_use(root: JsonObject) -> set[int]:
    """Return every accessor that glTF 2.0 itself refers to; references of extensions are unknown."""
    values: list[object] = []
    for primitive in _all_primitives(root):
        values += [*_accessors_of_vertices(primitive), primitive.get("indices")]
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
    """Return the JSON of the primitive without bake's attributes and metadata, with its own influences."""
    attributes = dict(json_access.member(primitive, "attributes", place))
    notices = _removed(attributes, note, place)
    former = former_attributes(document, attributes, note, place)
    tangent = former_tangent(document, attributes, note, place)
    before = with_former_stream(primitive)
    if before is not None and not draco.holds_the_same(document, primitive, before, place):
        # What the bake replaced was in the lost stream.
        before, former, tangent = None, None if former else former, None if tangent else tangent
    if tangent is None:
        message = (
            "another tool has removed or edited the TANGENT from before the bake: "
            "the straightened TANGENT stays"
        )
        notices.append(Notice("tangents-kept", message, place))
    if former is not None:
        attributes = former_sets(attributes, note)
    ours = json_access.member(primitive, "attributes", place).keys() - attributes.keys()
    # The former order of the attributes, if bake removed some and noted it.
    attributes = {**attributes, **(former or {}), **(tangent or {})}
    noted = noted_names(note, FORMER_ATTRIBUTES)
    order = [*(name for name in noted if name in attributes), *attributes]
    attributes = {name: attributes[name] for name in order}
    written = {**primitive, "attributes": attributes} if "attributes" in primitive else dict(primitive)
    if draco.extension_of(primitive) is not None:
        kept = before if former is not None and tangent is not None else None
        written["extensions"] = _extensions_before(primitive, kept, ours, place)
    extras = primitive.get("extras")
    if isinstance(extras, dict) and extras.get(KEY) == note:  # else it is that of an accessor
        left = {key: value for key, value in extras.items() if key != KEY}
        written["extras"] = left
        if not left and not note.get("keepExtras"):
            del written["extras"]
    if former is not None:
        return written, notices
    if FORMER_ATTRIBUTES in note:
        message = (
            "another tool has removed or edited the influences from before the bake: the "
            f"influences that {_who_changed(attributes, note)} stay, with adopted joints among them"
        )
        return written, [*notices, Notice("limited-kept", message, place)]
    message = (
        "another tool has removed or edited the influences from before the bake: joints that bake "
        "adopted stay, with weights too small to see. A bake takes them for the file's own: bake from the "
        "source instead"
    )
    return written, [*notices, Notice("adopted-kept", message, place)]


def _who_changed(attributes: JsonObject, note: JsonObject) -> str:
    return (
        "--neighbours extend added"
        if former_sets(attributes, note) != attributes
        else "--limit-influences left"
    )


def _removed(attributes: JsonObject, note: JsonObject, place: Place) -> list[Notice]:
    """Remove bake's additions from the attributes; return a notice if some can no longer be recognised.

    A damaged note may name any attribute. One that no bake adds stays.
    """
    names = added_slot_names(note)
    missing = [name for name in names if name not in attributes]
    doubtful = note.get("layout") == Layout.TEXCOORD and missing and len(missing) < len(names)
    generated = [name for name in noted_names(note, "generated") if name == "NORMAL"]
    for name in [*(() if doubtful else names), *blend_names(note), *generated]:
        attributes.pop(name, None)
    if not doubtful:
        return []
    message = (
        f"α and β were in {names[0]} to {names[-1]}, but {', '.join(missing)} are missing: the "
        "other sets stay, because they may hold texture coordinates now"
    )
    return [Notice("texcoords-kept", message, place, len(names) - len(missing))]


def _extensions_before(
    primitive: JsonObject, before: JsonObject | None, ours: Set[str], place: Place
) -> JsonObject:
    """Return the extensions of a primitive with the Draco stream that it had ``before``.

    None: the stream of the bake stays, and the extension no longer names ``ours`` in it.
    """
    extensions = dict(json_access.member(primitive, "extensions", place))
    if before is not None:
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


def _without(
    document: Document, root: JsonObject, removed: set[int], streams: set[int], notices: list[Notice]
) -> Document:
    """Return the document without the accessors, and without buffer views and bytes that only they used.

    streams are the buffer views of Draco streams that no primitive uses now.
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
    # The document with the buffers as they were before the bake.
    buffers = list(document.objects("buffers"))
    buffers = buffers[: len(buffers) - tail.fallbacks]
    if tail.undo.get(BUFFER_ADDED):
        uri = buffers.pop().get("uri")
        _put_back(root, "buffers", buffers)
        new_files = {name: pieces for name, pieces in document.new_files.items() if name != uri}
        return document.edited(json=root, new_files=new_files)
    root["buffers"] = [{**buffers[0], "byteLength": reference(tail.undo[BUFFER_LENGTH])}, *buffers[1:]]
    binary = memoryview(joined(document.binary or ()))
    return document.edited(json=root, binary=(binary[: tail.start],))


class _Tail(NamedTuple):
    """The start of a bake's buffer views, and its note on the former buffer.

    start is their first byte in the buffer that holds their data. fallbacks is the number of buffers at the
    end without bytes.
    """

    first_view: int
    undo: JsonObject
    start: int
    fallbacks: int


def _tail_of_bake(document: Document, removed: set[int], streams: set[int]) -> _Tail | None:
    """Return the end of the document that belongs to the bake alone, None if it has changed since.

    Other tools renumber accessors, put several into one buffer view, and append. Then the end cannot be cut
    off.
    """
    accessors, views = document.objects("accessors"), document.objects("bufferViews")
    kept = len(accessors) - len(removed)
    if not removed or removed != set(range(kept, len(accessors))):
        return None
    ours = set(_views_of([accessors[number] for number in removed])) | streams
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
    """Return the tail if the buffers, or the part of one, to be cut off hold no other data."""
    views, buffers = document.objects("bufferViews"), document.objects("buffers")
    kept = [data for view in views[:first] for data in _stored_ranges(view, document.place)]
    added = [data for view in views[first:] for data in _stored_ranges(view, document.place)]
    fallbacks = 1 if undo.get(FALLBACK_ADDED) else 0
    last = len(buffers) - fallbacks
    whole = last - 1 if undo.get(BUFFER_ADDED) else last  # buffers from here on are removed
    if any(whole <= buffer < len(buffers) for buffer, _, _ in kept):
        return None
    if undo.get(BUFFER_ADDED):
        return _Tail(first, undo, 0, fallbacks) if all(buffer >= whole for buffer, _, _ in added) else None
    length = reference(undo.get(BUFFER_LENGTH))
    starts = [begin for buffer, begin, _ in added if buffer == 0]
    if not starts or any(0 < buffer < last for buffer, _, _ in added) or not document.has_binary_buffer:
        return None
    start = min(starts)
    if length is None or not 0 < length <= start <= len(joined(document.binary or ())):
        return None
    # Views may have moved. The buffer gets its former length, and must hold all views that stay.
    is_free = all(end <= length for buffer, _, end in kept if buffer == 0)
    return _Tail(first, undo, start, fallbacks) if is_free else None


def _stored_ranges(view: JsonObject, place: Place) -> Iterator[tuple[int, int, int]]:
    """Yield (buffer, start, end) of the bytes of a buffer view, and of its compressed bytes."""
    for holder in meshopt.ranges_of(view, place):
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
    """Set a top-level array, or remove it if it is empty: glTF allows no empty array."""
    if entries:
        root[key] = entries
    else:
        root.pop(key, None)
