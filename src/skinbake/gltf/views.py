"""The bytes of buffer views, decompressed if meshopt compressed them (glTF 2.0, §3.6.2)."""

from __future__ import annotations

from skinbake.errors import InputError, Place
from skinbake.gltf.codecs import meshopt
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject, index, integer


def view_bytes(document: Document, view_index: int, place: Place) -> memoryview:
    """Return the bytes of one buffer view, decoded if meshopt compressed them.

    Raises InputError if the view does not fit its buffer, or cannot be decoded.
    """
    view = document.objects("bufferViews")[view_index]
    if meshopt.extension_of(view, place) is None:
        return stored_bytes(document, view, f"buffer view {view_index}", place)
    known = document.derived.setdefault("views", {})
    if view_index not in known:
        known[view_index] = _decompressed(document, view_index, view, place)
    found: memoryview = known[view_index]
    return found


def stored_bytes(document: Document, holder: JsonObject, what: str, place: Place) -> memoryview:
    """Return the stored bytes that ``buffer``, ``byteOffset`` and ``byteLength`` of an object name.

    ``what`` names the object in messages.
    """
    buffer_index = index(holder, "buffer", len(document.objects("buffers")), place)
    if buffer_index is None:
        raise InputError(f"{what} names no buffer", place)
    start = integer(holder, "byteOffset", place, default=0)
    length = integer(holder, "byteLength", place, minimum=1)
    data = document.buffer(buffer_index)
    if start + length > len(data):
        raise InputError(
            f"{what} ends at byte {start + length} of buffer {buffer_index}, which has {len(data)}", place
        )
    return data[start : start + length]


def _decompressed(document: Document, view_index: int, view: JsonObject, place: Place) -> memoryview:
    name = str(meshopt.extension_of(view, place))
    packing = meshopt.packing(view, name, f"buffer view {view_index}", place)
    what = f"the {name} of buffer view {view_index}"
    data = stored_bytes(document, view["extensions"][name], what, place)
    meshopt.check_length(data, packing, what, place)
    document.budget.claim_unpacked(packing.count * packing.stride, len(data), place)
    return meshopt.decoded(data, packing, what, place)
