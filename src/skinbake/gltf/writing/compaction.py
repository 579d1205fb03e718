"""Remove unreferenced bytes from the buffers of a document, and renumber its buffer views and buffers."""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Callable, Sequence
from itertools import accumulate
from typing import Any

from skinbake.errors import InputError, Place
from skinbake.gltf import resources
from skinbake.gltf.codecs import meshopt
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject, index, integer, names, reference
from skinbake.gltf.writing.additions import content_digest
from skinbake.gltf.writing.references import VIEW, views_in_use

Range = tuple[int, int]
Shift = Callable[[int], int]

ALIGNMENT = 4
"""Removed ranges are multiples of this many bytes, so that all later bytes stay aligned."""

OTHER_REFERENCES = ("EXT_structural_metadata", "EXT_mesh_features", "MSFT_texture_dds")
"""Extensions that may name buffer views by other keys: no view is removed in a file that uses them."""


def compacted(before: Document, after: Document) -> Document:
    """Return ``after`` without the buffer views that only ``before`` used, and without their bytes.

    Bytes that no view of ``before`` referred to stay. A buffer that becomes unused goes too, except the BIN
    chunk.
    """
    old, views = before.objects("bufferViews"), after.objects("bufferViews")
    used = set(names(after.json, "extensionsUsed", after.place))
    dropped = views_in_use(before.json) - views_in_use(after.json)
    if used & set(OTHER_REFERENCES):
        dropped = set()
    kept = [number for number in range(len(views)) if number not in dropped]
    needed = _by_buffer(after, [views[number] for number in kept])
    changed = [old[number] for number in range(len(old)) if number in dropped or old[number] != views[number]]
    # Fallback buffers of meshopt have no bytes.
    buffers = after.objects("buffers")
    chunk = 0 if after.has_binary_buffer else None
    holes = {
        buffer: _difference(ranges, needed.get(buffer, []))
        for buffer, ranges in _by_buffer(before, changed).items()
        if buffer == chunk or buffers[buffer].get("uri") is not None or buffer not in needed
    }
    gone = {buffer for buffer in holes if buffer not in needed and buffer != chunk}
    # A copy of the JSON with new numbers in its references to buffer views.
    numbers = {number: position for position, number in enumerate(kept)}
    result: JsonObject = {}
    left: list[tuple[Any, Any]] = [(after.json, result)]
    while left:
        node, copy = left.pop()
        for key, value in node.items() if isinstance(node, dict) else enumerate(node):
            if isinstance(value, dict):
                copy[key] = {}
                left.append((value, copy[key]))
            elif isinstance(value, list):
                copy[key] = [None] * len(value)
                left.append((value, copy[key]))
            else:
                number = reference(value) if key == VIEW else None
                copy[key] = value if number is None else numbers.get(number, value)
    root = result
    shifts = {buffer: shift_of(ranges) for buffer, ranges in holes.items()}
    lower = sorted(gone)
    root["bufferViews"] = [_moved(views[number], shifts, lower, after.place) for number in kept]
    return _cut(after, root, holes, gone)


def _by_buffer(document: Document, views: Sequence[JsonObject]) -> dict[int, list[Range]]:
    found: dict[int, list[Range]] = defaultdict(list)
    place, count = document.place, len(document.objects("buffers"))
    for view in views:
        for holder in meshopt.ranges_of(view, place):
            start = integer(holder, "byteOffset", place, default=0)
            length = integer(holder, "byteLength", place)
            buffer = index(holder, "buffer", count, place)
            if buffer is None:  # pragma: no cover: refused before: tests/gltf/test_compression.py
                raise InputError("a buffer view names no buffer", place)
            found[buffer].append((start, start + length))
    return found


def _difference(ranges: list[Range], needed: list[Range]) -> list[Range]:
    """Return the parts of ``ranges`` outside ``needed``, in order, each shrunk to aligned ends."""
    borders = sorted(
        [(start, 0, 1) for start, _ in ranges]
        + [(end, 0, -1) for _, end in ranges]
        + [(start, 1, 1) for start, _ in needed]
        + [(end, 1, -1) for _, end in needed]
    )
    depth = [0, 0]
    holes: list[Range] = []
    for (position, kind, step), following in zip(borders, [*borders[1:], (0, 0, 0)], strict=True):
        depth[kind] += step
        if depth[0] > 0 and depth[1] == 0 and following[0] > position:
            holes.append((position, following[0]))
    merged: list[Range] = []
    for start, end in holes:
        if merged and merged[-1][1] == start:
            merged[-1] = (merged[-1][0], end)
        else:
            merged.append((start, end))
    aligned = ((-(-start // ALIGNMENT) * ALIGNMENT, end // ALIGNMENT * ALIGNMENT) for start, end in merged)
    return [(start, end) for start, end in aligned if start < end]


def shift_of(holes: list[Range]) -> Shift:
    """Return what tells by which distance the byte at a position moves back, if there are these holes."""
    starts = [begin for begin, _ in holes]
    lengths = list(accumulate((end - begin for begin, end in holes), initial=0))
    return lambda position: lengths[bisect_left(starts, position)]


def _moved(view: JsonObject, shifts: dict[int, Shift], gone: list[int], place: Place) -> JsonObject:
    """Return a buffer view at its new place; ``gone`` are the numbers of removed buffers, ascending."""

    def placed(holder: JsonObject) -> JsonObject:
        buffer, start = integer(holder, "buffer", place), integer(holder, "byteOffset", place, default=0)
        shift = shifts[buffer](start) if buffer in shifts else 0
        moved = {**holder, "buffer": buffer - bisect_left(gone, buffer)}
        return {**moved, "byteOffset": start - shift} if shift else moved

    result = placed(view)
    for name in meshopt.extensions_of(view, place):
        result["extensions"] = {**result["extensions"], name: placed(view["extensions"][name])}
    return result


def _cut(document: Document, root: JsonObject, holes: dict[int, list[Range]], gone: set[int]) -> Document:
    """Return the document without the holes in its buffers, and without the buffers in ``gone``."""
    buffers: list[JsonObject] = []
    binary, new_files = document.binary, dict(document.new_files)
    for number, buffer in enumerate(document.objects("buffers")):
        if number in gone:
            new_files.pop(str(buffer.get("uri")), None)
            continue
        if not holes.get(number):
            buffers.append(buffer)
            continue
        data = document.buffer(number)
        starts = [0, *(end for _, end in holes[number])]
        ends = [*(start for start, _ in holes[number]), len(data)]
        pieces = [data[start:end] for start, end in zip(starts, ends, strict=True) if start < end]
        length = sum(len(piece) for piece in pieces)
        uri = buffer.get("uri")
        if uri is None:
            padding = bytes(-length % ALIGNMENT)
            binary = (*pieces, padding) if padding else tuple(pieces)
            buffers.append({**buffer, "byteLength": length})
        elif resources.is_data_uri(uri):
            text = resources.encode_data_uri(b"".join(pieces))
            buffers.append({**buffer, "uri": text, "byteLength": length})
        else:
            name = uri if uri in new_files else f"skinbake-{content_digest(tuple(pieces))}.bin"
            new_files[name] = tuple(pieces)
            buffers.append({**buffer, "uri": name, "byteLength": length})
    return document.edited(json={**root, "buffers": buffers}, binary=binary, new_files=new_files)
