"""The bytes of buffer views, decompressed if meshopt compressed them.

Source: glTF 2.0, §3.6.2.
"""

from __future__ import annotations

from skinbake.errors import InputError, Place
from skinbake.gltf.budget import Work
from skinbake.gltf.codecs import meshopt
from skinbake.gltf.document import Document, once_a_document
from skinbake.gltf.json_access import JsonObject, index, integer
from skinbake.gltf.resources import is_data_uri


@once_a_document
def view_bytes(document: Document, view_index: int, place: Place) -> memoryview:
    """Return the bytes of one buffer view, decoded once if meshopt compressed them.

    Raises InputError if the view does not fit its buffer, or cannot be decoded.
    """
    view = document.objects("bufferViews")[view_index]
    name = meshopt.extension_of(view, place)
    if name is None:
        return stored_bytes(document, view, f"buffer view {view_index}", place)
    packing = meshopt.packing(view, name, f"buffer view {view_index}", place)
    what = f"the {name} of buffer view {view_index}"
    data = stored_bytes(document, view["extensions"][name], what, place)
    meshopt.check_length(data, packing, what, place)
    size = packing.count * packing.stride
    document.budget.claim(Work(bytes=size, unpacked=size, packed=len(data)), "compressed data", place)
    return meshopt.decoded(data, packing, what, place)


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


def bytes_beside(document: Document) -> int:
    """Return the bytes of the buffers that lie in files beside a document."""
    beside = [
        number
        for number, buffer in enumerate(document.objects("buffers"))
        if isinstance(uri := buffer.get("uri"), str)
        and not is_data_uri(uri)
        and not meshopt.is_fallback(buffer, document.place)
    ]
    return sum(len(document.buffer(number)) for number in beside)
