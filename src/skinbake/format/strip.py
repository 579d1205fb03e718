"""Remove all additions of bake from a document, and restore the parts that it replaced."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Set

from skinbake.choices import Layout
from skinbake.errors import Notice, Place
from skinbake.format.former import former_attributes, former_sets, former_tangent, with_former_stream
from skinbake.format.morph_targets import former_targets
from skinbake.format.note import (
    BufferNote,
    GradientNote,
    buffer_note,
    corrective_note,
    gradient_note_in,
    morph_note,
    noted_targets,
    refuse_later,
    without_left,
    without_note,
)
from skinbake.gltf import json_access
from skinbake.gltf.codecs import draco, meshopt
from skinbake.gltf.document import Document, joined
from skinbake.gltf.json_access import (
    JsonObject,
    entries_of,
    integer,
    object_of,
    objects,
    put_back,
    text,
)
from skinbake.gltf.writing.references import buffers_in_use, uses_of_accessors, views_in_use


def stripped(document: Document) -> tuple[Document, int]:
    """Return the document as before bake, and the number of baked primitives; tell of leftovers.

    A mesh with correctives counts as one.

    A document without a bake is returned as it is. Accessors, buffer views and bytes are removed if they are
    still at the end, where bake put them. If another tool has rearranged the file since, they stay in it
    unused, and a notice says so. Raises InputError if the structure of the file is broken, or if a later
    version of skinbake has baked it: what its metadata means is unknown. The note of a bake that has left the
    file unbaked is removed, too.
    """
    document, corrected = uncorrected(document)
    count = len(corrected)
    meshes: list[JsonObject] = []
    changed: list[tuple[JsonObject, JsonObject]] = []
    for number, mesh in enumerate(document.objects("meshes")):
        place = Place(document.name, number, text(mesh, "name", document.place))
        of_targets = morph_note(mesh)
        if of_targets is not None:
            refuse_later(of_targets.version, place)
        morphing = former_targets(document, mesh)
        restored = []
        pairs = zip(objects(mesh, "primitives", place), objects(morphing, "primitives", place), strict=True)
        for position, ((given, primitive), noted) in enumerate(zip(pairs, noted_targets(mesh), strict=False)):
            here = Place(place.file, place.mesh, place.mesh_name, position)
            note = gradient_note_in(document, primitive)
            if note is None:
                restored.append(primitive)
                changed += [(given, primitive)] if noted else []
                count += bool(noted) and number not in corrected
                continue
            refuse_later(note.version, here)
            written = _restored(document, primitive, note, here)
            restored.append(written)
            changed.append((given, written))
            count += 1
        meshes.append({**morphing, "primitives": restored} if restored else morphing)
    if not changed and meshes == document.objects("meshes"):
        return document, count
    root = {**document.json, "meshes": meshes}
    removed = set[int]().union(
        *(_accessors_of_vertices(old) - _accessors_of_vertices(new) for old, new in changed)
    )
    every = (one for mesh in meshes for one in entries_of(mesh.get("primitives")))
    streams = _stream_views(old for old, _ in changed) - _stream_views(every)
    removed -= uses_of_accessors(root).keys()
    back = set[int]().union(
        *(_accessors_of_vertices(new) - _accessors_of_vertices(old) for old, new in changed)
    )
    return _without(document, root, removed, streams, back), count


def has_lost_metadata(document: Document) -> bool:
    """Tell whether primitives have attributes of α and β, in a document of which nothing can be stripped."""
    primitives = (one for mesh in document.objects("meshes") for one in entries_of(mesh.get("primitives")))
    return any("_SKINBAKE_ALPHA_0" in object_of(one.get("attributes")) for one in primitives)


def uncorrected(document: Document) -> tuple[Document, Collection[int]]:
    """Return the document without correctives alone, and the meshes that had any; tell as ``stripped``.

    What a bake has made for the file's own morph targets stays. Notes on what it left are gone.
    """
    document = without_left(document)
    corrected = {number for number, mesh in enumerate(document.objects("meshes")) if corrective_note(mesh)}
    if not corrected:
        return document, ()
    from skinbake.format.corrective_strip import narrowed, without_correctives  # few files have any

    root, to_narrow = without_correctives(document)
    unused = uses_of_accessors(document.json).keys() - uses_of_accessors(root).keys()
    return narrowed(_without(document, root, unused, set(), set()), to_narrow), corrected


def _stream_views(primitives: Iterable[JsonObject]) -> set[int]:
    """Return the buffer views of the Draco streams of some primitives."""
    return _numbers((draco.extension_of(primitive) or {}).get("bufferView") for primitive in primitives)


def _accessors_of_vertices(primitive: JsonObject) -> set[int]:
    values = [*json_access.values_of(primitive.get("attributes"))]
    for target in json_access.entries_of(primitive.get("targets")):
        values += target.values()
    return _numbers(values)


def _numbers(values: Iterable[object]) -> set[int]:
    return {number for value in values if (number := json_access.reference(value)) is not None}


def _restored(document: Document, primitive: JsonObject, note: GradientNote, place: Place) -> JsonObject:
    """Return the JSON of the primitive without bake's attributes and metadata, with its own influences."""
    attributes = dict(json_access.member(primitive, "attributes", place))
    _remove(document, attributes, note, place)
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
        document.notices.tell(Notice("tangents-kept", message, place))
    if former is not None:
        attributes = former_sets(attributes, note)
    ours = json_access.member(primitive, "attributes", place).keys() - attributes.keys()
    # The former order of the attributes, if bake removed some and noted it.
    attributes = {**attributes, **(former or {}), **(tangent or {})}
    noted = note.former_attributes or ()
    order = [*(name for name in noted if name in attributes), *attributes]
    attributes = {name: attributes[name] for name in order}
    written = {**primitive, "attributes": attributes} if "attributes" in primitive else dict(primitive)
    if draco.extension_of(primitive) is not None:
        extension = dict(draco.extension_of(primitive) or {})
        if before is not None and former is not None and tangent is not None:
            extension = dict(draco.extension_of(before) or {})
        else:  # the stream of the bake stays, and no longer has what is ours
            inside = json_access.member(extension, "attributes", place)
            extension["attributes"] = {name: number for name, number in inside.items() if name not in ours}
            extension = without_note(extension)
        written["extensions"] = {**primitive["extensions"], draco.EXTENSION: extension}
    written = without_note(written)  # unless it is that of an accessor
    if former is None:
        message = "another tool has removed or edited the influences from before the bake: "
        if note.former_attributes is not None:
            code, is_extended = "limited-kept", former_sets(attributes, note) != attributes
            option = "--neighbours extend added" if is_extended else "--limit-influences left"
            message += f"the influences that {option} stay, with adopted joints among them"
        else:
            code = "adopted-kept"
            message += (
                "joints that bake adopted stay, with weights too small to see. A bake takes them for the "
                "file's own: bake from the source instead"
            )
        document.notices.tell(Notice(code, message, place))
    return written


