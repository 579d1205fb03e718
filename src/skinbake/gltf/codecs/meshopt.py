"""Buffer views compressed by meshoptimizer: EXT_meshopt_compression, and KHR_meshopt_compression after it.

Both store the same codecs; the latter adds version 1 of the attribute codec and the COLOR filter. Which of
the two a file says makes no difference to reading it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from skinbake.errors import InputError, Place
from skinbake.gltf.codecs.meshopt_filters import unfiltered
from skinbake.gltf.json_access import JsonObject, integer, member, text

KHRONOS, VENDOR = "KHR_meshopt_compression", "EXT_meshopt_compression"
EXTENSIONS = (KHRONOS, VENDOR)

ATTRIBUTES, TRIANGLES, INDICES = "ATTRIBUTES", "TRIANGLES", "INDICES"
STRIDES_OF_FILTERS: dict[str, tuple[int, ...]] = {
    "NONE": tuple(range(4, 257, 4)),
    "OCTAHEDRAL": (4, 8),
    "QUATERNION": (8,),
    "EXPONENTIAL": tuple(range(4, 257, 4)),
    "COLOR": (4, 8),
}
USUAL_LEVEL, HIGHEST_LEVEL = 2, 3
"""How hard meshopt compresses where nothing else is asked for, and at most; 0 is the fastest."""

CODEC_VERSIONS = {VENDOR: 0, KHRONOS: 1}

EXPANSION = 1024
"""Bytes that one byte of the attribute codec can stand for at most.

Version 1 spends at least 2 bits on a run of one byte of up to 256 elements; version 0 at least 2 bits on
one of 16. The index codecs spend a byte on a triangle or index at least. The decoder sets all memory aside
before it looks at the data, so the count has to be held against its length first.
"""


@dataclass(frozen=True, slots=True)
class Packing:
    """How one buffer view is compressed: ``count`` elements of ``stride`` bytes, by mode and filter."""

    mode: str
    filter: str
    count: int
    stride: int


def extension_of(holder: JsonObject, place: Place) -> str | None:
    """Return which of the two extensions a buffer view or buffer has, None where it has neither."""
    extensions = member(holder, "extensions", place)
    return next((name for name in EXTENSIONS if name in extensions), None)


def is_fallback(buffer: JsonObject, place: Place) -> bool:
    """Tell whether a buffer only says how long the decompressed data would be."""
    name = extension_of(buffer, place)
    extension = {} if name is None else member(member(buffer, "extensions", place), name, place)
    return extension.get("fallback") is True


def packing(view: JsonObject, name: str, what: str, place: Place) -> Packing:
    """Return how a buffer view is compressed.

    Raises InputError where the extension's members contradict each other or the view, after the extension's
    specification. ``what`` is what messages call the view.
    """
    extension = member(member(view, "extensions", place), name, place)
    mode, chosen = text(extension, "mode", place), text(extension, "filter", place) or "NONE"
    count = integer(extension, "count", place, minimum=1)
    stride = integer(extension, "byteStride", place, minimum=1)
    found = f"the {name} of {what} says mode {mode!r}, filter {chosen!r}, byteStride {stride}, count {count}"
    if mode == ATTRIBUTES:
        allowed = STRIDES_OF_FILTERS.get(chosen, ())
    else:
        allowed = (2, 4) if mode in {TRIANGLES, INDICES} and chosen == "NONE" else ()
    if stride not in allowed or (mode == TRIANGLES and count % 3):
        raise InputError(f"{found}, which contradict each other", place)
    length = integer(view, "byteLength", place, minimum=1)
    if count * stride != length:
        raise InputError(f"{found}: that is {count * stride} bytes, but its byteLength is {length}", place)
    return Packing(str(mode), chosen, count, stride)


def check_length(data: memoryview, packing: Packing, what: str, place: Place) -> None:
    """Raise InputError where compressed data is too short for what it should hold, whatever it says."""
    least = packing.count * packing.stride // EXPANSION if packing.mode == ATTRIBUTES else packing.count // 3
    if len(data) < least:
        raise InputError(
            f"{what} has {len(data)} bytes for {packing.count} elements of {packing.stride} bytes, "
            f"but its codec needs at least {least}",
            place,
        )


def decoded(data: memoryview, packing: Packing, what: str, place: Place) -> memoryview:
    """Return the bytes that compressed ``data`` stands for, its filter undone.

    Its length must have been checked. Raises InputError where it is malformed. Over 4,000 cut or
    altered streams of real files the decoder never read past the end nor crashed: it checks every length.
    """
    import meshopt

    mode: Any = packing.mode
    try:
        values = meshopt.decode_gltf_buffer(bytes(data), packing.count, packing.stride, mode)
    except ValueError as error:
        raise InputError(f"{what} cannot be decoded: {error}", place) from error
    if packing.mode == ATTRIBUTES:
        values = unfiltered(np.ascontiguousarray(values), packing.filter)
    return np.ascontiguousarray(values).data.cast("B")


def level_of(asked: int | None) -> int:
    """Return the codec's level for one of 0 to 10, None for the usual one."""
    return USUAL_LEVEL if asked is None else min(asked, HIGHEST_LEVEL)


def encoded(values: npt.NDArray[Any], mode: str, name: str, level: int) -> tuple[bytes, str]:
    """Return an array compressed without loss, for a view of the extension ``name``, and the mode it took.

    values: attributes (V, components), elements a multiple of 4 bytes long, or triangles (3 T, 1) uint16 or
    uint32. level is 0 (fast) to 3 (small) and matters to attributes alone. Triangles are stored as a plain
    sequence of indices where their own codec would begin some of them at another corner.
    """
    import meshopt

    data = np.ascontiguousarray(values)
    if mode == ATTRIBUTES:
        return bytes(meshopt.encode_vertex_buffer_level(data, level, CODEC_VERSIONS[name])), mode
    indices, size = data.reshape(-1), data.dtype.itemsize
    if len(indices) % 3 == 0:
        compressed = bytes(meshopt.encode_index_buffer(indices))
        if np.array_equal(meshopt.decode_index_buffer(compressed, len(indices), size), indices):
            return compressed, TRIANGLES
    return bytes(meshopt.encode_index_sequence(indices)), INDICES