def _set_number(name: str) -> int:
    """Return the number of a set of texture coordinates, −1 for another attribute."""
    number = name.removeprefix("TEXCOORD_")
    return int(number) if number != name and number.isdecimal() and len(number) < 9 else -1


def _remove(document: Document, attributes: JsonObject, note: GradientNote, place: Place) -> None:
    """Remove bake's additions from the attributes; tell if some can no longer be recognised.

    A damaged note may name any attribute. One that no bake adds stays. So does what later attributes need: a
    NORMAL before a TANGENT, and texture coordinates before others, which would leave a gap.
    """
    names, is_texcoord = note.added_slot_names, note.layout == Layout.TEXCOORD
    missing = [name for name in names if name not in attributes]
    doubtful = is_texcoord and missing and len(missing) < len(names)
    generated = [name for name in note.generated if name == "NORMAL"]
    order = list(attributes)
    if "TANGENT" in order and "NORMAL" in order and order.index("TANGENT") > order.index("NORMAL"):
        generated = []  # a tool has added TANGENT since the bake
    last = max((_set_number(name) for name in names), default=-1)
    if is_texcoord and any(_set_number(name) > last for name in attributes):
        message = f"another tool has added texture coordinates behind {names[-1]}: α and β stay before them"
        document.notices.tell(Notice("texcoords-kept", message, place, len(names) - len(missing)))
        return
    for name in [*(() if doubtful else names), *note.blend_names, *generated]:
        attributes.pop(name, None)
    if doubtful:
        message = (
            f"α and β were in {names[0]} to {names[-1]}, but {', '.join(missing)} are missing: the "
            "other sets stay, because they may hold texture coordinates now"
        )
        document.notices.tell(Notice("texcoords-kept", message, place, len(names) - len(missing)))


def _without(
    document: Document, root: JsonObject, removed: Set[int], streams: Set[int], back: Set[int]
) -> Document:
    """Return the document without the accessors, and without buffer views and bytes that only they used.

    streams are the buffer views of Draco streams that no primitive uses now, back are accessors from before
    the bake that are attributes again.
    """
    accessors, views = document.objects("accessors"), document.objects("bufferViews")
    tail = _tail_of_bake(document, root, removed, streams)
    if tail is None:
        message = (
            "another tool has rearranged the file since its bake: the data of the bake stays in the file, "
            "unused"
        )
        document.notices.tell(Notice("bytes-left", message, document.place))
        return document.edited(json=_with_own_views(document, root, back))
    first, undo, start = tail
    put_back(root, "accessors", accessors[: len(accessors) - len(removed)])
    put_back(root, "bufferViews", views[:first])
    # The document with the buffers as they were before the bake.
    buffers = list(document.objects("buffers"))
    buffers = buffers[: len(buffers) - undo.fallback_added]
    if undo.added:
        uri = buffers.pop().get("uri")
        put_back(root, "buffers", buffers)
        new_files = {name: pieces for name, pieces in document.new_files.items() if name != uri}
        return document.edited(json=root, new_files=new_files)
    root["buffers"] = [{**buffers[0], "byteLength": undo.byte_length}, *buffers[1:]]
    binary = memoryview(joined(document.binary or ()))
    return document.edited(json=root, binary=(binary[:start],))


def _with_own_views(document: Document, root: JsonObject, numbers: Set[int]) -> JsonObject:
    """Return the JSON with a buffer view for each attribute that shares one without byteStride.

    glTF wants a stride where attributes share a view. Tools put accessors that no primitive used, as those
    from before a bake, into views without one.
    """
    accessors, views = list(document.objects("accessors")), list(document.objects("bufferViews"))
    users = Counter(json_access.reference(accessor.get("bufferView")) for accessor in accessors)
    for number in sorted(numbers):
        accessor = accessors[number]
        place, at = document.place.at(f"accessor {number}"), json_access.reference(accessor.get("bufferView"))
        if at is None or users[at] < 2 or not {"byteStride", "extensions"}.isdisjoint(views[at]):
            continue
        start = integer(views[at], "byteOffset", place, default=0)
        start += integer(accessor, "byteOffset", place, default=0)
        size = document.asset.accessors[number].described(place)[1]
        views.append({"buffer": views[at]["buffer"], "byteOffset": start, "byteLength": size})
        kept = {key: value for key, value in accessor.items() if key != "byteOffset"}
        accessors[number] = {**kept, "bufferView": len(views) - 1}
    return {**root, "accessors": accessors, "bufferViews": views} if views else root


def _tail_of_bake(
    document: Document, root: JsonObject, removed: Set[int], streams: Set[int]
) -> tuple[int, BufferNote, int] | None:
    """Return the first buffer view of the bake, its note, and the first byte of its data in the BIN chunk.

    None if the end of the document does not belong to the bake alone: other tools renumber accessors, put
    several into one buffer view, and append. root is the JSON without the bake, but for its accessors, views
    and buffers. What it still needs stays.
    """
    accessors, views = document.objects("accessors"), document.objects("bufferViews")
    buffers = document.objects("buffers")
    # The accessors and the views of the bake must be the last ones, and nothing else may use them.
    kept = len(accessors) - len(removed)
    ours = views_in_use([accessors[number] for number in removed if number < len(accessors)]) | streams
    first = len(views) - len(ours)
    are_last = removed == set(range(kept, len(accessors))) and ours == set(range(first, len(views)))
    if not removed or not ours or not are_last:
        return None
    undo = buffer_note(views[first])
    rest = {**root, "accessors": accessors[:kept], "bufferViews": views[:first]}
    if undo is None or not ours.isdisjoint(views_in_use(rest)):
        return None
    # So must be the buffers, or the part of one, that are cut off.
    last = len(buffers) - undo.fallback_added
    whole = last - undo.added  # buffers from here on are removed
    if any(whole <= buffer < len(buffers) for buffer in buffers_in_use(rest)):
        return None
    added = [data for view in views[first:] for data in _stored_ranges(view, document.place)]
    if undo.added:
        return (first, undo, 0) if all(buffer >= whole for buffer, _, _ in added) else None
    start = min((begin for buffer, begin, _ in added if buffer == 0), default=0)
    # Views may have moved. The buffer gets its former length, and must hold all views that stay.
    length = undo.byte_length or 0
    is_free = (
        document.has_binary_buffer
        and 0 < length <= start <= len(joined(document.binary or ()))
        and not any(0 < buffer < last for buffer, _, _ in added)
    )
    stay = (
        [data for view in views[:first] for data in _stored_ranges(view, document.place)] if is_free else []
    )
    is_free &= all(end <= length for buffer, _, end in stay if buffer == 0)
    return (first, undo, start) if is_free else None


def _stored_ranges(view: JsonObject, place: Place) -> Iterator[tuple[int, int, int]]:
    """Yield (buffer, start, end) of the bytes of a buffer view, and of its compressed bytes."""
    for holder in meshopt.ranges_of(view, place):
        start = integer(holder, "byteOffset", place, default=0)
        yield integer(holder, "buffer", place), start, start + integer(holder, "byteLength", place)
